//! Deflate (RFC 1951) of arrays that consist of runs: heights of buildings, of which a row repeats its
//! last value or the row above over long stretches.
//!
//! A general compressor hashes every few bytes to find out what a rasteriser knows: where values change. Two
//! distances are enough, the size of an element and that of a row, and the ends of runs tell how far each
//! goes, so that the bytes themselves are only needed for their checksum. On tiles of San Jose this takes a
//! fraction of the time of zlib-rs, for fewer bytes (`benches/RESULTS.md`); libdeflate is slower there. The
//! output depends on the array alone.

/// Longest match of the format, and the shortest.
const LONGEST: usize = 258;
const SHORTEST: usize = 3;
/// Farthest that a match may reach back.
const WINDOW: usize = 1 << 15;
/// Symbol that ends a block, and that of the shortest match.
const END: usize = 256;
const FIRST_LENGTH: usize = 257;
/// Longest code of a symbol, and of a code length.
const MAX_BITS: usize = 15;
const MAX_LENGTH_BITS: usize = 7;
/// The order in which the header has the lengths of the codes for code lengths.
const HEADER_ORDER: [usize; 19] =
    [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];

/// A literal byte, or a match.
#[derive(Clone, Copy)]
enum Token {
    Literal(u8),
    /// Its length, and whether it reaches back a row rather than an element.
    Match(u16, bool),
}

/// Cells of a row up to `end` that have one value, of which the first bytes of an element count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Segment {
    pub(crate) end: usize,
    pub(crate) value: [u8; 4],
}

/// A deflated file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Deflated {
    pub(super) bytes: Vec<u8>,
    /// Of the file as it was.
    pub(super) crc32: u32,
    pub(super) length: usize,
}

/// Deflates an array row by row, behind a header.
pub(crate) struct RowDeflater {
    cells: usize,
    element: usize,
    tokens: Vec<Token>,
    /// A match that the next cells may make longer: its bytes, and whether it reaches back a row.
    pending: (usize, bool),
    /// The row before, as segments and as bytes, once there is one.
    previous: Vec<Segment>,
    line: Vec<u8>,
    crc32: crc32fast::Hasher,
    length: usize,
}

impl RowDeflater {
    /// For rows of so many cells, each an element of 1 to 4 bytes.
    pub(crate) fn new(header: &[u8], cells: usize, element: usize) -> Self {
        let mut crc32 = crc32fast::Hasher::new();
        crc32.update(header);
        Self {
            cells,
            element,
            tokens: header.iter().map(|&byte| Token::Literal(byte)).collect(),
            pending: (0, false),
            previous: Vec::new(),
            line: vec![0; cells * element],
            crc32,
            length: header.len(),
        }
    }

    /// Adds a row: segments that follow each other from its first to its last cell, neighbours with different
    /// values.
    pub(crate) fn row(&mut self, segments: &[Segment]) {
        let (element, reaches) = (self.element, self.cells * self.element <= WINDOW);
        let mut last = self.previous.last().map(|segment| segment.value);
        let previous = std::mem::take(&mut self.previous);
        let above = if reaches { &previous[..] } else { &[] };
        let (mut at, mut here, mut there) = (0, 0, 0);
        while at < self.cells {
            while segments[here].end <= at {
                here += 1;
            }
            while above.get(there).is_some_and(|segment| segment.end <= at) {
                there += 1;
            }
            let Segment { end, value } = segments[here];
            let along = if last == Some(value) { end - at } else { 0 };
            let above = common(&segments[here..], &above[there..], at);
            let (cells, is_above) = if above > along { (above, true) } else { (along, false) };
            if cells * element >= SHORTEST {
                self.extend(cells * element, is_above);
                at += cells;
            } else {
                self.end_match();
                self.tokens.extend(value[..element].iter().map(|&byte| Token::Literal(byte)));
                at += 1;
            }
            last = Some(value_before(segments, here, at));
        }
        if *previous != *segments {
            let mut at = 0;
            for &Segment { end, value } in segments {
                match element {
                    4 => self.line[at * 4..end * 4].as_chunks_mut().0.fill(value),
                    1 => self.line[at..end].fill(value[0]),
                    _ => {
                        let cells =
                            self.line[at * element..end * element].chunks_exact_mut(element);
                        cells.for_each(|cell| cell.copy_from_slice(&value[..element]));
                    }
                }
                at = end;
            }
        }
        self.crc32.update(&self.line);
        self.length += self.line.len();
        self.previous = previous;
        self.previous.clear();
        self.previous.extend(segments);
    }

    /// Makes a match longer, or begins one.
    fn extend(&mut self, bytes: usize, above: bool) {
        if self.pending.1 != above {
            self.end_match();
        }
        self.pending = (self.pending.0 + bytes, above);
    }

    fn end_match(&mut self) {
        let (mut left, above) = std::mem::take(&mut self.pending);
        while left > 0 {
            let most = left.min(LONGEST);
            // What is left must be long enough for a match too.
            let rest = left - most;
            let now = if rest > 0 && rest < SHORTEST { most - SHORTEST } else { most };
            self.tokens.push(Token::Match(now as u16, above));
            left -= now;
        }
    }

    /// The deflated file.
    pub(crate) fn finish(mut self) -> Deflated {
        self.end_match();
        let bytes = encode(&self.tokens, self.element, self.cells * self.element);
        Deflated { bytes, crc32: self.crc32.finalize(), length: self.length }
    }
}

/// A file that is not looked at closely, since it is small.
pub(crate) fn deflate_small(bytes: &[u8]) -> Deflated {
    RowDeflater::new(bytes, 0, 1).finish()
}

/// The value of the cell before `at`, which lies in the segment `here` or begins the next one.
fn value_before(segments: &[Segment], here: usize, at: usize) -> [u8; 4] {
    let holds = |segment: &&Segment| segment.end >= at;
    segments[here..].iter().find(holds).map_or([0; 4], |segment| segment.value)
}

/// Cells from `at` on that two rows have in common.
fn common(one: &[Segment], other: &[Segment], at: usize) -> usize {
    let (mut ones, mut others) = (one.iter(), other.iter());
    let (mut a, mut b, mut end) = (ones.next(), others.next(), at);
    while let (Some(here), Some(there)) = (a, b)
        && here.value == there.value
    {
        end = here.end.min(there.end);
        if here.end == end {
            a = ones.next();
        }
        if there.end == end {
            b = others.next();
        }
    }
    end - at
}

/// One block, the last one, with codes of its own.
fn encode(tokens: &[Token], element: usize, row: usize) -> Vec<u8> {
    let distances = [Distance::of(element), Distance::of(row.clamp(1, WINDOW))];
    let (mut symbols, mut reaches) = ([0_u32; 286], [0_u32; 30]);
    symbols[END] = 1;
    for token in tokens {
        match *token {
            Token::Literal(byte) => symbols[usize::from(byte)] += 1,
            Token::Match(length, above) => {
                symbols[LENGTHS[usize::from(length)].symbol] += 1;
                reaches[distances[usize::from(above)].symbol] += 1;
            }
        }
    }
    let (symbols, reaches) = (Code::of(&symbols, MAX_BITS), Code::of(&reaches, MAX_BITS));
    let mut out = Bits::default();
    out.put(0b101, 3);
    write_codes(&mut out, &symbols, &reaches);
    let lengths = LENGTHS.map(|Length { symbol, extra, bits }| symbols.with(symbol, extra, bits));
    let reaches =
        distances.map(|Distance { symbol, extra, bits }| reaches.with(symbol, extra, bits));
    for token in tokens {
        match *token {
            Token::Literal(byte) => out.put_code(&symbols, usize::from(byte)),
            Token::Match(length, above) => {
                let (bits, count) = lengths[usize::from(length)];
                out.put(bits, count);
                let (bits, count) = reaches[usize::from(above)];
                out.put(bits, count);
            }
        }
    }
    out.put_code(&symbols, END);
    out.finish()
}

/// How a match's length is written.
#[derive(Clone, Copy)]
struct Length {
    symbol: usize,
    extra: u16,
    bits: u32,
}

/// Lengths up to [`LONGEST`] (RFC 1951, 3.2.5).
static LENGTHS: [Length; LONGEST + 1] = lengths();

const fn lengths() -> [Length; LONGEST + 1] {
    let mut lengths = [Length { symbol: 0, extra: 0, bits: 0 }; LONGEST + 1];
    let (mut symbol, mut length) = (FIRST_LENGTH, SHORTEST);
    while length <= LONGEST {
        // Eight symbols without extra bits, then four with each number of bits.
        let bits = if symbol < FIRST_LENGTH + 8 { 0 } else { (symbol - FIRST_LENGTH) / 4 - 1 };
        let mut extra = 0;
        while extra < 1 << bits && length <= LONGEST {
            lengths[length] = Length { symbol, extra: extra as u16, bits: bits as u32 };
            (extra, length) = (extra + 1, length + 1);
        }
        symbol += 1;
    }
    // The longest has a symbol of its own.
    lengths[LONGEST] = Length { symbol: 285, extra: 0, bits: 0 };
    lengths
}

/// How a distance is written.
#[derive(Clone, Copy)]
struct Distance {
    symbol: usize,
    extra: u16,
    bits: u32,
}

impl Distance {
    /// Of 1 to [`WINDOW`] bytes.
    fn of(distance: usize) -> Self {
        let offset = distance - 1;
        if offset < 4 {
            return Self { symbol: offset, extra: 0, bits: 0 };
        }
        let bits = offset.ilog2() - 1;
        let half = (offset >> bits) & 1;
        let extra = (offset & ((1 << bits) - 1)) as u16;
        Self { symbol: 2 * bits as usize + 2 + half, extra, bits }
    }
}

/// A prefix code: of each symbol its length, 0 for one that does not occur, and its bits, the first lowest.
struct Code {
    lengths: Vec<u8>,
    bits: Vec<u16>,
}

impl Code {
    /// Huffman's code, limited to `limit` bits, of symbols that occur so often.
    fn of(counts: &[u32], limit: usize) -> Self {
        let mut weights: Vec<u64> = counts.iter().map(|&count| count.into()).collect();
        let lengths = loop {
            let lengths = huffman(&weights);
            if lengths.iter().all(|&length| usize::from(length) <= limit) {
                break lengths;
            }
            // Rare symbols come closer to the others until the tree is flat enough.
            for weight in weights.iter_mut().filter(|weight| **weight > 0) {
                *weight = weight.div_ceil(2) + 1;
            }
        };
        let mut next = [0_u16; MAX_BITS + 2];
        for &length in lengths.iter().filter(|length| **length > 0) {
            next[usize::from(length) + 1] += 1;
        }
        for length in 1..=MAX_BITS {
            next[length] = (next[length] + next[length - 1]) << 1;
        }
        let bits = lengths.iter().map(|&length| {
            let code = &mut next[usize::from(length)];
            let bits = if length > 0 { code.reverse_bits() >> (16 - length) } else { 0 };
            *code += u16::from(length > 0);
            bits
        });
        Self { bits: bits.collect(), lengths }
    }

    /// A symbol's code with extra bits behind it, and how many these are together.
    fn with(&self, symbol: usize, extra: u16, bits: u32) -> (u64, u32) {
        let length = u32::from(self.lengths[symbol]);
        (u64::from(self.bits[symbol]) | u64::from(extra) << length, length + bits)
    }

    /// How many symbols there are up to the last that occurs, at least `least`.
    fn used(&self, least: usize) -> usize {
        let last = self.lengths.iter().rposition(|&length| length > 0);
        last.map_or(0, |last| last + 1).max(least)
    }
}

/// Lengths of Huffman's code; a single symbol has one bit.
fn huffman(weights: &[u64]) -> Vec<u8> {
    let mut lengths = vec![0; weights.len()];
    let mut leaves: Vec<usize> = (0..weights.len()).filter(|&at| weights[at] > 0).collect();
    if let [only] = leaves[..] {
        lengths[only] = 1;
    }
    leaves.sort_by_key(|&at| (weights[at], at));
    // Nodes in the order of their weights: leaves from one queue, pairs from another.
    let mut pairs: Vec<(u64, [usize; 2])> = Vec::new();
    let (mut next_leaf, mut next_pair) = (0, 0);
    while leaves.len() - next_leaf + pairs.len() - next_pair > 1 {
        let mut take = || {
            let leaf = leaves.get(next_leaf).map(|&at| (weights[at], at));
            match pairs.get(next_pair) {
                Some(&(pair, _)) if leaf.is_none_or(|(leaf, _)| leaf > pair) => {
                    next_pair += 1;
                    (pair, weights.len() + next_pair - 1)
                }
                _ => {
                    next_leaf += 1;
                    leaf.expect("one of the two is left")
                }
            }
        };
        let (one, other) = (take(), take());
        pairs.push((one.0 + other.0, [one.1, other.1]));
    }
    // From the root down, each pair's children are one bit longer.
    let mut depths = vec![0_u8; pairs.len()];
    for at in (0..pairs.len()).rev() {
        let depth = depths[at].saturating_add(1);
        for child in pairs[at].1 {
            match child.checked_sub(weights.len()) {
                Some(pair) => depths[pair] = depth,
                None => lengths[child] = depth,
            }
        }
    }
    lengths
}

/// The header of a block: the lengths of both codes, themselves coded, with runs of zeros in one symbol.
fn write_codes(out: &mut Bits, symbols: &Code, reaches: &Code) {
    let (count, reach_count) = (symbols.used(FIRST_LENGTH), reaches.used(1));
    let lengths = [&symbols.lengths[..count], &reaches.lengths[..reach_count]].concat();
    // Symbol, extra value, bits of it.
    let mut coded: Vec<(usize, u64, u32)> = Vec::new();
    for same in lengths.chunk_by(|a, b| a == b) {
        let mut left = same.len();
        while left > 0 {
            let (symbol, now) = match (same[0], left) {
                (0, 11..) => ((18, left.min(138) as u64 - 11, 7), left.min(138)),
                (0, 3..) => ((17, left as u64 - 3, 3), left),
                (length, _) => ((usize::from(length), 0, 0), 1),
            };
            coded.push(symbol);
            left -= now;
        }
    }
    let mut counts = [0_u32; 19];
    for &(symbol, ..) in &coded {
        counts[symbol] += 1;
    }
    let code = Code::of(&counts, MAX_LENGTH_BITS);
    let last = HEADER_ORDER.iter().rposition(|&symbol| code.lengths[symbol] > 0);
    let listed = last.map_or(0, |last| last + 1).max(4);
    out.put((count - FIRST_LENGTH) as u64, 5);
    out.put((reach_count - 1) as u64, 5);
    out.put((listed - 4) as u64, 4);
    for &symbol in &HEADER_ORDER[..listed] {
        out.put(code.lengths[symbol].into(), 3);
    }
    for (symbol, extra, bits) in coded {
        out.put_code(&code, symbol);
        out.put(extra, bits);
    }
}

/// Bits in the order of the format: the first is the lowest of a byte.
#[derive(Default)]
struct Bits {
    bytes: Vec<u8>,
    /// Fewer than eight bits between calls.
    pending: u64,
    count: u32,
}

impl Bits {
    fn put(&mut self, bits: u64, count: u32) {
        self.pending |= bits << self.count;
        self.count += count;
        if self.count >= 32 {
            self.bytes.extend((self.pending as u32).to_le_bytes());
            (self.pending, self.count) = (self.pending >> 32, self.count - 32);
        }
    }

    fn put_code(&mut self, code: &Code, symbol: usize) {
        self.put(code.bits[symbol].into(), code.lengths[symbol].into());
    }

    fn finish(mut self) -> Vec<u8> {
        let left = self.count.div_ceil(8) as usize;
        self.bytes.extend(&self.pending.to_le_bytes()[..left]);
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use flate2::read::DeflateDecoder;
    use proptest::prelude::*;

    use super::*;

    fn inflated(bytes: &[u8]) -> Vec<u8> {
        let mut inflated = Vec::new();
        let mut decoder = DeflateDecoder::new(bytes);
        decoder.read_to_end(&mut inflated).expect("sound");
        assert_eq!(decoder.total_in(), bytes.len() as u64, "nothing is left over");
        inflated
    }

    #[test]
    fn lengths_and_distances_are_those_of_the_format() {
        let length = |of: usize| (LENGTHS[of].symbol, LENGTHS[of].extra, LENGTHS[of].bits);
        assert_eq!([length(3), length(10), length(11)], [(257, 0, 0), (264, 0, 0), (265, 0, 1)]);
        assert_eq!([length(12), length(19)], [(265, 1, 1), (269, 0, 2)]);
        assert_eq!([length(257), length(258)], [(284, 30, 5), (285, 0, 0)]);
        let distance =
            |of| (Distance::of(of).symbol, Distance::of(of).extra, Distance::of(of).bits);
        assert_eq!([distance(1), distance(4), distance(5)], [(0, 0, 0), (3, 0, 0), (4, 0, 1)]);
        assert_eq!(
            [distance(6), distance(4320), distance(32768)],
            [(4, 1, 1), (24, 223, 11), (29, 8191, 13)]
        );
    }

    #[test]
    fn codes_are_no_longer_than_the_format_allows() {
        // Fibonacci's numbers make the deepest trees.
        let mut counts = vec![1_u32, 1];
        (2..40).for_each(|at| counts.push(counts[at - 1] + counts[at - 2]));
        assert!(huffman(&counts.iter().map(|&c| c.into()).collect::<Vec<_>>()).contains(&39));
        let code = Code::of(&counts, MAX_BITS);
        let kraft: f64 = code.lengths.iter().map(|&length| 0.5_f64.powi(length.into())).sum();
        assert!((kraft - 1.0).abs() < 1e-9 && code.lengths.iter().all(|&length| length <= 15));
    }

    /// Rows of numbers as segments.
    fn deflated(header: &[u8], rows: &[Vec<u8>], element: usize) -> Deflated {
        let cells = rows.first().map_or(0, Vec::len);
        let mut deflater = RowDeflater::new(header, cells, element);
        for row in rows {
            let mut segments: Vec<Segment> = Vec::new();
            for same in row.chunk_by(|a, b| a == b) {
                let begin = segments.last().map_or(0, |segment| segment.end);
                let value = [0, 1, 2, 3].map(|at| same[0].wrapping_mul(at + 1));
                segments.push(Segment { end: begin + same.len(), value });
            }
            deflater.row(&segments);
        }
        deflater.finish()
    }

    fn bytes(header: &[u8], rows: &[Vec<u8>], element: usize) -> Vec<u8> {
        let element = |&cell: &u8| (0..element as u8).map(move |at| cell.wrapping_mul(at + 1));
        [header, &rows.iter().flatten().flat_map(element).collect::<Vec<u8>>()].concat()
    }

    #[test]
    fn uniform_arrays_take_next_to_nothing() {
        assert_eq!(inflated(&deflate_small(b"").bytes), b"");
        assert_eq!(inflated(&deflate_small(b"text").bytes), b"text");
        let rows = vec![vec![0; 1000]; 1000];
        let Deflated { bytes, length, .. } = deflated(b"", &rows, 4);
        assert_eq!((inflated(&bytes), length), (vec![0; 4_000_000], 4_000_000));
        assert!(bytes.len() < 5000, "{}", bytes.len());
    }

    proptest! {
        #[test]
        fn arrays_are_inflated(
            cells in 1_usize..60,
            header in prop::collection::vec(any::<u8>(), 0..20),
            runs in prop::collection::vec((0_u8..4, 1_usize..200), 1..120),
            (element, stretch) in (1_usize..5, prop::sample::select(vec![1_usize, 1, 1, 300])),
        ) {
            let all: Vec<u8> =
                runs.iter().flat_map(|&(value, count)| vec![value; count]).collect();
            let rows: Vec<Vec<u8>> = all
                .chunks_exact(cells)
                .map(|row| row.iter().flat_map(|&cell| vec![cell; stretch]).collect())
                .collect();
            let expected = bytes(&header, &rows, element);
            let Deflated { bytes, crc32, length } = deflated(&header, &rows, element);
            prop_assert_eq!(inflated(&bytes), &expected[..]);
            prop_assert_eq!((crc32, length), (crc32fast::hash(&expected), expected.len()));
        }

        #[test]
        fn noise_is_inflated(
            rows in (1_usize..40).prop_flat_map(|cells| {
                prop::collection::vec(prop::collection::vec(any::<u8>(), cells), 0..20)
            }),
        ) {
            let expected = bytes(b"", &rows, 1);
            prop_assert_eq!(inflated(&deflated(b"", &rows, 1).bytes), expected);
        }
    }
}

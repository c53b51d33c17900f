//! Tokens as a block of RFC 1951: Huffman's codes of their own, and the bits.

/// Longest match of the format, and the shortest.
pub(super) const LONGEST: usize = 258;
pub(super) const SHORTEST: usize = 3;
/// Farthest that a match may reach back.
pub(super) const WINDOW: usize = 1 << 15;
/// Symbol that ends a block, and that of the shortest match.
const END: usize = 256;
const FIRST_LENGTH: usize = 257;
/// Longest code of a symbol, and of a code length.
const MAX_BITS: usize = 15;
const MAX_LENGTH_BITS: usize = 7;
/// The order in which the header has the lengths of the codes for code lengths.
const HEADER_ORDER: [usize; 19] =
    [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];

/// What is written next.
#[derive(Clone, Copy)]
pub(super) enum Token {
    /// The first so many bytes as they are.
    Literals([u8; 4], u8),
    /// Bytes, however many, that repeat those a row before, or an element before.
    Match { bytes: u32, above: bool },
}

/// Bytes as they are.
pub(super) fn literals(bytes: &[u8]) -> impl Iterator<Item = Token> {
    bytes.chunks(4).map(|some| {
        let mut four = [0; 4];
        four[..some.len()].copy_from_slice(some);
        Token::Literals(four, some.len() as u8)
    })
}

/// A long match as matches of the format: how many of the longest, and the lengths of up to two behind them.
fn parts(bytes: u32) -> (u32, [usize; 2]) {
    let (longest, rest) = (bytes / LONGEST as u32, bytes as usize % LONGEST);
    match rest {
        // What is left must be long enough for a match too.
        1..SHORTEST if longest > 0 => (longest - 1, [LONGEST - SHORTEST, rest + SHORTEST]),
        _ => (longest, [rest, 0]),
    }
}

/// One block, the last one, with codes of its own.
pub(super) fn encode(tokens: &[Token], element: usize, row: usize) -> Vec<u8> {
    let distances = [Distance::of(element), Distance::of(row.clamp(1, WINDOW))];
    let (mut symbols, mut reaches) = ([0_u32; 286], [0_u32; 30]);
    symbols[END] = 1;
    for token in tokens {
        match *token {
            Token::Literals(bytes, count) => {
                bytes[..usize::from(count)]
                    .iter()
                    .for_each(|byte| symbols[usize::from(*byte)] += 1);
            }
            Token::Match { bytes, above } => {
                let (longest, others) = parts(bytes);
                let reach = &mut reaches[distances[usize::from(above)].symbol];
                symbols[LENGTHS[LONGEST].symbol] += longest;
                *reach += longest;
                for length in others.into_iter().filter(|length| *length > 0) {
                    symbols[LENGTHS[length].symbol] += 1;
                    *reach += 1;
                }
            }
        }
    }
    let (symbols, reaches) = (Code::of(&symbols, MAX_BITS), Code::of(&reaches, MAX_BITS));
    let mut out = Bits::default();
    out.put(0b101, 3);
    write_codes(&mut out, &symbols, &reaches);
    let literals: [(u64, u32); 256] = std::array::from_fn(|byte| symbols.with(byte, 0, 0));
    // Of each length and each of the two distances, all that is written of a match.
    let matches = distances.map(|Distance { symbol, extra, bits }| {
        let (distance, distance_bits) = reaches.with(symbol, extra, bits);
        LENGTHS.map(|Length { symbol, extra, bits }| {
            let (length, length_bits) = symbols.with(symbol, extra, bits);
            (length | distance << length_bits, length_bits + distance_bits)
        })
    });
    for token in tokens {
        match *token {
            Token::Literals(bytes, count) => {
                for pair in bytes[..usize::from(count)].chunks(2) {
                    let (first, first_bits) = literals[usize::from(pair[0])];
                    let second = pair.get(1).map(|byte| literals[usize::from(*byte)]);
                    let (second, second_bits) = second.unwrap_or_default();
                    out.put(first | second << first_bits, first_bits + second_bits);
                }
            }
            Token::Match { bytes, above } => {
                let matches = &matches[usize::from(above)];
                let (longest, others) = parts(bytes);
                let (bits, count) = matches[LONGEST];
                (0..longest).for_each(|_| out.put(bits, count));
                for length in others.into_iter().filter(|length| *length > 0) {
                    let (bits, count) = matches[length];
                    out.put(bits, count);
                }
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
    /// The first `written` of them are final; there is always room for eight more.
    bytes: Vec<u8>,
    written: usize,
    /// Fewer than eight bits between calls.
    pending: u64,
    count: u32,
}

impl Bits {
    /// Appends up to 56 bits.
    #[inline]
    fn put(&mut self, bits: u64, count: u32) {
        self.pending |= bits << self.count;
        self.count += count;
        if self.bytes.len() < self.written + 8 {
            self.bytes.resize((2 * self.bytes.len()).max(1 << 12), 0);
        }
        self.bytes[self.written..self.written + 8].copy_from_slice(&self.pending.to_le_bytes());
        let whole = self.count / 8;
        self.written += whole as usize;
        self.pending >>= whole * 8;
        self.count %= 8;
    }

    fn put_code(&mut self, code: &Code, symbol: usize) {
        self.put(code.bits[symbol].into(), code.lengths[symbol].into());
    }

    fn finish(mut self) -> Vec<u8> {
        self.put(0, 0);
        self.bytes.truncate(self.written + usize::from(self.count > 0));
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}

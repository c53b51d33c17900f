//! Deflate (RFC 1951) of arrays that consist of runs: heights of buildings, of which a row repeats its
//! last value or the row above over long stretches.
//!
//! A general compressor hashes every few bytes to find out what the layout of such an array tells
//! already. Two distances are enough, the size of an element and that of a row, and comparing eight bytes
//! at a time finds how far each goes. On tiles of San Jose it compresses eight times as fast as level 2 of
//! zlib-rs, to fewer bytes (`benches/RESULTS.md`); libdeflate is slower there. The output depends on the
//! array alone.

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

/// The deflated bytes of a header, as it is, and of an array behind it whose elements and rows have so many
/// bytes.
///
/// # Panics
/// If an element has no bytes, or the array no whole number of elements.
pub(super) fn deflate_runs(bytes: &[u8], header: usize, element: usize, row: usize) -> Vec<u8> {
    assert!(element > 0 && (bytes.len() - header).is_multiple_of(element), "whole elements");
    let row = if row > element && row <= WINDOW { row } else { 0 };
    let tokens = tokens(bytes, header, element, row);
    let distances = [Distance::of(element), Distance::of(row.max(1))];

    let (mut symbols, mut reaches) = ([0_u32; 286], [0_u32; 30]);
    symbols[END] = 1;
    for token in &tokens {
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
    // One block, the last one, with codes of its own.
    out.put(0b101, 3);
    write_codes(&mut out, &symbols, &reaches);
    for token in &tokens {
        match *token {
            Token::Literal(byte) => out.put_code(&symbols, usize::from(byte)),
            Token::Match(length, above) => {
                let Length { symbol, extra, bits } = LENGTHS[usize::from(length)];
                out.put_code(&symbols, symbol);
                out.put(extra.into(), bits);
                let Distance { symbol, extra, bits } = distances[usize::from(above)];
                out.put_code(&reaches, symbol);
                out.put(extra.into(), bits);
            }
        }
    }
    out.put_code(&symbols, END);
    out.finish()
}

fn tokens(bytes: &[u8], header: usize, element: usize, row: usize) -> Vec<Token> {
    let mut tokens: Vec<Token> = bytes[..header].iter().map(|&byte| Token::Literal(byte)).collect();
    let mut at = header;
    while at < bytes.len() {
        let reach = |distance: usize| match distance {
            0 => 0,
            _ if at < header + distance => 0,
            _ => common(bytes, at, distance),
        };
        let along = reach(element);
        // What fills the longest match need not be compared with the row above.
        let above = if along >= LONGEST { 0 } else { reach(row) };
        let (length, is_above) = if above > along { (above, true) } else { (along, false) };
        // Whole elements, so that the next one begins where it should.
        let length = length - length % element;
        if length >= SHORTEST {
            push_matches(&mut tokens, length, is_above);
            at += length;
        } else {
            tokens.extend(bytes[at..at + element].iter().map(|&byte| Token::Literal(byte)));
            at += element;
        }
    }
    tokens
}

/// Bytes from `at` on that equal those `distance` before them.
fn common(bytes: &[u8], at: usize, distance: usize) -> usize {
    let (new, old) = (&bytes[at..], &bytes[at - distance..bytes.len() - distance]);
    let (new_words, new_rest) = new.as_chunks::<8>();
    let (old_words, old_rest) = old.as_chunks::<8>();
    for (index, (new, old)) in new_words.iter().zip(old_words).enumerate() {
        let differing = u64::from_le_bytes(*new) ^ u64::from_le_bytes(*old);
        if differing != 0 {
            return index * 8 + differing.trailing_zeros() as usize / 8;
        }
    }
    let rest = new_rest.iter().zip(old_rest).take_while(|(new, old)| new == old).count();
    new_words.len() * 8 + rest
}

/// Matches of a length together.
fn push_matches(tokens: &mut Vec<Token>, mut length: usize, above: bool) {
    while length > 0 {
        let most = length.min(LONGEST);
        // What is left must be long enough for a match too.
        let left = length - most;
        let now = if left > 0 && left < SHORTEST { most - SHORTEST } else { most };
        tokens.push(Token::Match(now as u16, above));
        length -= now;
    }
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

    #[test]
    fn empty_and_uniform_arrays_are_inflated() {
        for bytes in [vec![], vec![7], vec![0; 100_000], vec![1, 2, 3, 4]] {
            assert_eq!(inflated(&deflate_runs(&bytes, 0, 1, 10)), bytes);
        }
        assert!(deflate_runs(&vec![0; 1_000_000], 0, 4, 4000).len() < 2000);
    }

    proptest! {
        #[test]
        fn arrays_of_runs_are_inflated(
            runs in prop::collection::vec((0_u8..5, 1_usize..700), 0..60),
            header in prop::collection::vec(any::<u8>(), 0..20),
            (element, columns) in (prop::sample::select(vec![1_usize, 2, 4, 8]), 1_usize..9000),
        ) {
            let mut bytes = header.clone();
            for (value, length) in runs {
                let element: Vec<u8> = (0..element as u8).map(|at| value * (at + 1)).collect();
                bytes.extend(element.repeat(length));
            }
            let deflated = deflate_runs(&bytes, header.len(), element, element * columns);
            prop_assert_eq!(inflated(&deflated), bytes);
        }

        #[test]
        fn noise_is_inflated(bytes in prop::collection::vec(any::<u8>(), 0..3000), columns in 1_usize..50) {
            prop_assert_eq!(inflated(&deflate_runs(&bytes, 0, 1, columns)), bytes);
        }
    }
}

//! Deflate (RFC 1951) of arrays that consist of runs: heights of buildings, of which a row repeats its
//! last value or the row above over long stretches.
//!
//! A general compressor hashes every few bytes to find out what a rasteriser knows: where values change. Two
//! distances are enough, the size of an element and that of a row, and the ends of runs tell how far each
//! goes. What a stretch of a row repeats does not depend on what stands beside it, so arrays that overlap
//! share that work: a [`Strip`] is looked through once, and a [`Deflater`] joins strips to rows. On tiles of
//! San Jose this takes a fraction of the time of zlib-rs, for fewer bytes (`benches/RESULTS.md`); libdeflate
//! is slower there. The output depends on the array and on the widths of its strips alone.

mod code;
mod crc32;

use code::{SHORTEST, Token, WINDOW, encode, literals};
use crc32::Crc32Shift;

/// Cells of a row up to `end` that have one value, of which the first bytes of an element count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Segment {
    pub(crate) end: usize,
    pub(crate) value: [u8; 4],
}

/// What some cells are written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum StripPiece {
    /// One cell.
    Literal([u8; 4]),
    /// The cells of the row above, or again the cell before.
    Match { cells: u16, above: bool },
}

/// Some columns of an array with their rows, ready to be joined with those beside them.
#[derive(Debug)]
pub(crate) struct Strip {
    cells: usize,
    pieces: Vec<StripPiece>,
    rows: Vec<StripRow>,
}

#[derive(Debug)]
struct StripRow {
    /// Where its pieces end.
    end: u32,
    /// Of its bytes.
    crc32: u32,
    /// The values of its first and last cells, and how many have the first.
    first: [u8; 4],
    last: [u8; 4],
    same: u16,
}

/// Looks through the rows of a strip.
pub(crate) struct StripWriter<'a> {
    format: &'a ArrayFormat,
    strip: Strip,
    /// The row before, as segments and as bytes, once there is one.
    previous: Vec<Segment>,
    line: Vec<u8>,
}

impl<'a> StripWriter<'a> {
    /// For a strip of so many cells' width, of an array of that format.
    pub(crate) fn new(format: &'a ArrayFormat, cells: usize) -> Self {
        let strip = Strip { cells, pieces: Vec::new(), rows: Vec::new() };
        let line = vec![0; cells * format.element];
        Self { format, strip, previous: Vec::new(), line }
    }

    /// Adds a row: segments that follow each other from its first to its last cell, neighbours with different
    /// values.
    pub(crate) fn row(&mut self, segments: &[Segment]) {
        let before = self.strip.rows.last().map(|row| row.crc32);
        let crc32 = match before {
            Some(crc32) if self.previous == segments => crc32,
            _ => {
                write_line(&mut self.line, segments, self.format.element);
                crc32fast::hash(&self.line)
            }
        };
        self.find_pieces(segments);
        let value = |segment: Option<&Segment>| segment.map_or([0; 4], |segment| segment.value);
        self.strip.rows.push(StripRow {
            end: self.strip.pieces.len() as u32,
            crc32,
            first: value(segments.first()),
            last: value(segments.last()),
            same: segments.first().map_or(0, |segment| segment.end as u16),
        });
        self.previous.clear();
        self.previous.extend(segments);
    }

    fn find_pieces(&mut self, segments: &[Segment]) {
        let ArrayFormat { element, row_bytes, .. } = *self.format;
        let previous = if row_bytes <= WINDOW { &self.previous[..] } else { &[] };
        let (mut at, mut begin, mut here, mut there) = (0, 0, 0, 0);
        while at < self.strip.cells {
            while segments[here].end <= at {
                begin = segments[here].end;
                here += 1;
            }
            while previous.get(there).is_some_and(|segment| segment.end <= at) {
                there += 1;
            }
            let Segment { end, value } = segments[here];
            let along = if at > begin { end - at } else { 0 };
            let above = common(&segments[here..], &previous[there..], at);
            let (cells, above) = if above > along { (above, true) } else { (along, false) };
            if cells * element >= SHORTEST {
                self.strip.pieces.push(StripPiece::Match { cells: cells as u16, above });
                at += cells;
            } else {
                self.strip.pieces.push(StripPiece::Literal(value));
                at += 1;
            }
        }
    }

    /// The strip, once it has all its rows.
    pub(crate) fn finish(mut self) -> Strip {
        self.strip.pieces.shrink_to_fit();
        self.strip.rows.shrink_to_fit();
        self.strip
    }
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

/// The bytes of a row.
fn write_line(line: &mut [u8], segments: &[Segment], element: usize) {
    let mut at = 0;
    for &Segment { end, value } in segments {
        match element {
            4 => line[at * 4..end * 4].as_chunks_mut().0.fill(value),
            1 => line[at..end].fill(value[0]),
            _ => {
                let cells = line[at * element..end * element].chunks_exact_mut(element);
                cells.for_each(|cell| cell.copy_from_slice(&value[..element]));
            }
        }
        at = end;
    }
}

/// What arrays of one shape have in common.
#[derive(Debug)]
pub(crate) struct ArrayFormat {
    header: Vec<u8>,
    element: usize,
    row_bytes: usize,
    /// By the width of a strip in cells.
    shifts: Vec<(usize, Crc32Shift)>,
}

impl ArrayFormat {
    /// For arrays behind a header, of elements of 1 to 4 bytes, in rows of so many cells that consist of strips
    /// of these widths.
    pub(crate) fn new(header: Vec<u8>, element: usize, row_cells: usize, widths: &[usize]) -> Self {
        let shift = |&cells: &usize| (cells, Crc32Shift::over(cells * element));
        let shifts = widths.iter().map(shift).collect();
        Self { header, element, row_bytes: row_cells * element, shifts }
    }
}

/// A deflated file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Deflated {
    pub(super) bytes: Vec<u8>,
    /// Of the file as it was.
    pub(super) crc32: u32,
    pub(super) length: usize,
}

/// Deflates an array out of strips.
pub(crate) struct Deflater<'a> {
    format: &'a ArrayFormat,
    tokens: Vec<Token>,
    /// A match that the next cells may make longer: its bytes, and whether it reaches back a row.
    pending: (u32, bool),
    /// The value of the last cell, once there is one.
    last: Option<[u8; 4]>,
    crc32: u32,
    length: usize,
}

impl<'a> Deflater<'a> {
    /// Begins an array with its header.
    pub(crate) fn new(format: &'a ArrayFormat) -> Self {
        let header = &format.header;
        // Enough for the tiles of a dense city.
        let mut tokens = Vec::with_capacity(1 << 16);
        tokens.extend(literals(header));
        Self {
            format,
            tokens,
            pending: (0, false),
            last: None,
            crc32: crc32fast::hash(header),
            length: header.len(),
        }
    }

    /// Adds a row of a strip behind what is there already.
    ///
    /// # Panics
    /// If the format does not have strips of that width.
    pub(crate) fn add(&mut self, strip: &Strip, row: usize) {
        let element = self.format.element;
        let begin = row.checked_sub(1).map_or(0, |before| strip.rows[before].end as usize);
        let &StripRow { end, crc32, first, last, same } = &strip.rows[row];
        // What begins a row as the cell before it is repeats that: a distance of fewer bits.
        let mut goes_on = self.last == Some(first);
        for &piece in &strip.pieces[begin..end as usize] {
            let begins_on = std::mem::take(&mut goes_on);
            match piece {
                StripPiece::Literal(value) => {
                    self.end_match();
                    self.tokens.push(Token::Literals(value, element as u8));
                }
                StripPiece::Match { cells, above } => {
                    let above = above && !(begins_on && cells <= same);
                    if self.pending.1 != above {
                        self.end_match();
                    }
                    self.pending = (self.pending.0 + u32::from(cells) * element as u32, above);
                }
            }
        }
        let mut shifts = self.format.shifts.iter();
        let (_, shift) =
            shifts.find(|(cells, _)| *cells == strip.cells).expect("a width of the format");
        self.crc32 = shift.append(self.crc32, crc32);
        self.last = if strip.cells > 0 { Some(last) } else { self.last };
        self.length += strip.cells * element;
    }

    fn end_match(&mut self) {
        let (bytes, above) = std::mem::take(&mut self.pending);
        if bytes > 0 {
            self.tokens.push(Token::Match { bytes, above });
        }
    }

    /// The deflated file.
    pub(crate) fn finish(mut self) -> Deflated {
        self.end_match();
        let ArrayFormat { element, row_bytes, .. } = *self.format;
        let bytes = encode(&self.tokens, element, row_bytes);
        Deflated { bytes, crc32: self.crc32, length: self.length }
    }
}

/// A file that is not looked at closely, since it is small.
pub(crate) fn deflate_small(bytes: &[u8]) -> Deflated {
    let tokens: Vec<Token> = literals(bytes).collect();
    Deflated { bytes: encode(&tokens, 1, 1), crc32: crc32fast::hash(bytes), length: bytes.len() }
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

    /// Rows of numbers as segments, in strips that end at the columns of `cuts`.
    fn deflated(header: &[u8], rows: &[Vec<u8>], element: usize, cuts: &[usize]) -> Deflated {
        let cells = rows.first().map_or(0, Vec::len);
        let mut ends: Vec<usize> = cuts.iter().map(|cut| cut % cells.max(1)).collect();
        ends.extend([0, cells]);
        ends.sort_unstable();
        ends.dedup();
        let widths: Vec<usize> = ends.windows(2).map(|ends| ends[1] - ends[0]).collect();
        let format = ArrayFormat::new(header.to_vec(), element, cells, &widths);
        let strip = |ends: &[usize]| {
            let mut strip = StripWriter::new(&format, ends[1] - ends[0]);
            for row in rows {
                let mut segments: Vec<Segment> = Vec::new();
                for same in row[ends[0]..ends[1]].chunk_by(|a, b| a == b) {
                    let begin = segments.last().map_or(0, |segment| segment.end);
                    let value = [0, 1, 2, 3].map(|at| same[0].wrapping_mul(at + 1));
                    segments.push(Segment { end: begin + same.len(), value });
                }
                strip.row(&segments);
            }
            strip.finish()
        };
        let strips: Vec<Strip> = ends.windows(2).map(strip).collect();
        let mut deflater = Deflater::new(&format);
        for row in 0..rows.len() {
            for strip in &strips {
                deflater.add(strip, row);
            }
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
        for cuts in [&[][..], &[300, 600]] {
            let Deflated { bytes, length, .. } = deflated(b"", &rows, 4, cuts);
            assert_eq!((inflated(&bytes), length), (vec![0; 4_000_000], 4_000_000));
            assert!(bytes.len() < 5_000, "{}", bytes.len());
        }
    }

    proptest! {
        #[test]
        fn arrays_are_inflated(
            cells in 1_usize..60,
            header in prop::collection::vec(any::<u8>(), 0..20),
            runs in prop::collection::vec((0_u8..4, 1_usize..200), 1..120),
            (element, stretch) in (1_usize..5, prop::sample::select(vec![1_usize, 1, 1, 300])),
            cuts in prop::collection::vec(any::<usize>(), 0..4),
        ) {
            let all: Vec<u8> =
                runs.iter().flat_map(|&(value, count)| vec![value; count]).collect();
            let rows: Vec<Vec<u8>> = all
                .chunks_exact(cells)
                .map(|row| row.iter().flat_map(|&cell| vec![cell; stretch]).collect())
                .collect();
            let expected = bytes(&header, &rows, element);
            let Deflated { bytes, crc32, length } = deflated(&header, &rows, element, &cuts);
            prop_assert_eq!(inflated(&bytes), &expected[..]);
            prop_assert_eq!((crc32, length), (crc32fast::hash(&expected), expected.len()));
        }

        #[test]
        fn noise_is_inflated(
            rows in (1_usize..40).prop_flat_map(|cells| {
                prop::collection::vec(prop::collection::vec(any::<u8>(), cells), 0..20)
            }),
            cuts in prop::collection::vec(any::<usize>(), 0..4),
        ) {
            let expected = bytes(b"", &rows, 1);
            prop_assert_eq!(inflated(&deflated(b"", &rows, 1, &cuts).bytes), expected);
        }
    }
}

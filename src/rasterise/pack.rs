//! The file of a tile: heights, their sources and what it says of itself, as `.npz`.

use std::ops::Range;

use ndarray::{Array1, Array2};

use super::blocks::BlockTile;
use super::tile::HeightGrid;
use crate::store::{RowDeflater, Segment, deflate_small, npy_bytes, npz_of_deflated};

/// Packs tiles of one size.
#[derive(Debug)]
pub(super) struct Packer {
    /// Cells along a side.
    cells: usize,
    /// What stands in an `.npy` before the numbers.
    heights: Vec<u8>,
    sources: Vec<u8>,
}

impl Packer {
    /// For tiles of `cells` × `cells` cells.
    pub(super) fn new(cells: usize) -> Self {
        let shape = (cells, cells);
        let mut heights = npy_bytes(&Array2::<f32>::zeros(shape));
        heights.truncate(heights.len() - cells * cells * size_of::<f32>());
        let mut sources = npy_bytes(&Array2::<u8>::zeros(shape));
        sources.truncate(sources.len() - cells * cells);
        Self { cells, heights, sources }
    }

    /// The file of a tile of blocks.
    pub(super) fn blocks(&self, tile: &BlockTile<'_>, meta: Vec<u8>) -> Vec<u8> {
        self.pack(meta, |row, run| tile.for_each_run_of(row, run))
    }

    /// The file of a tile.
    pub(super) fn grid(&self, tile: &HeightGrid, meta: Vec<u8>) -> Vec<u8> {
        self.pack(meta, |row, run| {
            let heights = tile.height_m.row(row);
            let sources = tile.height_source.row(row);
            let cells: Vec<(f32, u8)> =
                heights.iter().copied().zip(sources.iter().copied()).collect();
            let mut at = 0;
            for same in cells.chunk_by(|a, b| a.0.to_bits() == b.0.to_bits() && a.1 == b.1) {
                run(at..at + same.len(), same[0].0, same[0].1);
                at += same.len();
            }
        })
    }

    /// `row` gives the runs of a row with height and source, from west to east; between them nothing is.
    fn pack(
        &self,
        meta: Vec<u8>,
        row: impl Fn(usize, &mut dyn FnMut(Range<usize>, f32, u8)),
    ) -> Vec<u8> {
        let cells = self.cells;
        let mut heights = RowDeflater::new(&self.heights, cells, size_of::<f32>());
        let mut sources = RowDeflater::new(&self.sources, cells, 1);
        let (mut of_heights, mut of_sources) = (Vec::new(), Vec::new());
        for number in 0..cells {
            of_heights.clear();
            of_sources.clear();
            let mut both = |end: usize, height: f32, source: u8| {
                push(&mut of_heights, end, height.to_le_bytes());
                push(&mut of_sources, end, [source, 0, 0, 0]);
            };
            let mut at = 0;
            row(number, &mut |run, height, source| {
                both(run.start, 0.0, 0);
                both(run.end, height, source);
                at = run.end;
            });
            if at < cells {
                both(cells, 0.0, 0);
            }
            heights.row(&of_heights);
            sources.row(&of_sources);
        }
        let meta = deflate_small(&npy_bytes(&Array1::from_vec(meta)));
        npz_of_deflated(&[
            ("height_m", heights.finish()),
            ("height_source", sources.finish()),
            ("meta_json", meta),
        ])
    }
}

/// Goes on to `end` with a value, which makes the last segment longer if it is the same.
fn push(segments: &mut Vec<Segment>, end: usize, value: [u8; 4]) {
    let begin = segments.last().map_or(0, |last| last.end);
    match segments.last_mut() {
        _ if begin == end => {}
        Some(last) if last.value == value => last.end = end,
        _ => segments.push(Segment { end, value }),
    }
}

//! The file of a tile: heights, their sources and what it says of itself, as `.npz`.

use ndarray::{Array1, Array2};

use super::blocks::{Block, BlockLayout, BlockStrips, BlockTile, Run};
use super::tile::HeightGrid;
use crate::config::GridConfig;
use crate::store::{
    ArrayFormat, Deflater, Segment, Strip, StripWriter, deflate_small, npy_bytes, npz_of_deflated,
};

/// Packs tiles of one size.
#[derive(Debug)]
pub(super) struct Packer<'a> {
    layout: BlockLayout<'a>,
    cells: usize,
    heights: ArrayFormat,
    sources: ArrayFormat,
}

impl<'a> Packer<'a> {
    /// For the tiles of a grid.
    pub(super) fn new(grid: &'a GridConfig) -> Self {
        let (layout, cells) = (BlockLayout::of(grid), grid.side_cells());
        let widths = [layout.rest, layout.side - layout.rest];
        // What stands in an `.npy` before the numbers.
        let mut heights = npy_bytes(&Array2::<f32>::zeros((cells, cells)));
        heights.truncate(heights.len() - cells * cells * size_of::<f32>());
        let mut sources = npy_bytes(&Array2::<u8>::zeros((cells, cells)));
        sources.truncate(sources.len() - cells * cells);
        Self {
            layout,
            cells,
            heights: ArrayFormat::new(heights, size_of::<f32>(), cells, &widths),
            sources: ArrayFormat::new(sources, 1, cells, &widths),
        }
    }

    /// The file of a tile that was painted alone: the same bytes as those of one of blocks.
    pub(super) fn grid(&self, tile: &HeightGrid, meta: Vec<u8>) -> Vec<u8> {
        self.blocks(&BlockTile::of_grid(tile, self.layout), meta)
    }

    /// The file of a tile of blocks.
    pub(super) fn blocks(&self, tile: &BlockTile<'_>, meta: Vec<u8>) -> Vec<u8> {
        let mut heights = Deflater::new(&self.heights);
        let mut sources = Deflater::new(&self.sources);
        let BlockLayout { side, rest, .. } = self.layout;
        for row in 0..self.cells {
            let (blocks, row) = tile.row(row);
            let mut left = self.cells;
            for block in blocks {
                let strips = block.strips(|block| self.strips(block));
                let mut add = |[of_heights, of_sources]: &[Strip; 2]| {
                    heights.add(of_heights, row);
                    sources.add(of_sources, row);
                };
                if rest > 0 {
                    add(&strips.west);
                }
                if left >= side {
                    add(&strips.east);
                }
                left = left.saturating_sub(side);
            }
        }
        let meta = deflate_small(&npy_bytes(&Array1::from_vec(meta)));
        npz_of_deflated(&[
            ("height_m", heights.finish()),
            ("height_source", sources.finish()),
            ("meta_json", meta),
        ])
    }

    fn strips(&self, block: &Block) -> BlockStrips {
        let BlockLayout { side, rest, .. } = self.layout;
        let strips = |from: usize, to: usize| {
            let height = |run: &Run| run.height_m.to_le_bytes();
            let source = |run: &Run| [run.source, 0, 0, 0];
            [
                strip(&self.heights, block, side, from..to, height),
                strip(&self.sources, block, side, from..to, source),
            ]
        };
        BlockStrips { west: strips(0, rest), east: strips(rest, side) }
    }
}

/// Some columns of a block's rows; between runs nothing is.
fn strip(
    format: &ArrayFormat,
    block: &Block,
    rows: usize,
    columns: std::ops::Range<usize>,
    value: impl Fn(&Run) -> [u8; 4],
) -> Strip {
    let mut writer = StripWriter::new(format, columns.len());
    let mut segments: Vec<Segment> = Vec::new();
    for row in 0..rows {
        segments.clear();
        for run in block.row(row) {
            let inside =
                |column: u16| usize::from(column).clamp(columns.start, columns.end) - columns.start;
            push(&mut segments, inside(run.start), [0; 4]);
            push(&mut segments, inside(run.end), value(run));
        }
        push(&mut segments, columns.len(), [0; 4]);
        writer.row(&segments);
    }
    writer.finish()
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

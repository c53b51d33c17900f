//! The file of a tile: heights, their sources and what it says of itself, as `.npz`.

use std::cell::RefCell;

use ndarray::{Array1, Array2};

use super::blocks::BlockTile;
use super::tile::HeightGrid;
use crate::store::{Runs, npy_bytes, npz_of_runs};

/// Bytes of a height.
const HEIGHT_BYTES: usize = size_of::<f32>();

/// The arrays of a tile as `.npy`.
#[derive(Debug, Default)]
struct TileArrays {
    /// Cells along a side.
    cells: usize,
    height_m: Vec<u8>,
    height_source: Vec<u8>,
}

thread_local! {
    /// Memory that is used for one tile after the other.
    static ARRAYS: RefCell<TileArrays> = RefCell::default();
}

impl TileArrays {
    /// Tiles without any building.
    fn empty(cells: usize) -> Self {
        Self {
            cells,
            height_m: npy_bytes(&Array2::<f32>::zeros((cells, cells))),
            height_source: npy_bytes(&Array2::<u8>::zeros((cells, cells))),
        }
    }

    /// Both arrays without their headers, in row-major order.
    fn data(&mut self) -> (&mut [[u8; HEIGHT_BYTES]], &mut [u8]) {
        let cells = self.cells * self.cells;
        let heights = self.height_m.len() - cells * HEIGHT_BYTES;
        let sources = self.height_source.len() - cells;
        (self.height_m[heights..].as_chunks_mut().0, &mut self.height_source[sources..])
    }

    fn npz(&self, meta: Vec<u8>) -> Vec<u8> {
        let Self { cells, height_m, height_source } = self;
        let meta = npy_bytes(&Array1::from_vec(meta));
        let runs = |npy: &'_ [u8], element: usize| {
            let header = npy.len() - cells * cells * element;
            (header, element, cells * element)
        };
        let (header, element, row) = runs(height_m, HEIGHT_BYTES);
        let heights = Runs { npy: height_m, header, element, row };
        let (header, element, row) = runs(height_source, 1);
        let sources = Runs { npy: height_source, header, element, row };
        let meta = Runs { npy: &meta, header: meta.len(), element: 1, row: 1 };
        npz_of_runs(&[("height_m", heights), ("height_source", sources), ("meta_json", meta)])
    }
}

/// The file of a tile of blocks, of `cells` × `cells` cells.
pub(super) fn pack_blocks(tile: &BlockTile<'_>, cells: usize, meta: Vec<u8>) -> Vec<u8> {
    ARRAYS.with_borrow_mut(|arrays| {
        if arrays.cells != cells {
            *arrays = TileArrays::empty(cells);
        }
        let (heights, sources) = arrays.data();
        heights.fill([0; HEIGHT_BYTES]);
        sources.fill(0);
        tile.for_each_run(|row, columns, run| {
            let columns = row * cells + columns.start..row * cells + columns.end;
            heights[columns.clone()].fill(run.height_m.to_le_bytes());
            sources[columns].fill(run.source);
        });
        arrays.npz(meta)
    })
}

/// The file of a tile.
pub(super) fn pack_grid(tile: &HeightGrid, meta: Vec<u8>) -> Vec<u8> {
    let HeightGrid { height_m, height_source, .. } = tile;
    let (cells, height_m, height_source) =
        (height_m.nrows(), npy_bytes(height_m), npy_bytes(height_source));
    TileArrays { cells, height_m, height_source }.npz(meta)
}

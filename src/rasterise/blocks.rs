//! Tiles that overlap, put together from blocks that are painted once.
//!
//! A cell's value depends on its place alone, so tiles share what lies in both: at 1,080 m every 512 m each
//! place lies in 4.4 tiles. Blocks have the size of the lattice and begin at the corners of tiles, so that a
//! tile is some whole blocks and a part of those to the east and to the south. A painted block is kept as
//! runs of equal cells until the last tile that needs it is made, and so is what it takes in their files.

use std::cell::RefCell;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock};

use geo::{Rect, coord};
use ndarray::Array2;

use super::tile::{HeightGrid, count, paint, statistics};
use crate::building::City;
use crate::config::GridConfig;
use crate::grid::{TileId, Window};
use crate::manifest::TileStatistics;
use crate::store::Strip;

/// Cells of a row that have one height, of one source.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Run {
    pub(super) start: u16,
    pub(super) end: u16,
    pub(super) height_m: f32,
    pub(super) source: u8,
}

/// A painted block.
#[derive(Debug, Default)]
pub(super) struct Block {
    /// Of all rows, from north to south, without the cells where nothing is.
    runs: Vec<Run>,
    /// Where each row's runs begin; one more for the end.
    rows: Vec<u32>,
    /// Outlines with a cell in the block, ascending, and a bit for each of its four parts in which they have
    /// one: those that belong to a tile which ends in the block, and the others.
    seen: Vec<(u32, u8)>,
    /// As the files of tiles have it, once one has.
    strips: OnceLock<BlockStrips>,
}

/// A block as the files of tiles have it: the columns that belong to tiles which end in it, and the others.
#[derive(Debug)]
pub(super) struct BlockStrips {
    /// Heights and sources.
    pub(super) west: [Strip; 2],
    pub(super) east: [Strip; 2],
}

/// How tiles consist of blocks.
#[derive(Debug, Clone, Copy)]
pub(super) struct BlockLayout<'a> {
    grid: &'a GridConfig,
    /// Cells along a side of a block.
    pub(super) side: usize,
    /// Of the last block of a tile, the columns or rows that belong to it; 0 if all do.
    pub(super) rest: usize,
}

impl<'a> BlockLayout<'a> {
    pub(super) fn of(grid: &'a GridConfig) -> Self {
        let spacing = f64::from(grid.spacing_m) / grid.cell_m;
        // All places are sums of binary fractions then, exact wherever one begins to count.
        let is_exact = (grid.cell_m * 1024.0).fract() == 0.0;
        let are_shared = grid.spacing_m < grid.side_m && is_exact && spacing.fract() == 0.0;
        let side = if are_shared { spacing as usize } else { grid.side_cells() };
        Self { grid, side, rest: grid.side_cells() % side }
    }

    /// Blocks along a side of a tile.
    fn count(self) -> usize {
        self.grid.side_cells().div_ceil(self.side)
    }

    /// A bit for each part of a block that has some of these cells.
    fn parts(self, row: usize, columns: &Range<usize>) -> u8 {
        let west = u8::from(columns.start < self.rest);
        let east = u8::from(columns.end > self.rest) << 1;
        (west | east) << if row < self.rest { 0 } else { 2 }
    }
}

/// Blocks that are not painted yet, or needed further, by their column and row on the lattice.
type Needed = HashMap<[i64; 2], (Arc<OnceLock<Block>>, u32)>;

/// The blocks of a lattice.
#[derive(Debug)]
pub(super) struct Blocks<'a> {
    city: &'a City,
    layout: BlockLayout<'a>,
    needed: Mutex<Needed>,
}

impl<'a> Blocks<'a> {
    /// The blocks of tiles, each of which is made once; `None` if the tiles do not share cells.
    pub(super) fn new(city: &'a City, grid: &'a GridConfig, tiles: &[TileId]) -> Option<Self> {
        let layout = BlockLayout::of(grid);
        if layout.count() == 1 {
            return None;
        }
        let blocks = Self { city, layout, needed: Mutex::default() };
        let mut needed = Needed::new();
        for &tile in tiles {
            for index in blocks.of(tile) {
                needed.entry(index).or_default().1 += 1;
            }
        }
        Some(Self { needed: Mutex::new(needed), ..blocks })
    }

    /// The blocks of a tile, row by row from its north-western one.
    fn of(&self, tile: TileId) -> impl Iterator<Item = [i64; 2]> + use<> {
        let BlockLayout { grid, .. } = self.layout;
        let (spacing, count) = (i64::from(grid.spacing_m), self.layout.count() as i64);
        let [column, row] = [tile.easting, tile.northing].map(|at| at.div_euclid(spacing));
        (0..count).flat_map(move |south| (0..count).map(move |east| [column + east, row - south]))
    }

    /// Puts a tile together.
    pub(super) fn tile(&self, tile: TileId) -> BlockTile<'_> {
        let blocks = self.of(tile).map(|index| {
            let block = self.take(index);
            block.get_or_init(|| self.paint(index));
            block
        });
        BlockTile { layout: self.layout, blocks: blocks.collect() }
    }

    /// A block, which is forgotten once all tiles have taken it.
    fn take(&self, index: [i64; 2]) -> Arc<OnceLock<Block>> {
        let mut needed = self.needed.lock().expect("nothing panics while it holds the lock");
        let Some((block, left)) = needed.get_mut(&index) else { return Arc::default() };
        *left -= 1;
        let (block, is_last) = (Arc::clone(block), *left == 0);
        if is_last {
            needed.remove(&index);
        }
        block
    }

    fn paint(&self, [column, row]: [i64; 2]) -> Block {
        let BlockLayout { grid, side, .. } = self.layout;
        let spacing = f64::from(grid.spacing_m);
        let half = f64::from(grid.side_m) / 2.0;
        let (west, north) = (column as f64 * spacing - half, row as f64 * spacing + half);
        let window = Window { west, north, cell: grid.cell_m, cells: side };
        let bounds =
            Rect::new(coord! { x: west, y: window.south() }, coord! { x: window.east(), y: north });
        let buildings = self.city.meeting(&bounds);
        CANVAS.with_borrow_mut(|(heights, sources)| {
            // Zeros wherever the block before, of the same size, left them.
            heights.resize(side * side, 0.0);
            sources.resize(side * side, 0);
            let mut seen: Vec<(u32, u8)> = Vec::new();
            paint(window, self.city, &buildings, heights, sources, |building, row, columns| {
                let parts = self.layout.parts(row, &columns);
                match seen.last_mut() {
                    Some((last, of_last)) if *last == building => *of_last |= parts,
                    _ => seen.push((building, parts)),
                }
            });
            seen.sort_unstable();
            let block = Block::of(heights, sources, side, seen);
            for (row, run) in block.all_runs() {
                let cells = row * side + usize::from(run.start)..row * side + usize::from(run.end);
                heights[cells.clone()].fill(0.0);
                sources[cells].fill(0);
            }
            block
        })
    }
}

thread_local! {
    /// Heights and sources of the block that is being painted; zeros between two blocks.
    static CANVAS: RefCell<(Vec<f32>, Vec<u8>)> = RefCell::default();
}

impl Block {
    fn of(heights: &[f32], sources: &[u8], side: usize, seen: Vec<(u32, u8)>) -> Self {
        let (mut runs, mut rows) = (Vec::new(), vec![0]);
        for (heights, sources) in heights.chunks_exact(side).zip(sources.chunks_exact(side)) {
            let mut at = 0;
            while let Some(empty) = first_built(&sources[at..]) {
                let start = at + empty;
                let (height_m, source) = (heights[start], sources[start]);
                let cells = heights[start..].iter().zip(&sources[start..]);
                let same = cells.take_while(|(height, of)| {
                    height.to_bits() == height_m.to_bits() && **of == source
                });
                at = start + same.count();
                runs.push(Run { start: start as u16, end: at as u16, height_m, source });
            }
            rows.push(runs.len() as u32);
        }
        Self { runs, rows, seen, strips: OnceLock::new() }
    }

    /// The runs of a row, from west to east.
    pub(super) fn row(&self, row: usize) -> &[Run] {
        &self.runs[self.rows[row] as usize..self.rows[row + 1] as usize]
    }

    fn all_runs(&self) -> impl Iterator<Item = (usize, &Run)> {
        (0..self.rows.len() - 1).flat_map(|row| self.row(row).iter().map(move |run| (row, run)))
    }

    /// What it takes in files of tiles.
    pub(super) fn strips(&self, make: impl FnOnce(&Self) -> BlockStrips) -> &BlockStrips {
        self.strips.get_or_init(|| make(self))
    }
}

/// Where the first building is. Most of a city is open ground.
fn first_built(sources: &[u8]) -> Option<usize> {
    let (chunks, rest) = sources.as_chunks::<16>();
    let open = chunks.iter().take_while(|chunk| u128::from_ne_bytes(**chunk) == 0).count() * 16;
    let rest = if open < chunks.len() * 16 { &sources[open..] } else { rest };
    rest.iter().position(|&source| source != 0).map(|at| open + at)
}

/// A tile as its blocks have it.
pub(super) struct BlockTile<'a> {
    layout: BlockLayout<'a>,
    blocks: Vec<Arc<OnceLock<Block>>>,
}

impl<'a> BlockTile<'a> {
    /// A tile that was painted alone, without what was seen in it.
    pub(super) fn of_grid(tile: &HeightGrid, layout: BlockLayout<'a>) -> Self {
        let BlockLayout { side, .. } = layout;
        let count = layout.count();
        let block = |index: usize| {
            let (south, east) = (index / count * side, index % count * side);
            let cells = layout.grid.side_cells();
            let inside = ndarray::s![south..cells.min(south + side), east..cells.min(east + side)];
            let mut heights = Array2::zeros((side, side));
            let mut sources = Array2::zeros((side, side));
            let here = tile.height_m.slice(inside);
            let there = ndarray::s![..here.nrows(), ..here.ncols()];
            heights.slice_mut(there).assign(&here);
            sources.slice_mut(there).assign(&tile.height_source.slice(inside));
            let heights = heights.as_slice().expect("a new array is contiguous");
            let sources = sources.as_slice().expect("a new array is contiguous");
            Arc::new(OnceLock::from(Block::of(heights, sources, side, Vec::new())))
        };
        Self { layout, blocks: (0..count * count).map(block).collect() }
    }

    /// The blocks that a row lies in, from west to east, and the row within them.
    pub(super) fn row(&self, row: usize) -> (impl Iterator<Item = &Block>, usize) {
        let (side, count) = (self.layout.side, self.layout.count());
        let blocks = &self.blocks[row / side * count..][..count];
        (blocks.iter().map(|block| painted(block)), row % side)
    }

    /// Calls `with(columns, height, source)` for all runs of a row, from west to east.
    fn for_each_run_of(&self, row: usize, mut with: impl FnMut(Range<usize>, f32, u8)) {
        let (cells, side) = (self.layout.grid.side_cells(), self.layout.side);
        let (blocks, row) = self.row(row);
        for (at, block) in blocks.enumerate() {
            let west = at * side;
            for &Run { start, end, height_m, source } in block.row(row) {
                let columns = west + usize::from(start)..(west + usize::from(end)).min(cells);
                if columns.is_empty() {
                    break;
                }
                with(columns, height_m, source);
            }
        }
    }

    /// Figures of the tile.
    pub(super) fn statistics(&self, city: &City) -> TileStatistics {
        let grid = self.layout.grid;
        let crop = grid.crop_offset_cells()..grid.crop_offset_cells() + grid.crop_cells();
        let (mut by_source, mut max_height_m) = ([0_u64; 4], 0.0_f32);
        for row in 0..grid.side_cells() {
            self.for_each_run_of(row, |columns, height, source| {
                max_height_m = max_height_m.max(height);
                let inside = columns.start.max(crop.start)..columns.end.min(crop.end);
                if crop.contains(&row) && !inside.is_empty() {
                    by_source[usize::from(source)] += inside.len() as u64;
                }
            });
        }
        statistics(count(city, self.seen()), by_source, max_height_m, crop.len())
    }

    /// Outlines with a cell in the tile.
    fn seen(&self) -> Vec<u32> {
        let count = self.layout.count();
        let ends = |at: usize| self.layout.rest > 0 && at + 1 == count;
        let mut seen = Vec::new();
        for (at, block) in self.blocks.iter().enumerate() {
            // Of the last column and row of blocks only the part that belongs to the tile.
            let columns = if ends(at % count) { 0b0101 } else { 0b1111 };
            let rows = if ends(at / count) { 0b0011 } else { 0b1111 };
            let here = painted(block).seen.iter();
            seen.extend(here.filter(|(_, parts)| parts & columns & rows != 0).map(|&(at, _)| at));
        }
        seen.sort_unstable();
        seen.dedup();
        seen
    }
}

fn painted(block: &OnceLock<Block>) -> &Block {
    block.get().expect("a tile's blocks are painted")
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use geo::MultiPolygon;
    use proptest::prelude::*;

    use super::super::pack::Packer;
    use super::*;
    use crate::building::{Attributes, Building, HeightSource, Kind, ObjectId};
    use crate::config::BuildingsConfig;
    use crate::crs::Utm;
    use crate::rasterise::TileSource;
    use crate::store::{NpzReader, read_npy};

    fn dense(tile: &BlockTile<'_>, city: &City, grid: &GridConfig) -> HeightGrid {
        let cells = grid.side_cells();
        let mut height_m = ndarray::Array2::zeros((cells, cells));
        let mut height_source = ndarray::Array2::zeros((cells, cells));
        for row in 0..cells {
            tile.for_each_run_of(row, |columns, height, source| {
                for column in columns {
                    height_m[[row, column]] = height;
                    height_source[[row, column]] = source;
                }
            });
        }
        HeightGrid { height_m, height_source, statistics: tile.statistics(city) }
    }

    prop_compose! {
        fn buildings()(all in prop::collection::vec(
            ((0.0_f64..200.0, 0.0_f64..200.0), (0.5_f64..60.0, 0.5_f64..60.0), 1_u8..9, any::<bool>(), any::<bool>()), 1..25
        )) -> Vec<Building> {
            all.into_iter().enumerate().map(|(at, ((x, y), (width, depth), height, is_part, raised))| {
                let corner = coord! { x: 512_000.0 + x, y: 4_000_256.0 + y };
                let rect = Rect::new(corner, corner + coord! { x: width, y: depth });
                let attributes = Attributes {
                    kind: if is_part { Kind::Part } else { Kind::Outline },
                    height_m: f32::from(height),
                    source: if at % 3 == 0 { HeightSource::Default } else { HeightSource::Height },
                    min_height_m: if raised { 3.0 } else { 0.0 },
                    raised,
                };
                // Some belong to one relation.
                let object = if at % 4 == 1 { ObjectId::Relation(7) } else { ObjectId::Way(at as i64) };
                Building { object, footprint: MultiPolygon(vec![rect.to_polygon()]), attributes }
            }).collect()
        }
    }

    proptest! {
        #[test]
        fn tiles_of_blocks_are_those_painted_alone(
            buildings in buildings(),
            (side_m, spacing_m, crop_m, cell_m) in prop::sample::select(vec![
                (40_u32, 16_u32, 20_u32, 1.0_f64), (40, 20, 40, 0.5), (36, 12, 12, 2.0), (45, 30, 15, 0.25),
            ]),
        ) {
            let grid = GridConfig { side_m, spacing_m, cell_m, crop_m, epsg: None };
            let city = City::new(buildings, &[], &BuildingsConfig::default());
            let source = TileSource::new(&city, &grid, Utm::from_zone(10, true).expect("a zone"));
            let tiles: Vec<TileId> = source.candidates().into_iter().collect();
            let blocks = Blocks::new(&city, &grid, &tiles).expect("they overlap");
            let packer = Packer::new(&grid);
            for &tile in &tiles {
                let (alone, of_blocks) = (source.rasterise(tile), blocks.tile(tile));
                let packed = packer.blocks(&of_blocks, b"{}".to_vec());
                prop_assert_eq!(&packer.grid(&alone, b"{}".to_vec()), &packed, "{}", tile);
                let mut archive = NpzReader::new(Cursor::new(&packed), 1 << 20).expect("an archive");
                let mut member = |name: &str| archive.member(name).expect("sound");
                let (heights, sources) = (member("height_m"), member("height_source"));
                let heights = read_npy(&heights).and_then(|npy| npy.to_array2()).expect("heights");
                let sources = read_npy(&sources).and_then(|npy| npy.to_array2()).expect("sources");
                prop_assert_eq!((&heights, &sources), (&alone.height_m, &alone.height_source));
                prop_assert_eq!(dense(&of_blocks, &city, &grid), alone, "{}", tile);
            }
            prop_assert!(blocks.needed.lock().expect("unpoisoned").is_empty(), "all are forgotten");
        }
    }

    #[test]
    fn tiles_that_share_no_cells_have_no_blocks() {
        let city = City::new(Vec::new(), &[], &BuildingsConfig::default());
        let grid = |side_m, spacing_m, cell_m| GridConfig {
            side_m,
            spacing_m,
            cell_m,
            crop_m: 10,
            epsg: None,
        };
        for grid in [grid(40, 40, 1.0), grid(40, 50, 1.0), grid(40, 16, 0.1), grid(40, 15, 2.0)] {
            assert!(Blocks::new(&city, &grid, &[]).is_none(), "{grid:?}");
        }
    }
}

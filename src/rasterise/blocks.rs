//! Tiles that overlap, put together from blocks that are painted once.
//!
//! A cell's value depends on its place alone, so tiles share what lies in both: at 1,080 m every 512 m each
//! place lies in 4.4 tiles. Blocks have the size of the lattice and begin at the corners of tiles, so that a
//! tile is some whole blocks and a part of those to the east and to the south. A painted block is kept as
//! runs of equal cells until the last tile that needs it is made.

use std::cell::RefCell;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock};

use geo::{Rect, coord};

use super::tile::{count, paint, statistics};
use crate::building::City;
use crate::config::GridConfig;
use crate::grid::{TileId, Window};
use crate::manifest::TileStatistics;

/// Side of the largest block, in cells: columns of runs are 16 bits.
const MAX_CELLS: usize = u16::MAX as usize;

/// Cells of a row that have one height, of one source.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Run {
    start: u16,
    end: u16,
    height_m: f32,
    source: u8,
}

/// A painted block.
#[derive(Debug, Default)]
struct Block {
    /// Of all rows, from north to south, without the cells where nothing is.
    runs: Vec<Run>,
    /// Where each row's runs begin; one more for the end.
    rows: Vec<u32>,
    /// Outlines with a cell in the block, ascending, and a bit for each of its four parts in which they have
    /// one: those that belong to a tile which ends in the block, and the others.
    seen: Vec<(u32, u8)>,
}

/// Blocks that are not painted yet, or needed further, by their column and row on the lattice.
type Needed = HashMap<[i64; 2], (Arc<OnceLock<Block>>, u32)>;

/// The blocks of a lattice.
#[derive(Debug)]
pub(super) struct Blocks<'a> {
    city: &'a City,
    grid: &'a GridConfig,
    /// Cells along a side of a block.
    side: usize,
    /// Of the last block of a tile, the columns or rows that belong to it.
    rest: usize,
    needed: Mutex<Needed>,
}

impl<'a> Blocks<'a> {
    /// The blocks of tiles, each of which is made once; `None` if the tiles do not share cells.
    pub(super) fn new(city: &'a City, grid: &'a GridConfig, tiles: &[TileId]) -> Option<Self> {
        let side = f64::from(grid.spacing_m) / grid.cell_m;
        // All places are sums of binary fractions then, exact wherever one begins to count.
        let is_exact = (grid.cell_m * 1024.0).fract() == 0.0;
        let overlaps = grid.spacing_m < grid.side_m;
        if !(overlaps && is_exact && side.fract() == 0.0 && side <= MAX_CELLS as f64) {
            return None;
        }
        let side = side as usize;
        let rest = grid.side_cells() % side;
        let blocks = Self { city, grid, side, rest, needed: Mutex::default() };
        let mut needed = Needed::new();
        for &tile in tiles {
            for index in blocks.of(tile) {
                needed.entry(index).or_default().1 += 1;
            }
        }
        Some(Self { needed: Mutex::new(needed), ..blocks })
    }

    /// Blocks along a side of a tile.
    fn count(&self) -> usize {
        self.grid.side_cells().div_ceil(self.side)
    }

    /// The blocks of a tile, row by row from its north-western one.
    fn of(&self, tile: TileId) -> impl Iterator<Item = [i64; 2]> + use<> {
        let (spacing, count) = (i64::from(self.grid.spacing_m), self.count() as i64);
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
        BlockTile { of: self, blocks: blocks.collect() }
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
        let spacing = f64::from(self.grid.spacing_m);
        let half = f64::from(self.grid.side_m) / 2.0;
        let (west, north) = (column as f64 * spacing - half, row as f64 * spacing + half);
        let window = Window { west, north, cell: self.grid.cell_m, cells: self.side };
        let bounds =
            Rect::new(coord! { x: west, y: window.south() }, coord! { x: window.east(), y: north });
        let buildings = self.city.meeting(&bounds);
        CANVAS.with_borrow_mut(|(heights, sources)| {
            heights.clear();
            heights.resize(self.side * self.side, 0.0);
            sources.clear();
            sources.resize(self.side * self.side, 0);
            let mut seen: Vec<(u32, u8)> = Vec::new();
            paint(window, self.city, &buildings, heights, sources, |building, row, columns| {
                let parts = self.parts(row, &columns);
                match seen.last_mut() {
                    Some((last, of_last)) if *last == building => *of_last |= parts,
                    _ => seen.push((building, parts)),
                }
            });
            seen.sort_unstable();
            Block::of(heights, sources, self.side, seen)
        })
    }

    /// A bit for each part of a block that has some of these cells.
    fn parts(&self, row: usize, columns: &Range<usize>) -> u8 {
        let west = u8::from(columns.start < self.rest);
        let east = u8::from(columns.end > self.rest) << 1;
        (west | east) << if row < self.rest { 0 } else { 2 }
    }
}

thread_local! {
    /// Heights and sources of the block that is being painted.
    static CANVAS: RefCell<(Vec<f32>, Vec<u8>)> = RefCell::default();
}

impl Block {
    fn of(heights: &[f32], sources: &[u8], side: usize, seen: Vec<(u32, u8)>) -> Self {
        let (mut runs, mut rows) = (Vec::new(), vec![0]);
        for (heights, sources) in heights.chunks_exact(side).zip(sources.chunks_exact(side)) {
            let mut at = 0;
            while let Some(empty) = sources[at..].iter().position(|&source| source != 0) {
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
        Self { runs, rows, seen }
    }

    fn row(&self, row: usize) -> &[Run] {
        &self.runs[self.rows[row] as usize..self.rows[row + 1] as usize]
    }
}

/// A tile as its blocks have it.
pub(super) struct BlockTile<'a> {
    of: &'a Blocks<'a>,
    blocks: Vec<Arc<OnceLock<Block>>>,
}

impl BlockTile<'_> {
    /// Calls `with(columns, height, source)` for all runs of a row, from west to east.
    pub(super) fn for_each_run_of(&self, row: usize, mut with: impl FnMut(Range<usize>, f32, u8)) {
        let (cells, side, count) = (self.of.grid.side_cells(), self.of.side, self.of.count());
        let blocks = &self.blocks[row / side * count..][..count];
        for (at, block) in blocks.iter().enumerate() {
            let west = at * side;
            for &Run { start, end, height_m, source } in painted(block).row(row % side) {
                let columns = west + usize::from(start)..(west + usize::from(end)).min(cells);
                if columns.is_empty() {
                    break;
                }
                with(columns, height_m, source);
            }
        }
    }

    /// Figures of the tile.
    pub(super) fn statistics(&self) -> TileStatistics {
        let grid = self.of.grid;
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
        statistics(count(self.of.city, self.seen()), by_source, max_height_m, crop.len())
    }

    /// Outlines with a cell in the tile.
    fn seen(&self) -> Vec<u32> {
        let count = self.of.count();
        let ends = |at: usize| self.of.rest > 0 && at + 1 == count;
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
    use geo::MultiPolygon;
    use proptest::prelude::*;

    use super::*;
    use crate::building::{Attributes, Building, HeightSource, Kind, ObjectId};
    use crate::config::BuildingsConfig;
    use crate::crs::Utm;
    use crate::rasterise::{HeightGrid, TileSource};

    fn dense(tile: &BlockTile<'_>, grid: &GridConfig) -> HeightGrid {
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
        HeightGrid { height_m, height_source, statistics: tile.statistics() }
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
            for &tile in &tiles {
                prop_assert_eq!(dense(&blocks.tile(tile), &grid), source.rasterise(tile), "{}", tile);
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

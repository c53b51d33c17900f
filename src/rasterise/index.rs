//! The tiles that buildings fill, and which buildings may touch which tile.

use std::collections::{BTreeSet, HashMap};

use geo::{BoundingRect, Rect};

use super::tile::{HeightGrid, rasterise_tile};
use crate::building::Building;
use crate::config::GridConfig;
use crate::crs::Utm;
use crate::grid::TileId;

/// Makes tiles of buildings. These are sorted into square blocks as wide as the lattice's
/// spacing; most lie in one block: about 4 bytes each, besides their bounding boxes.
pub struct TileSource<'a> {
    buildings: &'a [Building],
    boxes: Vec<Rect<f64>>,
    blocks: HashMap<[i64; 2], Vec<u32>>,
    grid: &'a GridConfig,
    utm: Utm,
}

impl<'a> TileSource<'a> {
    /// Sorts buildings whose footprints are in metres of a UTM zone.
    ///
    /// # Panics
    /// If a footprint has no ring at all.
    #[must_use]
    pub fn new(buildings: &'a [Building], grid: &'a GridConfig, utm: Utm) -> Self {
        let boxes: Vec<Rect<f64>> = buildings
            .iter()
            .map(|building| {
                building.footprint.bounding_rect().expect("a footprint has at least one ring")
            })
            .collect();
        let spacing = f64::from(grid.spacing_m);
        let mut blocks: HashMap<[i64; 2], Vec<u32>> = HashMap::new();
        for (index, bounds) in boxes.iter().enumerate() {
            for block in blocks_of(bounds, spacing) {
                blocks.entry(block).or_default().push(index as u32);
            }
        }
        Self { buildings, boxes, blocks, grid, utm }
    }

    /// All tiles of the lattice that some building's bounding box meets.
    #[must_use]
    pub fn candidates(&self) -> BTreeSet<TileId> {
        let half = f64::from(self.grid.side_m) / 2.0;
        let spacing = i64::from(self.grid.spacing_m);
        let mut tiles = BTreeSet::new();
        for bounds in &self.boxes {
            let range = |low: f64, high: f64| {
                let first = ((low - half) / spacing as f64).ceil() as i64;
                let last = ((high + half) / spacing as f64).floor() as i64;
                first..=last
            };
            for column in range(bounds.min().x, bounds.max().x) {
                for row in range(bounds.min().y, bounds.max().y) {
                    let (easting, northing) = (column * spacing, row * spacing);
                    tiles.insert(TileId { utm: self.utm, easting, northing });
                }
            }
        }
        tiles
    }

    /// Rasterises one tile.
    #[must_use]
    pub fn rasterise(&self, tile: TileId) -> HeightGrid {
        rasterise_tile(tile, self.grid, &self.of_tile(tile))
    }

    /// The buildings whose bounding boxes meet a tile.
    fn of_tile(&self, tile: TileId) -> Vec<&'a Building> {
        let half = f64::from(self.grid.side_m) / 2.0;
        let [x, y] = tile.center();
        let bounds = Rect::new([x - half, y - half], [x + half, y + half]);
        let mut indices: Vec<u32> = blocks_of(&bounds, self.grid.spacing_m.into())
            .filter_map(|block| self.blocks.get(&block))
            .flatten()
            .copied()
            .filter(|&index| meets(&self.boxes[index as usize], &bounds))
            .collect();
        indices.sort_unstable();
        indices.dedup();
        indices.into_iter().map(|index| &self.buildings[index as usize]).collect()
    }
}

fn blocks_of(bounds: &Rect<f64>, side: f64) -> impl Iterator<Item = [i64; 2]> + use<> {
    let block = |coordinate: f64| (coordinate / side).floor() as i64;
    let rows = block(bounds.min().y)..=block(bounds.max().y);
    let columns = block(bounds.min().x)..=block(bounds.max().x);
    columns.flat_map(move |column| rows.clone().map(move |row| [column, row]))
}

fn meets(a: &Rect<f64>, b: &Rect<f64>) -> bool {
    a.min().x <= b.max().x
        && b.min().x <= a.max().x
        && a.min().y <= b.max().y
        && b.min().y <= a.max().y
}

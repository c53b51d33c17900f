//! The tiles that buildings fill, and which buildings may touch which tile.

use std::collections::BTreeSet;

use geo::{BoundingRect, Rect};

use super::tile::{HeightGrid, rasterise_tile};
use crate::building::Building;
use crate::config::GridConfig;
use crate::crs::Utm;
use crate::grid::{BoxIndex, TileId};

/// Makes tiles of buildings, which are sorted into blocks as wide as the lattice's spacing.
pub struct TileSource<'a> {
    buildings: &'a [Building],
    index: BoxIndex,
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
        let index = BoxIndex::new(boxes, f64::from(grid.spacing_m));
        Self { buildings, index, grid, utm }
    }

    /// All tiles of the lattice that some building's bounding box meets.
    #[must_use]
    pub fn candidates(&self) -> BTreeSet<TileId> {
        let half = f64::from(self.grid.side_m) / 2.0;
        let spacing = i64::from(self.grid.spacing_m);
        let mut tiles = BTreeSet::new();
        for bounds in self.index.boxes() {
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
        let meeting = self.index.meeting(&tile.square(self.grid.side_m.into()));
        let buildings: Vec<&Building> =
            meeting.into_iter().map(|index| &self.buildings[index]).collect();
        rasterise_tile(tile, self.grid, &buildings)
    }
}

//! The tiles that the buildings of a city fill.

use std::collections::BTreeSet;

use super::tile::{HeightGrid, rasterise_tile};
use crate::building::City;
use crate::config::GridConfig;
use crate::crs::Utm;
use crate::grid::TileId;

/// Makes tiles of a city.
pub struct TileSource<'a> {
    pub(super) city: &'a City,
    grid: &'a GridConfig,
    utm: Utm,
}

impl<'a> TileSource<'a> {
    /// Tiles of a lattice in the projection of the city.
    #[must_use]
    pub fn new(city: &'a City, grid: &'a GridConfig, utm: Utm) -> Self {
        Self { city, grid, utm }
    }

    /// All tiles of the lattice that some building's bounding box meets.
    #[must_use]
    pub fn candidates(&self) -> BTreeSet<TileId> {
        let half = f64::from(self.grid.side_m) / 2.0;
        let spacing = i64::from(self.grid.spacing_m);
        let (mut tiles, mut last) = (BTreeSet::new(), None);
        for bounds in self.city.boxes() {
            let range = |low: f64, high: f64| {
                let first = ((low - half) / spacing as f64).ceil() as i64;
                let last = ((high + half) / spacing as f64).floor() as i64;
                first..=last
            };
            let met =
                [range(bounds.min().x, bounds.max().x), range(bounds.min().y, bounds.max().y)];
            // Neighbours mostly follow each other.
            if last.as_ref() == Some(&met) {
                continue;
            }
            let [columns, rows] = last.insert(met);
            for column in columns.clone() {
                for row in rows.clone() {
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
        let buildings = self.city.meeting(&tile.square(self.grid.side_m.into()));
        rasterise_tile(tile, self.grid, self.city, &buildings)
    }
}

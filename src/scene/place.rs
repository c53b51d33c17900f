//! Where base stations stand in a scene.

use std::collections::BTreeSet;

use super::sites::Site;
use super::solid::Solid;
use crate::config::{Placement, SceneConfig};
use crate::grid::{TileId, Window};
use crate::manifest::SceneStation;
use crate::random::Random;
use crate::rasterise::HeightGrid;

/// The square of a tile that base stations may stand in.
pub(super) struct Square<'a> {
    tile: TileId,
    /// Heights of the square as the tile's grid has them.
    grid: &'a HeightGrid,
    window: Window,
    /// The solids that meet the tile.
    solids: &'a [&'a Solid],
}

/// Base stations of a file, and what was done to them.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Placed {
    pub(super) stations: Vec<SceneStation>,
    pub(super) repeated: u64,
    pub(super) raised: u64,
}

impl<'a> Square<'a> {
    /// `grid` covers the square around the tile's centre, in cells of `cell_m`.
    pub(super) fn new(
        tile: TileId,
        grid: &'a HeightGrid,
        cell_m: f64,
        solids: &'a [&'a Solid],
    ) -> Self {
        let window = Window::around(tile, cell_m, grid.height_m.nrows());
        Self { tile, grid, window, solids }
    }

    /// Random base stations over centres of cells, where grid and mesh have the same heights. The
    /// i-th depends on seed, tile and i alone, so two may stand at the same place. None for
    /// [`Placement::Roof`] where there is no roof.
    pub(super) fn random(&self, config: &SceneConfig) -> Vec<SceneStation> {
        let cells = self.window.cells;
        let cells: Vec<usize> = match config.placement {
            Placement::Roof => {
                let heights = self.grid.height_m.iter().enumerate();
                heights.filter(|(_, height)| **height > 0.0).map(|(cell, _)| cell).collect()
            }
            _ => (0..cells * cells).collect(),
        };
        if cells.is_empty() {
            return Vec::new();
        }
        let TileId { utm, easting, northing } = self.tile;
        let of_tile = [utm.epsg().into(), easting as u64, northing as u64];
        let station = |index: u32| {
            let [epsg, easting, northing] = of_tile;
            let key = [config.seed, epsg, easting, northing, index.into()];
            let cell = cells[Random::keyed(&key).below(cells.len())];
            let place = self.center_of(cell);
            let roof = self.roof(place);
            let z = roof.unwrap_or(0.0) + config.height_above_m;
            self.station(place, z, roof.is_some(), None)
        };
        (0..config.base_stations).map(station).collect()
    }

    /// The sites of a file (places in metres of the projection), in their order. Nothing stands
    /// inside of a building: where the mesh or the grid says that a site would, it is raised over
    /// the roof.
    pub(super) fn of_sites<'s>(
        &self,
        sites: impl IntoIterator<Item = &'s ([f64; 2], Site)>,
        height_above_m: f64,
    ) -> Placed {
        let mut placed = Placed::default();
        let mut taken = BTreeSet::new();
        for (place, site) in sites {
            let roof = self.roof(*place);
            let height = site.height_m.unwrap_or(height_above_m);
            let wanted = site.on_building.unwrap_or(true);
            let (z, on_building) = match roof {
                Some(roof) if wanted => (roof + height, true),
                Some(roof) if self.is_inside(*place, height) => {
                    placed.raised += 1;
                    (roof + height_above_m, true)
                }
                _ => (height, false),
            };
            let station = self.station(*place, z, on_building, site.name.clone());
            if taken.insert(station.position_m.map(f64::to_bits)) {
                placed.stations.push(station);
            } else {
                placed.repeated += 1;
            }
        }
        placed
    }

    fn station(
        &self,
        place: [f64; 2],
        z: f64,
        on_building: bool,
        name: Option<String>,
    ) -> SceneStation {
        let [easting, northing] = self.tile.center();
        let position_m = [place[0] - easting, place[1] - northing, z];
        SceneStation { position_m, on_building, name }
    }

    fn center_of(&self, cell: usize) -> [f64; 2] {
        let Window { west, cell: side, cells, .. } = self.window;
        [west + ((cell % cells) as f64 + 0.5) * side, self.window.row_northing(cell / cells)]
    }

    /// Height of the grid's cell at a place, in metres; 0 where there is no building.
    fn grid_height(&self, [x, y]: [f64; 2]) -> f64 {
        let Window { west, north, cell, cells } = self.window;
        let index = |offset: f64| ((offset / cell).floor().max(0.0) as usize).min(cells - 1);
        self.grid.height_m[[index(north - y), index(x - west)]].into()
    }

    /// The solids over a place, as bottom and top.
    fn over(&self, [x, y]: [f64; 2]) -> impl Iterator<Item = [f64; 2]> {
        let covering = self.solids.iter().filter(move |solid| {
            let (low, high) = (solid.bounds().min(), solid.bounds().max());
            (low.x..=high.x).contains(&x) && (low.y..=high.y).contains(&y) && solid.covers([x, y])
        });
        covering.map(|solid| solid.heights_m().map(f64::from))
    }

    /// The highest roof over a place, that of mesh and grid which is higher; `None` if there is
    /// neither.
    fn roof(&self, place: [f64; 2]) -> Option<f64> {
        let highest = self.over(place).map(|[_, top]| top).fold(self.grid_height(place), f64::max);
        (highest > 0.0).then_some(highest)
    }

    /// Whether a height over a place lies inside of a solid, or not above the grid's building.
    fn is_inside(&self, place: [f64; 2], height: f64) -> bool {
        height <= self.grid_height(place)
            || self.over(place).any(|[bottom, top]| (bottom..=top).contains(&height))
    }
}

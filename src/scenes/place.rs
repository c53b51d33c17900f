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
pub(super) struct PlacedStations {
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
    pub(super) fn random(&self, config: &SceneConfig, rx_height_m: f64) -> Vec<SceneStation> {
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
            let z = roof.map_or(config.ground_height_m, |roof| roof + config.height_above_m);
            let z = if z > rx_height_m { z } else { config.ground_height_m };
            self.station(place, z, roof.is_some(), None)
        };
        (0..config.base_stations).map(station).collect()
    }

    /// The sites of a file (places in metres of the projection), in their order. Nothing stands
    /// inside of a building: where the mesh or the grid says that a site would, it is raised over
    /// the roof. Nor does one stand at the receivers' height or below it, be it on a low roof: it is
    /// raised to where others on the ground stand.
    pub(super) fn of_sites<'s>(
        &self,
        sites: impl IntoIterator<Item = &'s ([f64; 2], Site)>,
        config: &SceneConfig,
        rx_height_m: f64,
    ) -> PlacedStations {
        let mut placed = PlacedStations::default();
        let mut taken = BTreeSet::new();
        for (place, site) in sites {
            let roof = self.roof(*place);
            let over_roof = site.height_m.unwrap_or(config.height_above_m);
            let told = site.height_m.unwrap_or(config.ground_height_m);
            let height = if told > rx_height_m { told } else { config.ground_height_m };
            let wanted = site.on_building.unwrap_or(true);
            let (z, on_building, raised) = match roof {
                Some(roof) if wanted => (roof + over_roof, true, false),
                Some(roof) if self.is_inside(*place, height) => {
                    (roof + config.height_above_m, true, true)
                }
                _ => (height, false, height > told),
            };
            let low = z <= rx_height_m;
            let (z, raised) = if low { (config.ground_height_m, true) } else { (z, raised) };
            let station = self.station(*place, z, on_building, site.name.clone());
            if taken.insert(station.position_m.map(f64::to_bits)) {
                placed.raised += u64::from(raised);
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

#[cfg(test)]
mod tests {
    use super::super::solid::{Solids, extrude};
    use super::*;
    use crate::building::{Attributes, Building, City, HeightSource, Kind, ObjectId};
    use crate::config::{BuildingsConfig, GridConfig};
    use crate::rasterise::rasterise_tile;
    use geo::{MultiPolygon, Rect, coord};

    const GRID: GridConfig =
        GridConfig { side_m: 40, spacing_m: 20, cell_m: 1.0, crop_m: 40, epsg: None };

    fn tile() -> TileId {
        "utm10n_e500000_n4000000".parse().expect("an id")
    }

    /// A square building from a place relative to the tile's centre on.
    fn square(x: f64, y: f64, side: f64, [bottom, top]: [f32; 2]) -> Building {
        let corner = coord! { x: 500_000.0 + x, y: 4_000_000.0 + y };
        let footprint = MultiPolygon(vec![
            Rect::new(corner, corner + coord! { x: side, y: side }).to_polygon(),
        ]);
        let attributes = Attributes {
            kind: Kind::Outline,
            height_m: top,
            source: HeightSource::Height,
            min_height_m: bottom,
            raised: bottom > 2.0,
        };
        Building { object: ObjectId::Way(1), footprint, attributes }
    }

    /// A house of 9.5 m in the north-east, a canopy from 5 m to 6 m in the south-west.
    fn buildings() -> Vec<Building> {
        vec![square(5.0, 5.0, 8.0, [0.0, 9.5]), square(-15.0, -15.0, 10.0, [5.0, 6.0])]
    }

    fn with_square<T>(
        buildings: &[Building],
        tile: TileId,
        act: impl FnOnce(&Square<'_>) -> T,
    ) -> T {
        let city = City::new(buildings.to_vec(), &[], &BuildingsConfig::default());
        let all: Vec<usize> = (0..buildings.len()).collect();
        let grid = rasterise_tile(tile, &GRID, &city, &all);
        let Solids { solids, .. } = extrude(&city);
        let solids: Vec<&Solid> = solids.iter().collect();
        act(&Square::new(tile, &grid, GRID.cell_m, &solids))
    }

    fn random(config: &SceneConfig) -> Vec<SceneStation> {
        with_square(&buildings(), tile(), |square| square.random(config, 2.0))
    }

    fn config(placement: Placement, base_stations: u32) -> SceneConfig {
        SceneConfig { placement, base_stations, ..SceneConfig::default() }
    }

    fn in_square(value: f64, low: f64, side: f64) -> bool {
        (low..low + side).contains(&value)
    }

    #[test]
    fn any_cell_is_taken_and_what_covers_it_is_stood_on() {
        let stations = random(&config(Placement::Any, 1000));
        let mut seen = [0; 3];
        for SceneStation { position_m: [x, y, z], on_building, name } in &stations {
            assert!(x.abs() < 20.0 && y.abs() < 20.0, "{x}, {y}");
            assert!(x.fract().abs() == 0.5 && y.fract().abs() == 0.5, "centres of cells");
            let house = in_square(*x, 5.0, 8.0) && in_square(*y, 5.0, 8.0);
            let canopy = in_square(*x, -15.0, 10.0) && in_square(*y, -15.0, 10.0);
            let wanted = if house {
                11.5
            } else if canopy {
                8.0
            } else {
                10.0
            };
            assert_eq!((*z, *on_building), (wanted, house || canopy), "{x}, {y}");
            assert_eq!(*name, None);
            seen[if house { 0 } else { 1 + usize::from(canopy) }] += 1;
        }
        // 64 and 100 of 1600 cells.
        assert!((20..70).contains(&seen[0]) && (35..95).contains(&seen[2]), "{seen:?}");
    }

    #[test]
    fn roofs_are_those_of_buildings_on_the_ground() {
        let stations = random(&config(Placement::Roof, 200));
        assert!(
            stations.iter().all(|station| station.on_building && station.position_m[2] == 11.5)
        );
        let canopy = buildings().split_off(1);
        let roof = config(Placement::Roof, 1);
        assert_eq!(with_square(&canopy, tile(), |square| square.random(&roof, 2.0)), []);
    }

    #[test]
    fn a_place_depends_on_seed_tile_and_number_alone() {
        let five = random(&config(Placement::Any, 5));
        assert_eq!(five[..], random(&config(Placement::Any, 9))[..5]);
        assert_ne!(five, random(&SceneConfig { seed: 1, ..config(Placement::Any, 5) }));
        let east: TileId = "utm10n_e500020_n4000000".parse().expect("an id");
        let any = config(Placement::Any, 5);
        let there = with_square(&[], east, |square| square.random(&any, 2.0));
        let places = |stations: &[SceneStation]| -> Vec<f64> {
            stations.iter().map(|station| station.position_m[0]).collect()
        };
        assert_ne!(places(&five), places(&there));
    }

    #[test]
    fn sites_stand_on_roofs_or_on_the_ground_but_never_inside() {
        let site = |x: f64, y: f64, height_m: Option<f64>, on_building: Option<bool>| {
            let site =
                Site { lon_lat: [0.0; 2], height_m, on_building, name: Some("s".to_owned()) };
            ([500_000.0 + x, 4_000_000.0 + y], site)
        };
        let cases = [
            (site(7.3, 7.3, None, None), [11.5, 1.0], "on the roof there"),
            (site(7.4, 7.3, Some(20.0), Some(true)), [29.5, 1.0], "over the roof"),
            (site(7.5, 7.3, Some(30.0), Some(false)), [30.0, 0.0], "a mast through the house"),
            (site(7.6, 7.3, Some(5.0), Some(false)), [11.5, 1.0], "inside: raised"),
            (site(-10.2, -10.0, Some(3.0), Some(false)), [3.0, 0.0], "under the canopy"),
            (site(-10.3, -10.0, Some(5.5), Some(false)), [8.0, 1.0], "in the canopy: raised"),
            (site(-10.4, -10.0, None, None), [8.0, 1.0], "on the canopy"),
            (site(18.0, -18.0, Some(25.0), Some(true)), [25.0, 0.0], "no building there"),
            (site(18.0, -18.5, None, None), [10.0, 0.0], "on the ground"),
            (site(18.0, -18.6, Some(2.0), None), [10.0, 0.0], "at the receivers' height: raised"),
        ];
        let mut sites: Vec<_> = cases.iter().map(|(site, ..)| site.clone()).collect();
        sites.push(sites[0].clone());
        let placed = with_square(&buildings(), tile(), |square| {
            square.of_sites(&sites, &SceneConfig::default(), 2.0)
        });
        assert_eq!((placed.repeated, placed.raised, placed.stations.len()), (1, 3, cases.len()));
        for (station, (_, [z, on_building], why)) in placed.stations.iter().zip(cases) {
            assert_eq!(
                (station.position_m[2], station.on_building),
                (z, on_building > 0.0),
                "{why}"
            );
            assert_eq!(station.name.as_deref(), Some("s"));
        }
        assert!((placed.stations[0].position_m[0] - 7.3).abs() < 1e-9);
    }
}

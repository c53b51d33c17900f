//! One tile: which building is on top of each cell.

use ndarray::Array2;

use super::scanline::Scanline;
use crate::building::{Attributes, Building, Kind};
use crate::config::GridConfig;
use crate::grid::{TileId, Window};
use crate::manifest::{BuiltBySource, TileStatistics};

/// Heights of a tile and how well they are known.
#[derive(Debug, Clone, PartialEq)]
pub struct HeightGrid {
    /// Height of the highest building over the ground in metres, 0 where there is none;
    /// `[L, L]`, row 0 north, column 0 west.
    pub height_m: Array2<f32>,
    /// Source of the height: 0 no building, 1 `height`, 2 levels, 3 guess; same axes.
    pub height_source: Array2<u8>,
    /// Figures of the tile.
    pub statistics: TileStatistics,
}

/// Order of painting. Parts come after all outlines and thus replace them; what is elevated
/// comes last and only raises what is there.
fn layer(attributes: &Attributes) -> u8 {
    match (attributes.elevated, attributes.kind) {
        (false, Kind::Outline) => 0,
        (false, Kind::Part) => 1,
        (true, _) => 2,
    }
}

/// Rasterises the buildings that may touch a tile.
///
/// Overlaps take the highest, because within each layer lower buildings are painted first;
/// of equal heights the better known one wins.
#[must_use]
pub fn rasterise_tile(tile: TileId, grid: &GridConfig, buildings: &[&Building]) -> HeightGrid {
    let cells = grid.side_cells();
    let window = Window::around(tile, grid.cell_m, cells);
    let mut height_m = Array2::<f32>::zeros((cells, cells));
    let mut height_source = Array2::<u8>::zeros((cells, cells));
    let crop = grid.crop_offset_cells()..grid.crop_offset_cells() + grid.crop_cells();
    let heights = height_m.as_slice_mut().expect("a new array is contiguous");
    let sources = height_source.as_slice_mut().expect("a new array is contiguous");

    let mut order: Vec<&Building> = buildings.to_vec();
    order.sort_unstable_by(|a, b| {
        let (one, other) = (&a.attributes, &b.attributes);
        layer(one)
            .cmp(&layer(other))
            .then_with(|| one.height_m.total_cmp(&other.height_m))
            .then_with(|| other.source.cmp(&one.source))
            .then_with(|| a.object.cmp(&b.object))
    });
    let mut scanline = Scanline::default();
    let mut buildings_in_tile = 0;
    for building in order {
        let Attributes { height_m: top, source, .. } = building.attributes;
        let layer = layer(&building.attributes);
        let mut has_cells = false;
        for polygon in &building.footprint {
            scanline.fill(polygon, &window, |row, columns| {
                has_cells = true;
                let run = row * cells + columns.start..row * cells + columns.end;
                if layer < 2 {
                    heights[run.clone()].fill(top);
                    sources[run].fill(source as u8);
                } else {
                    let covered = heights[run.clone()].iter_mut().zip(&mut sources[run]);
                    for (height, known) in covered.filter(|(height, _)| **height > 0.0) {
                        if top > *height {
                            (*height, *known) = (top, source as u8);
                        }
                    }
                }
            });
        }
        buildings_in_tile += u32::from(has_cells && layer == 0);
    }

    let mut by_source = [0_u64; 4];
    for row in crop.clone() {
        for &source in &sources[row * cells + crop.start..row * cells + crop.end] {
            by_source[usize::from(source)] += 1;
        }
    }
    let [_, height, levels, default] = by_source;
    let built_cells = BuiltBySource { height, levels, default };
    let statistics = TileStatistics {
        buildings: buildings_in_tile,
        built: built_cells.total() as f64 / (crop.len() * crop.len()) as f64,
        max_height_m: heights.iter().copied().fold(0.0, f32::max),
        built_cells,
    };
    HeightGrid { height_m, height_source, statistics }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::building::{HeightSource, ObjectId};
    use geo::{MultiPolygon, Rect, coord};

    const GRID: GridConfig =
        GridConfig { side_m: 40, spacing_m: 20, cell_m: 1.0, crop_m: 20, epsg: None };

    fn tile() -> TileId {
        "utm10n_e500000_n4000000".parse().expect("an id")
    }

    /// A square building around a place relative to the tile's centre.
    fn square(id: i64, x: f64, y: f64, side: f64, attributes: Attributes) -> Building {
        let center = coord! { x: 500_000.0 + x, y: 4_000_000.0 + y };
        let half = coord! { x: side / 2.0, y: side / 2.0 };
        let footprint = MultiPolygon(vec![Rect::new(center - half, center + half).to_polygon()]);
        Building { object: ObjectId::Way(id), footprint, attributes }
    }

    fn with(kind: Kind, height_m: f32, elevated: bool) -> Attributes {
        let source = HeightSource::Height;
        Attributes { kind, height_m, source, min_height_m: 0.0, elevated }
    }

    /// The height at a place relative to the centre.
    fn at(grid: &HeightGrid, x: f64, y: f64) -> f32 {
        grid.height_m[[(20.0 - y).floor() as usize, (20.0 + x).floor() as usize]]
    }

    #[test]
    fn overlaps_take_the_highest_in_any_order() {
        let low = square(1, 0.0, 0.0, 10.0, with(Kind::Outline, 5.0, false));
        let high = square(2, 4.0, 0.0, 10.0, with(Kind::Outline, 9.0, false));
        let grid = rasterise_tile(tile(), &GRID, &[&low, &high]);
        assert_eq!((at(&grid, 0.5, 0.5), at(&grid, -4.5, 0.5)), (9.0, 5.0));
        assert_eq!(grid, rasterise_tile(tile(), &GRID, &[&high, &low]));
        assert_eq!((grid.statistics.buildings, grid.statistics.max_height_m), (2, 9.0));
        assert!((grid.statistics.built - 140.0 / 400.0).abs() < 1e-12);
    }

    #[test]
    fn parts_replace_the_outline_and_elevated_parts_only_raise() {
        let outline = square(1, 0.0, 0.0, 10.0, with(Kind::Outline, 20.0, false));
        let podium = square(2, 0.0, 0.0, 6.0, with(Kind::Part, 5.0, false));
        let tower = square(3, 0.0, 0.0, 2.0, with(Kind::Part, 50.0, true));
        let skyway = square(4, 15.0, 0.0, 4.0, with(Kind::Part, 9.0, true));
        let grid = rasterise_tile(tile(), &GRID, &[&tower, &podium, &skyway, &outline]);
        assert_eq!(at(&grid, 0.5, 0.5), 50.0);
        assert_eq!(at(&grid, 2.5, 0.5), 5.0);
        assert_eq!(at(&grid, 4.5, 0.5), 20.0);
        assert_eq!(at(&grid, 15.5, 0.5), 0.0);
        assert_eq!(grid.statistics.buildings, 1, "parts are not counted");
    }

    #[test]
    fn overlapping_tiles_agree() {
        let wall = square(1, 7.3, 3.9, 11.7, with(Kind::Outline, 7.0, false));
        let here = rasterise_tile(tile(), &GRID, &[&wall]);
        let east: TileId = "utm10n_e500020_n4000000".parse().expect("an id");
        let there = rasterise_tile(east, &GRID, &[&wall]);
        assert_eq!(
            here.height_m.slice(ndarray::s![.., 20..]),
            there.height_m.slice(ndarray::s![.., ..20])
        );
    }
}

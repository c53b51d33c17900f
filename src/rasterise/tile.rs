//! One tile: the prisms over each cell (`building::Prism`), the highest of them.

use std::collections::BTreeSet;
use std::ops::Range;

use ndarray::Array2;

use super::scanline::Scanline;
use crate::building::{Building, City, Kind, Limits, ObjectId, Prism};
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

/// Rasterises the buildings that may touch a tile, by their indices in the city.
#[must_use]
pub fn rasterise_tile(
    tile: TileId,
    grid: &GridConfig,
    city: &City,
    buildings: &[usize],
) -> HeightGrid {
    let cells = grid.side_cells();
    let window = Window::around(tile, grid.cell_m, cells);
    let mut height_m = Array2::<f32>::zeros((cells, cells));
    let mut height_source = Array2::<u8>::zeros((cells, cells));
    let crop = grid.crop_offset_cells()..grid.crop_offset_cells() + grid.crop_cells();
    let heights = height_m.as_slice_mut().expect("a new array is contiguous");
    let sources = height_source.as_slice_mut().expect("a new array is contiguous");
    let mut seen: Vec<u32> = Vec::new();
    paint(window, city, buildings, heights, sources, |building, _, _| {
        if seen.last() != Some(&building) {
            seen.push(building);
        }
    });

    let mut by_source = [0_u64; 4];
    for row in crop.clone() {
        for &source in &sources[row * cells + crop.start..row * cells + crop.end] {
            by_source[usize::from(source)] += 1;
        }
    }
    let max_height_m = heights.iter().copied().fold(0.0, f32::max);
    let statistics = statistics(count(city, seen), by_source, max_height_m, crop.len());
    HeightGrid { height_m, height_source, statistics }
}

/// Figures of a tile: buildings in it, cells of its central window by their source, its greatest height.
pub(super) fn statistics(
    buildings: u32,
    by_source: [u64; 4],
    max_height_m: f32,
    crop_cells: usize,
) -> TileStatistics {
    let [_, height, levels, default] = by_source;
    let built_cells = BuiltBySource { height, levels, default };
    TileStatistics {
        buildings,
        built: built_cells.total() as f64 / (crop_cells * crop_cells) as f64,
        max_height_m,
        built_cells,
    }
}

/// Number of objects among buildings, each named once: a relation may be several buildings, one for
/// each height of its rings.
pub(super) fn count(city: &City, seen: impl IntoIterator<Item = u32>) -> u32 {
    let mut ways = 0;
    let mut relations: BTreeSet<ObjectId> = BTreeSet::new();
    for building in seen {
        match city.buildings()[building as usize].object {
            ObjectId::Way(_) => ways += 1,
            object => {
                relations.insert(object);
            }
        }
    }
    ways + relations.len() as u32
}

/// Paints the buildings that may touch a window, by their indices in the city, over its cells: zeros in
/// row-major order.
///
/// Lower prisms are painted first, so the highest stays; of equal heights the better known one
/// wins. What floats comes last and only raises what is there. `seen(building, row, columns)` is told the
/// cells of each outline that stands on the ground, one outline after the other.
pub(super) fn paint(
    window: Window,
    city: &City,
    buildings: &[usize],
    heights: &mut [f32],
    sources: &mut [u8],
    mut seen: impl FnMut(u32, usize, Range<usize>),
) {
    let cells = window.cells;
    // What floats and begins where it ends is nothing.
    let is_there = |prism: &&Prism| !prism.floats || prism.bottom_m < prism.top_m;
    let prisms = buildings.iter().flat_map(|&at| city.prisms_of(at));
    let mut prisms: Vec<&Prism> = prisms.filter(is_there).collect();
    prisms.sort_unstable_by(|a, b| {
        a.floats
            .cmp(&b.floats)
            .then_with(|| a.top_m.total_cmp(&b.top_m))
            .then_with(|| b.source.cmp(&a.source))
            .then_with(|| a.building.cmp(&b.building))
    });
    let mut painter = Painter::new(city, window);
    for Prism { building, limits, top_m, source, floats, .. } in prisms {
        let Building { attributes, .. } = &city.buildings()[*building as usize];
        let counts = attributes.kind == Kind::Outline && !attributes.raised;
        let run = |row: usize, columns: Range<usize>| {
            row * cells + columns.start..row * cells + columns.end
        };
        let seen = |row: usize, columns: &Range<usize>| {
            if counts {
                seen(*building, row, columns.clone());
            }
        };
        if *floats {
            painter.paint(*building, limits.as_deref(), seen, |row, columns| {
                let run = run(row, columns);
                let covered = heights[run.clone()].iter_mut().zip(&mut sources[run]);
                for (height, known) in covered.filter(|(height, _)| **height > 0.0) {
                    if top_m > height {
                        (*height, *known) = (*top_m, *source as u8);
                    }
                }
            });
        } else {
            painter.paint(*building, limits.as_deref(), seen, |row, columns| {
                let run = run(row, columns);
                heights[run.clone()].fill(*top_m);
                sources[run].fill(*source as u8);
            });
        }
    }
}

/// Finds the cells of footprints and of regions within them.
struct Painter<'a> {
    city: &'a City,
    window: Window,
    scanline: Scanline,
    /// What covers each cell of the box around a footprint: a bit for each list of
    /// [`Limits::within`], and [`Self::WITHOUT`].
    mask: Vec<u8>,
}

impl<'a> Painter<'a> {
    const WITHOUT: u8 = 1 << 7;

    fn new(city: &'a City, window: Window) -> Self {
        Self { city, window, scanline: Scanline::default(), mask: Vec::new() }
    }

    /// Calls `seen(row, columns)` for the runs of cells of a building's footprint, and `paint(row, columns)`
    /// for those of them that lie within limits.
    fn paint(
        &mut self,
        building: u32,
        limits: Option<&Limits>,
        mut seen: impl FnMut(usize, &Range<usize>),
        mut paint: impl FnMut(usize, Range<usize>),
    ) {
        let city = self.city;
        let footprint = &city.buildings()[building as usize].footprint;
        let Some(limits) = limits else {
            for polygon in footprint {
                self.scanline.fill(polygon, &self.window, |row, run| {
                    seen(row, &run);
                    paint(row, run);
                });
            }
            return;
        };
        let (rows, columns) = self.cells_around(building);
        if rows.is_empty() || columns.is_empty() {
            return;
        }
        self.mask.clear();
        self.mask.resize(rows.len() * columns.len(), 0);
        for (list, within) in limits.within.iter().enumerate() {
            self.cover(within, 1 << list, &rows, &columns);
        }
        self.cover(&limits.without, Self::WITHOUT, &rows, &columns);
        let wanted = (1_u8 << limits.within.len()) - 1;
        for polygon in footprint {
            self.scanline.fill(polygon, &self.window, |row, run| {
                seen(row, &run);
                let at = (row - rows.start) * columns.len();
                let mask = &self.mask[at + run.start - columns.start..at + run.end - columns.start];
                let mut column = run.start;
                for same in mask.chunk_by(|a, b| (*a == wanted) == (*b == wanted)) {
                    if same[0] == wanted {
                        paint(row, column..column + same.len());
                    }
                    column += same.len();
                }
            });
        }
    }

    /// Sets a bit of the mask for the cells of footprints.
    fn cover(&mut self, footprints: &[u32], bit: u8, rows: &Range<usize>, columns: &Range<usize>) {
        for &other in footprints {
            let city = self.city;
            for polygon in &city.buildings()[other as usize].footprint {
                self.scanline.fill(polygon, &self.window, |row, run| {
                    let start = run.start.max(columns.start);
                    let end = run.end.min(columns.end);
                    if rows.contains(&row) && start < end {
                        let at = (row - rows.start) * columns.len();
                        let cells = at + start - columns.start..at + end - columns.start;
                        self.mask[cells].iter_mut().for_each(|mask| *mask |= bit);
                    }
                });
            }
        }
    }

    /// Rows and columns that hold all cells of a footprint.
    fn cells_around(&self, building: u32) -> (Range<usize>, Range<usize>) {
        let bounds = self.city.boxes()[building as usize];
        let rows = self.window.rows_between(bounds.min().y, bounds.max().y);
        // A crossing may be rounded beyond the end of its edge.
        let first = self.window.first_column_from(bounds.min().x).saturating_sub(1);
        let end = (self.window.first_column_from(bounds.max().x) + 1).min(self.window.cells);
        (rows, first..end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::building::{Attributes, HeightSource};
    use crate::config::BuildingsConfig;
    use geo::{MultiPolygon, Rect, coord};
    use proptest::prelude::*;

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

    fn with(kind: Kind, height_m: f32, raised: bool) -> Attributes {
        let source = HeightSource::Height;
        let min_height_m = if raised { 3.0 } else { 0.0 };
        Attributes { kind, height_m, source, min_height_m, raised }
    }

    fn guess(kind: Kind, height_m: f32) -> Attributes {
        Attributes { source: HeightSource::Default, ..with(kind, height_m, false) }
    }

    fn grid_at(tile: TileId, buildings: &[&Building]) -> HeightGrid {
        let buildings: Vec<Building> = buildings.iter().copied().cloned().collect();
        let all: Vec<usize> = (0..buildings.len()).collect();
        let city = City::new(buildings, &[], &BuildingsConfig::default());
        rasterise_tile(tile, &GRID, &city, &all)
    }

    fn grid(buildings: &[&Building]) -> HeightGrid {
        grid_at(tile(), buildings)
    }

    /// The height at a place relative to the centre.
    fn at(grid: &HeightGrid, x: f64, y: f64) -> f32 {
        grid.height_m[[(20.0 - y).floor() as usize, (20.0 + x).floor() as usize]]
    }

    #[test]
    fn overlaps_take_the_highest_in_any_order() {
        let low = square(1, 0.0, 0.0, 10.0, with(Kind::Outline, 5.0, false));
        let high = square(2, 4.0, 0.0, 10.0, with(Kind::Outline, 9.0, false));
        let made = grid(&[&low, &high]);
        assert_eq!((at(&made, 0.5, 0.5), at(&made, -4.5, 0.5)), (9.0, 5.0));
        assert_eq!(made, grid(&[&high, &low]));
        assert_eq!((made.statistics.buildings, made.statistics.max_height_m), (2, 9.0));
        assert!((made.statistics.built - 140.0 / 400.0).abs() < 1e-12);
    }

    #[test]
    fn a_guess_counts_only_where_nothing_is_known() {
        let known = square(1, 0.0, 0.0, 10.0, with(Kind::Outline, 5.0, false));
        let guessed = square(2, 4.0, 0.0, 10.0, guess(Kind::Outline, 9.0));
        let made = grid(&[&known, &guessed]);
        assert_eq!((at(&made, 0.5, 0.5), at(&made, 7.5, 0.5)), (5.0, 9.0));
    }

    #[test]
    fn parts_replace_the_outline_and_raised_ones_count_within_it_only() {
        let outline = square(1, 0.0, 0.0, 12.0, with(Kind::Outline, 50.0, false));
        let podium = square(2, 0.0, 0.0, 8.0, with(Kind::Part, 5.0, false));
        let tower = square(3, 0.0, 0.0, 2.0, with(Kind::Part, 50.0, true));
        let arcade = square(4, 5.0, 5.0, 2.0, with(Kind::Part, 8.0, true));
        let skyway = square(5, 15.0, 0.0, 4.0, with(Kind::Part, 9.0, true));
        let beyond = square(6, 6.0, -4.0, 4.0, with(Kind::Part, 7.0, true));
        let made = grid(&[&tower, &podium, &skyway, &outline, &arcade, &beyond]);
        assert_eq!(at(&made, 0.5, 0.5), 50.0, "the tower");
        assert_eq!(at(&made, 2.5, 0.5), 5.0, "the podium");
        assert_eq!(at(&made, -5.5, 0.5), 50.0, "the outline where no part lies");
        assert_eq!(
            at(&made, 4.5, 4.5),
            8.0,
            "an arcade stands on the ground, lower than the outline"
        );
        assert_eq!(at(&made, 15.5, 0.5), 0.0, "a skyway outside");
        assert_eq!((at(&made, 5.5, -3.5), at(&made, 7.5, -3.5)), (7.0, 0.0), "within and beyond");
        assert_eq!(made.statistics.buildings, 1, "parts are not counted");
    }

    #[test]
    fn what_is_raised_raises_what_stands_below() {
        let house = square(1, 0.0, 0.0, 10.0, with(Kind::Outline, 6.0, false));
        let canopy = square(2, 6.0, 0.0, 8.0, with(Kind::Outline, 9.0, true));
        let made = grid(&[&house, &canopy]);
        assert_eq!(
            (at(&made, 4.5, 0.5), at(&made, 8.5, 0.5), at(&made, 0.5, 0.5)),
            (9.0, 0.0, 6.0)
        );
    }

    #[test]
    fn overlapping_tiles_agree() {
        let wall = square(1, 7.3, 3.9, 11.7, with(Kind::Outline, 7.0, false));
        let part = square(2, 7.3, 3.9, 5.1, with(Kind::Part, 4.0, false));
        let here = grid(&[&wall, &part]);
        let east: TileId = "utm10n_e500020_n4000000".parse().expect("an id");
        let there = grid_at(east, &[&wall, &part]);
        assert_eq!(
            here.height_m.slice(ndarray::s![.., 20..]),
            there.height_m.slice(ndarray::s![.., ..20])
        );
    }

    proptest! {
        /// The rule of `building::prism` as it is written there, cell by cell, against the prisms.
        #[test]
        fn columns_follow_the_rule(
            squares in prop::collection::vec(
                (-16_i8..16, -16_i8..16, 3_u8..16, any::<bool>(), 0_u8..3, 1_u8..30, any::<bool>()),
                1..9,
            ),
        ) {
            let buildings: Vec<Building> = squares.into_iter().enumerate().map(|(id, it)| {
                let (x, y, side, is_part, bottom, height, known) = it;
                let kind = if is_part { Kind::Part } else { Kind::Outline };
                let raised = bottom == 2;
                let mut attributes = with(kind, f32::from(height) + if raised { 3.0 } else { 0.0 }, raised);
                if !known {
                    attributes.source = HeightSource::Default;
                }
                square(id as i64, f64::from(x), f64::from(y), f64::from(side), attributes)
            }).collect();
            let city = City::new(buildings, &[], &BuildingsConfig::default());
            let all: Vec<usize> = (0..city.buildings().len()).collect();
            let made = rasterise_tile(tile(), &GRID, &city, &all);
            for row in 0..40 {
                for column in 0..40 {
                    let place = [
                        500_000.0 - 20.0 + f64::from(column) + 0.5,
                        4_000_000.0 + 20.0 - f64::from(row) - 0.5,
                    ];
                    let cell = [row as usize, column as usize];
                    prop_assert_eq!(
                        (made.height_m[cell], made.height_source[cell]),
                        column_by_rule(&city, place),
                        "{:?}", cell
                    );
                }
            }
        }
    }

    /// Height and source over a place, by the rule.
    fn column_by_rule(city: &City, [x, y]: [f64; 2]) -> (f32, u8) {
        let covers = |&at: &usize| {
            let bounds = city.boxes()[at];
            // A centre on an edge belongs to the building north or east of it.
            bounds.min().x <= x && x < bounds.max().x && bounds.min().y <= y && y < bounds.max().y
        };
        let here: Vec<usize> = (0..city.buildings().len()).filter(covers).collect();
        let of = |at: usize| &city.buildings()[at].attributes;
        let is_replaced =
            |&at: &usize| here.iter().any(|&part| city.outlines_of(part).contains(&(at as u32)));
        let stands = here.iter().any(|&at| !of(at).raised);
        let counts = here.iter().filter(|at| stands && !is_replaced(at));
        let best = counts.max_by(|&&a, &&b| {
            let key = |at: usize| (of(at).source.is_known(), of(at).height_m);
            key(a).partial_cmp(&key(b)).expect("finite heights")
        });
        best.map_or((0.0, 0), |&at| (of(at).height_m, of(at).source as u8))
    }
}

//! Does a map lie on the buildings as its metadata say? Checks 4 and 8 of the import contract.
//!
//! No path enters a building without refraction, and few paths miss an outdoor cell. So the cells
//! without a path are the buildings' shape, and some outdoor shadows besides. Two figures tell how
//! well they agree:
//! - the *correlation* (phi coefficient) of "no path" and "building" ranks the eight ways a
//!   square can lie and shifts by up to three cells. On 553 maps of San Jose and Helsinki the true
//!   one always had the highest, but for one shift on a map that reaches 2 % of its cells;
//! - the *agreement*, (P(no path | building) − P(no path | outdoor)) / P(path | outdoor), is 1
//!   where exactly the buildings are without path, whatever part of the outdoors is; 0.5 to 1 on
//!   those maps and around 0 on the buildings of other tiles.
//!
//! Where refraction fills the buildings, the loss over free space in dB takes the place of "no path".

use ndarray::{Array2, ArrayView1, ArrayView2, Zip, s};

use super::check::rounded;
use super::metadata::{RadioMapMetadata, RowOrder};
use super::rejection::{Rejection, RejectionCode};
use super::window::{MapWindow, Occupancy};
use crate::grid::TileId;
use crate::manifest::{Evidence, MapWarning, OrientationScore, WarningCode};

/// Shifts are looked for up to so many cells.
const REACH: usize = 3;
/// A comparison needs so many cells of each kind.
const LEAST_CELLS: usize = 20;
/// Below it, cells without path and buildings have nothing to do with each other.
const LEAST_AGREEMENT: f64 = 0.45;
/// Below it, it is worth asking whether the map fits another tile better; one in forty does not.
const DOUBTFUL_AGREEMENT: f64 = 0.65;
/// A map that lies right has at least this correlation.
const LEAST_CORRELATION: f64 = 0.1;
/// Another way to lie must win by this, so that chance does not decide.
const MARGIN_FLIP: f64 = 0.02;
const MARGIN_SHIFT: f64 = 0.005;
/// Any must win by this where refraction lights up buildings: of ten maps of Helsinki a flip then led
/// by 0.02 on one.
const MARGIN_REFRACTION: f64 = 0.1;
/// And so much agreement is enough then.
const LEAST_AGREEMENT_REFRACTION: f64 = 0.1;
/// Another tile must win by this.
const MARGIN_TILE: f64 = 0.1;
/// A smaller lead of the declared way over all flips is worth a warning.
const CLEAR_LEAD: f64 = 0.05;
/// Decimals of figures for people.
const DECIMALS: i32 = 4;
/// Where fewer cells are without path than this share of the built ones, refraction filled them.
const MOST_FILLED: f64 = 0.5;
/// With a larger share of unreached outdoor cells there is too little to decide by.
const MOST_UNREACHED: f64 = 0.9;

/// One of the eight ways that a square can lie.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Flip {
    transposed: bool,
    rows: bool,
    columns: bool,
}

impl Flip {
    fn others() -> impl Iterator<Item = Self> {
        (1..8_u8).map(|bits| Self {
            transposed: bits & 1 != 0,
            rows: bits & 2 != 0,
            columns: bits & 4 != 0,
        })
    }

    fn of<T>(self, grid: ArrayView2<'_, T>) -> ArrayView2<'_, T> {
        let mut view = if self.transposed { grid.reversed_axes() } else { grid };
        if self.rows {
            view.invert_axis(ndarray::Axis(0));
        }
        if self.columns {
            view.invert_axis(ndarray::Axis(1));
        }
        view
    }

    /// What mends the map, in the words of NumPy.
    fn words(self) -> String {
        let steps = [
            (self.transposed, "transposed (.T)"),
            (self.rows, "flipped north to south (np.flipud)"),
            (self.columns, "flipped east to west (np.fliplr)"),
        ];
        let steps: Vec<&str> =
            steps.iter().filter(|(done, _)| *done).map(|(_, word)| *word).collect();
        steps.join(" and ")
    }
}

/// Sums over the cells of buildings and over those outdoors.
#[derive(Debug, Clone, Copy, Default)]
struct AgreementSums {
    count: [f64; 2],
    sum: [f64; 2],
    squares: f64,
}

impl AgreementSums {
    /// Of cells that are dark or not. Row by row, so that the compiler counts many cells at once: this runs 57
    /// times for each cell of a map.
    fn of_shadows(
        dark: ArrayView2<'_, bool>,
        building: ArrayView2<'_, bool>,
        outdoor: ArrayView2<'_, bool>,
    ) -> Self {
        let dark = dark.as_standard_layout();
        let (mut count_b, mut count_o, mut sum_b, mut sum_o) = (0_u32, 0_u32, 0_u32, 0_u32);
        for ((dark, building), outdoor) in
            dark.rows().into_iter().zip(building.rows()).zip(outdoor.rows())
        {
            let cells = contiguous(dark).iter().zip(contiguous(building)).zip(contiguous(outdoor));
            for ((&dark, &building), &outdoor) in cells {
                count_b += u32::from(building);
                count_o += u32::from(outdoor);
                sum_b += u32::from(dark & building);
                sum_o += u32::from(dark & outdoor);
            }
        }
        let [count_b, count_o, sum_b, sum_o] = [count_b, count_o, sum_b, sum_o].map(f64::from);
        Self { count: [count_b, count_o], sum: [sum_b, sum_o], squares: sum_b + sum_o }
    }

    /// Of how dark cells are; NaN where there is nothing to compare.
    fn of_levels(
        darkness: ArrayView2<'_, f64>,
        base: ArrayView2<'_, f64>,
        building: ArrayView2<'_, bool>,
        outdoor: ArrayView2<'_, bool>,
    ) -> Self {
        let (mut count_b, mut count_o, mut sum_b, mut sum_o, mut squares) =
            (0.0, 0.0, 0.0, 0.0, 0.0);
        let cells = Zip::from(darkness).and(base).and(building).and(outdoor);
        cells.for_each(|&darkness, &base, &indoors, &open| {
            let known = !darkness.is_nan();
            let value = if known { darkness + base } else { 0.0 };
            let weight = |is: bool| f64::from(u8::from(is & known));
            let (b, o) = (weight(indoors), weight(open));
            count_b += b;
            count_o += o;
            sum_b += b * value;
            sum_o += o * value;
            squares += (b + o) * value * value;
        });
        Self { count: [count_b, count_o], sum: [sum_b, sum_o], squares }
    }

    /// Mean darkness of buildings and of the outdoors.
    fn means(&self) -> [f64; 2] {
        [0, 1].map(|class| self.sum[class] / self.count[class].max(1.0))
    }

    /// Pearson's correlation of darkness and "is a building"; where darkness is 0 or 1 it is
    /// the phi coefficient.
    fn correlation(&self) -> f64 {
        let [b, o] = self.count;
        let (total, sum) = (b + o, self.sum[0] + self.sum[1]);
        let variance = self.squares / total.max(1.0) - (sum / total.max(1.0)).powi(2);
        let [indoor, open] = self.means();
        let scale = libm::sqrt(b * o) / total.max(1.0) / libm::sqrt(variance);
        if self.is_enough() && variance > 0.0 { (indoor - open) * scale } else { 0.0 }
    }

    /// See the module; only where darkness is 0 or 1.
    fn agreement(&self) -> f64 {
        let [indoor, open] = self.means();
        (indoor - open) / (1.0 - open).max(f64::EPSILON)
    }

    fn is_enough(&self) -> bool {
        self.count.iter().all(|&count| count >= LEAST_CELLS as f64)
    }
}

/// What is high where nothing arrives.
enum Darkness {
    /// Whether a cell is without path: 1 or 0.
    NoPath(Array2<bool>),
    /// Where paths go through walls, the negative level in dB; and what is added to it wherever the map lies, the
    /// level of free space, so that the distance to the transmitter does not count.
    Level { darkness: Array2<f64>, free_space: Array2<f64> },
}

fn contiguous(row: ArrayView1<'_, bool>) -> &[bool] {
    row.to_slice().expect("rows are contiguous")
}

/// How a map lies on the buildings of a tile.
pub(super) struct Orientation {
    darkness: Darkness,
    row_order: RowOrder,
    refraction: bool,
}

/// What the check finds: the score for the report, and what a user should look at.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OrientationVerdict {
    pub(super) score: OrientationScore,
    pub(super) warning: Option<MapWarning>,
}

impl Orientation {
    /// `level` gives a cell's level in dB and `free_space` that of free space at a row and column,
    /// of the same reference.
    pub(super) fn new(
        window: &MapWindow,
        occupancy: &Occupancy,
        metadata: &RadioMapMetadata,
        level: impl Fn(f64) -> f64,
        free_space: impl Fn((usize, usize)) -> f64,
    ) -> Self {
        let RadioMapMetadata { row_order, refraction, .. } = *metadata;
        let count = |grid: &Array2<bool>| grid.iter().filter(|&&is| is).count() as f64;
        let unreached = window.reached.len() as f64 - count(&window.reached);
        // Counted over all cells, however they lie.
        if !refraction || unreached >= MOST_FILLED * count(&occupancy.building) {
            let darkness = Darkness::NoPath(window.reached.mapv(|reached| !reached));
            Self { darkness, row_order, refraction }
        } else {
            let darkness = Zip::from(&window.values)
                .and(&window.reached)
                .map_collect(|&value, &reached| if reached { -level(value) } else { f64::NAN });
            let free_space = Array2::from_shape_fn(darkness.raw_dim(), free_space);
            Self { darkness: Darkness::Level { darkness, free_space }, row_order, refraction }
        }
    }

    fn evidence(&self) -> Evidence {
        match self.darkness {
            Darkness::NoPath(_) => Evidence::NoPath,
            Darkness::Level { .. } => Evidence::Level,
        }
    }

    fn sums(&self, occupancy: &Occupancy, flip: Flip) -> AgreementSums {
        let [building, outdoor] = [occupancy.building.view(), occupancy.outdoor.view()];
        match &self.darkness {
            Darkness::NoPath(dark) => {
                AgreementSums::of_shadows(flip.of(dark.view()), building, outdoor)
            }
            Darkness::Level { darkness, free_space } => {
                let darkness = flip.of(darkness.view());
                AgreementSums::of_levels(darkness, free_space.view(), building, outdoor)
            }
        }
    }

    /// With the map moved by rows and columns, on the cells that all shifts have in common.
    fn shifted(&self, occupancy: &Occupancy, [rows, columns]: [usize; 2]) -> AgreementSums {
        let inner = occupancy.building.nrows() - 2 * REACH;
        let moved = s![rows..rows + inner, columns..columns + inner];
        let common = s![REACH..REACH + inner, REACH..REACH + inner];
        let [building, outdoor] =
            [occupancy.building.slice(common), occupancy.outdoor.slice(common)];
        match &self.darkness {
            Darkness::NoPath(dark) => {
                AgreementSums::of_shadows(dark.slice(moved), building, outdoor)
            }
            Darkness::Level { darkness, free_space } => {
                let free_space = free_space.slice(common);
                AgreementSums::of_levels(darkness.slice(moved), free_space, building, outdoor)
            }
        }
    }

    /// Rejects a map that lies another way than declared. `elsewhere` gives the buildings of
    /// tiles nearby, and is asked only in doubt.
    pub(super) fn check<E: From<Rejection>>(
        &self,
        occupancy: &Occupancy,
        elsewhere: impl Fn() -> Result<Vec<(TileId, Occupancy)>, E>,
    ) -> Result<OrientationVerdict, E> {
        let declared = self.sums(occupancy, Flip::default());
        let flips = Flip::others().map(|flip| (flip, self.sums(occupancy, flip)));
        let (flip, flipped) = best(flips);
        let lead = declared.correlation() - flipped.correlation();
        let score = OrientationScore {
            evidence: self.evidence(),
            correlation: rounded(declared.correlation(), DECIMALS),
            agreement: self.agreement(&declared).map(|share| rounded(share, DECIMALS)),
            lead: rounded(lead, DECIMALS),
        };
        let [_, unreached] = declared.means();
        let hidden = self.evidence() == Evidence::NoPath && unreached > MOST_UNREACHED;
        if !declared.is_enough() || hidden {
            let text = "too few cells are reached, or too few built, to tell its orientation";
            let warning = MapWarning::new(WarningCode::OrientationUntold, text);
            return Ok(OrientationVerdict { score, warning: Some(warning) });
        }

        // Where levels are compared, the correlation itself must do.
        let agreement = score
            .agreement
            .unwrap_or_else(|| if declared.correlation() < LEAST_CORRELATION { 0.0 } else { 1.0 });
        let mut mistakes = Vec::new();
        if self.explains(&flipped, &declared, MARGIN_FLIP) {
            mistakes.push((flipped.correlation(), self.wrong_orientation(&score, flip, &flipped)));
        }
        if occupancy.building.nrows() > 2 * REACH + LEAST_CELLS {
            let span = 0..=2 * REACH;
            let all =
                span.clone().flat_map(|rows| span.clone().map(move |columns| [rows, columns]));
            let (shift, moved) = best(all.map(|shift| (shift, self.shifted(occupancy, shift))));
            let unmoved = self.shifted(occupancy, [REACH; 2]);
            if self.explains(&moved, &unmoved, MARGIN_SHIFT) {
                mistakes.push((moved.correlation(), shifted(&score, shift, &moved)));
            }
        }
        if agreement < DOUBTFUL_AGREEMENT {
            let tiles = elsewhere()?;
            let fits =
                tiles.iter().map(|(id, other)| (Some(*id), self.sums(other, Flip::default())));
            if let (Some(tile), other) = best(fits)
                && self.explains(&other, &declared, MARGIN_TILE)
            {
                mistakes.push((other.correlation(), wrong_tile(&score, tile, &other)));
            }
        }
        // Of several that would do, the one that explains most.
        if let Some((_, rejection)) = mistakes.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)) {
            return Err(rejection.into());
        }
        if agreement < self.least_agreement() {
            return Err(buildings_disagree(agreement, self.least_agreement()).into());
        }
        let words = self.in_file(flip).words();
        let text = || format!("once it is {words}, the map fits as well, or nearly so");
        let warning = || MapWarning::new(WarningCode::OrientationUnclear, text());
        Ok(OrientationVerdict { score, warning: (lead < CLEAR_LEAD).then(warning) })
    }

    fn least_agreement(&self) -> f64 {
        if self.refraction { LEAST_AGREEMENT_REFRACTION } else { LEAST_AGREEMENT }
    }

    /// Only where darkness is 0 or 1.
    fn agreement(&self, sums: &AgreementSums) -> Option<f64> {
        (self.evidence() == Evidence::NoPath).then(|| sums.agreement())
    }

    /// Whether a map that lies in another way fits, and better than as declared.
    fn explains(&self, other: &AgreementSums, declared: &AgreementSums, margin: f64) -> bool {
        let margin = if self.refraction { MARGIN_REFRACTION } else { margin };
        let least = (declared.correlation() + margin).max(LEAST_CORRELATION);
        let agrees = self.agreement(other).is_none_or(|share| share >= self.least_agreement());
        agrees && other.correlation() > least
    }

    /// The same change for the array as it is in the file, which may have south first.
    fn in_file(&self, flip: Flip) -> Flip {
        let swap = flip.transposed && self.row_order == RowOrder::SouthFirst;
        Flip { rows: flip.rows ^ swap, columns: flip.columns ^ swap, ..flip }
    }

    fn wrong_orientation(
        &self,
        score: &OrientationScore,
        flip: Flip,
        other: &AgreementSums,
    ) -> Rejection {
        let words = self.in_file(flip).words();
        let only_rows = flip == Flip { rows: true, ..Flip::default() };
        Rejection::new(
            RejectionCode::WrongOrientation,
            expected(score),
            format!("once it is {words}, it does (correlation {:.3})", other.correlation()),
            if only_rows {
                "correct row_order, or flip the array"
            } else {
                "save rows from south to north (or declare north_first) and columns from west to east"
            },
        )
    }
}

fn shifted(
    score: &OrientationScore,
    [rows, columns]: [usize; 2],
    other: &AgreementSums,
) -> Rejection {
    // What lies at row `rows` of the map belongs to row `REACH` of the tile.
    let south = cells(rows as i64 - REACH as i64, ["south", "north"]);
    let east = cells(columns as i64 - REACH as i64, ["east", "west"]);
    let shift: Vec<String> = south.into_iter().chain(east).collect();
    let found =
        format!("it lies {} of them (correlation {:.3})", shift.join(" and "), other.correlation());
    let mend = "center the map on the tile; mind even and odd numbers of cells";
    Rejection::new(RejectionCode::Shifted, expected(score), found, mend)
}

fn expected(score: &OrientationScore) -> String {
    format!("a map that fits the tile's buildings as declared (correlation {})", score.correlation)
}

/// A distance in words; none if there is none.
fn cells(count: i64, [positive, negative]: [&str; 2]) -> Option<String> {
    let (count, direction) = (count.abs(), if count < 0 { negative } else { positive });
    let unit = if count == 1 { "cell" } else { "cells" };
    (count > 0).then(|| format!("{count} {unit} {direction}"))
}

/// The first candidate with the highest correlation.
fn best<T: Default>(candidates: impl Iterator<Item = (T, AgreementSums)>) -> (T, AgreementSums) {
    let mut best = (T::default(), AgreementSums::default());
    let mut highest = f64::NEG_INFINITY;
    for (candidate, sums) in candidates {
        let correlation = sums.correlation();
        if correlation > highest {
            (best, highest) = ((candidate, sums), correlation);
        }
    }
    best
}

fn wrong_tile(score: &OrientationScore, tile: TileId, other: &AgreementSums) -> Rejection {
    Rejection::new(
        RejectionCode::WrongTile,
        expected(score),
        format!("it fits the buildings of {tile} (correlation {:.3})", other.correlation()),
        "correct location_id and map_center_m, or trace the scene of this tile",
    )
}

fn buildings_disagree(agreement: f64, least: f64) -> Rejection {
    Rejection::new(
        RejectionCode::BuildingsDisagree,
        format!("cells without path upon buildings (agreement of {least} or more)"),
        format!("agreement {agreement}, and no better however the map is turned"),
        "trace with the buildings of this tile, correct location_id, or declare refraction",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const CELLS: usize = 60;

    /// An L of buildings and a block, in no way symmetric.
    fn occupancy() -> Occupancy {
        let building = Array2::from_shape_fn((CELLS, CELLS), |(row, column)| {
            let l = (5..40).contains(&row) && (8..16).contains(&column)
                || (32..40).contains(&row) && (8..30).contains(&column);
            l || (10..18).contains(&row) && (40..55).contains(&column)
        });
        Occupancy { outdoor: building.mapv(|is| !is), building }
    }

    /// No path indoors, and none in some of the outdoors either.
    fn window() -> MapWindow {
        let reached = Array2::from_shape_fn((CELLS, CELLS), |(row, column)| {
            !occupancy().building[(row, column)] && (7 * row + 11 * column) % 13 != 0
        });
        MapWindow { values: reached.mapv(|reached| if reached { 1e-9 } else { 0.0 }), reached }
    }

    fn metadata(row_order: RowOrder, refraction: bool) -> RadioMapMetadata {
        let json = serde_json::json!({
            "location_id": "a", "row_order": row_order, "no_path_value": 0, "cell_size_m": 4,
            "map_center_m": [0, 0], "map_size_m": 240, "crs": 32633, "rx_height_m": 1.5,
            "tx_position_m": [0, 0, 20], "tx_power_dbm": 15, "tx_power_is": "per_re",
            "frequency_hz": 3.5e9, "tx_pattern": "iso", "sionna_version": "made up",
            "samples_per_tx": 1, "max_depth": 1, "refraction": refraction, "diffraction": false,
        });
        RadioMapMetadata::parse(json.to_string().as_bytes()).expect("complete")
    }

    fn placed_with(
        window: &MapWindow,
        metadata: &RadioMapMetadata,
    ) -> Result<OrientationVerdict, Rejection> {
        let level = |gain: f64| 10.0 * libm::log10(gain);
        let placement = Orientation::new(window, &occupancy(), metadata, level, |_| 0.0);
        placement.check(&occupancy(), || Ok(Vec::new()))
    }

    fn placed(window: &MapWindow, row_order: RowOrder) -> Result<OrientationVerdict, Rejection> {
        placed_with(window, &metadata(row_order, false))
    }

    fn turned(flip: Flip) -> MapWindow {
        let MapWindow { values, reached } = window();
        let darkness = reached.mapv(|reached| f64::from(u8::from(reached)));
        let reached = flip.of(darkness.view()).mapv(|reached| reached > 0.5);
        MapWindow { values: flip.of(values.view()).to_owned(), reached }
    }

    #[test]
    fn a_sound_map_passes_with_a_clear_lead() {
        let OrientationVerdict { score, warning } =
            placed(&window(), RowOrder::NorthFirst).expect("sound");
        assert_eq!(score.evidence, Evidence::NoPath);
        assert!(score.correlation > 0.75 && score.lead > 0.5, "{score:?}");
        assert!(score.agreement.is_some_and(|agreement| agreement > 0.99), "{score:?}");
        assert_eq!(warning, None);
    }

    #[test]
    fn each_of_the_seven_other_ways_is_named_by_what_mends_it() {
        for flip in Flip::others() {
            let rejection = placed(&turned(flip), RowOrder::NorthFirst).expect_err("turned");
            assert_eq!(rejection.code, RejectionCode::WrongOrientation);
            // What undoes it: transposing comes first, so rows and columns change places.
            let swap = flip.transposed;
            let rows = if swap { flip.columns } else { flip.rows };
            let columns = if swap { flip.rows } else { flip.columns };
            let words = Flip { rows, columns, ..flip }.words();
            assert!(rejection.found.contains(&format!("once it is {words}, ")), "{rejection}");
        }
    }

    #[test]
    fn a_transposed_map_is_named_so_whatever_its_row_order() {
        let transposed = Flip { transposed: true, ..Flip::default() };
        let mut south_first = window();
        south_first.values.invert_axis(ndarray::Axis(0));
        south_first.reached.invert_axis(ndarray::Axis(0));
        // As the file has it, then as the import turns it north.
        let mut seen = MapWindow {
            values: south_first.values.reversed_axes(),
            reached: south_first.reached.reversed_axes(),
        };
        seen.values.invert_axis(ndarray::Axis(0));
        seen.reached.invert_axis(ndarray::Axis(0));
        let rejection = placed(&seen, RowOrder::SouthFirst).expect_err("transposed");
        assert!(rejection.found.contains(&format!("once it is {}, ", transposed.words())));
    }

    #[test]
    fn shifts_are_named_with_their_direction() {
        let MapWindow { values, reached } = window();
        let moved = |rows: usize, columns: usize| {
            let at = |row: usize, column: usize| [(row + rows) % CELLS, (column + columns) % CELLS];
            let reached =
                Array2::from_shape_fn((CELLS, CELLS), |(row, column)| reached[at(row, column)]);
            let values =
                Array2::from_shape_fn((CELLS, CELLS), |(row, column)| values[at(row, column)]);
            placed(&MapWindow { values, reached }, RowOrder::NorthFirst).expect_err("moved")
        };
        let rejection = moved(3, CELLS - 1);
        assert_eq!(rejection.code, RejectionCode::Shifted);
        assert!(rejection.found.contains("3 cells north and 1 cell east"), "{rejection}");
    }

    /// Refraction: levels everywhere, 20 dB lower indoors.
    #[test]
    fn filled_buildings_are_found_by_their_level() {
        let filled = |flip: Flip| {
            let values = occupancy().building.mapv(|is| if is { 1e-11 } else { 1e-9 });
            let values = flip.of(values.view()).to_owned();
            MapWindow { reached: values.mapv(|_| true), values }
        };
        let refracted = metadata(RowOrder::NorthFirst, true);
        let sound = placed_with(&filled(Flip::default()), &refracted).expect("sound");
        assert_eq!((sound.score.evidence, sound.score.agreement), (Evidence::Level, None));
        let rows = Flip { rows: true, ..Flip::default() };
        let rejection = placed_with(&filled(rows), &refracted).expect_err("flipped");
        assert_eq!(rejection.code, RejectionCode::WrongOrientation);
        let undeclared = placed(&filled(Flip::default()), RowOrder::NorthFirst);
        let rejection = undeclared.expect_err("filled without refraction");
        assert_eq!(rejection.code, RejectionCode::BuildingsDisagree);
        assert!(rejection.mend.contains("declare refraction"));
    }

    #[test]
    fn without_buildings_nothing_can_be_told() {
        let nothing = Array2::from_elem((CELLS, CELLS), false);
        let open = Occupancy { outdoor: nothing.mapv(|is| !is), building: nothing };
        let window = window();
        let metadata = metadata(RowOrder::NorthFirst, false);
        let placement = Orientation::new(&window, &open, &metadata, |gain| gain, |_| 0.0);
        let verdict: OrientationVerdict =
            placement.check(&open, || Ok::<_, Rejection>(Vec::new())).expect("no evidence");
        let code = verdict.warning.map(|warning| warning.code);
        assert_eq!(code, Some(WarningCode::OrientationUntold));
    }
}

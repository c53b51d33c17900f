//! Are the levels what their metadata say? Check 3 of the import contract.
//!
//! In the open, a level can hardly exceed that of free space, and near a transmitter some cells
//! always come close to it. So the 99th percentile of (level − free-space level) over the reached
//! outdoor cells is about constant: −2 to 8 dB around the right power on nearly all maps (0.9 to
//! 5.7 dB on 98 % of 523 maps of San Jose). Any other kind of values, or another power, moves it
//! by tens of dB. Few maps lie below: where the transmitter stands in a courtyard nothing sees it.

use super::check::is_possible;
use super::convert::{power_per_re, to_rsrp};
use super::metadata::RadioMapMetadata;
use super::rejection::{Rejection, RejectionCode};
use super::window::{MapWindow, Occupancy};
use crate::manifest::{MapWarning, ValueKind, WarningCode};
use crate::units::Db;

/// Speed of light in vacuum, in m/s (exact by definition).
const SPEED_OF_LIGHT: f64 = 299_792_458.0;
/// Where the 99th percentile lies on sound maps, in dB.
const LEAST_DB: f64 = -2.0;
const MOST_DB: f64 = 8.0;
/// The share of cells below the level that is compared.
const SHARE: f64 = 0.99;
/// Where fewer outdoor cells are reached, low levels prove nothing.
const LEAST_REACHED: f64 = 0.1;
/// Above it, low levels are put down to what stands before the transmitter, though another kind of
/// values may fit (downtown towers: -8 dB), in dB.
const HIDDEN_DB: f64 = -15.0;
/// No level is lower at its best, whatever stands before the transmitter, in dB.
const HOPELESS_DB: f64 = -60.0;

/// Free-space path gain (λ / 4πd)², in dB (Friis); never nearer than one wavelength.
fn free_space(distance_m: f64, frequency_hz: f64) -> Db {
    let wavelength = SPEED_OF_LIGHT / frequency_hz;
    let ratio = wavelength / (4.0 * std::f64::consts::PI * distance_m.max(wavelength));
    Db::from_linear(ratio * ratio)
}

/// Places of a window's cells, and free-space gains there.
pub(super) struct FreeSpace {
    tx_position_m: [f64; 3],
    rx_height_m: f64,
    frequency_hz: f64,
    cell_m: f64,
    /// Row and column of the window's middle.
    middle: f64,
}

impl FreeSpace {
    /// For a window of `cells` cells of `cell_m` along a side.
    pub(super) fn new(
        metadata: &RadioMapMetadata,
        tx_position_m: [f64; 3],
        cell_m: f64,
        cells: usize,
    ) -> Self {
        let RadioMapMetadata { rx_height_m, frequency_hz, .. } = *metadata;
        let middle = (cells as f64 - 1.0) / 2.0;
        Self { tx_position_m, rx_height_m, frequency_hz, cell_m, middle }
    }

    /// At the centre of a cell, at the receivers' height.
    pub(super) fn gain(&self, (row, column): (usize, usize)) -> Db {
        let [east, north, up] = self.tx_position_m;
        let x = (column as f64 - self.middle) * self.cell_m - east;
        let y = (self.middle - row as f64) * self.cell_m - north;
        let z = self.rx_height_m - up;
        let distance = libm::sqrt(x * x + y * y + z * z).max(self.cell_m / 2.0);
        free_space(distance, self.frequency_hz)
    }
}

/// The cells that are compared, with what free space would give there.
pub(super) struct Comparison<'a> {
    metadata: &'a RadioMapMetadata,
    /// Values of reached outdoor cells, and free-space gains at their places.
    cells: Vec<(f64, Db)>,
    /// Of the outdoor cells, those that a path reaches.
    reached_share: f64,
}

impl<'a> Comparison<'a> {
    /// Compares at the window's outdoor cells.
    pub(super) fn new(
        window: &MapWindow,
        occupancy: &Occupancy,
        metadata: &'a RadioMapMetadata,
        free_space: &FreeSpace,
    ) -> Self {
        let outdoor = occupancy.outdoor.iter().filter(|&&outdoor| outdoor).count();
        let compared = |&(at, value): &((usize, usize), &f64)| {
            occupancy.outdoor[at] && window.reached[at] && value.is_finite()
        };
        let cells: Vec<_> = window
            .values
            .indexed_iter()
            .filter(compared)
            .map(|(at, &value)| (value, free_space.gain(at)))
            .collect();
        let reached_share = cells.len() as f64 / outdoor.max(1) as f64;
        Self { metadata, cells, reached_share }
    }

    /// The 99th percentile of level over free space if the values are of a kind, in dB.
    pub(super) fn excess_db(&self, kind: ValueKind) -> Option<f64> {
        let power = power_per_re(self.metadata);
        let mut excesses: Vec<f64> = self
            .cells
            .iter()
            .map(|&(value, gain)| to_rsrp(value, kind, self.metadata).0 - (power + gain).0)
            .filter(|excess| excess.is_finite())
            .collect();
        let rank = (excesses.len() as f64 * SHARE) as usize;
        (!excesses.is_empty()).then(|| *excesses.select_nth_unstable_by(rank, f64::total_cmp).1)
    }

    /// Other readings of the values that would fit, in words.
    fn fitting(&self, declared: ValueKind) -> Vec<String> {
        let fits = |excess: f64| (LEAST_DB..=MOST_DB).contains(&excess);
        let mut readings = Vec::new();
        for kind in ValueKind::ALL.into_iter().filter(|kind| *kind != declared) {
            if self.excess_db(kind).is_some_and(fits) {
                readings.push(kind.name().to_owned());
            }
        }
        let scaled = |kind: ValueKind, offset_db: f64, words: &str| {
            let fits = self.excess_db(kind).is_some_and(|excess| fits(excess + offset_db));
            fits.then(|| words.to_owned())
        };
        readings.extend(scaled(
            ValueKind::RssDbm,
            30.0,
            "received power in dBW: add 30 dB for rss_dbm",
        ));
        readings.extend(scaled(
            ValueKind::RssW,
            -30.0,
            "received power in mW: divide by 1000 for rss_w",
        ));
        let is_power = matches!(declared, ValueKind::RssW | ValueKind::RssDbm | ValueKind::RsrpDbm);
        if let Some(count) = self.metadata.n_subcarriers.filter(|_| is_power) {
            let offset = Db::from_linear(count.into()).0;
            let (carrier, element) = ("the whole carrier", "one resource element");
            let mixed = |values, power| format!("values of {values} with the power of {power}");
            readings.extend(scaled(declared, -offset, &mixed(carrier, element)));
            readings.extend(scaled(declared, offset, &mixed(element, carrier)));
        }
        readings
    }

    /// Checks the declared kind; the excess is `None` where no outdoor cell is reached.
    pub(super) fn check(&self, declared: ValueKind) -> Result<Option<f64>, Rejection> {
        let Some(excess) = self.excess_db(declared) else { return Ok(None) };
        if (LEAST_DB..=MOST_DB).contains(&excess) {
            return Ok(Some(excess));
        }
        let readings = self.fitting(declared);
        let unexplained = readings.is_empty() || self.reached_share < LEAST_REACHED;
        let hidden = (HIDDEN_DB..LEAST_DB).contains(&excess)
            || (unexplained && (HOPELESS_DB..LEAST_DB).contains(&excess));
        if hidden { Ok(Some(excess)) } else { Err(self.wrong(declared, excess, &readings)) }
    }

    /// The rejection of values that mostly cannot be of the declared kind, if another one fits.
    pub(super) fn other_kind(&self, declared: ValueKind) -> Option<Rejection> {
        let possible = |&&(value, _): &&(f64, Db)| is_possible(value, declared, self.metadata);
        let mostly_possible = 2 * self.cells.iter().filter(possible).count() > self.cells.len();
        let readings = self.fitting(declared);
        let excess = self.excess_db(declared).unwrap_or(f64::NAN);
        let explains = !mostly_possible && !readings.is_empty();
        explains.then(|| self.wrong(declared, excess, &readings))
    }

    fn wrong(&self, declared: ValueKind, excess: f64, readings: &[String]) -> Rejection {
        let mend = if readings.is_empty() {
            "correct tx_power_dbm, tx_power_is, frequency_hz or the kind of values".to_owned()
        } else {
            format!("the values fit {}", readings.join(", or "))
        };
        Rejection::new(
            RejectionCode::WrongValueKind,
            format!(
                "{} with the strongest cells {LEAST_DB} to {MOST_DB} dB above free space at {} dBm",
                declared.name(),
                self.metadata.tx_power_dbm,
            ),
            if excess.is_nan() {
                "values that this kind cannot have".to_owned()
            } else {
                format!("{excess:.1} dB")
            },
            mend,
        )
    }

    /// What a user should know of levels that are all far below free space.
    pub(super) fn warning(excess: Option<f64>) -> Option<MapWarning> {
        let excess = excess.filter(|excess| *excess < LEAST_DB)?;
        let text = format!(
            "even the strongest cells lie {:.1} dB below free space: either the transmitter \
             is hidden from all of them, or its power is not tx_power_dbm",
            -excess
        );
        Some(MapWarning::new(WarningCode::WeakLevels, text))
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;
    use serde_json::json;

    use super::*;

    const CELLS: usize = 40;
    const CELL_M: f64 = 10.0;
    const TX: [f64; 3] = [15.0, -40.0, 30.0];

    fn metadata() -> RadioMapMetadata {
        let json = json!({
            "location_id": "a", "row_order": "north_first", "no_path_value": 0,
            "cell_size_m": CELL_M, "map_center_m": [0, 0], "map_size_m": 400, "crs": 32633,
            "rx_height_m": 1.5, "tx_position_m": TX, "tx_power_dbm": 46, "tx_power_is": "total",
            "n_subcarriers": 3276, "frequency_hz": 3.5e9, "tx_pattern": "iso",
            "sionna_version": "made up", "samples_per_tx": 1, "max_depth": 1, "refraction": false,
            "diffraction": false,
        });
        RadioMapMetadata::parse(json.to_string().as_bytes()).expect("complete")
    }

    /// Free space all over the window, less a loss in dB.
    fn window(loss_db: f64, value: impl Fn(f64) -> f64) -> MapWindow {
        let middle = (CELLS as f64 - 1.0) / 2.0;
        let values = Array2::from_shape_fn((CELLS, CELLS), |(row, column)| {
            let x = (column as f64 - middle) * CELL_M - TX[0];
            let y = (middle - row as f64) * CELL_M - TX[1];
            let distance = libm::sqrt(x * x + y * y + 28.5 * 28.5);
            value(
                20.0 * libm::log10(
                    SPEED_OF_LIGHT / 3.5e9 / (4.0 * std::f64::consts::PI * distance),
                ) - loss_db,
            )
        });
        MapWindow { reached: Array2::from_elem((CELLS, CELLS), true), values }
    }

    fn open() -> Occupancy {
        let grid = |is: bool| Array2::from_elem((CELLS, CELLS), is);
        Occupancy { building: grid(false), outdoor: grid(true) }
    }

    fn friis(metadata: &RadioMapMetadata) -> FreeSpace {
        FreeSpace::new(metadata, TX, CELL_M, CELLS)
    }

    fn check(window: &MapWindow, kind: ValueKind) -> Result<Option<f64>, Rejection> {
        let metadata = metadata();
        Comparison::new(window, &open(), &metadata, &friis(&metadata)).check(kind)
    }

    #[test]
    fn free_space_at_100_m_and_3_5_ghz_is_83_3_db() {
        assert!((free_space(100.0, 3.5e9).0 + 83.329).abs() < 1e-3);
    }

    #[test]
    fn free_space_itself_has_no_excess_whatever_it_is_written_as() {
        let total = 46.0;
        let cases: [(ValueKind, &dyn Fn(f64) -> f64); 6] = [
            (ValueKind::PathGainDb, &|gain| gain),
            (ValueKind::PathGainLinear, &|gain| Db(gain).to_linear()),
            (ValueKind::PathLossDb, &|gain| -gain),
            (ValueKind::RssDbm, &|gain| total + gain),
            (ValueKind::RssW, &|gain| Db(total + gain - 30.0).to_linear()),
            (ValueKind::RsrpDbm, &|gain| total - 10.0 * libm::log10(3276.0) + gain),
        ];
        for (kind, value) in cases {
            let excess = check(&window(0.0, value), kind).expect("sound").expect("reached");
            assert!(excess.abs() < 1e-9, "{kind:?}: {excess}");
        }
    }

    #[test]
    fn another_unit_is_named() {
        let mend = |window: &MapWindow, kind| check(window, kind).expect_err("another unit").mend;
        let dbw = window(0.0, |gain| 46.0 - 30.0 + gain);
        assert!(mend(&dbw, ValueKind::RssDbm).contains("dBW"));
        let milliwatts = window(0.0, |gain| Db(46.0 + gain).to_linear());
        assert!(mend(&milliwatts, ValueKind::RssW).contains("mW"));
        let carrier = window(0.0, |gain| 46.0 + gain);
        assert!(mend(&carrier, ValueKind::RsrpDbm).contains("values of the whole carrier"));
        let loss = window(0.0, |gain| -gain);
        let metadata = metadata();
        let comparison = Comparison::new(&loss, &open(), &metadata, &friis(&metadata));
        let other = comparison.other_kind(ValueKind::PathGainDb).expect("another kind fits");
        assert!(other.mend.contains("path_loss_db"));
    }

    #[test]
    fn a_hidden_transmitter_is_no_mistake() {
        let excess = check(&window(12.0, |gain| gain), ValueKind::PathGainDb).expect("hidden");
        assert!(excess.is_some_and(|excess| (excess + 12.0).abs() < 1e-9));
        assert!(Comparison::warning(excess).is_some());
        assert!(check(&window(45.0, |gain| gain), ValueKind::PathGainDb).is_ok(), "nothing fits");
        assert!(check(&window(70.0, |gain| gain), ValueKind::PathGainDb).is_err());
        assert!(check(&window(-9.0, |gain| gain), ValueKind::PathGainDb).is_err(), "too strong");
    }
}

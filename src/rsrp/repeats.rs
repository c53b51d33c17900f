//! What repeats of a trace tell: the standard error of each value, and what half of them gave.
//!
//! Beside an array of values that are means of R independent repeats in linear power lies one of the
//! same shape whose name goes on with `_std_error`: in linear units the standard error of that mean,
//! the sample standard deviation over √R; in decibels that over the mean, times 10 / ln 10. A third
//! one, `_first_half`, is the mean of the first R/2 repeats in the unit of the values.
//!
//! Two bounds hold for powers, which are not negative, whatever their distribution: the standard error
//! is at most the mean, and half of the repeats differs from the mean by at most √(R−1) errors.

use std::io::{Read, Seek};

use ndarray::{Array2, Zip};

use super::check::{no_path, rounded};
use super::map::{AlignedMap, LoadedMap, PlacedArray, Relative, Repeats};
use super::member::member_matrix;
use super::metadata::{DirectionShift, RadioMapMetadata};
use super::rejection::{Rejection, RejectionCode, some};
use crate::manifest::{
    MASK_BUILDING, MASK_REACHED, MapReliability, MapWarning, ValueKind, WarningCode,
};
use crate::reliability::{HOLE_THRESHOLD, HoleModel, MAX_STD_ERROR_DB, relative_std_error};
use crate::store::NpzReader;
use crate::units::{Db, Dbm};

const STD_ERROR: &str = "_std_error";
const FIRST_HALF: &str = "_first_half";
/// Bounds are kept up to this, relative to the mean: float16 rounds decibels to 0.7 %.
const TOLERANCE: f64 = 0.02;
/// Relative error of a power whose level of some hundred decibels is a float32.
const FLOAT32: f64 = 1e-5;

/// Reads what lies in an archive beside the values of a map.
pub(super) fn beside<R: Read + Seek>(
    archive: &mut NpzReader<R>,
    name: &str,
    placed: &PlacedArray,
    metadata: &RadioMapMetadata,
) -> Result<Option<Repeats>, Rejection> {
    let names = archive.names();
    let [error, half] = [STD_ERROR, FIRST_HALF].map(|ending| format!("{name}{ending}"));
    let present = |wanted: &&String| names.contains(wanted);
    let Some(count) = metadata.several_repeats() else {
        return match [&error, &half].into_iter().find(present) {
            Some(array) => Err(without_repeats(array, metadata.repeats)),
            None => Ok(None),
        };
    };
    if !names.contains(&error) {
        let instead = format!("save sample standard deviation / sqrt(repeats) as {error}");
        return Err(missing(&error, count, some(&names), &instead));
    }
    let mut read = |array: &str| member_matrix(archive, array, name, placed);
    Ok(Some(Repeats {
        count,
        std_error: read(&error)?,
        first_half: present(&&half).then(|| read(&half)).transpose()?,
    }))
}

/// A bare `.npy` has no room for errors.
pub(super) fn none_in_npy(metadata: &RadioMapMetadata) -> Result<(), Rejection> {
    let Some(count) = metadata.several_repeats() else { return Ok(()) };
    let instead = "save map and error as .npz";
    Err(missing("of standard errors", count, "a single array in an .npy".to_owned(), instead))
}

fn missing(array: &str, count: u32, found: String, instead: &str) -> Rejection {
    Rejection::new(
        RejectionCode::ErrorMissing,
        format!("an array {array}, since repeats = {count}"),
        found,
        format!("{instead}, or leave repeats out and count all rays in samples_per_tx"),
    )
}

fn without_repeats(array: &str, repeats: Option<u32>) -> Rejection {
    Rejection::new(
        RejectionCode::ErrorWithoutRepeats,
        format!("repeats = 2 or more in the metadata, since there is {array}"),
        repeats.map_or("no repeats".to_owned(), |repeats| format!("repeats = {repeats}")),
        "write the number of repeats into the metadata, or leave the array out",
    )
}

/// A share of a mean from decibels over it.
fn from_db(kind: ValueKind, over_mean: f64) -> f64 {
    let gain = if kind == ValueKind::PathLossDb { -over_mean } else { over_mean };
    Db(gain).to_linear()
}

/// A share between none and all. What is all but for the rounding of float32 decibels is all: the other
/// half of the repeats then received nothing, which its own level would say.
fn whole_share(share: f64) -> f64 {
    if share > 1.0 - FLOAT32 { 1.0 } else { share.max(0.0) }
}

impl Repeats {
    /// What they tell of a reached cell. NaN where the arrays have it; not checked yet.
    fn raw(&self, map: &LoadedMap, at: (usize, usize), no_path: &impl Fn(f64) -> bool) -> Relative {
        let (value, kind) = (map.values[at], map.kind);
        let error = self.std_error[at];
        let first_half = self.first_half.as_ref().map(|halves| match halves[at] {
            half if no_path(half) => 0.0,
            half if kind.is_linear() => half / value / 2.0,
            half => from_db(kind, half - value) / 2.0,
        });
        let std_error = if kind.is_linear() { error / value } else { relative_std_error(error) };
        Relative { std_error, first_half }
    }

    /// The same for cells of a checked map, within their bounds; zeros where no path arrives.
    pub(super) fn relative(
        &self,
        map: &LoadedMap,
        metadata: &RadioMapMetadata,
    ) -> Array2<Relative> {
        let is_no_path = no_path(metadata, map.dtype);
        Array2::from_shape_fn(map.values.dim(), |at| {
            if is_no_path(map.values[at]) {
                let first_half = self.first_half.as_ref().map(|_| 0.0);
                return Relative { std_error: 0.0, first_half };
            }
            let Relative { std_error, first_half } = self.raw(map, at, &is_no_path);
            let first_half = first_half.map(whole_share);
            Relative { std_error: std_error.min(1.0), first_half }
        })
    }

    /// Compares the arrays with the values, which were checked, and with each other.
    pub(super) fn check(
        &self,
        map: &LoadedMap,
        metadata: &RadioMapMetadata,
    ) -> Result<(), Rejection> {
        if self.first_half.is_some() && !self.count.is_multiple_of(2) {
            return Err(half(
                format!("an even number of repeats, since there is an array *{FIRST_HALF}"),
                format!("repeats = {}", self.count),
                "leave the array out",
            ));
        }
        let is_no_path = no_path(metadata, map.dtype);
        let most_apart = f64::from(self.count - 1).sqrt();
        let (mut errors, mut halves) = (Vec::new(), Vec::new());
        for (at, &value) in map.values.indexed_iter() {
            let error = self.std_error[at];
            if is_no_path(value) {
                let is_wrong = error != 0.0 && !error.is_nan();
                errors.extend(is_wrong.then_some((error, value)));
                let something = self.first_half.as_ref().map(|halves| halves[at]);
                halves
                    .extend(something.filter(|&half| !is_no_path(half)).map(|half| (half, value)));
                continue;
            }
            let Relative { std_error, first_half } = self.raw(map, at, &is_no_path);
            if !(0.0..=1.0 + TOLERANCE).contains(&std_error) {
                errors.push((error, value));
                continue;
            }
            let apart = first_half.map(|share| (2.0 * share - 1.0).abs());
            let is_possible = |apart: f64| apart <= (most_apart * std_error).min(1.0) + TOLERANCE;
            if apart.is_some_and(|apart| !is_possible(apart)) {
                let found = self.first_half.as_ref().map_or(f64::NAN, |halves| halves[at]);
                halves.push((found, value));
            }
        }
        let told = |cells: &[(f64, f64)]| {
            let (found, value) = cells[0];
            let (wrong, total) = (cells.len(), map.values.len());
            format!("{found} beside {value}, and such in {wrong} of {total} cells")
        };
        if !errors.is_empty() {
            return Err(error_out_of_range(map.kind, told(&errors)));
        }
        if halves.is_empty() {
            return Ok(());
        }
        Err(half(
            format!(
                "{FIRST_HALF} within sqrt(repeats - 1) standard errors of the mean, from 0 to twice it"
            ),
            told(&halves),
            "save the mean over the first half of the same repeats, in the unit of the values, and \
             the standard error of the mean of all",
        ))
    }

    /// A warning where nothing says that repeats are independent.
    pub(super) fn warning(metadata: &RadioMapMetadata) -> Option<MapWarning> {
        let several = metadata.several_repeats().is_some();
        let told = metadata.direction_shift == Some(DirectionShift::Random);
        let text = "no direction_shift = \"random\": Sionna sends the same rays whatever its seed, and \
                    repeats that share rays have too small an error";
        (several && !told).then(|| MapWarning::new(WarningCode::DependentRepeats, text))
    }
}

fn error_out_of_range(kind: ValueKind, found: String) -> Rejection {
    let expected = if kind.is_linear() {
        "standard errors from 0 to the mean beside them, 0 where no path arrives".to_owned()
    } else {
        format!("standard errors from 0 to {MAX_STD_ERROR_DB:.3} dB, 0 where no path arrives")
    };
    let mend = if kind.is_linear() {
        "save sample standard deviation / sqrt(repeats) of the linear values"
    } else {
        "save 10 / ln 10 * sample standard deviation / sqrt(repeats) / mean of the linear values"
    };
    Rejection::new(RejectionCode::ErrorOutOfRange, expected, found, mend)
}

fn half(expected: String, found: String, mend: &str) -> Rejection {
    Rejection::new(RejectionCode::HalfOutOfRange, expected, found, mend)
}

/// How far the repeats of an aligned map agree.
pub(super) fn reliability(map: &AlignedMap, repeats: Option<u32>) -> Option<MapReliability> {
    let (errors, repeats) = map.errors.as_ref().zip(repeats)?;
    let model = HoleModel::new(repeats);
    let (mut outdoors, mut unsure, mut reached) = (0_u64, 0_u64, Vec::new());
    Zip::from(&map.rsrp_dbm).and(&errors.std_error_db).and(&map.mask).for_each(
        |&rsrp, &error, &kind| {
            outdoors += u64::from(kind != MASK_BUILDING);
            if kind == MASK_REACHED {
                reached.push(error);
                let shift = model.shift_to_sure_db(Dbm(rsrp.into()), error.into(), HOLE_THRESHOLD);
                unsure += u64::from(shift > 0.0);
            }
        },
    );
    let middle = reached.len() / 2;
    let median =
        (!reached.is_empty()).then(|| *reached.select_nth_unstable_by(middle, f32::total_cmp).1);
    Some(MapReliability {
        repeats,
        median_std_error_db: rounded(median.unwrap_or(0.0).into(), 3),
        unsure: rounded(unsure as f64 / outdoors.max(1) as f64, 4),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In decibels a half that received all lies 3.0103 dB above the mean, as float32 has it.
    #[test]
    fn all_of_the_power_is_all_in_decibels_too() {
        for level in [-143.83_f32, -99.5, -160.01] {
            let half = f64::from(level + 10.0 * 2.0_f32.log10());
            let share = from_db(ValueKind::PathGainDb, half - f64::from(level)) / 2.0;
            assert_eq!(whole_share(share).to_bits(), 1.0_f64.to_bits(), "{level}: {share}");
        }
        assert_eq!(whole_share(0.996).to_bits(), 0.996_f64.to_bits());
        assert_eq!(whole_share(-1e-9).to_bits(), 0.0_f64.to_bits());
    }
}

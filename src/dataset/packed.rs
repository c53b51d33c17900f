//! Levels with errors as integers: how a record of schema `record.v2` holds its arrays.
//!
//! A traced level is known to a tenth of a decibel at best, so a hundredth loses nothing; half of
//! the bytes are saved. Every value is a whole number of hundredths (of 250ths for shares), so that a
//! record that is read and written again has the same bytes.

use ndarray::{Array2, Zip};
use serde_bytes::ByteBuf;

use super::grids::{Grids, RecordError, matrix};
use crate::manifest::ErrorGrids;
use crate::manifest::{MASK_REACHED, MASK_UNREACHED};
#[cfg(feature = "build")]
use crate::store::npy_bytes;
use crate::units::Dbm;

/// What a level without any path is stored as; it is read as the record's floor.
const NO_LEVEL: i16 = i16::MIN;
/// Steps of a decibel.
const STEPS: f32 = 100.0;
/// Steps of a share: one half is one of them.
const SHARES: f32 = 250.0;
/// The largest standard error, 4.343 dB, in hundredths.
const MAX_ERROR: u16 = 434;

#[cfg(feature = "build")]
/// The arrays of a record as they lie in it.
pub(super) struct Packed {
    pub(super) rsrp_dbm: ByteBuf,
    pub(super) std_error_db: ByteBuf,
    pub(super) first_half_share: Option<ByteBuf>,
}

/// The same, of a record that is read.
#[derive(Clone, Copy)]
pub(super) struct PackedRef<'a> {
    pub(super) rsrp_dbm: &'a [u8],
    pub(super) std_error_db: &'a [u8],
    pub(super) first_half_share: Option<&'a [u8]>,
    pub(super) floor_dbm: Dbm,
}

#[cfg(feature = "build")]
/// Packs levels and errors; a cell at the floor that is no reached one has no level.
pub(super) fn pack(floor_dbm: Dbm, grids: &Grids, errors: &ErrorGrids) -> Packed {
    let floor = (floor_dbm.0 as f32).to_bits();
    let mut levels = Array2::from_elem(grids.mask.raw_dim(), NO_LEVEL);
    Zip::from(&mut levels)
        .and(&grids.rsrp_dbm)
        .and(&errors.std_error_db)
        .and(&grids.mask)
        .for_each(|level, &rsrp, &error, &kind| {
            if kind == MASK_REACHED || error != 0.0 || rsrp.to_bits() != floor {
                *level = in_steps(rsrp).max(NO_LEVEL + 1);
            }
        });
    // An error that is not zero stays so: a cell is sure only if all repeats agree.
    let std_error = errors.std_error_db.mapv(|error| match (error * STEPS).round() as u16 {
        0 => u16::from(error > 0.0),
        steps => steps,
    });
    let share = |share: f32| match (share * SHARES).round() as u8 {
        0 => u8::from(share > 0.0),
        steps => steps.min(if share < 1.0 { SHARES as u8 - 1 } else { u8::MAX }),
    };
    let packed = |array: Vec<u8>| ByteBuf::from(array);
    Packed {
        rsrp_dbm: packed(npy_bytes(&levels)),
        std_error_db: packed(npy_bytes(&std_error)),
        first_half_share: errors
            .first_half_share
            .as_ref()
            .map(|shares| packed(npy_bytes(&shares.mapv(share)))),
    }
}

#[cfg(feature = "build")]
/// Hundredths of a decibel; a float64 holds the product exactly enough to be rounded right.
fn in_steps(rsrp: f32) -> i16 {
    (f64::from(rsrp) * f64::from(STEPS)).round() as i16
}

/// The levels and errors of a record.
///
/// # Errors
/// [`RecordError`] names the array, and a reached cell without a level.
pub(super) fn unpack(
    packed: PackedRef<'_>,
    mask: &Array2<u8>,
) -> Result<(Array2<f32>, ErrorGrids), RecordError> {
    let cells = mask.nrows();
    let levels: Array2<i16> = matrix("rsrp_dbm", packed.rsrp_dbm, cells)?;
    let lacking =
        levels.indexed_iter().find(|&(at, &level)| level == NO_LEVEL && mask[at] == MASK_REACHED);
    if let Some((at, _)) = lacking {
        return Err(wrong("rsrp_dbm", "no level", at, "a level where mask is 0"));
    }
    let floor = packed.floor_dbm.0 as f32;
    let rsrp_dbm =
        levels.mapv(|level| if level == NO_LEVEL { floor } else { f32::from(level) / STEPS });
    let errors: Array2<u16> = matrix("std_error_db", packed.std_error_db, cells)?;
    let half = packed.first_half_share;
    let half = half.map(|bytes| matrix::<u8>("first_half_share", bytes, cells)).transpose()?;
    let errors = ErrorGrids {
        std_error_db: errors.mapv(|error| f32::from(error) / STEPS),
        first_half_share: half.map(|shares| shares.mapv(|share| f32::from(share) / SHARES)),
    };
    Ok((rsrp_dbm, errors))
}

/// Checks that errors mean what the schema says, and that nothing has one that no path reaches.
pub(super) fn check(grids: &Grids) -> Result<(), RecordError> {
    let Some(ErrorGrids { std_error_db, first_half_share }) = &grids.errors else { return Ok(()) };
    let most = f32::from(MAX_ERROR) / STEPS;
    for (at, &error) in std_error_db.indexed_iter() {
        let share = first_half_share.as_ref().map_or(0.0, |shares| shares[at]);
        if !(0.0..=most).contains(&error) {
            let expected = format!("0 to {most} dB");
            return Err(wrong("std_error_db", &error.to_string(), at, &expected));
        }
        if !(0.0..=1.0).contains(&share) {
            return Err(wrong("first_half_share", &share.to_string(), at, "0 to 1"));
        }
        if grids.mask[at] == MASK_UNREACHED && (error != 0.0 || share != 0.0) {
            let found = format!("{error} dB, share {share}");
            return Err(wrong("std_error_db", &found, at, "0 where mask is 2"));
        }
    }
    Ok(())
}

fn wrong(field: &'static str, found: &str, at: (usize, usize), expected: &str) -> RecordError {
    let found = format!("{found} at row {}, column {}", at.0, at.1);
    RecordError::Value { field, found, expected: expected.to_owned() }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::record::Record;
    use super::*;
    use crate::dataset::example;
    use ndarray::array;

    /// The example with errors, its levels whole hundredths.
    pub(in crate::dataset) fn example_with_errors() -> (Record, Grids) {
        let (mut record, mut grids) = example();
        record.repeats = Some(8);
        grids.rsrp_dbm = array![[-90.25, -104.5], [-160.0, -101.5]];
        grids.errors = Some(ErrorGrids {
            std_error_db: array![[0.25, 4.34], [0.0, 1.5]],
            first_half_share: Some(array![[0.5, 1.0], [0.0, 0.252]]),
        });
        (record.with_grids(&grids), grids)
    }

    #[test]
    fn records_with_errors_round_trip() {
        let (record, grids) = example_with_errors();
        assert_eq!(record.schema, Record::SCHEMA_WITH_ERRORS);
        let decoded = Record::decode(&record.encode()).expect("a record");
        assert_eq!(decoded, record);
        let again = decoded.sound_grids(2).expect("sound");
        assert_eq!(again, grids);
        assert_eq!(decoded.clone().with_grids(&again).encode(), record.encode());
        let mut without_half = grids;
        if let Some(errors) = &mut without_half.errors {
            errors.first_half_share = None;
        }
        let record = record.with_grids(&without_half);
        assert_eq!(record.sound_grids(2).expect("sound"), without_half);
    }

    #[test]
    fn levels_and_errors_are_rounded_and_nothing_uncertain_becomes_sure() {
        let (record, mut grids) = example_with_errors();
        grids.rsrp_dbm = array![[-90.004, -160.0], [-160.0, -340.0]];
        grids.errors = Some(ErrorGrids {
            std_error_db: array![[0.001, 0.0], [0.0, 4.343]],
            first_half_share: Some(array![[0.001, 0.0], [0.0, 0.9999]]),
        });
        let read = record.with_grids(&grids).sound_grids(2).expect("sound");
        assert_eq!(read.rsrp_dbm, array![[-90.0, -160.0], [-160.0, -327.67]]);
        let errors = read.errors.expect("errors");
        assert_eq!(errors.std_error_db, array![[0.01, 0.0], [0.0, 4.34]]);
        assert_eq!(errors.first_half_share, Some(array![[0.004, 0.0], [0.0, 0.996]]));
    }

    /// A level that happens to be the floor is one, also in a building that is partly outdoors.
    #[test]
    fn cells_at_the_floor_keep_their_levels() {
        let (record, mut grids) = example_with_errors();
        (grids.rsrp_dbm[[0, 0]], grids.rsrp_dbm[[0, 1]]) = (-160.0, -160.0);
        let record = record.with_grids(&grids);
        assert_eq!(record.sound_grids(2).expect("sound"), grids);
    }

    fn errors(grids: &mut Grids) -> &mut ErrorGrids {
        grids.errors.as_mut().expect("errors")
    }

    #[test]
    fn unsound_errors_are_named() {
        let (record, grids) = example_with_errors();
        let error = |change: &dyn Fn(&mut Record, &mut Grids)| {
            let (mut record, mut grids) = (record.clone(), grids.clone());
            change(&mut record, &mut grids);
            let record = if grids.errors.is_some() { record.with_grids(&grids) } else { record };
            let decoded = Record::decode(&record.encode());
            decoded.and_then(|record| record.sound_grids(2)).expect_err("unsound").to_string()
        };
        assert!(error(&|_, grids| errors(grids).std_error_db[[0, 0]] = 4.36).contains("4.34 dB"));
        assert!(error(&|_, grids| errors(grids).std_error_db[[1, 0]] = 1.0).contains("mask is 2"));
        let no_level = |_: &mut Record, grids: &mut Grids| {
            let shares = errors(grids).first_half_share.as_mut();
            shares.expect("shares")[[1, 0]] = 0.5;
        };
        assert!(error(&no_level).contains("mask is 2"));
        let share = |record: &mut Record, grids: &mut Grids| {
            grids.errors = None;
            record.first_half_share = Some(ByteBuf::from(npy_bytes(&array![[251_u8, 0], [0, 0]])));
        };
        assert!(error(&share).contains("first_half_share"));
        let lacking = |record: &mut Record, grids: &mut Grids| {
            grids.errors = None;
            record.rsrp_dbm = ByteBuf::from(npy_bytes(&array![[i16::MIN, 0], [i16::MIN, 0]]));
        };
        assert!(error(&lacking).contains("no level at row 0, column 0"));
        for lack in [
            |record: &mut Record| record.repeats = None,
            |record: &mut Record| {
                record.std_error_db = None;
            },
        ] {
            let said = error(&|record, grids| {
                grids.errors = None;
                lack(record);
            });
            assert!(said.contains("record.v2"), "{said}");
        }
        let of_v1 = error(&|record, grids| {
            grids.errors = None;
            record.schema = Record::SCHEMA.to_owned();
        });
        assert!(of_v1.contains("record.v1"), "{of_v1}");
    }
}

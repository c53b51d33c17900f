//! Figures of a split, added up record by record; integers, so the order does not matter.

use super::grids::Grids;
use super::record::Record;
use crate::manifest::{
    DatasetManifest, MaskCounts, Reliability, RsrpHistogram, ShiftHistogram, SplitStatistics,
};
use crate::manifest::{MASK_BUILDING, MASK_REACHED};
use crate::reliability::{HOLE_THRESHOLD, HoleModel, SURE};
use crate::units::Dbm;

const FIRST_DBM: i32 = -200;
const STEP_DB: i32 = 5;
const BINS: usize = 40;
const SHIFT_STEP_DB: f64 = 0.25;
const SHIFT_BINS: usize = 40;

/// The figures of one record.
#[must_use]
pub fn statistics_of(record: &Record, grids: &Grids) -> SplitStatistics {
    let mut cells = MaskCounts::default();
    let (mut holes, mut counts) = (0, vec![0; BINS]);
    for (&kind, &rsrp) in grids.mask.iter().zip(&grids.rsrp_dbm) {
        match kind {
            MASK_BUILDING => cells.building += 1,
            MASK_REACHED => {
                cells.reached += 1;
                holes += u64::from(f64::from(rsrp) < HOLE_THRESHOLD.0);
                let bin = ((rsrp - FIRST_DBM as f32) / STEP_DB as f32).max(0.0) as usize;
                counts[bin.min(BINS - 1)] += 1;
            }
            _ => {
                cells.unreached += 1;
                holes += 1;
            }
        }
    }
    SplitStatistics {
        records: 1,
        cells,
        holes,
        hole_threshold_dbm: HOLE_THRESHOLD,
        rsrp: RsrpHistogram { first_dbm: FIRST_DBM, step_db: STEP_DB, counts },
        built_cells: record.provenance.built_cells,
        reliability: reliability(record, grids),
    }
}

fn reliability(record: &Record, grids: &Grids) -> Option<Reliability> {
    let (errors, repeats) = grids.errors.as_ref().zip(record.repeats)?;
    let model = HoleModel::new(repeats);
    let (mut outdoor, mut sure_holes, mut unsure) = (0, 0, 0);
    let mut counts = vec![0; SHIFT_BINS];
    let cells = grids.mask.iter().zip(&grids.rsrp_dbm).zip(&errors.std_error_db);
    for ((&kind, &rsrp), &error) in cells.filter(|((kind, _), _)| **kind != MASK_BUILDING) {
        outdoor += 1;
        if kind != MASK_REACHED {
            sure_holes += 1;
            continue;
        }
        let (rsrp, error) = (Dbm(rsrp.into()), error.into());
        let shift = model.shift_to_sure_db(rsrp, error, HOLE_THRESHOLD);
        if shift > 0.0 {
            unsure += 1;
            counts[((shift / SHIFT_STEP_DB) as usize).min(SHIFT_BINS - 1)] += 1;
        } else {
            let chance = model.probability(rsrp, error, HOLE_THRESHOLD);
            sure_holes += u64::from(chance > 1.0 - SURE);
        }
    }
    let threshold_shift = ShiftHistogram { step_db: SHIFT_STEP_DB, counts };
    Some(Reliability { records: 1, outdoor, sure_holes, unsure, threshold_shift })
}

/// Adds the figures of `more` records to a sum, which begins empty.
pub(crate) fn add(sum: &mut Option<SplitStatistics>, more: &SplitStatistics) {
    let Some(sum) = sum else {
        *sum = Some(more.clone());
        return;
    };
    let pairs = [
        (&mut sum.records, more.records),
        (&mut sum.cells.reached, more.cells.reached),
        (&mut sum.cells.building, more.cells.building),
        (&mut sum.cells.unreached, more.cells.unreached),
        (&mut sum.holes, more.holes),
        (&mut sum.built_cells.height, more.built_cells.height),
        (&mut sum.built_cells.levels, more.built_cells.levels),
        (&mut sum.built_cells.default, more.built_cells.default),
    ];
    add_reliability(&mut sum.reliability, more.reliability.as_ref());
    let bins = sum.rsrp.counts.iter_mut().zip(more.rsrp.counts.iter().copied());
    for (total, count) in pairs.into_iter().chain(bins) {
        // Counts in a forged record must not end the verification of the others.
        *total = total.saturating_add(count);
    }
}

fn add_reliability(sum: &mut Option<Reliability>, more: Option<&Reliability>) {
    let Some(more) = more else { return };
    let Some(sum) = sum else {
        *sum = Some(more.clone());
        return;
    };
    let pairs = [
        (&mut sum.records, more.records),
        (&mut sum.outdoor, more.outdoor),
        (&mut sum.sure_holes, more.sure_holes),
        (&mut sum.unsure, more.unsure),
    ];
    let bins = more.threshold_shift.counts.iter().copied();
    let bins = sum.threshold_shift.counts.iter_mut().zip(bins);
    for (total, count) in pairs.into_iter().chain(bins) {
        *total = total.saturating_add(count);
    }
}

/// How sure the holes of all splits are, if any record tells errors.
pub(crate) fn reliability_of(manifest: &DatasetManifest) -> Option<Reliability> {
    let mut sum = None;
    for split in manifest.statistics.values() {
        add_reliability(&mut sum, split.reliability.as_ref());
    }
    sum
}

/// Unsure cells as a share of the outdoor cells of records with errors, 0 to 1.
#[must_use]
pub fn unsure_share(reliability: &Reliability) -> f64 {
    reliability.unsure as f64 / reliability.outdoor.max(1) as f64
}

/// Coverage holes as a share of outdoor cells, 0 to 1.
#[must_use]
pub fn hole_share(statistics: &SplitStatistics) -> f64 {
    let outdoor = statistics.cells.reached + statistics.cells.unreached;
    if outdoor == 0 { 0.0 } else { statistics.holes as f64 / outdoor as f64 }
}

#[cfg(test)]
mod tests {
    use super::super::packed::tests::example_with_errors;
    use super::super::record::tests::example;
    use super::*;

    /// Of three outdoor cells one is 9.75 dB over the threshold with an error of 0.25 dB, one has no
    /// path, and one is 1.5 dB below it with an error of 1.5 dB: 1.895 · 1.5 − 1.5 = 1.34 dB to the
    /// next sure threshold.
    #[test]
    fn cells_are_sure_or_lack_some_decibels() {
        let (record, grids) = example_with_errors();
        let one = statistics_of(&record, &grids);
        let reliability = one.reliability.as_ref().expect("errors");
        assert_eq!((reliability.records, reliability.outdoor), (1, 3));
        assert_eq!((reliability.sure_holes, reliability.unsure), (1, 1));
        assert_eq!(reliability.threshold_shift.counts[5], 1, "1.25 to 1.5 dB");
        assert!((unsure_share(reliability) - 1.0 / 3.0).abs() < 1e-12);
        let mut sum = None;
        add(&mut sum, &one);
        add(&mut sum, &statistics_of(&example().0, &example().1));
        add(&mut sum, &one);
        let sum = sum.and_then(|sum| sum.reliability).expect("errors");
        assert_eq!((sum.records, sum.unsure, sum.threshold_shift.counts[5]), (2, 2, 2));
    }

    #[test]
    fn cells_are_counted_by_kind_and_level() {
        let (record, grids) = example();
        let one = statistics_of(&record, &grids);
        assert_eq!(one.cells, MaskCounts { reached: 2, building: 1, unreached: 1 });
        assert_eq!(one.holes, 2, "one unreached, one of -101.5 dBm");
        assert!((hole_share(&one) - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!(one.rsrp.counts[22], 1, "-90 dBm lies in the bin from -90");
        assert_eq!(one.rsrp.counts[19], 1, "-101.5 dBm lies in the bin from -105");
        let mut sum = None;
        add(&mut sum, &one);
        add(&mut sum, &one);
        assert_eq!(sum.map(|sum| (sum.records, sum.holes)), Some((2, 4)));
    }
}

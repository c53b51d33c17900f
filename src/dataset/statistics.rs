//! Figures of a split, added up record by record; integers, so the order does not matter.

use super::record::{Grids, Record};
use crate::manifest::{MaskCounts, RsrpHistogram, SplitStatistics};
use crate::radio_map::{MASK_BUILDING, MASK_REACHED};
use crate::units::Dbm;

/// The threshold that coverage holes are counted with, in dBm (the paper's default).
const HOLE_THRESHOLD: Dbm = Dbm(-100.0);
const FIRST_DBM: i32 = -200;
const STEP_DB: i32 = 5;
const BINS: usize = 40;

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
    }
}

/// Adds the figures of `more` records to a sum, which begins empty.
pub(super) fn add(sum: &mut Option<SplitStatistics>, more: &SplitStatistics) {
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
    let bins = sum.rsrp.counts.iter_mut().zip(more.rsrp.counts.iter().copied());
    for (total, count) in pairs.into_iter().chain(bins) {
        // Counts in a forged record must not end the verification of the others.
        *total = total.saturating_add(count);
    }
}

/// Coverage holes as a share of outdoor cells, 0 to 1.
#[must_use]
pub fn hole_share(statistics: &SplitStatistics) -> f64 {
    let outdoor = statistics.cells.reached + statistics.cells.unreached;
    if outdoor == 0 { 0.0 } else { statistics.holes as f64 / outdoor as f64 }
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::example;
    use super::*;

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

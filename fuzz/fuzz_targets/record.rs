//! Any bytes as a record of a shard: what is accepted is the same after it is written and read
//! again, arrays included.
#![no_main]

use holescout::dataset::{Grids, Record};
use holescout::store::read_npy;
use holescout_fuzz as _;
use libfuzzer_sys::fuzz_target;

fn same(a: &Grids, b: &Grids) {
    let bits = |values: &ndarray::Array2<f32>| values.mapv(f32::to_bits);
    assert_eq!(bits(&a.height_m), bits(&b.height_m));
    assert_eq!(bits(&a.rsrp_dbm), bits(&b.rsrp_dbm));
    assert_eq!(a.mask, b.mask);
    let errors = |grids: &Grids| {
        grids.errors.as_ref().map(|errors| {
            let shares = errors.first_half_share.as_ref().map(&bits);
            (bits(&errors.std_error_db), shares)
        })
    };
    assert_eq!(errors(a), errors(b));
}

fuzz_target!(|bytes: &[u8]| {
    let Ok(record) = Record::decode(bytes) else { return };
    let written = record.encode();
    let again = Record::decode(&written).expect("accepted before");
    assert_eq!(again.encode(), written);

    let cells = read_npy(&record.mask).ok().and_then(|mask| mask.shape.first().copied());
    let cells = cells.unwrap_or(2);
    let Ok(grids) = record.grids(cells) else { return };
    if let Ok(sound) = record.sound_grids(cells) {
        same(&sound, &grids);
        assert!(sound.height_m.iter().all(|height| height.is_finite() && *height >= 0.0));
        assert!(sound.rsrp_dbm.iter().all(|level| level.is_finite()));
    }
    same(&record.with_grids(&grids).grids(cells).expect("just written"), &grids);
});

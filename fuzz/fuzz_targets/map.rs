//! Any bytes as the `.npz` of a radio map, with metadata of its own or those of a preset: what is
//! taken is square, has a transmitter, and is the same the second time.
#![no_main]

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use holescout::config::Preset;
use holescout::rsrp::{Supplement, load_archive};
use holescout_fuzz as _;
use libfuzzer_sys::fuzz_target;

const LIMIT: u64 = 1 << 16;

fuzz_target!(|bytes: &[u8]| {
    let assume = BTreeMap::from([("map_size_m".to_owned(), serde_json::json!(484))]);
    let presets = [Preset::Sionna, Preset::Geo2sigmap, Preset::LargeRadioMaps].map(Some);
    let supplements =
        presets.map(|preset| Supplement { preset, assume: Some(&assume), scenes: None });
    for supplement in [Supplement::default()].into_iter().chain(supplements) {
        for tx in [None, Some(1)] {
            let load = || {
                let name = Path::new("utm10n_e590848_n4128256.npz");
                load_archive(Cursor::new(bytes), name, LIMIT, &supplement, tx)
            };
            let Ok((described, map)) = load() else { continue };
            assert!(map.values.is_square() && !map.values.is_empty());
            if let Some(repeats) = &map.repeats {
                let half = repeats.first_half.as_ref();
                assert!(repeats.count > 1 && repeats.std_error.dim() == map.values.dim());
                assert!(half.is_none_or(|half| half.dim() == map.values.dim()));
            }
            assert!(described.metadata.tx_position_m.all().contains(&map.tx_position_m));
            assert!(supplement.preset.is_some() || described.assumed.is_empty());
            let (again, same) = load().expect("loaded before");
            assert_eq!(again.assumed, described.assumed);
            assert!(map.values.iter().zip(&same.values).all(|(a, b)| a.to_bits() == b.to_bits()));
        }
    }
});

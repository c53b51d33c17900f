//! Any bytes as metadata: what is accepted is the same after it is written and read again, what is
//! not has a short reason.
#![no_main]

use holescout::rsrp::RadioMapMetadata;
use holescout_fuzz as _;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    match RadioMapMetadata::parse(bytes) {
        Ok(metadata) => {
            let epsg = metadata.crs.epsg();
            assert!(epsg.is_some());
            assert!(!metadata.no_path_value.values().is_empty());
            assert!(!metadata.tx_position_m.all().is_empty());
            let written = serde_json::to_vec(&metadata).expect("numbers and texts");
            let again = RadioMapMetadata::parse(&written).expect("accepted before");
            assert_eq!(again, metadata);
        }
        Err(rejection) => {
            let texts = [&rejection.expected, &rejection.found, &rejection.mend];
            assert!(texts.iter().all(|text| !text.is_empty()), "{rejection:?}");
            // Control characters grow when they are escaped.
            assert!(texts.iter().all(|text| text.len() <= 1000 + 10 * bytes.len()));
        }
    }
});

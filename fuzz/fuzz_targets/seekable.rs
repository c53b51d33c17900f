//! Any bytes as a shard: where all frames can be read, they are what a plain Zstandard decoder makes
//! of the whole file.
#![no_main]

use std::io::Cursor;

use holescout::store::SeekTable;
use holescout_fuzz::allow;
use libfuzzer_sys::fuzz_target;

/// The largest frame that is ever unpacked, and what is needed beside it.
const LARGEST: usize = (1 << 28) + (16 << 20);
/// Whole files are compared up to this size.
const COMPARED: usize = 1 << 20;

fuzz_target!(init: allow(LARGEST), |bytes: &[u8]| {
    let mut file = Cursor::new(bytes);
    let Ok(table) = SeekTable::read(&mut file) else { return };
    assert!(table.frame(&mut file, table.len()).is_err());
    let frames = table.len().min(16);
    let mut whole = Vec::new();
    for frame in 0..frames {
        let Ok(record) = table.frame(&mut file, frame) else { return };
        assert!(record.len() <= table.largest_frame());
        whole.extend(record);
        if whole.len() > COMPARED {
            return;
        }
    }
    if frames == table.len() {
        match zstd::decode_all(bytes) {
            Ok(stream) => assert!(stream == whole),
            // A stream needs the window that a frame asks for; one whole frame needs none.
            Err(error) => assert!(error.to_string().contains("too much memory"), "{error}"),
        }
    }
});

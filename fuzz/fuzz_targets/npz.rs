//! Any bytes as `.npz`: names are distinct, no member is larger than allowed, and what is read can
//! be written to another archive that holds the same.
#![no_main]

use std::io::Cursor;

use holescout::store::{NpzError, NpzReader, npz_bytes};
use holescout_fuzz as _;
use libfuzzer_sys::fuzz_target;

const LIMIT: u64 = 1 << 16;
/// Unpacking all of 256 members would be slow and show nothing new.
const UNPACKED: usize = 8;

fuzz_target!(|bytes: &[u8]| {
    let Ok(mut archive) = NpzReader::new(Cursor::new(bytes), LIMIT) else { return };
    let names = archive.names();
    assert!(names.is_sorted_by(|a, b| a < b), "{names:?}");
    let mut members = Vec::new();
    for name in names.iter().take(UNPACKED) {
        match archive.member(name) {
            Ok(member) => {
                assert!(member.len() as u64 <= LIMIT);
                assert_eq!(archive.member(name).expect("read before"), member);
                members.push((&**name, member));
            }
            Err(NpzError::TooLarge { bytes, limit, .. }) => assert!(bytes >= limit),
            Err(NpzError::File(error)) => panic!("there is no file: {error}"),
            Err(_) => {}
        }
    }
    members.retain(|(name, _)| name.bytes().all(|byte| byte.is_ascii_alphanumeric()));
    let again = npz_bytes(&members, 1);
    let mut again = NpzReader::new(Cursor::new(again), LIMIT).expect("just written");
    for (name, member) in members {
        assert_eq!(again.member(name).expect("just written"), member);
    }
});

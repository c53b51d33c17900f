//! Hostile and damaged maps cost `import-rsrp` neither memory nor the run: bombs, headers
//! that lie, cut, noisy and flipped files are rejected like any other mistake, and none is
//! ever taken for a map with other values.

mod pipeline;

use std::collections::BTreeMap;
use std::fs;
use std::io::{Cursor, Seek, SeekFrom, Write};
use std::process::Command;
use std::sync::LazyLock;

use ndarray::Array2;
use serde_json::Value;
use zip::{CompressionMethod, ZipArchive};

use pipeline::importing::Import;
use pipeline::maps::{SITE, Window, good_values, metadata, write_npz};
use pipeline::numpy::{Float, Layout, npy, npy_raw, npy_text, npz, npz_members, replaced};
use pipeline::{Random, Run, assert_says, read, read_json, run, write};

fn f4(values: &Array2<f64>) -> Vec<u8> {
    npy(values, Layout::plain(Float::F4))
}

/// Runs the import with at most so much memory (address space), in MiB.
fn limited(import: &Import, mebibytes: u32) -> Run {
    let command = import.command();
    let limit = format!("ulimit -v {}; exec \"$0\" \"$@\"", mebibytes * 1024);
    let mut shell = Command::new("sh");
    shell.args(["-c", &limit]).arg(command.get_program()).args(command.get_args());
    run(shell.args(["--max-array", "1", "--threads", "2"]))
}

/// An archive of one array that unpacks to a gibibyte of zeros.
fn bomb(header: &[u8], name: &str, metadata: Option<&Value>) -> Vec<u8> {
    let mut zeros = header.to_vec();
    zeros.resize(1 << 30, 0);
    let mut members = vec![(name, zeros)];
    let text = metadata.map(|metadata| npy_text(metadata.to_string().as_bytes()));
    members.extend(text.map(|text| ("meta_json", text)));
    let bytes = npz(&members, CompressionMethod::Deflated);
    assert!(bytes.len() < 4 << 20, "a bomb is small");
    bytes
}

/// The size before compression that the first member claims to have, in both its headers.
fn claim_size(archive: &mut [u8], size: u32) {
    let first = |magic: &[u8]| {
        let found = archive.windows(4).position(|window| window == magic);
        found.expect("a header")
    };
    let (local, central) = (first(b"PK\x03\x04"), first(b"PK\x01\x02"));
    archive[local + 22..local + 26].copy_from_slice(&size.to_le_bytes());
    archive[central + 24..central + 28].copy_from_slice(&size.to_le_bytes());
}

#[test]
fn bombs_are_refused_without_unpacking_them() {
    let header = npy_raw("'<f4'", false, "(16384, 16384)", &[]);
    let metadata = |id: usize| metadata(&SITE.ids[id], Window::Coarse);
    let honest = bomb(&header, "path_gain", Some(&metadata(0)));
    let mut lying = bomb(&header, "path_gain", Some(&metadata(1)));
    claim_size(&mut lying, 121 * 121 * 4 + 128);
    let text = bomb(&npy_raw("'|u1'", false, "(1073741696,)", &[]), "meta_json", None);
    let import = Import::new();
    write(&import.map("bad.honest.npz"), honest);
    write(&import.map("bad.lying.npz"), lying);
    write(&import.map("bad.text.npz"), text);
    limited(&import, 512).succeeds();
    let rejected = import.listed();
    let codes: Vec<_> = rejected.iter().map(|line| (&line.file[..], &line.code[..])).collect();
    assert_eq!(codes[0], ("bad.honest.npz", "too_large"));
    assert_says(&rejected[0].found, &["path_gain", "1073741824"]);
    assert!([("bad.lying.npz", "too_large"), ("bad.lying.npz", "damaged")].contains(&codes[1]));
    assert_eq!(codes[2], ("bad.text.npz", "too_large"));
    assert_eq!(codes.len(), 3);
}

#[test]
fn headers_that_lie_are_refused_without_allocating() {
    let file = |version: u8, length: &[u8], text: &str| {
        let magic = [b"\x93NUMPY", &[version, 0][..]].concat();
        [&magic, length, text.as_bytes(), &[0; 64]].concat()
    };
    let lies = [
        npy_raw("'<f8'", false, "(100000, 100000)", &[0; 64]),
        npy_raw("'<f4'", false, "(18446744073709551615, 2)", &[0; 64]),
        npy_raw("'<f4'", false, "(99999999999999999999, 2)", &[0; 64]),
        npy_raw("'<f4'", false, "(-4, 4)", &[0; 64]),
        npy_raw("'<f4'", false, "(0, 0)", &[]),
        npy_raw("'<f4'", false, "()", &[0; 4]),
        npy_raw("'<f4'", false, "(4, 4)", &[0; 65]),
        npy_raw("'<f4'", true, "(4, 4", &[0; 64]),
        file(1, &[0xff, 0xff], "{}"),
        file(2, &[0xff; 4], "{}"),
        file(3, &[4, 0, 0, 0], "\u{ff}{}"),
        file(1, &[4, 0], "{{}}"),
        file(9, &[2, 0], "{}"),
        b"\x93NUMPY".to_vec(),
        vec![],
    ];
    let import = Import::new();
    let mut expected = 0;
    for (number, lie) in lies.iter().enumerate() {
        // Nine tiles: the tenth is the good map's.
        let (tile, file) = (&SITE.ids[number % 9], format!("bad.{number:02}"));
        let metadata = metadata(tile, Window::Coarse);
        if number < 9 {
            write_npz(&import.map(&format!("{file}.npz")), "path_gain", lie.clone(), &metadata);
        } else {
            let text = npy_text(metadata.to_string().as_bytes());
            let swapped = [("path_gain", text), ("meta_json", lie.clone())];
            let swapped = npz(&swapped, CompressionMethod::Stored);
            write(&import.map(&format!("{file}.npz")), swapped);
        }
        expected += 1;
    }
    limited(&import, 512).succeeds();
    let rejected = import.listed();
    assert_eq!(rejected.len(), expected);
    for line in rejected {
        assert!(["damaged", "wrong_shape"].contains(&&*line.code), "{line:?}");
    }
}

/// Sizes at which a computer's arithmetic gives way.
#[test]
fn sizes_beyond_memory_are_refused() {
    let version_2 = |length: u32| {
        let header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (4, 4), }";
        [b"\x93NUMPY\x02\x00", &length.to_le_bytes()[..], header, &[0; 64]].concat()
    };
    let lies = [
        npy_raw("'<f8'", false, "(2147483648, 2147483648)", &[0; 64]),
        npy_raw("'<f8'", false, "(4294967296, 4294967296)", &[]),
        npy_raw("'<f4'", false, "(0, 4611686018427387904)", &[]),
        npy_raw("'<f4'", true, "(9223372036854775808, 0)", &[]),
        npy_raw("'<f4'", false, "(0, 18446744073709551615, 18446744073709551615)", &[]),
        npy_raw("'<U1000000000'", false, "()", &[0; 64]),
        npy_raw("'<U18446744073709551615'", false, "(2,)", &[0; 64]),
        version_2(u32::MAX),
        version_2(u32::MAX - 11),
    ];
    let import = Import::new();
    for (number, lie) in lies.iter().enumerate() {
        let metadata = metadata(&SITE.ids[number], Window::Coarse);
        let path = import.map(&format!("bad.{number}.npz"));
        write_npz(&path, "path_gain", lie.clone(), &metadata);
    }
    limited(&import, 512).succeeds();
    let rejected = import.listed();
    assert_eq!(rejected.len(), lies.len());
    for line in rejected {
        assert_eq!(line.code, "damaged", "{line:?}");
    }
}

/// The end of an archive is in its last bytes and says how many members there are: memory for as
/// many is not taken on its word. The file is sparse: it takes no space.
#[test]
fn a_directory_that_declares_too_much_is_refused_without_allocating() {
    const DIRECTORY_AT: u64 = 1 << 29;
    const END_AT: u64 = 2 * DIRECTORY_AT;
    let members = ((END_AT - DIRECTORY_AT) / 46 - 1).to_le_bytes();
    let (record_bytes, no_disk) = (44_u64.to_le_bytes(), [0_u8; 8]);
    let directory = [DIRECTORY_AT.to_le_bytes(), DIRECTORY_AT.to_le_bytes()].concat();
    let wide = [
        // ZIP64 end of the directory, its locator, the end (APPNOTE.TXT, 4.3.14 to 4.3.16).
        [b"PK\x06\x06", &record_bytes[..], &[45, 0, 45, 0], &no_disk].concat(),
        [&members[..], &members, &directory].concat(),
        [b"PK\x06\x07", &[0; 4][..], &END_AT.to_le_bytes(), &[1, 0, 0, 0]].concat(),
        [b"PK\x05\x06", &[0; 4][..], &[0xff; 12], &[0; 2]].concat(),
    ];
    let import = Import::new();
    let path = import.map("bad.npz");
    write(&path, []);
    let mut file = fs::OpenOptions::new().write(true).open(&path).expect("opened");
    for (at, bytes) in [(DIRECTORY_AT, b"PK\x01\x02".to_vec()), (END_AT, wide.concat())] {
        file.seek(SeekFrom::Start(at)).expect("sought");
        file.write_all(&bytes).expect("written");
    }
    drop(file);
    limited(&import, 512).succeeds();
    let rejected = import.listed();
    assert_eq!(rejected[0].code, "damaged", "{rejected:?}");
    fs::remove_file(&path).expect("removed");
}

/// Two members over the same bytes unpack to more than the file's size allows for; a member that
/// is an archive itself is not looked into.
#[test]
fn overlapping_and_nested_archives_are_refused() {
    let text = |id: usize| npy_text(metadata(&SITE.ids[id], Window::Coarse).to_string().as_bytes());
    let sound =
        |id: usize| [("path_gain", f4(&good_values(&SITE.ids[0]))), ("meta_json", text(id))];
    let mut overlapping = npz(&sound(0), CompressionMethod::Stored);
    let header = overlapping.windows(4).rposition(|window| window == b"PK\x01\x02");
    let at = header.expect("the second one") + 42;
    overlapping[at..at + 4].copy_from_slice(&[0; 4]);
    let inner = npz(&sound(1), CompressionMethod::Deflated);
    let nested = [("path_gain", inner), ("meta_json", text(1))];
    let import = Import::new();
    write(&import.map("bad.nested.npz"), npz(&nested, CompressionMethod::Stored));
    write(&import.map("bad.overlapping.npz"), overlapping);
    limited(&import, 512).succeeds();
    let codes: Vec<_> = import.listed().into_iter().map(|line| line.code).collect();
    assert_eq!(codes, ["damaged", "damaged"]);
}

/// A large `.npy` is refused by its size on the disk (a sparse file: it takes no space).
#[test]
fn a_large_npy_is_refused_unread() {
    let import = Import::new();
    let path = import.map("bad.npy");
    write(&path, npy_raw("'<f4'", false, "(8192, 8192)", &[]));
    write(&import.map("bad.json"), metadata(&SITE.ids[0], Window::Coarse).to_string());
    let file = fs::OpenOptions::new().write(true).open(&path).expect("opened");
    file.set_len(128 + (4 << 26)).expect("a sparse file");
    limited(&import, 256).succeeds();
    let rejected = import.listed();
    assert_eq!(rejected[0].code, "too_large", "{rejected:?}");
    assert_says(&rejected[0].mend, &["crop", "limit"]);
}

/// A sound file for each of nine tiles, compressed and stored in turns.
fn sound_files() -> Vec<(&'static str, Vec<u8>)> {
    let tiles = SITE.ids[..9].iter().enumerate();
    tiles
        .map(|(number, tile)| {
            let values = f4(&good_values(tile));
            let method = if number % 2 == 0 {
                CompressionMethod::Deflated
            } else {
                CompressionMethod::Stored
            };
            let text = npy_text(metadata(tile, Window::Coarse).to_string().as_bytes());
            let members = [("path_gain", values), ("meta_json", text)];
            (tile.as_str(), npz(&members, method))
        })
        .collect()
}

/// RSRP of the sound files, by name of the imported map.
static SOUND: LazyLock<BTreeMap<String, Vec<u8>>> = LazyLock::new(|| {
    let import = Import::new();
    for (tile, bytes) in sound_files() {
        write(&import.map(&format!("{tile}.npz")), bytes);
    }
    assert_eq!(import.rejected(), []);
    let tiles = SITE.ids.iter().map(|tile| format!("{tile}.npz"));
    tiles.map(|file| (file.clone(), rsrp(&import, &file))).collect()
});

fn rsrp(import: &Import, file: &str) -> Vec<u8> {
    npz_members(&import.out().join(file)).remove("rsrp_dbm").expect("an imported map")
}

/// Imports nine files that were spoiled; whichever is taken must hold what the sound ones do.
fn import_spoiled(mut spoil: impl FnMut(Vec<u8>) -> Vec<u8>) -> usize {
    let import = Import::new();
    for (tile, bytes) in sound_files() {
        write(&import.map(&format!("{tile}.npz")), spoil(bytes));
    }
    let rejected = import.rejected();
    let manifest = read_json(&import.out().join("manifest.json"));
    for map in manifest["maps"].as_array().expect("a list") {
        let file = map["file"].as_str().expect("a name");
        assert_eq!(rsrp(&import, file), SOUND[file], "a value changed unnoticed");
    }
    rejected.len()
}

#[test]
fn truncated_files_are_refused() {
    let mut random = Random(3);
    for _ in 0..3 {
        let refused = import_spoiled(|mut bytes| {
            bytes.truncate(random.below(bytes.len()));
            bytes
        });
        assert_eq!(refused, 9);
    }
}

#[test]
fn random_bytes_are_refused() {
    let mut random = Random(4);
    let refused = import_spoiled(|bytes| {
        let keep = [0, 4, 30][random.below(3)];
        let noise = (keep..bytes.len()).map(|_| random.next() as u8);
        bytes[..keep].iter().copied().chain(noise).collect()
    });
    assert_eq!(refused, 9);
}

/// A flipped byte is refused, or was of no meaning: never taken for another value.
#[test]
fn flipped_bytes_never_change_a_value_or_end_the_run() {
    let mut random = Random(5);
    let mut refused = 0;
    for round in 0..23 {
        refused += import_spoiled(|mut bytes| {
            // Half of the flips hit the directory and the headers, which are few bytes.
            let at = match round % 4 {
                0 => random.below(120),
                1 => bytes.len() - 1 - random.below(260),
                _ => random.below(bytes.len()),
            };
            bytes[at] ^= 1 << random.below(8);
            bytes
        });
    }
    assert!(refused > 100, "{refused} of 207 refused");
}

/// Which of two members of one name is meant? Readers differ, so it is nobody's guess.
#[test]
fn an_archive_with_a_name_twice_is_refused() {
    let metadata = metadata(&SITE.ids[0], Window::Coarse);
    let text = npy_text(metadata.to_string().as_bytes());
    let other = f4(&(good_values(&SITE.ids[0]) / 2.0));
    let twice = |members: &[(&str, Vec<u8>)], from: &str, to: &str| {
        let import = Import::new();
        let bytes = npz(members, CompressionMethod::Stored);
        write(&import.map("bad.npz"), replaced(&bytes, from, to));
        let names = ZipArchive::new(Cursor::new(read(&import.map("bad.npz"))));
        names.expect("still an archive");
        let rejected = import.only_rejection();
        assert!(["damaged", "several_value_arrays"].contains(&&*rejected.code), "{rejected:?}");
    };
    let arrays = [
        ("path_gain", f4(&good_values(&SITE.ids[0]))),
        ("path_gaim", other),
        ("meta_json", text.clone()),
    ];
    twice(&arrays, "path_gaim", "path_gain");
    let texts = [
        ("path_gain", f4(&good_values(&SITE.ids[0]))),
        ("meta_json", text.clone()),
        ("meta_jsom", text),
    ];
    twice(&texts, "meta_jsom", "meta_json");
    // With a comment, the end of the archive is not in its last bytes.
    let import = Import::new();
    let mut commented = replaced(&npz(&texts, CompressionMethod::Stored), "meta_jsom", "meta_json");
    let length_at = commented.len() - 2;
    commented[length_at] = 4;
    commented.extend(b"note");
    write(&import.map("bad.npz"), commented);
    assert_eq!(import.only_rejection().code, "damaged");
}

/// What the tests above spoil is sound, else [`SOUND`] fails.
#[test]
fn sound_files_are_taken() {
    assert_eq!(SOUND.len(), 10);
}

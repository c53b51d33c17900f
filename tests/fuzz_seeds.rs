//! The seeds of fuzzing are sound files by other programs: all are read, so that fuzzing begins
//! inside the formats and not at their doors. `make fuzz-seeds` writes them.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::Path;

use holescout::config::Preset;
use holescout::dataset::Record;
use holescout::rsrp::{RadioMapMetadata, Supplement, load_archive};
use holescout::store::{NpzReader, SeekTable, read_npy};
use serde_json::json;

/// The seeds of a target with their names.
fn seeds(target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds").join(target);
    let files = fs::read_dir(folder).expect("a folder of seeds");
    let seeds: Vec<_> = files
        .map(|file| file.expect("listed").path())
        .map(|path| (path.display().to_string(), fs::read(&path).expect("read")))
        .collect();
    assert!(!seeds.is_empty(), "no seeds for {target}");
    seeds
}

#[test]
fn arrays_are_read() {
    for (name, bytes) in seeds("npy") {
        let npy = read_npy(&bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(npy.text().is_some(), name.contains("text"), "{name}");
    }
}

#[test]
fn archives_are_read() {
    for (name, bytes) in seeds("npz") {
        let mut archive = NpzReader::new(Cursor::new(bytes), 1 << 16)
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(archive.names().len(), if name.ends_with("empty") { 0 } else { 2 }, "{name}");
        for array in archive.names() {
            let member = archive.member(&array).unwrap_or_else(|error| panic!("{name}: {error}"));
            read_npy(&member).unwrap_or_else(|error| panic!("{name}: {array}: {error}"));
        }
    }
}

/// With metadata of their own, or by the preset that they are named after.
#[test]
fn maps_are_read() {
    let assume = [
        ("rx_height_m", json!(2)),
        ("map_size_m", json!(484)),
        ("tx_position_m", json!([0, 0, 20])),
        ("tx_power_dbm", json!(15)),
        ("tx_power_is", json!("per_re")),
        ("frequency_hz", json!(3.5e9)),
        ("tx_pattern", json!("iso")),
        ("sionna_version", json!("sionna-rt 2.2.0")),
        ("samples_per_tx", json!(1e7)),
        ("max_depth", json!(5)),
        ("refraction", json!(false)),
        ("diffraction", json!(true)),
    ];
    let mut assume: BTreeMap<_, _> =
        assume.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
    for (name, bytes) in seeds("map") {
        let preset = match name.rsplit_once('/') {
            Some((_, "sionna")) => Some(Preset::Sionna),
            Some((_, "large")) => Some(Preset::LargeRadioMaps),
            // Positions that are no numbers: found by reading, it once ended the program.
            Some((_, "text")) => Some(Preset::Geo2sigmap),
            _ => None,
        };
        if preset == Some(Preset::LargeRadioMaps) {
            assume.remove("tx_position_m"); // the archive tells it
        }
        let supplement = Supplement { preset, assume: preset.map(|_| &assume), scenes: None };
        let path = Path::new("utm10n_e590848_n4128256.npz");
        let (described, map) =
            load_archive(Cursor::new(bytes), path, 1 << 16, &supplement, Some(1))
                .unwrap_or_else(|rejection| panic!("{name}: {rejection}"));
        assert_eq!(map.values.dim(), (3, 3), "{name}");
        assert_eq!(described.assumed.is_empty(), preset.is_none(), "{name}");
        if preset == Some(Preset::LargeRadioMaps) {
            assert_eq!(map.tx_position_m, [9.0 - 242.0, 8.0 - 242.0, 7.0]);
            assume.insert("tx_position_m".to_owned(), json!([0, 0, 20]));
        }
    }
}

#[test]
fn metadata_are_read() {
    for (name, bytes) in seeds("metadata") {
        RadioMapMetadata::parse(&bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
    }
}

/// Found by fuzzing: `serde_json` took numbers of many digits for their neighbours, so that metadata
/// were others after they had been written and read again.
#[test]
fn numbers_of_many_digits_are_the_nearest() {
    for (name, bytes) in seeds("metadata") {
        let mut metadata: serde_json::Value = serde_json::from_slice(&bytes).expect("JSON");
        metadata["map_center_m"][0] = serde_json::Value::Null;
        for digits in ["1.8446744077419102e20", "24.605934392528546", "385792.10000000003"] {
            let text = metadata.to_string().replace("null", digits);
            let metadata = RadioMapMetadata::parse(text.as_bytes())
                .unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(Ok(metadata.map_center_m[0]), digits.parse::<f64>(), "{name}");
        }
    }
}

#[test]
fn records_are_read() {
    for (name, bytes) in seeds("record") {
        let record = Record::decode(&bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
        record.sound_grids(3).unwrap_or_else(|error| panic!("{name}: {error}"));
    }
}

#[test]
fn shards_are_read() {
    for (name, bytes) in seeds("seekable") {
        let mut file = Cursor::new(bytes);
        let table = SeekTable::read(&mut file).unwrap_or_else(|error| panic!("{name}: {error}"));
        for frame in 0..table.len() {
            table.frame(&mut file, frame).unwrap_or_else(|error| panic!("{name}: {error}"));
        }
    }
}

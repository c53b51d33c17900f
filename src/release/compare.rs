//! What differs between two records, two configurations, two lists of files.

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::Value;

use super::changes::{Change, FileChanges};
use crate::dataset::Record;

/// The field of a record that holds its data's origin and not its data.
pub(super) const PROVENANCE: &str = "provenance";

/// Names of the fields in which two records differ; the split is told apart.
pub(super) fn changed_fields(a: &Record, b: &Record) -> Vec<&'static str> {
    // By name, so that a new field does not compile until it is compared.
    let Record {
        schema,
        id,
        split: _,
        epsg,
        center_m,
        center_lon_lat,
        cell_m,
        row_order,
        height_m,
        rsrp_dbm,
        mask,
        repeats,
        std_error_db,
        first_half_share,
        floor_dbm,
        flight_height_m,
        base_station,
        radio,
        provenance,
    } = a;
    [
        ("schema", *schema != b.schema),
        ("id", *id != b.id),
        ("epsg", *epsg != b.epsg),
        ("center_m", *center_m != b.center_m),
        ("center_lon_lat", *center_lon_lat != b.center_lon_lat),
        ("cell_m", *cell_m != b.cell_m),
        ("row_order", *row_order != b.row_order),
        ("height_m", *height_m != b.height_m),
        ("rsrp_dbm", *rsrp_dbm != b.rsrp_dbm),
        ("mask", *mask != b.mask),
        ("repeats", *repeats != b.repeats),
        ("std_error_db", *std_error_db != b.std_error_db),
        ("first_half_share", *first_half_share != b.first_half_share),
        ("floor_dbm", *floor_dbm != b.floor_dbm),
        ("flight_height_m", *flight_height_m != b.flight_height_m),
        ("base_station", *base_station != b.base_station),
        ("radio", *radio != b.radio),
        (PROVENANCE, *provenance != b.provenance),
    ]
    .into_iter()
    .filter_map(|(field, differs)| differs.then_some(field))
    .collect()
}

/// Keys in which two values differ, with dots between those of nested tables; lists count whole.
pub(super) fn changed_keys(a: &impl Serialize, b: &impl Serialize) -> Vec<Change> {
    fn flat(value: &impl Serialize) -> BTreeMap<String, Value> {
        let mut keys = BTreeMap::new();
        let value = serde_json::to_value(value).expect("keys are strings");
        flatten(String::new(), value, &mut keys);
        keys
    }
    changes(flat(a), flat(b))
}

/// What differs between two tables.
pub(super) fn changes(a: BTreeMap<String, Value>, mut b: BTreeMap<String, Value>) -> Vec<Change> {
    let mut changes: Vec<Change> = Vec::new();
    for (key, old) in a {
        let new = b.remove(&key);
        if new.as_ref() != Some(&old) {
            changes.push(Change { key, old: Some(old), new });
        }
    }
    changes.extend(b.into_iter().map(|(key, new)| Change { key, old: None, new: Some(new) }));
    changes.sort_by(|a, b| a.key.cmp(&b.key));
    changes
}

fn flatten(key: String, value: Value, keys: &mut BTreeMap<String, Value>) {
    match value {
        Value::Object(table) => {
            for (name, value) in table {
                let key = if key.is_empty() { name } else { format!("{key}.{name}") };
                flatten(key, value, keys);
            }
        }
        value => {
            keys.insert(key, value);
        }
    }
}

/// Files by name and SHA-256 that are new, gone, or other ones.
pub(super) fn changed_files(
    a: &BTreeMap<String, String>,
    b: &BTreeMap<String, String>,
) -> FileChanges {
    let names = |files: &mut dyn Iterator<Item = &String>| files.cloned().collect::<Vec<_>>();
    FileChanges {
        added: names(&mut b.keys().filter(|name| !a.contains_key(*name))),
        removed: names(&mut a.keys().filter(|name| !b.contains_key(*name))),
        changed: names(&mut a.iter().filter_map(|(name, digest)| {
            b.get(name).is_some_and(|other| other != digest).then_some(name)
        })),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::example;
    use crate::units::Dbm;
    use serde_json::json;

    #[test]
    fn fields_that_differ_are_named_and_the_split_is_none() {
        let (record, _) = example();
        let mut other = record.clone();
        other.split = crate::config::Split::Val;
        assert_eq!(changed_fields(&record, &other), [""; 0]);
        other.mask[10] ^= 1;
        other.floor_dbm = Dbm(-150.0);
        other.provenance.tile_sha256.clear();
        assert_eq!(changed_fields(&record, &other), ["mask", "floor_dbm", PROVENANCE]);
    }

    #[test]
    fn nested_keys_are_told_with_dots() {
        let a = json!({ "grid": { "side_m": 1, "crop_m": 2 }, "list": [1, 2], "gone": true });
        let b = json!({ "grid": { "side_m": 1, "crop_m": 3 }, "list": [1], "new": { "x": 1 } });
        let change = |key: &str, old: Value, new: Value| {
            let some = |value: Value| (!value.is_null()).then_some(value);
            Change { key: key.to_owned(), old: some(old), new: some(new) }
        };
        let expected = [
            change("gone", json!(true), json!(null)),
            change("grid.crop_m", json!(2), json!(3)),
            change("list", json!([1, 2]), json!([1])),
            change("new.x", json!(null), json!(1)),
        ];
        assert_eq!(changed_keys(&a, &b), expected);
        assert_eq!(changed_keys(&a, &a), []);
    }

    #[test]
    fn files_are_new_gone_or_other_ones() {
        let files = |files: &[(&str, &str)]| {
            let owned = files.iter().map(|(name, sum)| ((*name).to_owned(), (*sum).to_owned()));
            owned.collect::<BTreeMap<_, _>>()
        };
        let a = files(&[("a", "1"), ("b", "1"), ("c", "1")]);
        let b = files(&[("b", "2"), ("c", "1"), ("d", "1")]);
        let FileChanges { added, removed, changed } = changed_files(&a, &b);
        assert_eq!(
            (added, removed, changed),
            (vec!["d".into()], vec!["a".into()], vec!["b".into()])
        );
    }
}

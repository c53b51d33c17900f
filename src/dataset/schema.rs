//! The JSON Schemas of records: one type in Rust, two schemas, since a reader of the first must not
//! meet a field that it does not know.

use serde_json::{Map, Value, json};

use super::record::Record;
use crate::manifest::json_schema_with;

/// Fields that only records with errors have.
const OF_ERRORS: [&str; 3] = ["repeats", "std_error_db", "first_half_share"];
/// Those of them that all records with errors have.
const REQUIRED: [&str; 2] = ["repeats", "std_error_db"];
/// Where the description of levels goes over to the other schema.
const OTHER: &str = " In `record.v2`";
const LEVELS: &str = "`.npy`, int16 `[n, n]`: RSRP in hundredths of dBm per resource element, -32768 for \
    the floor; levels below -327.67 dBm are raised to that. A building cell that is partly outdoors holds \
    the level there, a wholly covered one the floor.";

/// The schemas of records without and with errors, by name.
#[must_use]
pub fn record_schemas() -> [(&'static str, Vec<u8>); 2] {
    let of = |name: &'static str, change: fn(&mut Map<String, Value>)| {
        let schema = json_schema_with::<Record>(|schema| {
            let field = &mut schema["properties"]["schema"];
            field["description"] = json!(format!("Always `{name}`."));
            field["const"] = json!(name);
            change(schema);
        });
        (name, schema)
    };
    [of(Record::SCHEMA, without_errors), of(Record::SCHEMA_WITH_ERRORS, with_errors)]
}

fn without_errors(schema: &mut Map<String, Value>) {
    let properties = schema["properties"].as_object_mut().expect("a type with fields");
    properties.retain(|name, _| !OF_ERRORS.contains(&name.as_str()));
    let description = &mut properties["rsrp_dbm"]["description"];
    let text = description.as_str().unwrap_or_default();
    let of_v1 = text.split_once(OTHER).map_or(text, |(before, _)| before).to_owned();
    *description = json!(of_v1);
}

fn with_errors(schema: &mut Map<String, Value>) {
    let properties = schema["properties"].as_object_mut().expect("a type with fields");
    properties["rsrp_dbm"]["description"] = json!(LEVELS);
    for name in OF_ERRORS {
        let field = properties[name].as_object_mut().expect("a field");
        field.remove("default");
        let kind = field.get("type").and_then(|kinds| kinds.get(0)).cloned();
        field.insert("type".to_owned(), kind.expect("a type, or null"));
    }
    properties["repeats"]["minimum"] = json!(2);
    let required = schema["required"].as_array_mut().expect("required fields");
    required.extend(REQUIRED.map(|name| json!(name)));
}

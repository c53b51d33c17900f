//! `inspect` shows a dataset's figures, and a record as text, JSON or picture.

#![expect(clippy::float_cmp, reason = "values that must be exact are compared exactly")]

mod pipeline;

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use pipeline::{
    HELSINKI, assert_says, holescout, plant, read, read_json, run, temporary_dir, tree, write,
};

fn inspect() -> Command {
    let mut command = holescout("inspect");
    command.arg(&HELSINKI.dataset);
    command
}

fn manifest() -> Value {
    read_json(&HELSINKI.dataset.join("manifest.json"))
}

fn some_id() -> String {
    manifest()["records"][5]["id"].as_str().expect("a name").to_owned()
}

#[test]
fn the_summary_counts_records_and_holes() {
    let text = run(&mut inspect()).succeeds();
    assert_says(&text, &["15 records of 121 × 121 cells of 4 m", "2 shards"]);
    assert_says(&text, &["train: 8 records", "val: 7 records", "holes", "-100 dBm"]);
    assert_says(&text, &["9 records that overlap another split"]);
}

#[test]
fn the_summary_as_json_is_the_manifest() {
    let stdout = run(inspect().arg("--json")).succeeds();
    assert_eq!(stdout.lines().count(), 1);
    let summary: Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!(summary, manifest());
}

#[test]
fn a_record_is_told_in_words() {
    let text = run(inspect().args(["--id", &some_id()])).succeeds();
    assert_says(&text, &[&some_id(), "longitude 24.9", "latitude 60.1", "reached", "unreached"]);
    assert_says(&text, &["building", "holes", "15 dBm per resource element", "3.500 GHz"]);
    assert_says(&text, &["path_gain_db", "sionna-rt 2.2.0"]);
}

#[test]
fn a_record_as_json_has_its_arrays_as_lists() {
    let stdout = run(inspect().args(["--json", "--id", &some_id()])).succeeds();
    let record: Value = serde_json::from_str(stdout.trim_end()).expect("one line of JSON");
    assert_eq!(record["id"], some_id());
    for field in ["height_m", "rsrp_dbm", "mask"] {
        let rows = record[field].as_array().expect("rows");
        assert_eq!(rows.len(), 121, "{field}");
        for row in rows {
            let cells = row.as_array().expect("cells");
            assert!(cells.len() == 121 && cells.iter().all(Value::is_number), "{field}");
        }
    }
    for (mask, height) in cells(&record, "mask").zip(cells(&record, "height_m")) {
        assert_eq!(mask == 1.0, height >= 2.0, "a building is what blocks flight");
    }
}

fn cells<'a>(record: &'a Value, field: &str) -> impl Iterator<Item = f64> + use<'a> {
    let rows = record[field].as_array().expect("rows").iter();
    let cells = rows.flat_map(|row| row.as_array().expect("cells"));
    cells.map(|cell| cell.as_f64().expect("a number"))
}

/// Decodes a picture to width, height and RGB pixels.
fn picture(path: &Path) -> (usize, usize, Vec<u8>) {
    let decoder = png::Decoder::new(BufReader::new(File::open(path).expect("opened")));
    let mut reader = decoder.read_info().expect("a PNG");
    let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut pixels).expect("whole");
    assert_eq!(info.color_type, png::ColorType::Rgb);
    (info.width as usize, info.height as usize, pixels)
}

#[test]
fn a_record_as_picture_shows_three_panels() {
    let dir = temporary_dir();
    let path = dir.path().join("record.png");
    for scale in [1, 3] {
        let mut command = inspect();
        command.args(["--id", &some_id(), "--scale", &scale.to_string(), "--png"]);
        run(command.arg(&path)).succeeds();
        let (width, height, pixels) = picture(&path);
        let side = 121 * scale;
        assert!((3 * side..3 * side + 100).contains(&width), "width {width}");
        assert!((side..side + 120).contains(&height), "height {height}");
        let mut colors: Vec<&[u8]> = pixels.chunks(3).collect();
        colors.sort_unstable();
        colors.dedup();
        assert!(colors.len() > 50, "levels have colours: {}", colors.len());
    }
}

#[test]
fn the_threshold_decides_what_is_drawn_as_a_hole() {
    let dir = temporary_dir();
    let red = |threshold: &str| {
        let path = dir.path().join("record.png");
        let mut command = inspect();
        command.args(["--id", &some_id(), "--hole-threshold", threshold, "--png"]);
        run(command.arg(&path)).succeeds();
        let (_, _, pixels) = picture(&path);
        pixels.chunks(3).filter(|color| *color == [203, 24, 29]).count()
    };
    let counts = [red("-160"), red("-100"), red("-60")];
    assert!(counts.is_sorted() && counts[0] < counts[2], "{counts:?}");
}

#[test]
fn the_table_has_a_line_for_each_record() {
    let dir = temporary_dir();
    let path = dir.path().join("records.csv");
    run(inspect().arg("--csv").arg(&path)).succeeds();
    let text = read(&path);
    let mut table = csv::Reader::from_reader(&text[..]);
    let header: Vec<String> =
        table.headers().expect("a header").iter().map(str::to_owned).collect();
    assert_eq!(header[..4], ["id", "split", "lon", "lat"]);
    let rows: Vec<csv::StringRecord> = table.records().collect::<Result<_, _>>().expect("rows");
    assert_eq!(rows.len(), 15);
    let column = |name: &str| header.iter().position(|column| column == name).expect("a column");
    let sum = |split: &str, name: &str| -> u64 {
        let of_split = rows.iter().filter(|row| &row[column("split")] == split);
        of_split.map(|row| row[column(name)].parse::<u64>().expect("a count")).sum()
    };
    for split in ["train", "val"] {
        let cells = &manifest()["statistics"][split]["cells"];
        for name in ["reached", "unreached", "building"] {
            assert_eq!(json!(sum(split, name)), cells[name]);
        }
    }
}

#[test]
fn what_does_not_exist_is_named_with_what_does() {
    let message = run(inspect().args(["--id", "utm35n_e0_n0"])).refused();
    assert_says(&message, &["utm35n_e0_n0", "15", "for instance utm35n_e38"]);
    let message = run(inspect().args(["--id", "helsinki"])).refused();
    assert_says(&message, &["helsinki", "tile id", "for instance"]);
    let dir = temporary_dir();
    let message = run(inspect().arg("--png").arg(dir.path().join("a.png"))).refused();
    assert_says(&message, &["--png", "--id"]);
    let message = run(holescout("inspect").arg(dir.path())).refused();
    assert_says(&message, &["manifest.json", "holescout shard"]);
    let message = run(holescout("inspect").arg(&HELSINKI.tiles)).refused();
    assert_says(&message, &["tiles.v2", "dataset.v1"]);
}

#[test]
fn a_picture_that_cannot_be_written_is_a_failure_with_its_path() {
    let dir = temporary_dir();
    let path = dir.path().join("nowhere/a.png");
    let outcome = run(inspect().args(["--id", &some_id(), "--png"]).arg(&path));
    assert_ne!(outcome.code, Some(0));
    assert_says(&outcome.stderr, &["nowhere/a.png"]);
}

#[test]
fn a_damaged_shard_is_named() {
    let dir = temporary_dir();
    plant(dir.path(), &tree(&HELSINKI.dataset));
    let entry = &manifest()["records"][5];
    let shard = entry["shard"].as_str().expect("a name");
    let mut bytes = read(&dir.path().join(shard));
    // Every frame is hit.
    bytes.iter_mut().skip(100).step_by(1000).for_each(|byte| *byte ^= 1);
    write(&dir.path().join(shard), bytes);
    let mut command = holescout("inspect");
    let message = run(command.arg(dir.path()).args(["--id", &some_id()])).refused();
    assert_says(&message, &[shard]);
}

/// `holescout inspect | head -c 1`: the reader leaves, which is no failure.
#[test]
fn a_closed_pipe_is_no_failure() {
    for flags in [vec![], vec!["--json".to_owned(), "--id".to_owned(), some_id()]] {
        let (mut reader, writer) = std::io::pipe().expect("a pipe");
        let mut command = inspect();
        command.args(flags).stdout(writer).stderr(Stdio::piped());
        let child = command.spawn().expect("started");
        drop(command); // and with it our end for writing
        reader.read_exact(&mut [0]).expect("a byte");
        drop(reader);
        let outcome = child.wait_with_output().expect("ended");
        assert_eq!(outcome.status.code(), Some(0));
        assert_eq!(String::from_utf8_lossy(&outcome.stderr), "");
    }
}

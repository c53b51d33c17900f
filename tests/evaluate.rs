//! `holescout evaluate` on the fixtures: figures that follow from the rules of the task, the same
//! bytes at any number of threads, refusals that say what to do.
#![allow(clippy::panic, reason = "helpers of tests fail by panicking")]

mod pipeline;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use serde_json::Value;

use pipeline::repeats::{REPEATED, REPEATS};
use pipeline::{
    HELSINKI, assert_same_files, assert_says, copy_of, holescout, read, read_json, run, sha256,
    shared_dir, temporary_dir, tree, verify, write,
};

const FILES: [&str; 14] = [
    "NOTICE",
    "SHA256SUMS",
    "distance.csv",
    "distance.png",
    "distance.svg",
    "manifest.json",
    "maps.csv",
    "precision.png",
    "precision.svg",
    "recall.png",
    "recall.svg",
    "report.html",
    "report.json",
    "scores.csv",
];

/// `evaluate` of all fixtures.
fn evaluate(out: &Path, options: &[&str]) -> Command {
    let mut command = holescout("evaluate");
    command.arg("--dataset").arg(&HELSINKI.dataset).arg("--out").arg(out);
    command.args(["--split", "all"]).args(options);
    command
}

/// What makes it fast enough for a test.
const SMALL: [&str; 4] = ["--starts", "30", "--bootstrap", "200"];

/// The evaluation of all fixtures, run once.
static EVALUATION: LazyLock<PathBuf> = LazyLock::new(|| {
    let out = shared_dir("evaluation").join("out");
    run(&mut evaluate(&out, &SMALL)).succeeds();
    out
});

fn report(out: &Path) -> Value {
    read_json(&out.join("report.json"))
}

/// Means by method, k and starts.
type Means = BTreeMap<(String, u64, u64), f64>;

fn means(report: &Value, measure: &str) -> Means {
    let scores = report["scores"].as_array().expect("scores");
    let key = |score: &Value| {
        let number = |name: &str| score[name].as_u64().expect("a number");
        (score["method"].as_str().expect("a name").to_owned(), number("k"), number("starts"))
    };
    let scores = scores.iter().filter(|score| !score[measure].is_null());
    scores.map(|score| (key(score), score[measure]["mean"].as_f64().expect("a mean"))).collect()
}

#[test]
fn an_evaluation_is_whole_and_verifies() {
    let names: Vec<String> = tree(&EVALUATION).into_keys().collect();
    assert_eq!(names, FILES);
    assert_says(&run(&mut verify(&EVALUATION)).succeeds(), &["sound", "13 files"]);
    let (_dir, copy, _) = copy_of(&EVALUATION);
    write(&copy.join("scores.csv"), "method\n");
    assert_says(&run(&mut verify(&copy)).refused(), &["scores.csv", "SHA-256"]);
}

/// Checksums made anew do not hide that tables, report and manifest contradict each other.
#[test]
fn an_evaluation_that_contradicts_itself_does_not_verify() {
    for (file, from, to, says) in [
        ("scores.csv", "oracle", "agent", "scores.csv: its figures are not those of report.json"),
        ("report.json", "\"split\": \"", "\"split\": \"no", "report.json: split differs"),
        ("report.json", "\"bootstrap\"", "\"bootsprat\"", "report.json: "),
    ] {
        let (_dir, copy, files) = copy_of(&EVALUATION);
        let text = String::from_utf8(files[file].clone()).expect("text");
        assert!(text.contains(from), "{file} has {from}");
        let sums = String::from_utf8(files["SHA256SUMS"].clone()).expect("text");
        write(&copy.join(file), text.replacen(from, to, 1));
        let sums = sums.replace(&sha256(&files[file]), &sha256(&read(&copy.join(file))));
        write(&copy.join("SHA256SUMS"), sums);
        assert_says(&run(&mut verify(&copy)).refused(), &[says]);
    }
}

#[test]
fn figures_follow_the_rules_of_the_task() {
    let report = report(&EVALUATION);
    let starts = 30;
    for measure in ["precision", "recall", "recall_with_indoor"] {
        let means = means(&report, measure);
        assert!(means.len() > 100, "{}", means.len());
        for ((method, k, n), &mean) in &means {
            assert!((0.0..=1.0).contains(&mean), "{measure} of {method}");
            if measure != "precision" {
                for ((other, other_k, fewer), &less) in &means {
                    let same = (other, other_k) == (method, k);
                    assert!(!same || fewer > n || less <= mean, "{measure} of {method} from {n}");
                }
            }
        }
    }
    let precision = means(&report, "precision");
    let at = |method: &str, k| precision[&(method.to_owned(), k, starts)];
    let moving = ["g-rsp", "g-rsp-continuous", "shadow", "random-walk", "wall-walk", "oracle"];
    for method in moving.into_iter().chain(["trees", "belief", "trees-told-bs", "leave-one-out"]) {
        assert_eq!(at(method, 0), at("rsp", 0), "the same starts");
        for (k, more) in [(0, 1), (1, 2), (2, 4), (4, 8)] {
            assert!(at(method, k) <= at(method, more), "{method}: who found a hole stays there");
            assert!(at(method, k) <= at("oracle", k), "{method} beats the oracle at k = {k}");
        }
    }
    assert!(at("oracle", 1) > at("rsp", 0), "an oracle that does not move");
    assert_eq!(at("g-bnp-8", 0), at("bnp-8", 0));
}

#[test]
fn intervals_hold_their_means_and_flights_add_up() {
    let report = report(&EVALUATION);
    let mut intervals = 0;
    let mut pending = vec![&report];
    while let Some(value) = pending.pop() {
        if let (Some(mean), Some(low), Some(high)) =
            (value["mean"].as_f64(), value["low"].as_f64(), value["high"].as_f64())
        {
            assert!(low <= mean && mean <= high, "{value}");
            intervals += 1;
        }
        match value {
            Value::Array(values) => pending.extend(values),
            Value::Object(values) => pending.extend(values.values()),
            _ => {}
        }
    }
    assert!(intervals > 1000, "{intervals}");

    let maps = report["maps"]["evaluated"].as_u64().expect("a number");
    for flights in report["flights"].as_array().expect("flights") {
        let found = flights["found_after"].as_array().expect("counts").iter();
        let found: u64 = found.map(|count| count.as_u64().expect("a count")).sum();
        let not_found = flights["not_found"].as_u64().expect("a count");
        assert_eq!(found + not_found, maps * 30, "{flights}");
    }
    let difficulty = &report["difficulty"];
    let by_hops = difficulty["cells_by_hops"].as_array().expect("counts").iter();
    let reached: u64 = by_hops.map(|count| count.as_u64().expect("a count")).sum();
    let cells = reached + difficulty["unreachable"].as_u64().expect("a count");
    assert_eq!(Some(cells), report["maps"]["outdoor_cells"].as_u64());
    assert_eq!(difficulty["cells_by_hops"][0], report["maps"]["hole_cells"]);
}

#[test]
fn threads_do_not_matter() {
    for threads in ["1", "2", "8"] {
        let dir = temporary_dir();
        let out = dir.path().join("out");
        run(evaluate(&out, &SMALL).args(["--threads", threads])).succeeds();
        assert_same_files(&tree(&out), &tree(&EVALUATION));
    }
}

#[test]
fn seeds_noise_and_stale_maps_matter_where_they_should() {
    let dir = temporary_dir();
    let precision = |options: &[&str]| {
        let out = dir.path().join("out");
        let methods = ["--overwrite", "--methods", "rsp,wall-walk,g-rsp,oracle"];
        run(evaluate(&out, &SMALL).args(methods).args(options)).succeeds();
        let precision = means(&report(&out), "precision");
        move |method: &str| precision[&(method.to_owned(), if method == "rsp" { 0 } else { 4 }, 30)]
    };
    let plain = precision(&[]);
    let seeded = precision(&["--seed", "1"]);
    assert_ne!(plain("rsp"), seeded("rsp"));
    // The oracle and the starts know the truth; the others measure with an error of 20 dB.
    let noisy = precision(&["--noise", "20"]);
    assert_eq!((noisy("rsp"), noisy("oracle")), (plain("rsp"), plain("oracle")));
    assert!(noisy("g-rsp") < plain("g-rsp"), "false alarms end flights early");
    // Without any stored building there are no walls to walk along.
    let stale = precision(&["--stale", "1"]);
    assert_eq!((stale("rsp"), stale("oracle")), (plain("rsp"), plain("oracle")));
    assert_ne!(stale("wall-walk"), plain("wall-walk"));
}

/// What learns is fitted on the train split, so there it finds more than a walk does, whatever there is on others.
#[test]
fn what_learns_from_the_train_split_has_learned() {
    let dir = temporary_dir();
    let out = dir.path().join("out");
    let methods = "wall-walk,trees,belief,trees-told-bs,leave-one-out";
    let mut command = holescout("evaluate");
    command.arg("--dataset").arg(&HELSINKI.dataset).arg("--out").arg(&out);
    command.args(["--split", "train", "--starts", "100", "--methods", methods]);
    run(&mut command).succeeds();
    let precision = means(&report(&out), "precision");
    let at = |method: &str| precision[&(method.to_owned(), 2, 100)];
    for method in ["trees", "belief", "trees-told-bs", "leave-one-out"] {
        assert!(at(method) > at("wall-walk"), "{method}: {}", at(method));
    }
}

/// Who asked for what learns gets an error, who did not a note.
#[test]
fn without_anything_to_learn_from_what_learns_is_left_out_and_said_so() {
    let dir = temporary_dir();
    let out = dir.path().join("out");
    // Nothing is weak enough to be a hole.
    let threshold = ["--threshold", "-290"];
    let floor = dir.path().join("floor.toml");
    write(&floor, "[rl]\nfloor_dbm = -400.0\n");
    let all = |options: &[&str]| {
        run(evaluate(&out, options).args(SMALL).args(threshold).arg("--config").arg(&floor))
    };
    let methods = "rsp,trees,oracle,belief,trees-told-bs,leave-one-out";
    let refused = all(&["--methods", methods]).refused();
    assert_says(&refused, &["trees, belief, trees-told-bs, leave-one-out", "train split"]);
    let (_, mend) = refused.split_once("--methods ").expect("a mend");
    assert_eq!(mend.trim(), "rsp,oracle");
    assert!(!out.exists(), "nothing is left");
    all(&["--methods", mend.trim()]).succeeds();
    let note = run(evaluate(&out, &["--overwrite"])
        .args(SMALL)
        .args(threshold)
        .arg("--config")
        .arg(&floor));
    assert_says(&note.stderr, &["note: trees, belief, trees-told-bs, leave-one-out are left out"]);
    note.succeeds();
    let report = read(&out.join("report.json"));
    assert!(!String::from_utf8_lossy(&report).contains("\"trees\""));
}

#[test]
fn the_page_needs_no_network_and_names_the_licence() {
    let page = String::from_utf8(read(&EVALUATION.join("report.html"))).expect("UTF-8");
    for foreign in ["src=\"http", "href=\"http", "@import", "url(http", "fetch(", "{{"] {
        assert!(!page.contains(foreign), "{foreign}");
    }
    assert_says(&page, &["OpenStreetMap", "ODbL"]);
    let notice = String::from_utf8(read(&EVALUATION.join("NOTICE"))).expect("UTF-8");
    assert_says(&notice, &["OpenStreetMap", "ODbL"]);
}

#[test]
fn what_cannot_be_evaluated_is_refused_with_the_mend() {
    let dir = temporary_dir();
    let out = dir.path().join("out");
    let mut test_split = holescout("evaluate");
    test_split.arg("--dataset").arg(&HELSINKI.dataset).arg("--out").arg(&out);
    assert_says(&run(&mut test_split).refused(), &["test", "no records", "train, val"]);
    assert!(!out.exists(), "nothing is left");

    let mut tiles = holescout("evaluate");
    tiles.arg("--dataset").arg(&HELSINKI.tiles).arg("--out").arg(&out);
    assert_says(&run(&mut tiles).refused(), &["tiles.v2", "holescout shard"]);

    let unknown = run(&mut evaluate(&out, &["--methods", "rsp,psr"]));
    assert_eq!(unknown.code, Some(2), "{unknown:?}");
    assert_says(&unknown.stderr, &["psr", "random-walk"]);

    for (flag, value, key) in [
        ("--steps", "2,1", "evaluate.steps"),
        ("--stale", "1.5", "evaluate.stale_share"),
        ("--starts", "0", "evaluate.starts"),
        ("--reach", "40", "rl.reach_cells"),
        ("--threshold", "5", "rl.hole_threshold_dbm"),
        ("--methods", "rsp,rsp", "evaluate.methods"),
    ] {
        let refused = run(&mut evaluate(&out, &[flag, value])).refused();
        assert_says(&refused, &[key, "expected"]);
    }

    let agent = run(&mut evaluate(&out, &["--methods", "rsp,agent"])).refused();
    assert_says(&agent, &["agent", "--policy"]);
    let missing = run(&mut evaluate(&out, &["--policy", "nowhere"])).refused();
    assert_says(&missing, &["nowhere"]);

    let occupied = run(&mut evaluate(&EVALUATION, &["--seed", "9"])).refused();
    assert_says(&occupied, &["--overwrite"]);
}

// Holes by distance and density, how sure they are -------------------------------------------

#[test]
fn holes_are_counted_by_distance_and_density() {
    let report = report(&EVALUATION);
    let bins = report["distances"].as_array().expect("classes");
    let sum = |key: &str| bins.iter().map(|bin| bin[key].as_u64().expect("a count")).sum::<u64>();
    assert_eq!(Some(sum("cells")), report["maps"]["outdoor_cells"].as_u64());
    assert_eq!(Some(sum("holes")), report["maps"]["hole_cells"].as_u64());
    for bin in bins.iter().filter(|bin| bin["cells"] != 0) {
        let share =
            bin["holes"].as_f64().expect("a count") / bin["cells"].as_f64().expect("a count");
        assert!((bin["hole_share"]["mean"].as_f64().expect("a mean") - share).abs() < 1e-12);
    }
    let table = String::from_utf8(read(&EVALUATION.join("distance.csv"))).expect("text");
    assert_eq!(table.lines().count(), bins.len() + 1);
    assert_says(&table, &["from_m,to_m,cells,holes,hole_share,hole_share_low,hole_share_high\n"]);

    let groups = report["groups"].as_array().expect("groups");
    for kind in ["hole_share", "built_share", "height", "footprint", "region"] {
        let of_kind = groups.iter().filter(|group| group["kind"] == kind);
        let maps: u64 = of_kind.map(|group| group["maps"].as_u64().expect("a count")).sum();
        assert_eq!(Some(maps), report["maps"]["evaluated"].as_u64(), "{kind}");
    }
}

#[test]
fn without_errors_the_reliability_is_unknown() {
    let report = report(&EVALUATION);
    assert_eq!(report["labels"], Value::Null);
    assert!(report["scores"][0].get("expected_precision").is_none());
    let header = String::from_utf8(read(&EVALUATION.join("scores.csv"))).expect("text");
    assert!(!header.contains("expected"));
    let dir = temporary_dir();
    let said =
        run(&mut evaluate(&dir.path().join("out"), &["--starts", "5", "--bootstrap", "100"]));
    assert_says(&said.succeeds(), &["how sure the holes are is unknown"]);
}

/// The evaluation of maps with repeats, run once.
static OF_REPEATS: LazyLock<PathBuf> = LazyLock::new(|| {
    let out = shared_dir("evaluation-of-repeats").join("out");
    let mut command = holescout("evaluate");
    command.arg("--dataset").arg(&REPEATED.dataset).arg("--out").arg(&out);
    run(command.args(["--split", "all"]).args(SMALL)).succeeds();
    out
});

#[test]
fn flights_are_judged_by_the_chance_of_a_hole() {
    let report = report(&OF_REPEATS);
    let labels = &report["labels"];
    assert_eq!(
        (&labels["maps"], &labels["repeats"]),
        (&report["maps"]["evaluated"], &Value::from([REPEATS; 2]))
    );
    assert_eq!(labels["outdoor_cells"], report["maps"]["outdoor_cells"]);
    let [plain, expected, sure_holes, sure] =
        ["precision", "expected_precision", "sure_holes", "sure"]
            .map(|measure| means(&report, measure));
    assert_eq!(plain.len(), expected.len());
    for (key, expected) in &expected {
        // A sure hole counts for 0.95 at least, a cell that is surely none for 0.05 at most.
        assert!(*expected >= 0.95 * sure_holes[key] - 1e-9, "{key:?}");
        assert!(*expected <= 1.0 - 0.95 * (sure[key] - sure_holes[key]) + 1e-9, "{key:?}");
        assert!(sure_holes[key] <= sure[key] && sure_holes[key] <= plain[key] + 1e-9, "{key:?}");
    }
    // Random cells are as sure as cells are.
    let share = |cells: &str| {
        labels[cells].as_f64().expect("a count") / labels["outdoor_cells"].as_f64().expect("cells")
    };
    let random = ("rsp".to_owned(), 0, 30);
    assert!((sure[&random] - (1.0 - share("unsure"))).abs() < 0.1);
    assert!((sure_holes[&random] - share("sure_holes")).abs() < 0.1);
    let mean = labels["expected_hole_share"]["mean"].as_f64().expect("a mean");
    assert!((expected[&random] - mean).abs() < 0.1);
}

#[test]
fn the_label_ceiling_rises_with_steps_and_stays_below_one_at_the_start() {
    let report = report(&OF_REPEATS);
    let ceiling = report["labels"]["ceiling"].as_array().expect("steps");
    let steps: Vec<u64> = ceiling.iter().map(|at| at["k"].as_u64().expect("a number")).collect();
    assert_eq!(steps, [0, 1, 2, 4, 8]);
    let of = |measure: &str| -> Vec<f64> {
        ceiling.iter().map(|at| at[measure]["mean"].as_f64().expect("a mean")).collect()
    };
    let (precision, expected) = (of("precision"), of("expected_precision"));
    assert!(precision[1] > precision[0] && expected[1] > expected[0], "{precision:?}");
    assert!(precision.iter().chain(&expected).all(|share| (0.0..=1.0).contains(share)));
    let plain = means(&report, "precision");
    assert!(precision[0] < 2.0 * plain[&("rsp".to_owned(), 0, 30)] + 0.1);
}

#[test]
fn reports_of_errors_do_not_depend_on_threads_and_show_them() {
    for threads in ["1", "8"] {
        let dir = temporary_dir();
        let out = dir.path().join("out");
        let mut command = holescout("evaluate");
        command.arg("--dataset").arg(&REPEATED.dataset).arg("--out").arg(&out);
        let said =
            run(command.args(["--split", "all", "--threads", threads]).args(SMALL)).succeeds();
        assert_says(
            &said,
            &["expected precision", "Label ceiling", "maps tell errors", "are unsure"],
        );
        assert_same_files(&tree(&out), &tree(&OF_REPEATS));
    }
    let table = |name: &str| String::from_utf8(read(&OF_REPEATS.join(name))).expect("text");
    assert_says(&table("scores.csv"), &[",expected_precision,", ",sure_high\n"]);
    assert_says(&table("maps.csv"), &["precision,recall,expected_precision,sure_holes,sure\n"]);
    assert_says(&table("distance.csv"), &["expected_high\n"]);
    assert_says(&table("distance.svg"), &["chance of a hole"]);
}

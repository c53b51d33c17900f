//! `holescout train`: it learns, and a killed run ends in the same weights as one that was left alone.
#![cfg(feature = "torch")]

mod pipeline;

use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use holescout::config::{Config, EvaluateConfig, Precision, Split, TrainConfig};
use holescout::dataset::{Dataset, Grids};
use holescout::evaluate::precision;
use holescout::rl::agent::{Agent, Trainer, TrainerSetup};
use holescout::rl::policy::{MakePolicy, Policy, RandomWalk};
use holescout::rl::{MapSource, World};
use ndarray::Array2;
use serde_json::Value;
use tch::Device;

use pipeline::training::{SMALL, evaluate, train, train_on, trained};
use pipeline::{
    HELSINKI, Random, assert_says, holescout, read, read_json, run, sha256, shard, temporary_dir,
    write,
};

fn weights(run: &Path) -> String {
    sha256(&read(&run.join("checkpoints/000000024/weights.safetensors")))
}

/// What neither preset uses, over maps that come and go.
const ALL: &str = "
n_step = 3
tau = 0.05
priority_alpha = 0.6
dueling = true
encoding = 'paper'
factored = false
reward_prediction = 1.0
dense_terminal = true
avoid_visited = false
anneal_learning_rate = false
map_memory_mb = 1
block = 1
refresh_every = 2
";

/// The log without what is never the same twice.
fn log(run: &Path) -> Vec<Value> {
    let text = String::from_utf8(read(&run.join("log.jsonl"))).expect("text");
    let lines = text.lines().map(|line| serde_json::from_str(line).expect("JSON"));
    let timeless = |mut line: Value| {
        let pace = ["samples_per_s", "waiting"].map(|key| line.as_object_mut()?.remove(key));
        assert_eq!(pace[0].is_some(), line["loss"].is_number(), "{line}");
        line
    };
    lines.map(timeless).collect()
}

#[test]
fn killed_runs_end_in_the_same_weights_and_log() {
    for (seed, options) in [(7, ""), (8, ALL)] {
        let dir = temporary_dir();
        let config = dir.path().join("small.toml");
        write(&config, [SMALL, options].concat());
        let (whole, killed) = (dir.path().join("whole"), dir.path().join("killed"));
        let ended = run(&mut train(&whole, &config, &[]));
        assert_eq!(ended.stderr.contains("others come and go"), !options.is_empty(), "{ended:?}");
        let again = dir.path().join("again");
        run(&mut train(&again, &config, &[])).succeeds();
        assert_eq!(weights(&again), weights(&whole), "the same seed twice");
        let kills = kill_until_done(&mut Random(seed), &killed, || train(&killed, &config, &[]));
        assert!(kills >= 5, "killed {kills} times only");
        for file in ["weights.safetensors", "learning.safetensors", "state.msgpack"] {
            let last = |run: &Path| read(&run.join("checkpoints/000000024").join(file));
            assert!(last(&killed) == last(&whole), "{file}");
        }
        assert_eq!(log(&killed), log(&whole));
        for directory in [&killed, &killed.join("checkpoints")] {
            let names = std::fs::read_dir(directory).expect("listed").flatten();
            let names = names.map(|entry| entry.file_name().to_string_lossy().into_owned());
            let mut left = names.filter(|name| name.starts_with(".holescout-tmp"));
            assert_eq!(left.next(), None, "nothing half-written is left");
        }
        assert_eq!(
            read(&killed.join("best/weights.safetensors")),
            read(&whole.join("best/weights.safetensors"))
        );
        // A finished run has nothing left to do.
        let done = run(&mut train(&killed, &config, &[])).succeeds();
        assert_says(&done, &["24 updates, done"]);
    }
}

/// Kills a run at random moments, each soon after it has written a checkpoint, until one ends by
/// itself; returns how many were killed.
fn kill_until_done(random: &mut Random, out: &Path, command: impl Fn() -> Command) -> u32 {
    let newest = || {
        let entries = std::fs::read_dir(out.join("checkpoints")).into_iter().flatten().flatten();
        let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
        names.filter(|name| !name.starts_with('.')).max()
    };
    for kills in 0.. {
        let before = newest();
        let mut child = command();
        let mut child = child.stderr(Stdio::null()).stdout(Stdio::null()).spawn().expect("started");
        while newest() == before && child.try_wait().expect("a child").is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(Duration::from_millis(random.below(60) as u64));
        child.kill().expect("killed");
        if child.wait().expect("gone").success() {
            return kills;
        }
    }
    unreachable!("every start comes closer to the end")
}

#[test]
fn a_terminated_run_saves_first() {
    let dir = temporary_dir();
    let config = dir.path().join("small.toml");
    write(&config, SMALL);
    let out = dir.path().join("run");
    let options = ["--updates", "100000", "--checkpoint-every", "100000", "--json"];
    let mut child = train(&out, &config, &options);
    let child = child.stdout(Stdio::piped()).spawn().expect("started");
    // The first judgement was made: training is under way, and no checkpoint is due.
    while !out.join("best").exists() {
        std::thread::sleep(Duration::from_millis(1));
    }
    let terminated = Command::new("kill").arg(child.id().to_string()).status();
    assert!(terminated.expect("sent").success());
    let ended = child.wait_with_output().expect("gone");
    assert!(ended.status.success(), "{ended:?}");
    let summary: Value = serde_json::from_slice(&ended.stdout).expect("JSON");
    assert_eq!(summary["complete"], false);
    let updates = summary["updates"].as_u64().expect("a number");
    assert!((12..100_000).contains(&updates), "{summary}");
    assert!(out.join(format!("checkpoints/{updates:09}/state.msgpack")).exists());
}

#[test]
fn training_stops_early_when_scores_no_longer_rise() {
    let dir = temporary_dir();
    let config = dir.path().join("small.toml");
    write(&config, [SMALL, "patience = 1\n"].concat());
    let out = dir.path().join("run");
    let train = || train(&out, &config, &["--evaluate-every", "1", "--json"]);
    let ended = run(&mut train()).succeeds();
    let summary: Value = serde_json::from_str(&ended).expect("JSON");
    let updates = summary["updates"].as_u64().expect("a number");
    assert!(updates < 24 && summary["complete"] == true, "{summary}");
    let best = summary["best"][1].as_u64().expect("an update");
    assert_eq!(updates, best + 1);
    let again = run(&mut train()).succeeds();
    assert_eq!(serde_json::from_str::<Value>(&again).expect("JSON"), summary);
}

#[test]
fn an_exported_policy_is_what_was_trained() {
    let dir = temporary_dir();
    let config = dir.path().join("small.toml");
    write(&config, SMALL);
    let (run_dir, out) = (dir.path().join("run"), dir.path().join("policy"));
    run(&mut train(&run_dir, &config, &["--updates", "12"])).succeeds();
    let best = run_dir.join("best");
    let export = |out: &Path| {
        let mut command = holescout("export-policy");
        command.arg(&best).arg("--out").arg(out);
        run(&mut command).succeeds()
    };
    export(&out);
    assert_eq!(read(&out.join("weights.safetensors")), read(&best.join("weights.safetensors")));
    let manifest = read_json(&out.join("manifest.json"));
    assert_eq!(manifest["updates"], 12);
    let schema = Path::new(env!("CARGO_MANIFEST_DIR")).join("schemas/policy.v4.json");
    let schema = jsonschema::validator_for(&read_json(&schema)).expect("a schema");
    assert!(schema.is_valid(&manifest), "{manifest}");
    assert!(manifest["score"].is_number(), "the best checkpoint was judged");
    assert_eq!(manifest["train"]["widths"], Value::from(vec![4; 7]));
    let card = String::from_utf8(read(&out.join("README.md"))).expect("text");
    assert!(!card.contains("{{"), "{card}");
    let again = dir.path().join("again");
    export(&again);
    for file in ["README.md", "SHA256SUMS", "manifest.json"] {
        assert_eq!(read(&out.join(file)), read(&again.join(file)), "{file}");
    }
    let evaluation = |policy: &Path| {
        let to = dir.path().join(policy.file_name().expect("a name")).with_extension("report");
        let mut command = evaluate(&HELSINKI.dataset, policy, &to);
        command.args(["--starts", "3", "--methods", "rsp", "--device", "cpu"]);
        run(&mut command).succeeds();
        read(&to.join("report.json"))
    };
    assert_eq!(evaluation(&out), evaluation(&best));
    // Nor does it fly with states that it has never seen.
    let scaled = dir.path().join("scaled.toml");
    write(&scaled, "[rl]\nheight_scale_m = 25.0");
    let none = dir.path().join("none");
    let mut command = evaluate(&HELSINKI.dataset, &out, &none);
    command.arg("--config").arg(&scaled);
    assert_says(&run(&mut command).refused(), &["rl.height_scale_m", "25 here, 50 there"]);
    // Other weights under the same manifest are found out.
    write(&again.join("weights.safetensors"), b"other");
    let mut command = evaluate(&HELSINKI.dataset, &again, &none);
    assert_says(&run(&mut command).refused(), &["weights.safetensors", "manifest"]);
}

#[test]
fn a_run_of_another_configuration_or_dataset_is_refused_with_the_difference() {
    let (_dir, config, out) = trained(2);
    let refused = run(&mut train(&out, &config, &["--updates", "2", "--seed", "1"])).refused();
    assert_says(&refused, &["train.seed", "1 here, 0 there"]);
    // What is only watched may change.
    run(&mut train(&out, &config, &["--updates", "2", "--evaluate-every", "1"])).succeeds();
}

#[test]
fn a_trained_policy_is_evaluated_beside_the_others() {
    let dir = temporary_dir();
    let config = dir.path().join("small.toml");
    write(&config, SMALL);
    let (run_dir, out) = (dir.path().join("run"), dir.path().join("evaluation"));
    run(&mut train(&run_dir, &config, &[])).succeeds();
    let mut command = evaluate(&HELSINKI.dataset, &run_dir.join("best"), &out);
    command.args(["--starts", "5", "--methods", "rsp,oracle"]);
    assert_says(&run(&mut command).succeeds(), &["Agent"]);
    let report = read_json(&out.join("report.json"));
    let digest = sha256(&read(&run_dir.join("best/weights.safetensors")));
    assert_eq!(report["policy_sha256"], digest);
    let at = |method: &str, k: u64| {
        let mut scores = report["scores"].as_array().expect("scores").iter();
        let score = scores.find(|s| s["method"] == method && s["k"] == k && s["starts"] == 5);
        score.expect("a score")["precision"]["mean"].as_f64().expect("a mean")
    };
    assert_eq!(at("agent", 0), at("rsp", 0), "the same starts");
    assert!(at("agent", 4) <= at("oracle", 4));
}

/// Cells of 11 m instead of 4 m, 44 × 44 of them, and six cells a step: trained on and flown over; the policy
/// flies over larger maps too. The paper's network cannot.
#[test]
fn maps_and_reaches_of_other_sizes_train_and_evaluate() {
    let dir = temporary_dir();
    let (coarse, config) = (dir.path().join("coarse"), dir.path().join("reach.toml"));
    run(shard(&HELSINKI.tiles, &HELSINKI.rsrp, &coarse).args(["--downsample", "11"])).succeeds();
    let flown = |policy: &Path, dataset: &Path, config: &Path| {
        let out = dir.path().join("evaluation");
        let mut command = evaluate(dataset, &policy.join("best"), &out);
        command.arg("--config").arg(config).arg("--overwrite");
        run(command.args(["--starts", "5", "--methods", "rsp,trees,agent"]))
    };
    write(&config, format!("[rl]\nreach_cells = 6\n{SMALL}"));
    let of_coarse = dir.path().join("of_coarse");
    run(&mut train_on(&coarse, &of_coarse, &config, &[])).succeeds();
    for dataset in [&coarse, &HELSINKI.dataset] {
        let flown = flown(&of_coarse, dataset, &config);
        // It is said that these are not the maps that it knows.
        let note = "44 × 44 cells of 11 m, and flies over 121 × 121 cells of 4 m";
        assert_eq!(flown.stderr.contains(note), *dataset == HELSINKI.dataset, "{flown:?}");
        assert_says(&flown.succeeds(), &["Agent", "Predictor"]);
    }

    let paper = dir.path().join("paper.toml");
    let settings = ["encoding = 'paper'", "hole_prediction = 0.0", ""];
    write(&paper, format!("{SMALL}{}", settings.join("\n")));
    let of_paper = dir.path().join("of_paper");
    run(&mut train(&of_paper, &paper, &["--updates", "2"])).succeeds();
    let refused = flown(&of_paper, &coarse, &paper).refused();
    assert_says(&refused, &["44 × 44", "31 × 31", "rl.reach_cells", "train.encoding"]);
}

/// What an older version wrote is told from what is damaged: it has no checksums.
#[test]
fn checkpoints_of_an_older_version_are_refused_with_the_way_on() {
    let (dir, config, out) = trained(2);
    for checkpoint in ["checkpoints/000000002", "best"] {
        let state = out.join(checkpoint).join("state.msgpack");
        let mut bytes = read(&state);
        let version = b"checkpoint.v5";
        let at = bytes.windows(version.len()).position(|window| window == version);
        let last = at.expect("the schema is told") + version.len() - 1;
        bytes[last] = b'1';
        write(&state, bytes);
        std::fs::remove_file(out.join(checkpoint).join("SHA256SUMS")).expect("it was there");
    }
    let way_on = ["checkpoint.v1", "checkpoint.v5", "another directory"];
    assert_says(&run(&mut train(&out, &config, &["--updates", "2"])).refused(), &way_on);
    let mut command = evaluate(&HELSINKI.dataset, &out.join("best"), &dir.path().join("none"));
    assert_says(&run(&mut command).refused(), &way_on);
}

#[test]
fn what_cannot_be_trained_on_is_refused() {
    let dir = temporary_dir();
    let config = dir.path().join("config.toml");
    let refused = |text: &str| {
        write(&config, text);
        run(&mut train(&dir.path().join("run"), &config, &[])).refused()
    };
    let paper = "[rl]\nreach_cells = 14\n[train]\nencoding = 'paper'";
    assert_says(&refused(paper), &["31 × 31", "29 × 29", "rl.reach_cells", "train.encoding"]);
    assert_says(
        &refused("[train]\nfactored = true\nn_step = 2"),
        &["train.factored", "train.n_step"],
    );
    assert_says(&refused("[train]\nchannels = ['visited']"), &["train.channels", "height"]);
    assert_says(
        &refused("[train]\nlearning_starts = 1"),
        &["train.learning_starts", "train.batch_size"],
    );
    assert_says(&refused("[train]\nn_step = 9"), &["train.n_step", "1 to 8"]);
    assert_says(
        &refused("[rl]\nhole_threshold_dbm = -300.0\nfloor_dbm = -400.0"),
        &["nothing to learn"],
    );
}

#[test]
fn too_little_memory_is_told_before_anything_begins() {
    let dir = temporary_dir();
    let config = dir.path().join("config.toml");
    write(&config, "[train]\nbatch_size = 65536\nlearning_starts = 65536\nbuffer_size = 100000000");
    let out = dir.path().join("run");
    let failed = run(&mut train(&out, &config, &[]));
    assert_eq!(failed.code, Some(1), "{failed:?}");
    assert_says(&failed.stderr, &["MB are free", "train.buffer_size", "train.batch_size"]);
    assert!(!out.exists());
}

/// Maps that change faster than a batch comes together are waited for, not for ever.
#[test]
fn a_single_map_that_changes_at_every_step_can_be_learned_from() {
    let dataset = Arc::new(Dataset::open(&HELSINKI.dataset).expect("opened"));
    let config = Config::default();
    let train = TrainConfig {
        batch_size: 32,
        num_envs: 4,
        learning_starts: 32,
        buffer_size: 256,
        refresh_every: 1,
        widths: [2; 7],
        precision: Precision::Float32,
        ..config.train
    };
    let (rl, device) = (&config.rl, Device::Cpu);
    let setup = TrainerSetup { dataset_sha256: "", rl, train: &train, device };
    let source = MapSource::split(&dataset, Split::Train, &config.rl, 0, 0);
    let pool = source.fill().expect("a map");
    assert_eq!(pool.maps().len(), 1);
    let before = pool.maps().all()[0].0;
    let mut trainer = Trainer::new(setup, pool).expect("there is something to learn");
    (0..4).for_each(|_| trainer.update().expect("maps are read"));
    assert_eq!(trainer.updates(), 4);
    assert_ne!(trainer.pool().maps().all()[0].0, before, "it was replaced");
}

/// The random walk, made for any map.
#[derive(Debug)]
struct Walking;

impl MakePolicy for Walking {
    fn policy<'a>(&'a self, _: &World) -> Box<dyn Policy + 'a> {
        Box::new(RandomWalk)
    }
}

/// A plain without buildings whose west is a hole: whoever flies west finds it. The loss falls, and
/// the agent finds the hole far more often than a random walk.
#[test]
fn it_learns_a_map_with_a_known_answer() {
    let dataset = Dataset::open(&HELSINKI.dataset).expect("opened");
    let record = dataset.record(dataset.manifest().records[0].id).expect("read");
    let grids = Grids {
        height_m: Array2::zeros((121, 121)),
        rsrp_dbm: Array2::from_shape_fn((121, 121), |(_, column)| -120.0 + column as f32),
        mask: Array2::zeros((121, 121)),
        errors: None,
    };
    let train = TrainConfig {
        updates: 300,
        batch_size: 32,
        num_envs: 32,
        learning_starts: 512,
        learning_rate: 2e-3,
        target_network_frequency: 20,
        widths: [8; 7],
        augment: false,
        precision: Precision::Float32,
        ..TrainConfig::default()
    };
    let evaluate = EvaluateConfig { starts: 100, steps: vec![8], ..EvaluateConfig::default() };
    let config = Config { train, evaluate, ..Config::default() };
    let maps = [Arc::new(World::new(&record, &grids, &config.rl))];
    let (rl, train, device) = (&config.rl, &config.train, Device::Cpu);
    let setup = TrainerSetup { dataset_sha256: "", rl, train, device };
    let pool = MapSource::maps(maps.to_vec()).fill().expect("a map to learn");
    let mut trainer = Trainer::new(setup, pool).expect("there is something to learn");
    let mut loss_of = |updates: u64| {
        (0..updates).for_each(|_| trainer.update().expect("maps are in memory"));
        trainer.report().expect("finite").loss
    };
    let (first, _, last) = (loss_of(20), loss_of(260), loss_of(20));
    assert!(last < 0.5 * first, "the loss went from {first} to {last}");
    let agent = Agent::new(trainer.policy().duplicate(), 121, rl, train);
    let found = |policy: &dyn MakePolicy| precision(policy, &maps, &config)[0][0];
    let (learned, walked) = (found(&agent), found(&Walking));
    assert!(learned > walked + 0.2, "the agent {learned}, a random walk {walked}");
}

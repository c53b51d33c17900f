//! `holescout train`: it learns, and a killed run ends in the same weights as one that was left alone.
#![cfg(feature = "torch")]

mod pipeline;

use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use holescout::config::{Config, EvaluateConfig, Precision, TrainConfig};
use holescout::dataset::{Dataset, Grids};
use holescout::evaluate::precision;
use holescout::rl::World;
use holescout::rl::agent::{Agent, TrainJob, Trainer};
use holescout::rl::policy::{MakePolicy, Policy, RandomWalk};
use ndarray::Array2;

use pipeline::{
    HELSINKI, Random, assert_says, holescout, read, read_json, run, sha256, temporary_dir, write,
};

/// A network that is small enough for tests.
const SMALL: &str = "
[train]
updates = 24
batch = 8
episodes = 8
warmup = 64
replay = 256
widths = [4, 4, 4, 4, 4, 4, 4]
target_sync = 5
precision = 'float32'
checkpoint_every = 2
evaluate_every = 12
evaluate_starts = 4
";

fn train(run: &Path, config: &Path, options: &[&str]) -> Command {
    let mut command = holescout("train");
    command.arg("--dataset").arg(&HELSINKI.dataset).arg("--config").arg(config);
    command.arg("--run").arg(run).args(options);
    // Sums of floating-point numbers depend on how they are split.
    command.env("OMP_NUM_THREADS", "1").args(["--threads", "1"]);
    command
}

fn weights(run: &Path) -> String {
    sha256(&read(&run.join("checkpoints/000000024/weights.safetensors")))
}

#[test]
fn killed_runs_end_in_the_same_weights_and_log() {
    let dir = temporary_dir();
    let config = dir.path().join("small.toml");
    write(&config, SMALL);
    let (whole, killed) = (dir.path().join("whole"), dir.path().join("killed"));
    run(&mut train(&whole, &config, &[])).succeeds();
    let again = dir.path().join("again");
    run(&mut train(&again, &config, &[])).succeeds();
    assert_eq!(weights(&again), weights(&whole), "the same seed twice");

    let mut random = Random(7);
    let mut kills = 0;
    loop {
        let mut child =
            train(&killed, &config, &[]).stderr(Stdio::null()).stdout(Stdio::null()).spawn();
        let child = child.as_mut().expect("started");
        std::thread::sleep(Duration::from_millis(200 + random.below(1200) as u64));
        child.kill().expect("killed");
        let ended = child.wait().expect("gone");
        kills += 1;
        if ended.success() || kills == 20 {
            break;
        }
    }
    assert!(kills > 1, "it was never killed");
    run(&mut train(&killed, &config, &[])).succeeds();
    assert_eq!(weights(&killed), weights(&whole));
    assert_eq!(read(&killed.join("log.jsonl")), read(&whole.join("log.jsonl")));
    for directory in [&killed, &killed.join("checkpoints")] {
        let names = std::fs::read_dir(directory).expect("listed").flatten();
        let names = names.map(|entry| entry.file_name().to_string_lossy().into_owned());
        let mut left = names.filter(|name| name.starts_with(".holescout-checkpoint"));
        assert_eq!(left.next(), None, "nothing half-written is left");
    }
    // A finished run has nothing left to do.
    assert_says(&run(&mut train(&killed, &config, &[])).succeeds(), &["24 updates, done"]);
}

#[test]
fn a_run_of_another_configuration_or_dataset_is_refused_with_the_difference() {
    let dir = temporary_dir();
    let config = dir.path().join("small.toml");
    write(&config, SMALL);
    let out = dir.path().join("run");
    run(&mut train(&out, &config, &["--updates", "2"])).succeeds();
    let refused = run(&mut train(&out, &config, &["--updates", "2", "--seed", "1"])).refused();
    assert_says(&refused, &["train.seed", "1 here, 0 there"]);
    // What is only watched may change.
    run(&mut train(&out, &config, &["--updates", "2", "--evaluate-every", "1"])).succeeds();

    let checkpoint = out.join("checkpoints/000000002/weights.safetensors");
    let bytes = read(&checkpoint);
    write(&checkpoint, &bytes[..bytes.len() / 2]);
    let refused = run(&mut train(&out, &config, &["--updates", "2"])).refused();
    assert_says(&refused, &["weights.safetensors"]);
}

#[test]
fn a_trained_policy_is_evaluated_beside_the_others() {
    let dir = temporary_dir();
    let config = dir.path().join("small.toml");
    write(&config, SMALL);
    let (run_dir, out) = (dir.path().join("run"), dir.path().join("evaluation"));
    run(&mut train(&run_dir, &config, &[])).succeeds();
    let mut evaluate = holescout("evaluate");
    evaluate.arg("--dataset").arg(&HELSINKI.dataset).arg("--out").arg(&out);
    evaluate.arg("--policy").arg(run_dir.join("best"));
    evaluate.args(["--split", "val", "--starts", "5", "--methods", "rsp,oracle"]);
    assert_says(&run(&mut evaluate).succeeds(), &["Agent"]);
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

#[test]
fn what_cannot_be_trained_on_is_refused() {
    let dir = temporary_dir();
    let config = dir.path().join("config.toml");
    let refused = |text: &str| {
        write(&config, text);
        run(&mut train(&dir.path().join("run"), &config, &[])).refused()
    };
    assert_says(&refused("[rl]\nreach_cells = 14"), &["31 × 31", "29 × 29", "rl.reach_cells"]);
    assert_says(&refused("[train]\nwarmup = 1"), &["train.warmup", "train.batch"]);
    assert_says(
        &refused("[rl]\nhole_threshold_dbm = -300.0\nfloor_dbm = -400.0"),
        &["nothing to learn"],
    );
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
    };
    let train = TrainConfig {
        updates: 300,
        batch: 32,
        episodes: 32,
        warmup: 512,
        learning_rate: 2e-3,
        target_sync: 20,
        widths: [8; 7],
        augment: false,
        precision: Precision::Float32,
        ..TrainConfig::default()
    };
    let evaluate = EvaluateConfig { starts: 100, steps: vec![8], ..EvaluateConfig::default() };
    let config = Config { train, evaluate, ..Config::default() };
    let maps = [Arc::new(World::new(&record, &grids, &config.rl))];
    let job = TrainJob { maps: &maps, dataset_sha256: "", rl: &config.rl, train: &config.train };
    let mut trainer = Trainer::new(job).expect("there is something to learn");
    let losses: Vec<f64> =
        (0..config.train.updates).map(|_| trainer.update().expect("finite").loss).collect();
    let mean = |losses: &[f64]| losses.iter().sum::<f64>() / losses.len() as f64;
    let (first, last) = (mean(&losses[..20]), mean(&losses[280..]));
    assert!(last < 0.5 * first, "the loss went from {first} to {last}");
    let agent = Agent::new(trainer.policy().duplicate(), &config.rl, true);
    let found = |policy: &dyn MakePolicy| precision(policy, &maps, &config)[0].1;
    let (learned, walked) = (found(&agent), found(&Walking));
    assert!(learned > walked + 0.2, "the agent {learned}, a random walk {walked}");
}

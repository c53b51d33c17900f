//! Runs of `holescout train` lose nothing that they had, and believe nothing that they did not write.
#![cfg(feature = "torch")]

mod pipeline;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use pipeline::training::{SMALL, evaluate, seal, train, train_on, trained};
use pipeline::{
    HELSINKI, assert_same_files, assert_says, copy_of, helsinki_config, holescout, read, read_json,
    run, temporary_dir, tree, verify, write,
};

const FILES: [&str; 3] = ["weights.safetensors", "learning.safetensors", "state.msgpack"];

fn checkpoint(run: &Path, update: u32) -> PathBuf {
    run.join(format!("checkpoints/{update:09}"))
}

fn remove(directory: &Path) {
    std::fs::remove_dir_all(directory).expect("it was there");
}

/// Demands that a command is refused and that nothing in the directory has changed.
fn refused_unchanged(directory: &Path, command: &mut Command) -> String {
    let before = tree(directory);
    let said = run(command).refused();
    let mut after = tree(directory);
    after.retain(|name, _| before.contains_key(name) || !name.ends_with(".holescout-lock"));
    assert_same_files(&after, &before);
    said
}

#[test]
fn without_checkpoints_a_run_goes_on_from_its_best_and_keeps_its_log() {
    let (_dir, config, out) = trained(24);
    let ended =
        (read(&checkpoint(&out, 24).join(FILES[0])), read(&out.join("best").join(FILES[0])));
    let log = read(&out.join("log.jsonl"));
    let judged = |log: &[u8]| {
        let text = String::from_utf8(log.to_vec()).expect("text");
        let lines = text.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
        lines.filter(|line| line["precision"].is_object()).collect::<Vec<_>>()
    };
    remove(&out.join("checkpoints"));
    let again = run(&mut train(&out, &config, &["--updates", "24"])).succeeds();
    assert_says(&again, &["24 updates, done"]);
    assert_eq!(read(&checkpoint(&out, 24).join(FILES[0])), ended.0, "the same end");
    assert_eq!(read(&out.join("best").join(FILES[0])), ended.1);
    assert_eq!(judged(&read(&out.join("log.jsonl"))), judged(&log));

    // Without the best either nothing is left to go on from, and the log is not begun anew.
    remove(&out.join("checkpoints"));
    remove(&out.join("best"));
    let command = || train(&out, &config, &["--updates", "24"]);
    let said = refused_unchanged(&out, &mut command());
    assert_says(&said, &["log.jsonl", "another directory", "remove the log"]);
    std::fs::remove_file(out.join("log.jsonl")).expect("it was there");
    run(&mut command()).succeeds();
}

/// A run that goes back to an earlier checkpoint, and is judged more often from then on, does not replace a better
/// policy by a worse one.
#[test]
fn a_better_policy_is_not_replaced_by_a_worse_one() {
    let (_dir, config, out) = trained(24);
    let best = read(&out.join("best").join(FILES[2]));
    let score = |said: &str| serde_json::from_str::<Value>(said).expect("JSON")["best"].clone();
    let go_on = |every: &str| {
        let options = ["--updates", "24", "--evaluate-every", every, "--json"];
        score(&run(&mut train(&out, &config, &options)).succeeds())
    };
    let before = go_on("12");
    let [precision, update] =
        [&before[0], &before[1]].map(|value| value.as_f64().expect("a number"));
    // From update 20 on, judged after each update; the best is of update 12 or 24.
    remove(&checkpoint(&out, 22));
    remove(&checkpoint(&out, 24));
    let after = go_on("1");
    assert!(after[0].as_f64().expect("a number") >= precision, "{before} {after}");
    if after[1].as_f64() == Some(update) {
        assert_eq!(read(&out.join("best").join(FILES[2])), best, "it is the very same");
    }
}

#[test]
fn directories_of_somebody_else_are_left_alone() {
    let dir = temporary_dir();
    let config = dir.path().join("small.toml");
    write(&config, SMALL);
    let out = dir.path().join("papers");
    std::fs::create_dir_all(out.join("best")).expect("created");
    write(&out.join("best/thesis.doc"), b"text");
    let said = refused_unchanged(&out, &mut train(&out, &config, &[]));
    assert_says(&said, &["papers", "holds best", "another directory"]);

    // Nor is what somebody has put into a run.
    let (_dir, config, out) = trained(2);
    write(&out.join("best/notes.txt"), b"text");
    let said = run(&mut train(&out, &config, &["--updates", "2", "--evaluate-every", "1"]));
    assert_eq!(read(&out.join("best/notes.txt")), b"text", "{said:?}");
}

#[test]
fn a_run_does_not_lie_in_its_dataset() {
    let (_copy, dataset, before) = copy_of(&HELSINKI.dataset);
    let dir = temporary_dir();
    let config = dir.path().join("small.toml");
    write(&config, SMALL);
    let link = dir.path().join("link");
    std::os::unix::fs::symlink(&dataset, &link).expect("linked");
    for out in [dataset.join("run"), link.join("runs/first")] {
        let mut command = holescout("train");
        command.arg("--dataset").arg(&dataset).arg("--config").arg(&config).arg("--run").arg(&out);
        assert_says(&run(&mut command).refused(), &["finished output", "elsewhere"]);
        let mut command = holescout("evaluate");
        command.arg("--dataset").arg(&dataset).arg("--out").arg(&out);
        command.args(["--split", "val", "--methods", "rsp"]);
        assert_says(&run(&mut command).refused(), &["finished output", "elsewhere"]);
    }
    assert_same_files(&tree(&dataset), &before);
    run(&mut verify(&dataset)).succeeds();
}

/// A bit in any file, weights of another checkpoint, a file cut short: found, and the mend that is printed works.
#[test]
fn damaged_checkpoints_are_refused_and_the_way_on_is_told() {
    let (_dir, config, out) = trained(6);
    let whole = tree(&out);
    let command = || train(&out, &config, &["--updates", "6"]);
    let last = checkpoint(&out, 6);
    let flip = |file: &str| {
        let mut bytes = read(&last.join(file));
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        write(&last.join(file), bytes);
    };
    let damages: [(&str, &dyn Fn()); 6] = [
        (FILES[0], &|| flip(FILES[0])),
        (FILES[1], &|| flip(FILES[1])),
        (FILES[2], &|| flip(FILES[2])),
        (FILES[0], &|| write(&last.join(FILES[0]), read(&checkpoint(&out, 4).join(FILES[0])))),
        (FILES[1], &|| {
            let bytes = read(&last.join(FILES[1]));
            write(&last.join(FILES[1]), &bytes[..bytes.len() / 2]);
        }),
        ("SHA256SUMS", &|| std::fs::remove_file(last.join("SHA256SUMS")).expect("it was there")),
    ];
    for (file, damage) in damages {
        damage();
        let said = refused_unchanged(&out, &mut command());
        assert_says(&said, &[file, "remove", "000000006", "goes on from", "000000004"]);
        if file != FILES[1] {
            let none = out.with_file_name("none");
            let said = run(&mut evaluate(&HELSINKI.dataset, &last, &none)).refused();
            assert_says(&said, &[file]);
        }
        remove(&last);
        run(&mut command()).succeeds();
        for name in FILES {
            assert_eq!(read(&last.join(name)), whole[&format!("checkpoints/000000006/{name}")]);
        }
    }
    // The best is looked at before anything is trained.
    let best = out.join("best");
    write(&best.join(FILES[2]), b"other");
    let said = refused_unchanged(&out, &mut command());
    assert_says(&said, &["best", FILES[2], "remove"]);
    remove(&best);
    run(&mut command()).succeeds();
}

#[test]
fn weights_that_are_not_finite_are_neither_flown_nor_given_away_nor_trained_on() {
    let (dir, config, out) = trained(2);
    let directory = checkpoint(&out, 2);
    for (file, value) in [(FILES[0], f32::NAN), (FILES[1], f32::INFINITY)] {
        let sound = read(&directory.join(file));
        let mut bytes = sound.clone();
        let end = bytes.len();
        bytes[end - 4..].copy_from_slice(&value.to_le_bytes());
        write(&directory.join(file), bytes);
        seal(&directory);
        let said = run(&mut train(&out, &config, &["--updates", "2"])).refused();
        assert_says(&said, &[file, "not finite", "remove", "000000002"]);
        if file == FILES[0] {
            let none = dir.path().join("none");
            let said = run(&mut evaluate(&HELSINKI.dataset, &directory, &none)).refused();
            assert_says(&said, &[file, "not finite"]);
            let mut export = holescout("export-policy");
            export.arg(&directory).arg("--out").arg(&none);
            assert_says(&run(&mut export).refused(), &[file, "not finite"]);
            assert!(!none.exists());
        }
        write(&directory.join(file), sound);
        seal(&directory);
    }
    run(&mut train(&out, &config, &["--updates", "2"])).succeeds();
}

/// What a full disk does, by a limit on the size of files.
#[test]
fn a_full_disk_is_not_the_inputs_fault_and_loses_nothing() {
    let (_dir, config, out) = trained(2);
    // One that has all updates to do, and cannot write its first checkpoint.
    let full = out.with_file_name("full");
    let command = train(&full, &config, &[]);
    let mut limited = Command::new("bash");
    limited.args(["-c", "trap '' XFSZ; ulimit -f 4; exec \"$@\"", "limited"]);
    limited.arg(command.get_program()).args(command.get_args());
    let failed = run(&mut limited);
    assert_eq!(failed.code, Some(1), "{failed:?}");
    assert_says(&failed.stderr, &["cannot write", ".safetensors"]);
    assert!(!failed.stderr.contains("Os {"), "{failed:?}");
    let names = std::fs::read_dir(full.join("checkpoints")).expect("listed").flatten();
    assert_eq!(names.count(), 0, "nothing half-written is left");
    run(&mut train(&full, &config, &[])).succeeds();
}

#[test]
fn threads_that_were_asked_for_are_those_of_libtorch_too() {
    let dir = temporary_dir();
    let config = dir.path().join("small.toml");
    write(&config, SMALL);
    for threads in ["1", "2"] {
        let mut command = holescout("train");
        command.arg("--dataset").arg(&HELSINKI.dataset).arg("--config").arg(&config);
        command.arg("--run").arg(dir.path().join(threads));
        command.args(["--updates", "1", "--threads", threads]);
        command.env("OMP_NUM_THREADS", "2");
        let trained = run(&mut command);
        assert_says(&trained.stderr, &[&format!("threads: {threads};")]);
        trained.succeeds();
    }
}

#[test]
fn a_policy_flies_only_where_states_are_made_as_it_knows_them() {
    let (dir, _, out) = trained(2);
    let other = dir.path().join("other.toml");
    for (setting, value) in [
        ("hole_threshold_dbm", "-95.0"),
        ("floor_dbm", "-150.0"),
        ("encoding_decay", "0.5"),
        ("flight_height_m", "3.0"),
    ] {
        write(&other, format!("[rl]\n{setting} = {value}\n"));
        let mut command = evaluate(&HELSINKI.dataset, &out.join("best"), &dir.path().join("none"));
        let said = run(command.arg("--config").arg(&other)).refused();
        assert_says(&said, &[&format!("rl.{setting}"), "here", "there", "its own settings"]);
    }
}

#[test]
fn the_advice_after_divergence_works() {
    let dir = temporary_dir();
    let (wild, tame) = (dir.path().join("wild.toml"), dir.path().join("tame.toml"));
    let wide = SMALL.replace("[4, 4, 4, 4, 4, 4, 4]", "[16, 16, 16, 16, 16, 16, 16]");
    let free = "max_grad_norm = 0.0\nloss = 'squared'\nhole_prediction = 0.0\nanneal_learning_rate = false";
    write(&wild, format!("{wide}{free}\nlearning_rate = 0.99\n"));
    write(&tame, format!("{wide}{free}\nlearning_rate = 1e-4\n"));
    let out = dir.path().join("run");
    let failed = run(&mut train(&out, &wild, &[]));
    assert_eq!(failed.code, Some(1), "{failed:?}");
    let advice = ["no longer finite", "another directory", "--run", "train.learning_rate"];
    assert_says(&failed.stderr, &advice);
    run(&mut train(&dir.path().join("another"), &tame, &[])).succeeds();
}

/// `train.block` decides in which order maps come and go.
#[test]
fn maps_come_in_the_blocks_that_were_asked_for() {
    let dir = temporary_dir();
    let (dataset, config) = (dir.path().join("dataset"), dir.path().join("config.toml"));
    let text = String::from_utf8(read(&helsinki_config())).expect("text");
    write(&config, text + "\n[shard]\nrecords_per_shard = 2\n");
    let mut shard = holescout("shard");
    shard.arg("--tiles").arg(&HELSINKI.tiles).arg("--rsrp").arg(&HELSINKI.rsrp);
    run(shard.arg("--config").arg(&config).arg("--out").arg(&dataset)).succeeds();
    let weights = |name: &str, block: &str| {
        let out = dir.path().join(name);
        write(&config, format!("{SMALL}map_memory_mb = 1\nrefresh_every = 2\n{block}"));
        run(&mut train_on(&dataset, &out, &config, &["--updates", "12"])).succeeds();
        read(&checkpoint(&out, 12).join(FILES[0]))
    };
    let [all, one, again] =
        [weights("all", ""), weights("one", "block = 1\n"), weights("again", "block = 1\n")];
    assert!(one == again && one != all);
}

/// A validation that would take minutes ends soon after a signal, and is made up for: the run ends as one that was
/// left alone does.
#[test]
fn a_signal_stops_a_long_validation_and_nothing_is_lost() {
    let dir = temporary_dir();
    let (config, out) = (dir.path().join("small.toml"), dir.path().join("run"));
    write(&config, SMALL);
    let slow = ["--updates", "12"];
    let starts = |starts: u32| {
        write(
            &config,
            SMALL.replace("evaluate_starts = 4", &format!("evaluate_starts = {starts}")),
        );
    };
    starts(100_000);
    let mut child = train(&out, &config, &slow);
    let child = child.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("started");
    // The checkpoint of update 10 is there: what follows is update 12, and its judgement.
    while !checkpoint(&out, 10).exists() {
        std::thread::sleep(Duration::from_millis(1));
    }
    std::thread::sleep(Duration::from_secs(3));
    assert!(!out.join("best").exists(), "it is being judged");
    let (signalled, pid) = (Instant::now(), child.id().to_string());
    assert!(Command::new("kill").arg(pid).status().expect("sent").success());
    let ended = child.wait_with_output().expect("gone");
    let waited = signalled.elapsed();
    assert!(ended.status.success(), "{ended:?}");
    assert!(waited < Duration::from_secs(10), "{waited:?}");
    assert!(checkpoint(&out, 12).exists() && !out.join("best").exists());

    starts(4);
    let alone = dir.path().join("alone");
    for run_dir in [&out, &alone] {
        run(&mut train(run_dir, &config, &slow)).succeeds();
    }
    for name in FILES {
        let of = |run: &Path| read(&run.join("best").join(name));
        // How many starts a map is judged from is part of what a checkpoint says.
        assert!(name == FILES[2] || of(&out) == of(&alone), "{name}");
    }
    let schema = Path::new(env!("CARGO_MANIFEST_DIR")).join("schemas/run.v1.json");
    let schema = jsonschema::validator_for(&read_json(&schema)).expect("a schema");
    assert!(schema.is_valid(&read_json(&out.join("run.json"))));
}

/// Each checkpoint vouches for its files; what they tell must be that of the run.
#[test]
fn a_run_and_the_policy_of_it_verify_until_something_is_changed() {
    let (dir, _, out) = trained(24);
    let said = run(&mut verify(&out)).succeeds();
    assert_says(&said, &["sound"]);
    let policy = dir.path().join("policy");
    run(holescout("export-policy").arg(out.join("best")).arg("--out").arg(&policy)).succeeds();
    run(&mut verify(&policy)).succeeds();

    let last = checkpoint(&out, 24);
    for (file, says) in [
        ("checkpoints/000000024/learning.safetensors", "learning.safetensors"),
        ("best/weights.safetensors", "best/weights.safetensors"),
        ("log.jsonl", "log.jsonl: line 1: no update"),
        ("run.json", "run.json"),
    ] {
        let path = out.join(file);
        let before = read(&path);
        let mut damaged = before.clone();
        damaged[0] ^= 0x55;
        write(&path, damaged);
        assert_says(&run(&mut verify(&out)).refused(), &[says]);
        write(&path, before);
    }
    // A list that leaves the state out vouches for nothing of it.
    let list = last.join("SHA256SUMS");
    let before = read(&list);
    let text = String::from_utf8(before.clone()).expect("text");
    let without = text.lines().filter(|line| !line.ends_with("state.msgpack"));
    write(&list, without.flat_map(|line| [line, "\n"]).collect::<String>());
    assert_says(&run(&mut verify(&out)).refused(), &["000000024/state.msgpack: "]);
    write(&list, before);
    let elsewhere = checkpoint(&out, 23);
    std::fs::rename(&last, &elsewhere).expect("renamed");
    assert_says(&run(&mut verify(&out)).refused(), &["000000023/state.msgpack: of update 24"]);
    std::fs::rename(&elsewhere, &last).expect("renamed");
    run(&mut verify(&out)).succeeds();
}

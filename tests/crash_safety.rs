//! A stage may be killed at any moment: what it leaves is never taken for finished, and
//! running it again ends in the same bytes, without a file too many.
//!
//! Kills are real (SIGKILL) and their moments seeded; the states that only a kill within
//! some microseconds leaves are made by hand.

mod pipeline;

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::Value;

use pipeline::{
    HELSINKI, Random, Tree, assert_same_files, assert_says, fixture, import, plant, rasterise,
    read, run, shard, temporary_dir, tree, verify, write,
};

const JOURNAL: &str = ".holescout-build.jsonl";

/// Starts a command that says nothing.
fn start(command: &mut Command) -> Child {
    let silent = command.stdout(Stdio::null()).stderr(Stdio::null());
    silent.spawn().expect("the command starts")
}

/// SIGKILL.
fn kill(mut child: Child) {
    child.kill().expect("killed, or ended before");
    child.wait().expect("reaped");
}

/// Waits until a file is there, or the process has ended.
fn wait_for(path: &Path, child: &mut Child) {
    while !path.exists() && child.try_wait().expect("known").is_none() {
        sleep(Duration::from_micros(50));
    }
}

/// Starts a stage and stops it, with SIGSTOP, when its journal has so many lines, before it ends.
fn stop_midway(stage: &mut Command, out: &Path, lines: usize) -> Child {
    let journal = out.join(JOURNAL);
    let written = || fs::read_to_string(&journal).map_or(0, |text| text.lines().count());
    // A busy machine may let the stage end before this process looks again.
    for _ in 0..10 {
        let mut child = start(stage);
        while written() < lines && child.try_wait().expect("known").is_none() {
            sleep(Duration::from_micros(50));
        }
        // Reaped, if it has ended: then there is nothing to stop.
        if child.try_wait().expect("known").is_none() {
            signal("STOP", &child);
            if journal.exists() && !out.join("manifest.json").exists() {
                return child;
            }
            kill(child);
        }
        fs::remove_dir_all(out).expect("removed");
    }
    unreachable!("the stage always ended first");
}

/// Starts a stage and kills it when its journal has so many lines, before it ends.
fn kill_midway(stage: &mut Command, out: &Path, lines: usize) {
    kill(stop_midway(stage, out, lines));
}

/// What is left must be refused unless it is whole, and completed by running again.
fn assert_recovers(command: &mut Command, out: &Path, expected: &Tree) {
    let left = if out.exists() { tree(out) } else { Tree::new() };
    let verdict = run(&mut verify(out));
    if left == *expected {
        verdict.succeeds();
    } else {
        let message = verdict.refused();
        let told = message.contains("interrupted") || message.contains(JOURNAL);
        assert!(told, "names the reason: {message}");
    }
    run(command).succeeds();
    assert_same_files(&tree(out), expected);
    run(&mut verify(out)).succeeds();
}

/// Kills a stage after seeded times and beside its milestones; a run takes up each time
/// what the killed one left.
fn kill_and_resume(stage: impl Fn(&Path) -> Command, expected: &Tree, kills: u32, seed: u64) {
    let dir = temporary_dir();
    let whole = dir.path().join("whole");
    let begun = Instant::now();
    run(&mut stage(&whole)).succeeds();
    let duration = begun.elapsed();
    assert_same_files(&tree(&whole), expected);

    let mut random = Random(seed);
    for number in 0..kills {
        let out = dir.path().join(format!("time-{number}"));
        // Killed twice: the second time while it resumes.
        for _ in 0..2 {
            let child = start(&mut stage(&out));
            sleep(duration.mul_f64(random.share()));
            kill(child);
        }
        assert_recovers(&mut stage(&out), &out, expected);
    }
    let items: Vec<&String> = expected.keys().filter(|name| name.contains("utm")).collect();
    let some_item = items.get(random.below(items.len().max(1)));
    let milestones = [JOURNAL, "SHA256SUMS", "manifest.json"].into_iter();
    for name in milestones.chain(some_item.map(|name| name.as_str())) {
        let out = dir.path().join(format!("file-{name}"));
        let mut child = start(&mut stage(&out));
        wait_for(&out.join(name), &mut child);
        kill(child);
        assert_recovers(&mut stage(&out), &out, expected);
    }
}

/// A few tiles: reading the extract takes most of the time.
#[test]
fn a_killed_rasterise_is_completed() {
    let stage = |out: &Path| {
        let mut command = rasterise(out);
        command.args(["--bbox", "24.94,60.169,24.951,60.172"]);
        command
    };
    let dir = temporary_dir();
    run(&mut stage(dir.path())).succeeds();
    kill_and_resume(stage, &tree(dir.path()), 3, 11);
}

#[test]
fn a_killed_import_is_completed() {
    let stage = |out: &Path| import(&fixture("helsinki/rsrp"), &HELSINKI.tiles, out);
    kill_and_resume(stage, &tree(&HELSINKI.rsrp), 6, 12);
}

/// Eight shards instead of two, so that there is more to resume.
#[test]
fn a_killed_shard_is_completed() {
    let stage = |out: &Path| {
        let mut command = shard(&HELSINKI.tiles, &HELSINKI.rsrp, out);
        command.args(["--records-per-shard", "2"]);
        command
    };
    let dir = temporary_dir();
    run(&mut stage(dir.path())).succeeds();
    kill_and_resume(stage, &tree(dir.path()), 6, 13);
}

/// A dataset in a directory of its own.
fn copied_dataset(dir: &Path) -> std::path::PathBuf {
    let out = dir.join("dataset");
    plant(&out, &tree(&HELSINKI.dataset));
    out
}

fn build(out: &Path) -> Command {
    shard(&HELSINKI.tiles, &HELSINKI.rsrp, out)
}

/// As [`build`], of another configuration.
fn build_other(out: &Path) -> Command {
    let mut command = build(out);
    command.args(["--zstd-level", "1", "--records-per-shard", "4"]);
    command
}

fn other_dataset() -> Tree {
    let dir = temporary_dir();
    run(&mut build_other(dir.path())).succeeds();
    tree(dir.path())
}

/// The first line of the journal of [`build_other`].
fn plan_of_other() -> Vec<u8> {
    let dir = temporary_dir();
    let out = dir.path().join("dataset");
    kill_midway(&mut build_other(&out), &out, 2);
    let journal = read(&out.join(JOURNAL));
    journal.split_inclusive(|byte| *byte == b'\n').next().expect("a line").to_vec()
}

/// Killed after a replacement was begun and while the old output is removed, the list of
/// whose files goes last.
#[test]
fn a_replacement_killed_while_it_removes_the_old_output_is_completed() {
    let plan = plan_of_other();
    let states = [
        (&plan[..], &[][..]),
        (&plan, &["manifest.json"]),
        (&plan, &["manifest.json", "NOTICE", "README.md"]),
        (b"", &[]),
    ];
    for (journal, gone) in states {
        let dir = temporary_dir();
        let out = copied_dataset(dir.path());
        write(&out.join(JOURNAL), journal);
        for name in gone {
            fs::remove_file(out.join(name)).expect("removed");
        }
        run(&mut verify(&out)).refused();
        run(build_other(&out).arg("--overwrite")).succeeds();
        assert_same_files(&tree(&out), &other_dataset());
    }
}

/// An item is written before the journal notes it. Killed in between and replaced by
/// another configuration, the item must not stay.
#[test]
fn an_item_that_was_only_announced_is_removed() {
    let dir = temporary_dir();
    let out = dir.path().join("dataset");
    kill_midway(build(&out).args(["--records-per-shard", "2"]), &out, 8);
    let journal = String::from_utf8(read(&out.join(JOURNAL))).expect("text");
    let kept = journal.lines().enumerate().filter(|(at, line)| *at == 0 || line.contains("null"));
    let announced: Vec<&str> = kept.map(|(_, line)| line).collect();
    write(&out.join(JOURNAL), announced.join("\n"));
    assert!(out.join("train/shard-00000.msgpack.zst").exists());
    run(build_other(&out).arg("--overwrite")).succeeds();
    run(&mut verify(&out)).succeeds();
    assert_same_files(&tree(&out), &other_dataset());
}

/// A signal by its name.
fn signal(name: &str, child: &Child) {
    let status = Command::new("kill").arg(format!("-{name}")).arg(child.id().to_string()).status();
    assert!(status.expect("kill is there").success());
}

/// Two runs must not write to one directory, whatever they were told.
#[test]
fn a_running_build_is_not_disturbed() {
    // Slow enough to be caught.
    let slow = |out: &Path| {
        let mut command = build(out);
        command.args(["--zstd-level", "19"]);
        command
    };
    let dir = temporary_dir();
    let alone = dir.path().join("alone");
    run(&mut slow(&alone)).succeeds();
    let attempts: [fn(&mut Command) -> &mut Command; 3] = [
        |same| same,
        |same| same.arg("--overwrite"),
        |other| other.args(["--overwrite", "--records-per-shard", "4"]),
    ];
    for (number, attempt) in attempts.into_iter().enumerate() {
        let out = dir.path().join(format!("dataset-{number}"));
        // With the first line the journal is locked; merely there, it need not be yet.
        let mut first = stop_midway(&mut slow(&out), &out, 1);
        let second = run(attempt(&mut slow(&out)));
        signal("CONT", &first);
        let status = first.wait().expect("ended");
        assert_eq!(second.code, Some(1), "waiting may help: {second:?}");
        assert_says(&second.stderr, &["dataset", "another run"]);
        assert!(status.success(), "the first run is not disturbed");
        assert_same_files(&tree(&out), &tree(&alone));
    }
}

/// Damage that comes between a kill and the next run is noticed.
#[test]
fn a_resumed_run_trusts_no_damaged_item() {
    let dir = temporary_dir();
    let out = dir.path().join("rsrp");
    let stage = || import(&fixture("helsinki/rsrp"), &HELSINKI.tiles, &out);
    kill_midway(&mut stage(), &out, 6);
    let maps = tree(&out).into_keys().filter(|name| name.starts_with("utm"));
    let written: Vec<String> = maps.collect();
    write(&out.join(&written[0]), "damaged");
    fs::remove_file(out.join(&written[1])).expect("removed");
    assert_recovers(&mut stage(), &out, &tree(&HELSINKI.rsrp));
}

/// A journal is read with suspicion: what it says of files outside is not believed.
#[test]
fn a_forged_journal_removes_no_file_outside_of_the_directory() {
    let dir = temporary_dir();
    let out = dir.path().join("dataset");
    let outside = dir.path().join("thesis.tex");
    write(&outside, "ten years of work");
    let digest = serde_json::json!({"bytes": 1, "sha256": "00"});
    let mut lines = vec![serde_json::json!({"stage": "dataset", "fingerprint": "other"})];
    for name in ["../thesis.tex", &outside.to_string_lossy()] {
        lines.push(serde_json::json!({"key": name, "files": [[name, digest]], "item": null}));
    }
    let journal: Vec<String> = lines.iter().map(|line: &Value| format!("{line}\n")).collect();
    write(&out.join(JOURNAL), journal.concat());
    run(build(&out).arg("--overwrite")).succeeds();
    assert_eq!(read(&outside), b"ten years of work");
    assert_same_files(&tree(&out), &tree(&HELSINKI.dataset));
}

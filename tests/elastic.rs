//! Several tasks build an output together: in any number and order, killed and run again, in one
//! directory or in several that are copied together. Merged, it has the bytes of a single run;
//! what is missing is never passed over.

mod pipeline;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;
use std::thread::sleep;
use std::time::Duration;

use serde_json::Value;

use pipeline::{
    HELSINKI, Random, Run, Tree, assert_same_files, assert_says, fixture, holescout, import, plant,
    rasterise, read, run, shard, shared_dir, temporary_dir, tree, verify, write,
};

/// Exit code of a task that need not be tried again.
const PERMANENT: i32 = 42;

// Stages ---------------------------------------------------------------------------------

/// A stage of the fixtures, and what a single run of it writes.
struct Stage {
    name: &'static str,
    /// The command that fills a directory.
    command: fn(&Path) -> Command,
    /// Its single run's output.
    whole: PathBuf,
}

impl Stage {
    fn new(name: &'static str, command: fn(&Path) -> Command) -> Self {
        let whole = shared_dir(&format!("elastic-{name}")).join("whole");
        run(&mut command(&whole)).succeeds();
        Self { name, command, whole }
    }

    fn task(&self, out: &Path, index: u32, count: u32) -> Command {
        let mut command = (self.command)(out);
        command.args(["--task-index", &index.to_string(), "--task-count", &count.to_string()]);
        command
    }

    fn merge(&self, out: &Path, count: u32) -> Command {
        let mut command = (self.command)(out);
        command.args(["--merge", "--task-count", &count.to_string()]);
        command
    }

    fn expected(&self) -> Tree {
        tree(&self.whole)
    }
}

fn few_tiles(out: &Path) -> Command {
    let mut command = rasterise(out);
    command.args(["--bbox", "24.94,60.169,24.951,60.172"]);
    command
}

/// 15 tiles, each with a verdict.
static TILES: LazyLock<Stage> = LazyLock::new(|| Stage::new("tiles", few_tiles));

static SCENES: LazyLock<Stage> = LazyLock::new(|| {
    LazyLock::force(&TILES);
    Stage::new("scenes", |out| {
        let mut command = holescout("scenes");
        command.arg("--osm").arg(fixture("helsinki/helsinki.osm.pbf"));
        command.arg("--tiles").arg(&TILES.whole).arg("--out").arg(out);
        command
    })
});

/// Two of the maps are rejected, since both claim the same tile.
static MAPS: LazyLock<Stage> = LazyLock::new(|| {
    let maps = shared_dir("elastic-given-maps");
    plant(&maps, &tree(&fixture("helsinki/rsrp")));
    let first = tree(&maps).into_iter().next().expect("a map");
    write(&maps.join("another-name.npz"), first.1);
    Stage::new("maps", |out| {
        let maps = Path::new(env!("CARGO_TARGET_TMPDIR")).join("elastic-given-maps");
        import(&maps, &HELSINKI.tiles, out)
    })
});

/// Eight shards.
fn small_shards(out: &Path) -> Command {
    let mut command = shard(&HELSINKI.tiles, &HELSINKI.rsrp, out);
    command.args(["--records-per-shard", "2"]);
    command
}

static SHARDS: LazyLock<Stage> = LazyLock::new(|| Stage::new("shards", small_shards));

/// The JSON that a run ends with.
fn summary(command: &mut Command) -> Value {
    let said = run(command.arg("--json")).succeeds();
    serde_json::from_str(said.lines().last().unwrap_or_default()).expect("JSON")
}

/// Demands that a run ends as permanent; returns what was said.
fn permanent(ended: Run) -> String {
    assert_eq!(ended.code, Some(PERMANENT), "{ended:?}");
    ended.stderr
}

/// Demands that a run ends so that trying again may help; returns what was said.
fn temporary(ended: Run) -> String {
    assert_eq!(ended.code, Some(1), "{ended:?}");
    ended.stderr
}

fn shuffled(count: u32, random: &mut Random) -> Vec<u32> {
    let mut order: Vec<u32> = (0..count).collect();
    for at in (1..order.len()).rev() {
        order.swap(at, random.below(at + 1));
    }
    order
}

/// A file that this machine does not give now is not an input that all others lack.
#[test]
fn a_task_that_cannot_read_a_file_may_be_tried_again() {
    let names: Vec<String> = tree(&fixture("helsinki/rsrp")).into_keys().collect();
    let sidecar = names[0].replace(".npz", ".json");
    for name in ["another.npz", &sidecar] {
        let dir = temporary_dir();
        let (maps, out) = (dir.path().join("maps"), dir.path().join("out"));
        plant(&maps, &tree(&fixture("helsinki/rsrp")));
        // Opens as a regular file for everybody, root included, and fails when it is read.
        std::os::unix::fs::symlink("/proc/self/mem", maps.join(name)).expect("linked");
        let mut task = import(&maps, &HELSINKI.tiles, &out);
        task.args(["--task-index", "0", "--task-count", "2"]);
        assert_says(&temporary(run(&mut task)), &[name, "Input/output error"]);
        assert!(!out.exists(), "nothing is begun with other inputs");
        fs::remove_file(maps.join(name)).expect("removed");
        run(&mut task).succeeds();
    }
}

// The same bytes -------------------------------------------------------------------------

/// Tasks in any order, one of them twice, then the merge.
fn build_in_parts(stage: &Stage, counts: &[u32], seed: u64) {
    let mut random = Random(seed);
    for &count in counts {
        let dir = temporary_dir();
        let out = dir.path().join("out");
        let mut order = shuffled(count, &mut random);
        order.push(order[random.below(order.len())]);
        let mut items = 0;
        for (at, &index) in order.iter().enumerate() {
            let said = summary(&mut stage.task(&out, index, count));
            let number = |key: &str| said[key].as_u64().expect("a number");
            let again = at == order.len() - 1;
            assert_eq!((number("task"), number("of")), (index.into(), count.into()));
            assert_eq!(number(if again { "built" } else { "found" }), 0, "{said}");
            items += if again { 0 } else { number("items") };
            assert!(!out.join("manifest.json").exists(), "tasks end without manifest");
            if again {
                assert_eq!(number("planned"), items, "{}: each item falls to one task", stage.name);
            }
        }
        run(&mut stage.merge(&out, count)).succeeds();
        assert_same_files(&tree(&out), &stage.expected());
        run(&mut verify(&out)).succeeds();
    }
}

#[test]
fn tiles_in_parts_are_those_of_a_single_run() {
    build_in_parts(&TILES, &[1, 2, 4, 7, 23], 1);
}

#[test]
fn scenes_in_parts_are_those_of_a_single_run() {
    build_in_parts(&SCENES, &[1, 2, 4, 7], 2);
}

#[test]
fn maps_in_parts_are_those_of_a_single_run() {
    build_in_parts(&MAPS, &[1, 2, 4, 7], 3);
    let rejected = String::from_utf8(MAPS.expected()["rejected.csv"].clone()).expect("text");
    assert_eq!(rejected.matches("duplicate_location").count(), 2, "seen by whichever task");
}

/// More tasks than shards: some have nothing to do, and must have run nevertheless.
#[test]
fn shards_in_parts_are_those_of_a_single_run() {
    build_in_parts(&SHARDS, &[1, 2, 4, 7, 11], 4);
}

#[test]
fn parts_in_directories_of_their_own_are_copied_together() {
    for stage in [&*MAPS, &*SHARDS, &*SCENES] {
        let dir = temporary_dir();
        let together = dir.path().join("together");
        for index in [1, 0, 2] {
            let out = dir.path().join(format!("part-{index}"));
            run(&mut stage.task(&out, index, 3)).succeeds();
            for (name, bytes) in tree(&out) {
                let path = together.join(name);
                assert!(!path.exists(), "no two tasks write the same name");
                write(&path, bytes);
            }
        }
        run(&mut stage.merge(&together, 3)).succeeds();
        assert_same_files(&tree(&together), &stage.expected());
    }
}

#[test]
fn threads_change_nothing_in_a_part() {
    let parts = ["1", "2", "8"].map(|threads| {
        let dir = temporary_dir();
        run(MAPS.task(dir.path(), 1, 3).args(["--threads", threads])).succeeds();
        // The order of the journal's lines may differ, and what they say in the end may not.
        let mut files = tree(dir.path());
        let journal = files.remove(&journal(1, 3)).expect("a journal");
        let journal = String::from_utf8(journal).expect("text");
        (files, journal.lines().last().expect("a done-marker").to_owned())
    });
    for (files, done) in &parts {
        assert_same_files(files, &parts[0].0);
        assert_eq!(done, &parts[0].1);
    }
}

/// Engines run a task again whose success they missed: nothing is lost, nothing is built.
#[test]
fn tasks_and_merges_are_harmless_once_all_is_done() {
    let dir = temporary_dir();
    let out = dir.path().join("out");
    for index in 0..2 {
        run(&mut SHARDS.task(&out, index, 2)).succeeds();
    }
    run(&mut SHARDS.merge(&out, 2)).succeeds();
    assert_eq!(summary(&mut SHARDS.task(&out, 1, 2))["whole"], true);
    assert_eq!(summary(&mut SHARDS.merge(&out, 2))["records"], 15);
    assert_same_files(&tree(&out), &SHARDS.expected());
    // A merge that was killed in its last step has left a journal.
    write(&out.join(journal(1, 2)), plan_of(&SHARDS));
    run(&mut SHARDS.merge(&out, 2)).succeeds();
    assert_same_files(&tree(&out), &SHARDS.expected());
    // But what was damaged since is not called done.
    write(&out.join("NOTICE"), "damaged");
    for command in [&mut SHARDS.task(&out, 1, 2), &mut SHARDS.merge(&out, 2)] {
        assert_says(&permanent(run(command)), &["NOTICE", "checksum", "remove the directory"]);
    }
}

fn journal(index: u32, count: u32) -> String {
    format!(".holescout-build.{index}-of-{count}.jsonl")
}

/// The first line of a stage's journals.
fn plan_of(stage: &Stage) -> Vec<u8> {
    let dir = temporary_dir();
    run(&mut stage.task(dir.path(), 0, 1)).succeeds();
    let text = read(&dir.path().join(journal(0, 1)));
    text.split_inclusive(|byte| *byte == b'\n').next().expect("a line").to_vec()
}

// Gaps -----------------------------------------------------------------------------------

/// All tasks of three but some, in a directory.
fn parts_but(stage: &Stage, out: &Path, missing: &[u32]) {
    for index in (0..3).filter(|index| !missing.contains(index)) {
        run(&mut stage.task(out, index, 3)).succeeds();
    }
}

/// Demands that a merge names the tasks, changes nothing, and passes once they have run again.
fn assert_gap(stage: &Stage, out: &Path, tasks: &[u32], words: &[&str]) {
    let before = tree(out);
    let message = temporary(run(&mut stage.merge(out, 3)));
    let again: Vec<String> = tasks.iter().map(ToString::to_string).collect();
    assert_says(&message, &[&format!("--task-index {},", again.join(" "))]);
    assert_says(&message, words);
    assert_same_files(&tree(out), &before);
    for &index in tasks {
        run(&mut stage.task(out, index, 3)).succeeds();
    }
    run(&mut stage.merge(out, 3)).succeeds();
    assert_same_files(&tree(out), &stage.expected());
}

#[test]
fn a_task_that_has_not_run_is_a_gap() {
    let dir = temporary_dir();
    for (number, missing) in [&[1][..], &[0, 2], &[0, 1, 2]].into_iter().enumerate() {
        let out = dir.path().join(number.to_string());
        fs::create_dir(&out).expect("a directory");
        parts_but(&SHARDS, &out, missing);
        let count = format!("{} of 3 tasks", missing.len());
        let first = format!("task {} has not run here", missing[0]);
        assert_gap(&SHARDS, &out, missing, &[&count, &first]);
    }
    // Nothing is made of nothing.
    let absent = dir.path().join("absent");
    assert_says(&temporary(run(&mut SHARDS.merge(&absent, 3))), &["3 of 3 tasks"]);
    assert!(!absent.exists());
}

/// Tasks without items count as well: nobody else can tell that they had none.
#[test]
fn a_task_without_items_must_have_run() {
    let dir = temporary_dir();
    for index in 0..10 {
        run(&mut SHARDS.task(dir.path(), index, 11)).succeeds();
    }
    let message = temporary(run(&mut SHARDS.merge(dir.path(), 11)));
    assert_says(&message, &["task 10 has not run here"]);
}

/// What a kill leaves of a journal.
type Cut = fn(&str) -> String;

#[test]
fn an_interrupted_task_is_a_gap() {
    // Without its last line, without its last item, and torn in the middle of a line.
    let cuts: [(&str, Cut); 3] = [
        ("interrupted at its end", |text| {
            let lines: Vec<&str> = text.lines().collect();
            lines[..lines.len() - 1].join("\n")
        }),
        ("interrupted before", |text| {
            let lines: Vec<&str> = text.lines().collect();
            lines[..lines.len() - 2].join("\n")
        }),
        ("interrupted before", |text| text[..text.len() / 2].to_owned()),
    ];
    for (reason, cut) in cuts {
        let dir = temporary_dir();
        parts_but(&SHARDS, dir.path(), &[]);
        let path = dir.path().join(journal(2, 3));
        let text = String::from_utf8(read(&path)).expect("text");
        write(&path, cut(&text));
        assert_gap(&SHARDS, dir.path(), &[2], &["task 2 was", reason]);
    }
}

#[test]
fn a_damaged_or_missing_file_is_a_gap() {
    let harm: [fn(&Path); 2] =
        [|path| write(path, "damaged"), |path| fs::remove_file(path).expect("removed")];
    for stage in [&*SHARDS, &*TILES, &*SCENES] {
        for harm in harm {
            let dir = temporary_dir();
            parts_but(stage, dir.path(), &[0, 2]);
            let files = tree(dir.path()).into_keys().filter(|name| !name.starts_with('.'));
            let file = files.max().expect("a file");
            parts_but(stage, dir.path(), &[1]);
            harm(&dir.path().join(&file));
            assert_gap(stage, dir.path(), &[1], &["task 1 wrote", &file, "damaged or missing"]);
        }
    }
}

/// The done-marker covers what the journal says of items, not only the files.
#[test]
fn a_changed_journal_is_a_gap() {
    let dir = temporary_dir();
    parts_but(&TILES, dir.path(), &[]);
    let path = dir.path().join(journal(1, 3));
    let text = String::from_utf8(read(&path)).expect("text");
    let changed = text.replacen("\"buildings\":", "\"buildings\":9", 1);
    assert_ne!(text, changed);
    write(&path, changed);
    let message = temporary(run(&mut TILES.merge(dir.path(), 3)));
    assert_says(&message, &["1 of 3 tasks", "task 1"]);
}

// Whose a directory is -------------------------------------------------------------------

#[test]
fn tasks_of_other_inputs_or_another_number_are_refused() {
    let dir = temporary_dir();
    parts_but(&SHARDS, dir.path(), &[2]);
    let before = tree(dir.path());
    let other = |command: &mut Command| permanent(run(command.args(["--zstd-level", "1"])));
    for command in [&mut SHARDS.task(dir.path(), 2, 3), &mut SHARDS.merge(dir.path(), 3)] {
        assert_says(&other(command), &["other inputs or another configuration", "remove this one"]);
    }
    let counts = [&mut SHARDS.task(dir.path(), 1, 4), &mut SHARDS.merge(dir.path(), 4)];
    for command in counts {
        assert_says(&permanent(run(command)), &["parts of 3 tasks", "4 tasks"]);
    }
    // The tiles know nothing of shards.
    assert_says(&permanent(run(&mut TILES.task(dir.path(), 0, 3))), &["dataset of another stage"]);
    assert_same_files(&tree(dir.path()), &before);
    let foreign = temporary_dir();
    write(&foreign.path().join("thesis.tex"), "ten years of work");
    assert_says(&permanent(run(&mut SHARDS.task(foreign.path(), 0, 3))), &["thesis.tex"]);
    assert_eq!(tree(foreign.path()).len(), 1);
}

/// A single run goes on with what tasks have built, and replaces what others have with
/// `--overwrite`.
#[test]
fn a_single_run_takes_over_what_tasks_left() {
    let dir = temporary_dir();
    let out = dir.path().join("taken-over");
    parts_but(&SHARDS, &out, &[0]);
    run(&mut (SHARDS.command)(&out)).succeeds();
    assert_same_files(&tree(&out), &SHARDS.expected());

    let out = dir.path().join("replaced");
    parts_but(&SHARDS, &out, &[0]);
    let other = || {
        let mut command = (SHARDS.command)(&out);
        command.args(["--zstd-level", "1"]);
        command
    };
    assert_says(&run(&mut other()).refused(), &["--overwrite"]);
    run(other().arg("--overwrite")).succeeds();
    run(&mut verify(&out)).succeeds();
}

/// What a killed single run left is its own, and tasks say so.
#[test]
fn tasks_do_not_mix_with_a_single_run() {
    let dir = temporary_dir();
    write(&dir.path().join(".holescout-build.jsonl"), plan_of(&SHARDS));
    for command in [&mut SHARDS.task(dir.path(), 0, 2), &mut SHARDS.merge(dir.path(), 2)] {
        assert_says(&permanent(run(command)), &["interrupted run without --task-count"]);
    }
    assert_eq!(tree(dir.path()).len(), 1, "nothing is left of the refused");
}

// Exit codes -----------------------------------------------------------------------------

#[test]
fn what_no_retry_can_help_exits_with_42() {
    let dir = temporary_dir();
    let out = dir.path().join("out");
    let with = |args: &[&str]| run((SHARDS.command)(&out).args(args));
    let usage: [(&[&str], &str); 9] = [
        (&["--task-index", "3", "--task-count", "3"], "task 3 of 3"),
        (&["--task-index", "0", "--task-count", "0"], "1 or more"),
        (&["--task-index=-1", "--task-count", "3"], "--task-index"),
        (&["--task-index", "0"], "--task-count"),
        (&["--merge"], "--task-count"),
        (&["--merge", "--task-index", "0", "--task-count", "3"], "--merge"),
        (&["--task-index", "0", "--task-count", "3", "--overwrite"], "remove the directory"),
        (&["--merge", "--task-count", "3", "--overwrite"], "remove the directory"),
        (&["--task-index", "0", "--task-count", "3", "--colour"], "--colour"),
    ];
    for (args, word) in usage {
        assert_says(&permanent(with(args)), &[word]);
    }
    // Of a configuration and of inputs that are wrong.
    assert_says(
        &permanent(with(&["--task-index", "0", "--task-count", "2", "--val", "7"])),
        &["split.val"],
    );
    let mut absent = import(&dir.path().join("absent"), &HELSINKI.tiles, &out);
    permanent(run(absent.args(["--task-index", "0", "--task-count", "2"])));
    assert!(!out.exists());
    // The same without tasks.
    assert_eq!(with(&["--val", "7"]).code, Some(3));
    assert_eq!(with(&["--colour"]).code, Some(2));
}

#[test]
fn a_failing_machine_exits_with_1() {
    // Nobody can make a directory there.
    let ended = run(&mut SHARDS.task(Path::new("/proc/holescout"), 0, 2));
    assert_says(&temporary(ended), &["cannot create"]);
}

/// A task, a merge and a single run wait for whoever works on the same part: the engine is to try
/// again. Here this test is the other run.
#[test]
fn a_task_that_runs_already_is_not_disturbed() {
    let dir = temporary_dir();
    parts_but(&SHARDS, dir.path(), &[1]);
    let held = fs::File::create(dir.path().join(journal(1, 3))).expect("a journal");
    held.lock().expect("locked");
    let before = tree(dir.path());
    for command in [
        &mut SHARDS.task(dir.path(), 1, 3),
        &mut SHARDS.merge(dir.path(), 3),
        &mut (SHARDS.command)(dir.path()),
        (SHARDS.command)(dir.path()).arg("--overwrite"),
    ] {
        assert_says(&temporary(run(command)), &["another run"]);
        assert_same_files(&tree(dir.path()), &before);
    }
    drop(held);
    // A task waits for a single run as well.
    let single = fs::File::create(dir.path().join(".holescout-build.jsonl")).expect("a journal");
    single.lock().expect("locked");
    assert_says(&temporary(run(&mut SHARDS.task(dir.path(), 1, 3))), &["another run"]);
    drop(single);
    fs::remove_file(dir.path().join(".holescout-build.jsonl")).expect("removed");
    run(&mut SHARDS.task(dir.path(), 1, 3)).succeeds();
    run(&mut SHARDS.merge(dir.path(), 3)).succeeds();
    assert_same_files(&tree(dir.path()), &SHARDS.expected());
}

// The environment ------------------------------------------------------------------------

const VARIABLES: [&str; 5] = [
    "SLURM_ARRAY_TASK_ID",
    "JOB_COMPLETION_INDEX",
    "AWS_BATCH_JOB_ARRAY_INDEX",
    "SLURM_ARRAY_TASK_COUNT",
    "AWS_BATCH_JOB_ARRAY_SIZE",
];

fn with_variables(out: &Path, args: &[&str], variables: &[(&str, &str)]) -> Command {
    let mut command = (SHARDS.command)(out);
    for name in VARIABLES {
        command.env_remove(name);
    }
    command.args(args).envs(variables.iter().copied());
    command
}

#[test]
fn engines_tell_a_task_which_it_is() {
    let dir = temporary_dir();
    for (index, name) in VARIABLES[..3].iter().enumerate() {
        let index = index.to_string();
        let variables = [(*name, index.as_str())];
        let mut command = with_variables(dir.path(), &["--task-count", "3"], &variables);
        assert_eq!(summary(&mut command)["task"].to_string(), index);
    }
    run(&mut SHARDS.merge(dir.path(), 3)).succeeds();
    assert_same_files(&tree(dir.path()), &SHARDS.expected());

    let dir = temporary_dir();
    let engines = [("SLURM_ARRAY_TASK_ID", VARIABLES[3]), (VARIABLES[2], VARIABLES[4])];
    for (index, (name, count)) in engines.into_iter().enumerate() {
        let index = index.to_string();
        let variables = [(name, index.as_str()), (count, "2")];
        let mut command = with_variables(dir.path(), &["--task-count", "auto"], &variables);
        assert_eq!(summary(&mut command)["of"], 2);
    }
    run(&mut SHARDS.merge(dir.path(), 2)).succeeds();
    // What is given counts, and what is not there is named.
    let both = ["--task-count", "2", "--task-index", "1"];
    let said = summary(&mut with_variables(dir.path(), &both, &[(VARIABLES[0], "7")]));
    assert_eq!(said["whole"], true);
    let mut lost = with_variables(dir.path(), &["--task-count", "2"], &[]);
    assert_says(&permanent(run(&mut lost)), &VARIABLES[..3]);
    let mut lost = with_variables(dir.path(), &["--task-count", "auto"], &[(VARIABLES[0], "1")]);
    assert_says(&permanent(run(&mut lost)), &VARIABLES[3..]);
}

/// An array job over cities must not be split by surprise.
#[test]
fn the_environment_alone_splits_nothing() {
    let dir = temporary_dir();
    let variables = VARIABLES.map(|name| (name, "1"));
    run(&mut with_variables(dir.path(), &[], &variables)).succeeds();
    assert_same_files(&tree(dir.path()), &SHARDS.expected());
}

// Kills ----------------------------------------------------------------------------------

/// SIGKILL, again and again, at seeded times; two tasks at a time, as on a cluster.
#[test]
fn killed_tasks_are_completed() {
    let mut random = Random(21);
    for stage in [&*SHARDS, &*MAPS, &*TILES] {
        let dir = temporary_dir();
        let out = dir.path().join("out");
        let spawn = |index| {
            let mut command = stage.task(&out, index, 3);
            let quiet = command.stdout(Stdio::null()).stderr(Stdio::null());
            quiet.spawn().expect("started")
        };
        for _ in 0..6 {
            let first = random.below(3) as u32;
            let mut children = [spawn(first), spawn((first + 1) % 3)];
            sleep(Duration::from_millis(random.below(600) as u64));
            for child in &mut children {
                child.kill().expect("killed, or ended before");
                child.wait().expect("reaped");
            }
        }
        let merged = run(&mut stage.merge(&out, 3));
        if merged.code != Some(0) {
            temporary(merged);
            parts_but(stage, &out, &[]);
            run(&mut stage.merge(&out, 3)).succeeds();
        }
        assert_same_files(&tree(&out), &stage.expected());
    }
}

/// A killed merge leaves nothing that the next one cannot complete.
#[test]
fn a_killed_merge_is_completed() {
    let mut random = Random(22);
    for _ in 0..6 {
        let dir = temporary_dir();
        parts_but(&SHARDS, dir.path(), &[]);
        let mut merge = SHARDS.merge(dir.path(), 3);
        let mut child = merge.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("started");
        sleep(Duration::from_micros(random.below(60_000) as u64));
        child.kill().expect("killed, or ended before");
        child.wait().expect("reaped");
        run(&mut SHARDS.merge(dir.path(), 3)).succeeds();
        assert_same_files(&tree(dir.path()), &SHARDS.expected());
    }
}

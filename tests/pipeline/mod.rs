//! What the tests of the stages after `rasterise` share: the command as a process, the
//! fixtures, and directories compared byte by byte.

#![allow(dead_code, reason = "each test binary uses a part of it")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

use serde_json::Value;
use tempfile::TempDir;

pub(crate) mod importing;
pub(crate) mod maps;
pub(crate) mod numpy;
pub(crate) mod repeats;
#[cfg(feature = "torch")]
pub(crate) mod training;

/// Files of a directory tree by relative path.
pub(crate) type Tree = BTreeMap<String, Vec<u8>>;

// The command ----------------------------------------------------------------------------

/// The command, with a subcommand and without progress.
pub(crate) fn holescout(subcommand: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_holescout"));
    command.args([subcommand, "--quiet"]);
    command
}

/// How a run ended.
#[derive(Debug)]
pub(crate) struct Run {
    /// `None` if a signal ended it.
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// Runs a command to its end.
pub(crate) fn run(command: &mut Command) -> Run {
    command.output().expect("the command starts").into()
}

impl From<Output> for Run {
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code(),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

impl Run {
    /// Demands success; returns standard output.
    pub(crate) fn succeeds(self) -> String {
        assert_eq!(self.code, Some(0), "should succeed: {self:#?}");
        self.stdout
    }

    /// Demands exit code 3; returns everything that was said.
    pub(crate) fn refused(self) -> String {
        assert_eq!(self.code, Some(3), "should be refused as invalid: {self:#?}");
        [self.stdout, self.stderr].concat()
    }
}

/// Demands that a message holds each of some words.
pub(crate) fn assert_says(message: &str, words: &[&str]) {
    for word in words {
        assert!(message.contains(word), "{word:?} is not in: {message}");
    }
}

// Stages ---------------------------------------------------------------------------------

/// A file of `fixtures/`.
pub(crate) fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name)
}

/// The configuration of the Helsinki fixtures.
pub(crate) fn helsinki_config() -> PathBuf {
    fixture("helsinki/holescout.toml")
}

/// An empty directory that stays until the next run of the tests, for what a whole test
/// binary shares (a static is never dropped, so a temporary directory would pile up).
pub(crate) fn shared_dir(name: &str) -> PathBuf {
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    if dir.exists() {
        fs::remove_dir_all(&dir).expect("the earlier run's directory goes");
    }
    fs::create_dir_all(&dir).expect("a directory");
    dir
}

/// A directory of one test.
pub(crate) fn temporary_dir() -> TempDir {
    tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).expect("a directory")
}

/// `rasterise` of the Helsinki extract.
pub(crate) fn rasterise(out: &Path) -> Command {
    let mut command = holescout("rasterise");
    command.arg("--osm").arg(fixture("helsinki/helsinki.osm.pbf"));
    command.arg("--config").arg(helsinki_config());
    command.arg("--out").arg(out);
    command
}

/// `import-rsrp` of a directory of maps.
pub(crate) fn import(maps: &Path, tiles: &Path, out: &Path) -> Command {
    let mut command = holescout("import-rsrp");
    command.arg("--maps").arg(maps).arg("--tiles").arg(tiles);
    command.arg("--config").arg(helsinki_config());
    command.arg("--out").arg(out);
    command
}

/// `shard` of tiles and imported maps.
pub(crate) fn shard(tiles: &Path, rsrp: &Path, out: &Path) -> Command {
    let mut command = holescout("shard");
    command.arg("--tiles").arg(tiles).arg("--rsrp").arg(rsrp);
    command.arg("--config").arg(helsinki_config());
    command.arg("--out").arg(out);
    command
}

/// `release` of a dataset.
pub(crate) fn release(dataset: &Path, version: &str, out: &Path) -> Command {
    let mut command = holescout("release");
    command.arg(dataset).arg("--version").arg(version).arg("--out").arg(out);
    command.env_remove("SOURCE_DATE_EPOCH");
    command
}

/// `verify` of any stage's output.
pub(crate) fn verify(directory: &Path) -> Command {
    let mut command = holescout("verify");
    command.arg(directory);
    command
}

/// The outputs of the three stages.
pub(crate) struct Stages {
    pub(crate) tiles: PathBuf,
    pub(crate) rsrp: PathBuf,
    pub(crate) dataset: PathBuf,
}

/// The three stages of the Helsinki fixtures, run once for each test binary.
pub(crate) static HELSINKI: LazyLock<Stages> = LazyLock::new(|| {
    let root = shared_dir(concat!("helsinki-", env!("CARGO_CRATE_NAME")));
    let stages = Stages {
        tiles: root.join("tiles"),
        rsrp: root.join("rsrp"),
        dataset: root.join("dataset"),
    };
    let Stages { tiles, rsrp, dataset } = &stages;
    run(&mut rasterise(tiles)).succeeds();
    run(&mut import(&fixture("helsinki/rsrp"), tiles, rsrp)).succeeds();
    run(&mut shard(tiles, rsrp, dataset)).succeeds();
    stages
});

/// Shards of a dataset of the fixtures (the fifth and the sixth), and its other files.
pub(crate) const DATASET_FILES: [&str; 7] = [
    "NOTICE",
    "README.md",
    "SHA256SUMS",
    "manifest.json",
    "train/shard-00000.msgpack.zst",
    "val/shard-00000.msgpack.zst",
    "croissant.json",
];

// Files ----------------------------------------------------------------------------------

/// A file's bytes.
pub(crate) fn read(path: &Path) -> Vec<u8> {
    fs::read(path).unwrap_or_else(|error| panic_with(&format!("{}: {error}", path.display())))
}

/// A file's JSON.
pub(crate) fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&read(path)).expect("JSON")
}

/// Writes a file.
pub(crate) fn write(path: &Path, bytes: impl AsRef<[u8]>) {
    fs::create_dir_all(path.parent().expect("a directory")).expect("a directory");
    fs::write(path, bytes).expect("written");
}

#[expect(clippy::panic, reason = "a failed test")]
fn panic_with(message: &str) -> ! {
    panic!("{message}")
}

/// All files below a directory, empty directories excepted.
pub(crate) fn tree(root: &Path) -> Tree {
    fn collect(root: &Path, directory: &Path, files: &mut Tree) {
        for entry in fs::read_dir(directory).expect("listed") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                collect(root, &path, files);
            } else {
                let name = path.strip_prefix(root).expect("below the root");
                files.insert(name.to_string_lossy().into_owned(), read(&path));
            }
        }
    }
    let mut files = Tree::new();
    collect(root, root, &mut files);
    files
}

/// Writes a tree of files.
pub(crate) fn plant(root: &Path, files: &Tree) {
    for (name, bytes) in files {
        write(&root.join(name), bytes);
    }
}

/// Demands that two directories hold the same files with the same bytes.
pub(crate) fn assert_same_files(found: &Tree, expected: &Tree) {
    let names = |files: &Tree| files.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(found), names(expected), "the same files");
    for (name, bytes) in found {
        assert!(*bytes == expected[name], "{name} differs");
    }
}

/// A stage's output in a directory of its own.
pub(crate) fn copy_of(output: &Path) -> (TempDir, PathBuf, Tree) {
    let dir = temporary_dir();
    let (copy, files) = (dir.path().join("copy"), tree(output));
    plant(&copy, &files);
    (dir, copy, files)
}

/// SHA-256 as hexadecimal digits.
pub(crate) fn sha256(bytes: &[u8]) -> String {
    use sha2::{Digest, Sha256};
    let digest = Sha256::digest(bytes);
    let digits: Vec<String> = digest.iter().map(|byte| format!("{byte:02x}")).collect();
    digits.concat()
}

// Random numbers -------------------------------------------------------------------------

/// `SplitMix64`: the same numbers on every machine.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Below `end`.
    pub(crate) fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }

    /// From 0 to 1.
    pub(crate) fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

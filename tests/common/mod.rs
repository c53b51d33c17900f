//! What the integration tests share: running the command, reading directories, seeded numbers.
#![allow(dead_code, reason = "every test is a crate of its own and uses another part of this")]

pub(crate) mod pbf;

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use holescout::store::{NpzReader, read_npy};
use ndarray::Array2;

/// Exit codes of the command.
pub(crate) const FAILED_WHILE_RUNNING: i32 = 1;
pub(crate) const WRONG_USAGE: i32 = 2;
pub(crate) const INVALID_INPUT: i32 = 3;

/// Limits for runs on hostile files: a run that needs more has lost its bounds.
const MAX_MEMORY_KIB: u32 = 4 << 20;
const MAX_CPU_S: u32 = 10;

/// A file of `fixtures/`.
pub(crate) fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name)
}

/// The extract of central Helsinki.
pub(crate) fn helsinki() -> PathBuf {
    fixture("helsinki/helsinki.osm.pbf")
}

/// An empty directory that is removed in the end.
pub(crate) fn scratch() -> tempfile::TempDir {
    tempfile::tempdir().expect("temporary directories can be made")
}

/// The bytes of a file.
pub(crate) fn read(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Makes a file.
pub(crate) fn write(path: &Path, bytes: impl AsRef<[u8]>) {
    std::fs::write(path, bytes).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}

/// `height_m` and `height_source` of a tile.
pub(crate) fn tile_grids(path: &Path) -> (Array2<f32>, Array2<u8>) {
    let mut archive = NpzReader::open(path, 1 << 24).expect("the tile was written");
    let heights = archive.member("height_m").expect("tiles hold heights");
    let sources = archive.member("height_source").expect("tiles hold sources");
    let heights = read_npy(&heights).and_then(|npy| npy.to_array2());
    let sources = read_npy(&sources).and_then(|npy| npy.to_array2());
    (heights.expect("heights are float32"), sources.expect("sources are uint8"))
}

/// Arguments of different types as one list.
#[macro_export]
macro_rules! args {
    ($($arg:expr),* $(,)?) => {
        [$(::std::ffi::OsString::from($arg)),*]
    };
}

/// The command `holescout`, without terminal.
pub(crate) fn holescout() -> Command {
    quiet(Command::new(env!("CARGO_BIN_EXE_holescout")))
}

/// The command `holescout` after some shell commands that set limits.
pub(crate) fn holescout_after(shell: &str) -> Command {
    let mut command = Command::new("sh");
    command.args(["-c", &format!("{shell}; exec \"$0\" \"$@\"")]);
    command.arg(env!("CARGO_BIN_EXE_holescout"));
    quiet(command)
}

/// The command `holescout` with bounds on memory and time: whatever exceeds them is ended
/// by a signal, or aborts.
pub(crate) fn bounded_holescout() -> Command {
    holescout_after(&format!("ulimit -v {MAX_MEMORY_KIB}; ulimit -t {MAX_CPU_S}"))
}

fn quiet(mut command: Command) -> Command {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// How a run ended.
#[derive(Debug)]
pub(crate) struct Run {
    /// `None` if a signal ended it.
    pub(crate) code: Option<i32>,
    pub(crate) signal: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl From<Output> for Run {
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code(),
            signal: output.status.signal(),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

impl Run {
    /// The last line of standard output as JSON.
    pub(crate) fn summary(&self) -> serde_json::Value {
        let last = self.stdout.lines().last().unwrap_or_default();
        serde_json::from_str(last)
            .unwrap_or_else(|error| panic!("{last:?} is no JSON ({error}): {self:?}"))
    }

    /// This run, which must have succeeded.
    pub(crate) fn succeeded(self) -> Self {
        assert_eq!(self.code, Some(0), "{self:?}");
        self
    }
}

/// Runs a command with further arguments to its end.
pub(crate) fn run_command<A: AsRef<OsStr>>(
    mut command: Command,
    args: impl IntoIterator<Item = A>,
) -> Run {
    let output = command.args(args).output().expect("the command starts");
    output.into()
}

/// Runs `holescout` to its end.
pub(crate) fn run<A: AsRef<OsStr>>(args: impl IntoIterator<Item = A>) -> Run {
    run_command(holescout(), args)
}

/// All files below a directory by their relative paths; nothing if there is no directory.
pub(crate) fn files(directory: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut pending = vec![directory.to_owned()];
    while let Some(next) = pending.pop() {
        let Ok(entries) = std::fs::read_dir(&next) else {
            assert!(!next.exists(), "{} cannot be listed", next.display());
            continue;
        };
        for entry in entries {
            let path = entry.expect("directories can be listed").path();
            if path.is_dir() {
                pending.push(path);
            } else {
                let name = path.strip_prefix(directory).expect("it lies below");
                found.insert(name.to_string_lossy().into_owned(), read(&path));
            }
        }
    }
    found
}

/// What differs between two directories, as a text that fits on a screen.
pub(crate) fn differences(
    one: &BTreeMap<String, Vec<u8>>,
    other: &BTreeMap<String, Vec<u8>>,
) -> Vec<String> {
    let mut names: Vec<_> = one.keys().chain(other.keys()).collect();
    names.sort();
    names.dedup();
    names
        .into_iter()
        .filter_map(|name| match (one.get(name), other.get(name)) {
            (Some(a), Some(b)) if a == b => None,
            (Some(a), Some(b)) => Some(format!("{name}: {} bytes, {} bytes", a.len(), b.len())),
            (Some(_), None) => Some(format!("{name}: only in the first")),
            (None, _) => Some(format!("{name}: only in the second")),
        })
        .collect()
}

/// Seeded numbers (`SplitMix64`), the same on every machine.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A number below `end`.
    pub(crate) fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }
}

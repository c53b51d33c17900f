//! The source keeps its order: modules import only from lower ones, each foreign format has
//! one place, the library prints nothing, files stay short enough to read.
//!
//! The source is read as text without comments, strings and characters; every rule is also
//! shown to find a made-up violation.
#![allow(
    clippy::panic,
    clippy::too_many_lines,
    reason = "helpers of tests fail by panicking; tables of cases are long"
)]

use std::path::{Path, PathBuf};

/// Modules of the library, lowest first; each imports only from lower lines.
const LEVELS: [&[&str]; 13] = [
    &["units", "error", "progress", "random", "config"],
    &["crs", "reliability"],
    &["grid"],
    &["building"],
    &["store"],
    &["manifest"],
    &["osm", "rasterise", "scene", "radio_map"],
    &["dataset"],
    &["rl"],
    &["evaluate"],
    &["train"],
    &["release"],
    &["rebuild"],
];
/// Imports within a level that are allowed nevertheless: (importing, imported).
const WITHIN_LEVEL: [(&str, &str); 5] = [
    ("config", "units"),
    ("config", "error"),
    ("rasterise", "osm"),
    ("scene", "osm"),
    ("scene", "rasterise"),
];
/// Crates that are named below one path only.
const ONLY_BELOW: [(&str, &str); 7] = [
    ("osmpbfreader", "src/osm"),
    ("protobuf", "src/osm"),
    ("clap", "pipeline"),
    ("indicatif", "pipeline"),
    ("tch", "src/rl/agent"),
    ("safetensors", "src/rl/agent"),
    ("forust_ml", "src/evaluate/fitted"),
];
/// Macros and functions that only the command may use.
const PRINTING: [&str; 6] = ["println!", "eprintln!", "print!", "eprint!", "dbg!", "process::exit"];
const MAX_LINES: usize = 500;
const MAX_STAGE_LINES: usize = 120;
/// Files of `pipeline/` that are no stages but what all stages share.
const SHARED_BY_STAGES: [&str; 4] = ["main.rs", "cli.rs", "console.rs", "failure.rs"];

/// A source file: its path from the root of the repository, with `/`, and its text.
struct Source {
    path: String,
    text: String,
}

impl Source {
    /// The top-level module of the library that it belongs to.
    fn module(&self) -> Option<&str> {
        let below = self.path.strip_prefix("src/")?;
        let first = below.split('/').next().expect("split gives at least one");
        let module = first.strip_suffix(".rs").unwrap_or(first);
        (module != "lib").then_some(module)
    }

    /// How many `super::` lead to the crate's root.
    fn depth(&self) -> usize {
        let parts = self.path.split('/').count() - 1;
        if self.path.ends_with("/mod.rs") { parts - 1 } else { parts }
    }
}

/// The text with comments, strings and characters blanked out; lines stay where they are.
fn code(text: &str) -> String {
    let chars: Vec<char> = text.chars().collect();
    let mut code = String::with_capacity(text.len());
    let mut at = 0;
    while at < chars.len() {
        let Some(end) = blank_end(&chars, at) else {
            code.push(chars[at]);
            at += 1;
            continue;
        };
        let blanked = chars[at..end.min(chars.len())].iter();
        code.extend(blanked.map(|&c| if c == '\n' { '\n' } else { ' ' }));
        at = end;
    }
    code
}

/// Where the comment, string or character that begins here ends; `None` if none does.
fn blank_end(chars: &[char], at: usize) -> Option<usize> {
    let is = |offset: usize, wanted: char| chars.get(at + offset) == Some(&wanted);
    let after_word = at > 0 && is_word(chars[at - 1]);
    match chars[at] {
        '/' if is(1, '/') => Some(find(chars, at, |rest| rest[0] == '\n')),
        '/' if is(1, '*') => Some(block_comment_end(chars, at)),
        '"' => Some(string_end(chars, at)),
        'r' if !after_word || chars[at - 1] == 'b' => raw_string_end(chars, at),
        '\'' if is(1, '\\') => Some(find(chars, at + 3, |rest| rest[0] == '\'') + 1),
        // Anything else that does not close after one character is a lifetime.
        '\'' if is(2, '\'') => Some(at + 3),
        _ => None,
    }
}

fn find(chars: &[char], from: usize, wanted: impl Fn(&[char]) -> bool) -> usize {
    (from..chars.len()).find(|&at| wanted(&chars[at..])).unwrap_or(chars.len())
}

fn block_comment_end(chars: &[char], from: usize) -> usize {
    let (mut depth, mut at) = (0, from);
    while at < chars.len() {
        match chars[at..] {
            ['/', '*', ..] => (depth, at) = (depth + 1, at + 2),
            ['*', '/', ..] => (depth, at) = (depth - 1, at + 2),
            _ => at += 1,
        }
        if depth == 0 {
            break;
        }
    }
    at
}

fn string_end(chars: &[char], from: usize) -> usize {
    let mut at = from + 1;
    while at < chars.len() && chars[at] != '"' {
        at += if chars[at] == '\\' { 2 } else { 1 };
    }
    at + 1
}

fn raw_string_end(chars: &[char], from: usize) -> Option<usize> {
    let hashes = chars[from + 1..].iter().take_while(|&&c| c == '#').count();
    if chars.get(from + 1 + hashes) != Some(&'"') {
        return None;
    }
    let closes = |rest: &[char]| {
        rest[0] == '"' && rest.len() > hashes && rest[1..=hashes].iter().all(|&c| c == '#')
    };
    Some(find(chars, from + 2 + hashes, closes) + 1 + hashes)
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Words and single other characters, without white space.
fn tokens(code: &str) -> Vec<&str> {
    let mut tokens = Vec::new();
    let mut rest = code.trim_start();
    while let Some(first) = rest.chars().next() {
        let end = if is_word(first) {
            rest.find(|c| !is_word(c)).unwrap_or(rest.len())
        } else {
            first.len_utf8()
        };
        tokens.push(&rest[..end]);
        rest = rest[end..].trim_start();
    }
    tokens
}

/// The first words of a path's continuation: `a::b` gives `a`, `{a::b, c as d}` gives `a`, `c`.
fn first_words<'a>(tokens: &[&'a str]) -> Vec<&'a str> {
    match tokens {
        ["{", group @ ..] => {
            let mut words = Vec::new();
            let (mut depth, mut fresh) = (0, true);
            for &token in group {
                match token {
                    "}" if depth == 0 => break,
                    "}" => depth -= 1,
                    "{" => depth += 1,
                    "," if depth == 0 => fresh = true,
                    word if depth == 0 && fresh => {
                        words.push(word);
                        fresh = false;
                    }
                    _ => {}
                }
            }
            words
        }
        [word, ..] => vec![word],
        [] => vec![],
    }
}

/// Modules named by `crate::...`, and by as many `super::` as lead to the root.
fn imports(source: &Source) -> Vec<String> {
    let everything = code(&source.text);
    let mut found = Vec::new();
    let all = tokens(&everything);
    for at in 0..all.len() {
        if let ["crate", ":", ":", rest @ ..] = &all[at..] {
            found.extend(first_words(rest));
        }
    }
    let without_tests = without_tests(&everything);
    let outside = tokens(&without_tests);
    let chain = ["super", ":", ":"].repeat(source.depth());
    for at in 0..outside.len() {
        let begins = at < 3 || outside[at - 3..at] != ["super", ":", ":"];
        if let Some(rest) = outside[at..].strip_prefix(&chain[..])
            && begins
        {
            found.extend(first_words(rest));
        }
    }
    found.into_iter().map(str::to_owned).collect()
}

/// The code before its `#[cfg(test)]` module, which comes last in every file.
fn without_tests(code: &str) -> String {
    let is_test_module = |rest: &str| {
        let mut after = rest.lines().skip(1).map(str::trim);
        after.next().is_some_and(|line| line.starts_with("mod ") && line.ends_with('{'))
    };
    let mut from = 0;
    while let Some(at) = code[from..].find("#[cfg(test)]") {
        if is_test_module(&code[from + at..]) {
            return code[..from + at].to_owned();
        }
        from += at + 1;
    }
    code.to_owned()
}

fn level(module: &str) -> Option<usize> {
    LEVELS.iter().position(|level| level.contains(&module))
}

/// What a file does against the order of the modules.
fn order_violations(source: &Source) -> Vec<String> {
    let Some(module) = source.module() else {
        return vec![];
    };
    let path = &source.path;
    let Some(own) = level(module) else {
        return vec![format!("{path}: module {module} has no level, add it to LEVELS")];
    };
    let mut violations: Vec<String> = imports(source)
        .into_iter()
        .filter(|import| import != module)
        .filter_map(|import| match level(&import) {
            None => Some(format!("{path}: {import} has no level, add it to LEVELS")),
            Some(other) if other < own => None,
            _ if WITHIN_LEVEL.contains(&(module, import.as_str())) => None,
            Some(_) => Some(format!("{path}: {module} must not import {import}")),
        })
        .collect();
    violations.dedup();
    violations
}

/// Crates that a file names though they have their place elsewhere.
fn place_violations(source: &Source) -> Vec<String> {
    let code = code(&source.text);
    let words = tokens(&code);
    let is_below = |place: &str| {
        let rest = source.path.strip_prefix(place);
        rest.is_some_and(|rest| rest.starts_with('/') || rest == ".rs")
    };
    ONLY_BELOW
        .iter()
        .filter(|(name, place)| words.contains(name) && !is_below(place))
        .map(|(name, place)| format!("{}: {name} belongs below {place}", source.path))
        .collect()
}

/// What a file of the library prints, and whether it ends the process.
fn printing_violations(source: &Source) -> Vec<String> {
    if source.module().is_none() && source.path != "src/lib.rs" {
        return vec![];
    }
    let code = code(&source.text);
    let words = tokens(&code);
    let uses = |forbidden: &str| {
        let wanted = tokens(forbidden);
        words.windows(wanted.len()).any(|window| window == wanted)
    };
    PRINTING
        .iter()
        .filter(|forbidden| uses(forbidden))
        .map(|forbidden| format!("{}: the library must not use {forbidden}", source.path))
        .collect()
}

/// A file that is too long, its unit tests apart.
fn length_violations(source: &Source) -> Vec<String> {
    let name = source.path.rsplit('/').next().expect("split gives at least one");
    let is_stage = source.path.starts_with("pipeline/") && !SHARED_BY_STAGES.contains(&name);
    let most = if is_stage { MAX_STAGE_LINES } else { MAX_LINES };
    // Blanked strings and comments keep their lines.
    let lines = without_tests(&code(&source.text)).lines().count();
    let too_long = lines > most;
    too_long
        .then(|| format!("{}: {lines} lines, at most {most}", source.path))
        .into_iter()
        .collect()
}

fn violations(source: &Source) -> Vec<String> {
    [
        order_violations(source),
        place_violations(source),
        printing_violations(source),
        length_violations(source),
    ]
    .concat()
}

/// All Rust files below some folders of the repository.
fn sources(folders: &[&str]) -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut pending: Vec<PathBuf> = folders.iter().map(|folder| root.join(folder)).collect();
    let mut sources = Vec::new();
    while let Some(folder) = pending.pop() {
        for entry in std::fs::read_dir(&folder).expect("the folder is there") {
            let path = entry.expect("it can be listed").path();
            if path.is_dir() {
                pending.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let below = path.strip_prefix(root).expect("it lies below the root");
                sources.push(Source {
                    path: below.to_string_lossy().replace('\\', "/"),
                    text: std::fs::read_to_string(&path).expect("source is UTF-8"),
                });
            }
        }
    }
    sources.sort_by(|a, b| a.path.cmp(&b.path));
    sources
}

#[test]
fn the_source_keeps_its_order() {
    let sources = sources(&["src", "pipeline"]);
    assert!(sources.len() > 20, "only {} files were found", sources.len());
    let violations: Vec<String> = sources.iter().flat_map(violations).collect();
    assert!(violations.is_empty(), "\n{}", violations.join("\n"));
}

/// The imports that are there are found, or the test above would pass on anything.
#[test]
fn real_imports_are_found() {
    let sources = sources(&["src"]);
    let source = |path: &str| {
        let mut found = sources.iter().filter(|source| source.path == path);
        found.next().unwrap_or_else(|| panic!("{path} is there"))
    };
    let stage = imports(source("src/rasterise/stage.rs"));
    for module in ["osm", "store", "manifest", "grid"] {
        assert!(stage.iter().any(|import| import == module), "{module} in {stage:?}");
    }
    let config = imports(source("src/config/mod.rs"));
    assert!(config.iter().any(|import| import == "error"), "{config:?}");
}

fn made_up(path: &str, text: &str) -> Vec<String> {
    violations(&Source { path: path.to_owned(), text: text.to_owned() })
}

#[test]
fn violations_are_found() {
    let cases = [
        ("src/crs/utm.rs", "use crate::grid::TileId;", "crs must not import grid"),
        ("src/grid/area.rs", "fn f(b: &crate::building::Building) {}", "must not import building"),
        (
            "src/grid.rs",
            "use crate::{\n config::X, building::{A, B}\n};",
            "must not import building",
        ),
        ("src/osm/block.rs", "use crate::rasterise::Scanline;", "osm must not import rasterise"),
        ("src/config.rs", "use crate::progress::Progress;", "must not import progress"),
        ("src/store/npz.rs", "use super::super::manifest::Input;", "must not import manifest"),
        ("src/store/npz.rs", "use super::super::{units, dataset};", "must not import dataset"),
        ("src/units.rs", "use super::store;", "units must not import store"),
        ("src/crs/mod.rs", "use super::store::Digest;", "crs must not import store"),
        ("src/wizardry.rs", "", "wizardry has no level"),
        ("src/crs/utm.rs", "use crate::wizardry::Wand;", "wizardry has no level"),
        ("src/scene/mesh.rs", "use osmpbfreader::Way;", "osmpbfreader belongs below src/osm"),
        ("src/osmosis.rs", "fn f() -> protobuf::Result<()> {}", "protobuf belongs below src/osm"),
        ("src/config.rs", "#[derive(clap::Args)] struct A;", "clap belongs below pipeline"),
        ("src/dataset.rs", "use tch::Tensor;", "tch belongs below src/rl"),
        ("pipeline/train.rs", "use tch::Tensor;", "tch belongs below src/rl"),
        ("src/lib.rs", "fn f() { println!(\"{}\", 1); }", "must not use println!"),
        ("src/crs.rs", "fn f() { std::process::exit(1) }", "must not use process::exit"),
        ("src/crs.rs", "fn f() { eprint! {\"\"} }", "must not use eprint!"),
    ];
    for (path, text, wanted) in cases {
        let found = made_up(path, text);
        assert!(found.iter().any(|line| line.contains(wanted)), "{text:?} gave {found:?}");
    }
    let long = "fn f() {}\n".repeat(MAX_LINES + 1);
    assert_eq!(made_up("src/units.rs", &long).len(), 1);
    assert_eq!(made_up("pipeline/console.rs", &long).len(), 1);
    let stage = "fn f() {}\n".repeat(MAX_STAGE_LINES + 1);
    assert_eq!(made_up("pipeline/train.rs", &stage).len(), 1);
}

#[test]
fn what_is_allowed_is_not_reported() {
    let tests_apart = format!(
        "fn f() {{}}\n#[cfg(test)]\nmod tests {{\n    use super::*;\n{}}}\n",
        "    fn g() {}\n".repeat(MAX_LINES)
    );
    let cases = [
        ("src/config.rs", "use crate::units::Dbm;\nimpl crate::error::HasFault for X {}"),
        ("src/rasterise/stage.rs", "use crate::osm::Extract;\nuse crate::rasterise::tile;"),
        ("src/osm/pbf.rs", "use osmpbfreader::fileformat::Blob;\nuse protobuf::Message;"),
        ("src/rl/agent/network.rs", "use tch::Tensor;"),
        ("src/store/npz.rs", "use super::npy::NpyError;\nuse super::super::units::Db;"),
        (
            "src/units.rs",
            "pub(crate) fn f() {}\nmod a {}\n#[cfg(test)]\nmod tests {\n use super::*;\n}",
        ),
        ("src/units.rs", "// use crate::store::X;\n/* println!() /* */ use crate::rl; */"),
        ("src/units.rs", "const A: &str = \"use crate::store; \\\" println!()\";"),
        ("src/units.rs", "const A: &str = r#\"\"use crate::rl::X;\"#; const Q: char = '\"';"),
        ("src/units.rs", "fn f<'a>(a: &'a str) -> &'a str { a } const C: char = '\\'';"),
        ("pipeline/main.rs", "fn main() { println!(); std::process::exit(1) }"),
        ("src/units.rs", &tests_apart),
    ];
    for (path, text) in cases {
        assert_eq!(made_up(path, text), Vec::<String>::new(), "{text:?}");
    }
}

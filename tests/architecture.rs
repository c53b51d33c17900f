//! The source keeps its order: modules import only from lower ones, no two files import from
//! each other, each foreign format has one place, no two types have one name, the library prints
//! nothing, files stay short enough to read.
//!
//! Files are read by `syn`; every rule is also shown to find a made-up violation.
#![allow(
    clippy::panic,
    clippy::too_many_lines,
    reason = "helpers of tests fail by panicking; tables of cases are long"
)]

#[path = "architecture/source.rs"]
mod source;

use std::collections::{BTreeMap, BTreeSet};

use source::{Crate, Source, sources};

/// Modules of the library, lowest first; each imports only from lower lines.
const LEVELS: [&[&str]; 14] = [
    &["units", "error", "progress", "random", "config"],
    &["crs", "reliability"],
    &["grid"],
    &["building"],
    &["store"],
    &["manifest"],
    &["osm", "rasterise", "scenes", "rsrp"],
    &["dataset"],
    &["rl"],
    &["evaluate"],
    &["train"],
    &["release", "export"],
    &["verify"],
    &["rebuild"],
];
/// Imports within a level that are allowed nevertheless: (importing, imported).
const WITHIN_LEVEL: [(&str, &str); 5] = [
    ("config", "units"),
    ("config", "error"),
    ("rasterise", "osm"),
    ("scenes", "osm"),
    ("scenes", "rasterise"),
];
/// Crates that are named below one path only.
const ONLY_BELOW: [(&str, &str); 6] = [
    ("osmpbfreader", "src/osm"),
    ("protobuf", "src/osm"),
    ("clap", "pipeline"),
    ("indicatif", "pipeline"),
    ("tch", "src/rl/agent"),
    ("forust_ml", "src/evaluate/fitted"),
];
/// What only the command may use: macros by their names, functions by their paths.
const PRINTING: [&str; 6] =
    ["println !", "eprintln !", "print !", "eprint !", "dbg !", "process :: exit"];
const MAX_LINES: usize = 500;
const MAX_STAGE_LINES: usize = 120;
/// Files of `pipeline/` that are no stages but what all stages share.
const SHARED_BY_STAGES: [&str; 4] = ["main.rs", "cli.rs", "console.rs", "failure.rs"];

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
    let imported: BTreeSet<String> =
        source.paths().into_iter().filter_map(|path| path.into_iter().next()).collect();
    imported
        .into_iter()
        .filter(|import| import != module)
        .filter_map(|import| match level(&import) {
            None => Some(format!("{path}: {import} has no level, add it to LEVELS")),
            Some(other) if other < own => None,
            _ if WITHIN_LEVEL.contains(&(module, import.as_str())) => None,
            Some(_) => Some(format!("{path}: {module} must not import {import}")),
        })
        .collect()
}

/// Crates that a file names though they have their place elsewhere.
fn place_violations(source: &Source) -> Vec<String> {
    let words = source.words();
    let is_below = |place: &str| {
        let rest = source.path.strip_prefix(place);
        rest.is_some_and(|rest| rest.starts_with('/') || rest == ".rs")
    };
    ONLY_BELOW
        .iter()
        .filter(|(name, place)| words.iter().any(|word| word == name) && !is_below(place))
        .map(|(name, place)| format!("{}: {name} belongs below {place}", source.path))
        .collect()
}

/// What a file of the library prints, and whether it ends the process.
fn printing_violations(source: &Source) -> Vec<String> {
    if source.module().is_none() && source.path != "src/lib.rs" {
        return vec![];
    }
    let words = source.words();
    let uses = |forbidden: &str| {
        let wanted: Vec<&str> = forbidden.split(' ').flat_map(split_colons).collect();
        words.windows(wanted.len()).any(|window| window == wanted)
    };
    PRINTING
        .iter()
        .filter(|forbidden| uses(forbidden))
        .map(|forbidden| format!("{}: the library must not use {forbidden}", source.path))
        .collect()
}

fn split_colons(word: &str) -> Vec<&str> {
    if word == "::" { vec![":", ":"] } else { vec![word] }
}

/// A file that is too long, its unit tests apart.
fn length_violations(source: &Source) -> Vec<String> {
    let name = source.path.rsplit('/').next().expect("split gives at least one");
    let is_stage = source.path.starts_with("pipeline/") && !SHARED_BY_STAGES.contains(&name);
    let most = if is_stage { MAX_STAGE_LINES } else { MAX_LINES };
    let lines = source.lines_without_tests();
    let too_long = lines > most;
    too_long
        .then(|| format!("{}: {lines} lines, at most {most}", source.path))
        .into_iter()
        .collect()
}

/// Files that import from each other, directly or by way of others: one line a circle.
fn circles(sources: &[Source]) -> Vec<String> {
    let imports = Crate::of(sources).imports();
    let reached = |from: &String| {
        let mut reached = BTreeSet::new();
        let mut pending: Vec<&String> = imports[from].iter().collect();
        while let Some(file) = pending.pop() {
            if reached.insert(file.clone()) {
                pending.extend(&imports[file]);
            }
        }
        reached
    };
    let reached: BTreeMap<&String, BTreeSet<String>> =
        imports.keys().map(|file| (file, reached(file))).collect();
    let circle = |file: &String| -> Vec<&str> {
        let both = reached[file].iter().filter(|other| reached[other].contains(file));
        both.map(String::as_str).collect()
    };
    let circles: BTreeSet<Vec<&str>> =
        imports.keys().map(circle).filter(|circle| !circle.is_empty()).collect();
    let described = |files: &Vec<&str>| {
        let within = |file: &&str| {
            let of = imports[*file].iter().filter(|other| files.contains(&other.as_str()));
            let of: Vec<&str> = of.map(String::as_str).collect();
            format!("{file} imports {}", of.join(", "))
        };
        format!("a circle: {}", files.iter().map(within).collect::<Vec<_>>().join("; "))
    };
    circles.iter().map(described).collect()
}

/// Types that share their names: a reader of one takes it for the other.
fn namesakes(sources: &[Source]) -> Vec<String> {
    let mut places: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for source in sources.iter().filter(|source| source.path.starts_with("src/")) {
        for name in source.types() {
            places.entry(name).or_default().push(&source.path);
        }
    }
    let shared = places.iter().filter(|(_, places)| places.len() > 1);
    shared
        .map(|(name, places)| format!("{name} is a type of {}", places.join(" and of ")))
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

#[test]
fn the_source_keeps_its_order() {
    let sources = sources(&["src", "pipeline"]);
    assert!(sources.len() > 20, "only {} files were found", sources.len());
    let mut violations: Vec<String> = sources.iter().flat_map(violations).collect();
    violations.extend(circles(&sources));
    violations.extend(namesakes(&sources));
    assert!(violations.is_empty(), "\n{}", violations.join("\n"));
}

/// The imports that are there are found, or the test above would pass on anything.
#[test]
fn real_imports_are_found() {
    let sources = sources(&["src"]);
    let imports = Crate::of(&sources).imports();
    let stage = &imports["src/rasterise/stage.rs"];
    // By name, by way of what modules re-export, and of a neighbour.
    for file in ["src/osm/passes.rs", "src/store/output/build.rs", "src/rasterise/blocks.rs"] {
        assert!(stage.contains(file), "{file} in {stage:?}");
    }
    assert!(imports.values().map(BTreeSet::len).sum::<usize>() > 500);
}

fn made_up(path: &str, text: &str) -> Vec<String> {
    violations(&Source::new(path, text))
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
        ("src/crs.rs", "fn f() { g!(1, crate::store::A) }", "crs must not import store"),
        ("src/wizardry.rs", "", "wizardry has no level"),
        ("src/crs/utm.rs", "use crate::wizardry::Wand;", "wizardry has no level"),
        ("src/scenes/mesh.rs", "use osmpbfreader::Way;", "osmpbfreader belongs below src/osm"),
        ("src/osmosis.rs", "fn f() -> protobuf::Result<()> {}", "protobuf belongs below src/osm"),
        ("src/config.rs", "#[derive(clap::Args)] struct A;", "clap belongs below pipeline"),
        ("src/dataset.rs", "use tch::Tensor;", "tch belongs below src/rl"),
        ("pipeline/train.rs", "use tch::Tensor;", "tch belongs below src/rl"),
        ("src/lib.rs", "fn f() { println!(\"{}\", 1); }", "must not use println !"),
        ("src/crs.rs", "fn f() { std::process::exit(1) }", "must not use process :: exit"),
        ("src/crs.rs", "fn f() { eprint! {\"\"} }", "must not use eprint !"),
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
fn circles_and_namesakes_are_found() {
    let made_up = |files: &[(&str, &str)]| -> Vec<Source> {
        files.iter().map(|(path, text)| Source::new(path, text)).collect()
    };
    let circle = [
        ("src/lib.rs", "mod a;"),
        ("src/a/mod.rs", "mod b; mod c; mod d; pub use b::B; pub use self::c::{C, D as E};"),
        ("src/a/b.rs", "use super::E; pub struct B;"),
        ("src/a/c.rs", "pub struct C(super::B); pub struct D;"),
        ("src/a/d.rs", "use crate::a::B;"),
    ];
    let found = circles(&made_up(&circle));
    assert_eq!(found, ["a circle: src/a/b.rs imports src/a/c.rs; src/a/c.rs imports src/a/b.rs"]);
    // A module that uses what its child has, and a child that uses what its parent has.
    let parent = [
        ("src/lib.rs", "mod a;"),
        ("src/a/mod.rs", "mod b; use b::B; pub struct A; fn f(b: B) {}"),
        ("src/a/b.rs", "use super::A; pub struct B;"),
    ];
    let found = circles(&made_up(&parent));
    assert_eq!(
        found,
        ["a circle: src/a/b.rs imports src/a/mod.rs; src/a/mod.rs imports src/a/b.rs"]
    );
    let mut tests_apart = circle;
    tests_apart[2].1 = "pub(super) struct B; #[cfg(test)] mod tests { use super::super::E; }";
    assert_eq!(circles(&made_up(&tests_apart)), Vec::<String>::new());

    let twins = [("src/a.rs", "struct A; enum B {}"), ("src/b.rs", "type A = u8; trait C {}")];
    assert_eq!(namesakes(&made_up(&twins)), ["A is a type of src/a.rs and of src/b.rs"]);
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

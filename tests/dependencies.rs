//! How much a user of the library takes along.

use std::collections::BTreeSet;
use std::process::Command;

/// Crates that are built with some features, the library among them.
fn crates(features: &str) -> BTreeSet<String> {
    let output = Command::new(env!("CARGO"))
        .args(["tree", "--locked", "--no-default-features", "--features", features])
        .args(["--edges", "normal,build", "--prefix", "none", "--format", "{p}"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("UTF-8");
    let package = |line: &str| {
        let mut words = line.split(' ');
        Some(format!("{} {}", words.next()?, words.next()?))
    };
    text.lines().filter_map(package).collect()
}

#[test]
fn reading_a_dataset_takes_sixty_crates_at_most() {
    let base = crates("");
    assert!(base.contains("holescout v0.1.0"), "{base:?}");
    assert!(base.len() <= 60, "{} crates: {base:?}", base.len());
}

/// No library drags in a command line, or plots that it does not draw.
#[test]
fn features_bring_what_they_say_and_no_more() {
    for (features, with, without) in [
        ("build", "osmpbfreader", ["clap", "resvg", "object_store"]),
        ("report", "resvg", ["clap", "indicatif", "object_store"]),
        ("remote", "object_store", ["clap", "resvg", "osmpbfreader"]),
        ("cli", "clap", ["tch", "object_store", "tokio"]),
    ] {
        let crates = crates(features);
        let has = |name: &str| crates.iter().any(|line| line.split(' ').next() == Some(name));
        assert!(has(with), "{features} needs {with}");
        for other in without {
            assert!(!has(other), "{features} has no use for {other}");
        }
    }
}

//! The recorded inputs among the files given, laid out under the names that were recorded.
//!
//! Links are made, no copies: a stage names its inputs by file name, and takes all maps of a
//! directory, so that other names or a file too many would give another manifest.

use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::RebuildError;
use crate::error::FileError;
use crate::manifest::{ImportInputs, Input, MapFile};
use crate::store::{Digest, MANIFEST, sha256_file};

/// The recorded extracts, in their order.
pub(super) fn extracts(
    recorded: &[Input],
    given: &[PathBuf],
    scratch: &Path,
) -> Result<Vec<PathBuf>, RebuildError> {
    if given.is_empty() {
        let names: Vec<&str> = recorded.iter().map(|input| input.file.as_str()).collect();
        return Err(RebuildError::NotGiven { recorded: names.join(", "), flag: "--osm" });
    }
    let digests: Vec<Digest> =
        given.par_iter().map(|path| sha256_file(path)).collect::<Result<_, _>>()?;
    let mut links = Vec::new();
    for (number, Input { file, digest, .. }) in recorded.iter().enumerate() {
        let Some(at) = digests.iter().position(|found| found == digest) else {
            let given = given.iter().zip(&digests);
            let given = given.map(|(path, digest)| format!("{}: {digest}", path.display()));
            return Err(RebuildError::MissingExtract {
                recorded: format!("{file} ({digest})"),
                given: given.collect::<Vec<_>>().join(", "),
            });
        };
        // A directory for each: two extracts may share a name.
        links.push(link(&given[at], &scratch.join(format!("osm/{number}")), file)?);
    }
    Ok(links)
}

/// A directory with the recorded maps and nothing else.
pub(super) fn maps(
    recorded: &ImportInputs,
    given: Option<&Path>,
    scratch: &Path,
) -> Result<PathBuf, RebuildError> {
    let ImportInputs { maps, ignored, .. } = recorded;
    let given = given.ok_or_else(|| RebuildError::NotGiven {
        recorded: format!("{} radio maps", maps.len()),
        flag: "--maps",
    })?;
    let wrong: Vec<String> =
        maps.par_iter().filter_map(|map| difference(map, given).err()).collect();
    if let Some(example) = wrong.first() {
        return Err(RebuildError::OtherMaps {
            path: given.to_owned(),
            recorded: maps.len(),
            missing: wrong.len(),
            example: example.clone(),
        });
    }
    let directory = scratch.join("maps");
    for map in maps {
        let path = link(&given.join(&map.file), &directory, &map.file)?;
        if map.sidecar.is_some() {
            let sidecar = path.with_extension("json");
            let name = sidecar.file_name().unwrap_or_default().to_string_lossy().into_owned();
            link(&given.join(&name), &directory, &name)?;
        }
    }
    // Only their names count.
    for name in ignored {
        let path = directory.join(plain(name)?);
        std::fs::write(&path, b"").map_err(FileError::new("write", &path))?;
    }
    Ok(directory)
}

/// What is wrong with a map in the directory given, as an error.
fn difference(map: &MapFile, given: &Path) -> Result<(), String> {
    let path = given.join(&map.file);
    let sidecar = path.with_extension("json");
    for (path, recorded) in [(path, &map.digest), (sidecar, &map.sidecar)] {
        let Some(recorded) = recorded else { continue };
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        match sha256_file(&path) {
            Ok(found) if found == *recorded => {}
            Ok(found) => return Err(format!("{name}: {found}, recorded {recorded}")),
            Err(error) => return Err(format!("{name}: {}", error.source)),
        }
    }
    Ok(())
}

/// A directory whose manifest has the recorded digest.
pub(super) fn stage<'a>(
    what: &str,
    flag: &'static str,
    recorded: &str,
    given: Option<&'a Path>,
) -> Result<&'a Path, RebuildError> {
    let expected = format!("{what} whose manifest has SHA-256 {recorded}");
    let Some(given) = given else {
        return Err(RebuildError::NotGiven { recorded: expected, flag });
    };
    let found = sha256_file(&given.join(MANIFEST))?.sha256;
    if found == recorded {
        return Ok(given);
    }
    let found = format!("its manifest has SHA-256 {found}");
    Err(RebuildError::Other { path: given.to_owned(), found, recorded: expected })
}

/// A recorded file under its recorded name.
pub(super) fn file(
    name: &str,
    recorded: &Digest,
    flag: &'static str,
    given: Option<&Path>,
    scratch: &Path,
) -> Result<PathBuf, RebuildError> {
    let recorded_as = format!("{name}: {recorded}");
    let Some(given) = given else {
        return Err(RebuildError::NotGiven { recorded: recorded_as, flag });
    };
    let found = sha256_file(given)?;
    if found != *recorded {
        let (path, found) = (given.to_owned(), found.to_string());
        return Err(RebuildError::Other { path, found, recorded: recorded_as });
    }
    link(given, &scratch.join("file"), name)
}

fn link(original: &Path, directory: &Path, name: &str) -> Result<PathBuf, RebuildError> {
    std::fs::create_dir_all(directory).map_err(FileError::new("create", directory))?;
    let original = original.canonicalize().map_err(FileError::new("open", original))?;
    let path = directory.join(plain(name)?);
    symlink(original, &path).map_err(FileError::new("link", &path))?;
    Ok(path)
}

/// A name comes from a manifest: it must not lead out of its directory.
fn plain(name: &str) -> Result<&str, RebuildError> {
    let is_plain = Path::new(name).file_name().is_some_and(|plain| plain == name);
    is_plain.then_some(name).ok_or_else(|| RebuildError::Name { name: name.to_owned() })
}

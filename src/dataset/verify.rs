//! `holescout verify`: is every byte what it should be, and does it make sense?
//!
//! Works on the output of every stage: checksums and manifests are the same everywhere;
//! tiles, maps and records are each read and compared with what their manifest says.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::record::Record;
use super::shard::ShardReader;
use super::statistics;
use crate::config::{Config, Split};
use crate::grid::TileId;
use crate::manifest::{
    DatasetConfig, DatasetManifest, EvaluationManifest, ManifestError, RsrpFile, RsrpManifest,
    ScenesManifest, ShardEntry, SplitStatistics, TileFile, TilesManifest, load, schema,
};
use crate::progress::Progress;
use crate::scene::check_scene;
use crate::store::{FrameBuffer, MANIFEST, SUMS, parse_sums, sha256_file};

/// Something that is wrong.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct VerifyFailure {
    /// The file, relative to the directory.
    pub file: String,
    /// The record in it, if a single one is to blame.
    pub record: Option<String>,
    /// What is wrong: expected and found.
    pub reason: String,
}

impl std::fmt::Display for VerifyFailure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.record {
            Some(record) => write!(f, "{}: {record}: {}", self.file, self.reason),
            None => write!(f, "{}: {}", self.file, self.reason),
        }
    }
}

/// The result of verifying a directory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verification {
    /// The manifest's schema: what kind of output this is.
    pub schema: String,
    /// Files whose checksums were compared.
    pub files: usize,
    /// Tiles, maps or records that were read.
    pub items: usize,
    /// All that is wrong; empty if the directory is sound.
    pub failures: Vec<VerifyFailure>,
}

/// Verifies the output of any stage.
///
/// # Errors
/// [`ManifestError`] if there is no manifest that could be verified, for instance after an
/// interrupted run. Everything else that is wrong is listed in the result.
pub fn verify(root: &Path, progress: &dyn Progress) -> Result<Verification, ManifestError> {
    let found = schema(root);
    let mut failures = Vec::new();
    let files = check_sums(root, &mut failures, progress);
    let items = match found.as_deref() {
        Some(TilesManifest::SCHEMA) => {
            let (manifest, _) = load::<TilesManifest>(root, "rasterise", TilesManifest::SCHEMA)?;
            let (tagged, accounted) = (manifest.buildings.tagged, manifest.accounted());
            if tagged != accounted {
                let reason = format!(
                    "{tagged} objects with building tags, but {accounted} buildings and rows of \
                     problems.csv that say why not"
                );
                failures.push(failure(MANIFEST, reason));
            }
            check_items(&manifest.tiles, progress, &mut failures, |entry| {
                let read = TileFile::read(root, entry).map_err(|error| error.to_string());
                let matches = read.map(|tile| tile.meta.id == entry.id);
                (&entry.file, demand(matches, "tile id differs from the manifest's"))
            })
        }
        Some(RsrpManifest::SCHEMA) => {
            let (manifest, _) = load::<RsrpManifest>(root, "import-rsrp", RsrpManifest::SCHEMA)?;
            check_items(&manifest.maps, progress, &mut failures, |entry| {
                let read = RsrpFile::read(root, entry).map_err(|error| error.to_string());
                let matches = read.map(|map| map.meta.id == entry.id);
                (&entry.file, demand(matches, "tile id differs from the manifest's"))
            })
        }
        Some(ScenesManifest::SCHEMA) => {
            let (manifest, _) = load::<ScenesManifest>(root, "scenes", ScenesManifest::SCHEMA)?;
            check_items(&manifest.scenes, progress, &mut failures, |entry| {
                let file = entry.files.first().map_or(MANIFEST, |first| &first.file);
                (file, check_scene(root, entry))
            })
        }
        Some(EvaluationManifest::SCHEMA) => {
            load::<EvaluationManifest>(root, "evaluate", EvaluationManifest::SCHEMA)?;
            0
        }
        _ => {
            let (manifest, _) = load::<DatasetManifest>(root, "shard", DatasetManifest::SCHEMA)?;
            check_dataset(root, &manifest, progress, &mut failures)
        }
    };
    failures.sort();
    failures.dedup();
    Ok(Verification { schema: found.unwrap_or_default(), files, items, failures })
}

fn failure(file: &str, reason: impl Into<String>) -> VerifyFailure {
    VerifyFailure { file: file.to_owned(), record: None, reason: reason.into() }
}

fn demand(holds: Result<bool, String>, otherwise: &str) -> Result<(), String> {
    if holds? { Ok(()) } else { Err(otherwise.to_owned()) }
}

/// Every listed file has its checksum, and every file is listed.
fn check_sums(root: &Path, failures: &mut Vec<VerifyFailure>, progress: &dyn Progress) -> usize {
    let text = std::fs::read_to_string(root.join(SUMS)).unwrap_or_default();
    let sums = match parse_sums(&text) {
        Ok(sums) if !sums.is_empty() => sums,
        Ok(_) => {
            failures.push(failure(SUMS, "missing or empty"));
            return 0;
        }
        Err(line) => {
            let reason = format!("no checksum of a file of this directory: {line:?}");
            failures.push(failure(SUMS, reason));
            return 0;
        }
    };
    progress.begin("comparing checksums", Some(sums.len() as u64));
    let wrong: Vec<VerifyFailure> = sums
        .par_iter()
        .filter_map(|(expected, file)| {
            let found = sha256_file(&root.join(file));
            progress.advance(1);
            match found {
                Ok(digest) if digest.sha256 == *expected => None,
                Ok(digest) => {
                    let found = digest.sha256;
                    Some(failure(file, format!("SHA-256 is {found}, expected {expected}")))
                }
                Err(error) => Some(failure(file, error.source.to_string())),
            }
        })
        .collect();
    progress.end();
    failures.extend(wrong);
    let listed: BTreeSet<PathBuf> = sums.iter().map(|(_, file)| PathBuf::from(file)).collect();
    if !listed.contains(Path::new(MANIFEST)) {
        failures.push(failure(SUMS, format!("does not list {MANIFEST}")));
    }
    for file in files_below(root) {
        let relative = file.strip_prefix(root).unwrap_or(&file);
        if relative != Path::new(SUMS) && !listed.contains(relative) {
            let name = relative.to_string_lossy();
            failures.push(failure(&name, format!("not listed in {SUMS}: not part of this output")));
        }
    }
    sums.len()
}

fn files_below(directory: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(directory).into_iter().flatten().flatten();
    entries
        .flat_map(|entry| {
            let path = entry.path();
            if path.is_dir() { files_below(&path) } else { vec![path] }
        })
        .collect()
}

fn check_items<'a, T: Sync>(
    entries: &'a [T],
    progress: &dyn Progress,
    failures: &mut Vec<VerifyFailure>,
    check: impl Fn(&'a T) -> (&'a str, Result<(), String>) + Sync,
) -> usize {
    progress.begin("reading items", Some(entries.len() as u64));
    let wrong: Vec<VerifyFailure> = entries
        .par_iter()
        .filter_map(|entry| {
            let (file, result) = check(entry);
            progress.advance(1);
            result.err().map(|reason| failure(file, reason))
        })
        .collect();
    progress.end();
    failures.extend(wrong);
    entries.len()
}

/// What a shard was found to hold.
struct ReadShard {
    ids: Vec<Option<TileId>>,
    statistics: Option<SplitStatistics>,
    failures: Vec<VerifyFailure>,
}

fn check_dataset(
    root: &Path,
    manifest: &DatasetManifest,
    progress: &dyn Progress,
    failures: &mut Vec<VerifyFailure>,
) -> usize {
    progress.begin("reading records", Some(manifest.records.len() as u64));
    let read: Vec<ReadShard> = manifest
        .shards
        .par_iter()
        .map(|entry| read_shard(root, entry, manifest, progress))
        .collect();
    progress.end();

    let mut sums: BTreeMap<Split, Option<SplitStatistics>> = BTreeMap::new();
    let mut frames: BTreeMap<(&str, usize), TileId> = BTreeMap::new();
    let mut splits: BTreeMap<TileId, Split> = BTreeMap::new();
    for (entry, shard) in manifest.shards.iter().zip(&read) {
        failures.extend(shard.failures.iter().cloned());
        if let Some(statistics) = &shard.statistics {
            statistics::add(sums.entry(entry.split).or_default(), statistics);
        }
        for (frame, id) in shard.ids.iter().enumerate() {
            let Some(id) = *id else { continue };
            frames.insert((&entry.file, frame), id);
            if splits.insert(id, entry.split).is_some() {
                failures.push(VerifyFailure {
                    record: Some(id.to_string()),
                    ..failure(&entry.file, "stands in the dataset more than once")
                });
            }
        }
    }
    for entry in &manifest.records {
        let found = frames.remove(&(entry.shard.as_str(), entry.frame as usize));
        if found != Some(entry.id) {
            let found = found.map_or_else(|| "nothing".to_owned(), |id| id.to_string());
            failures.push(VerifyFailure {
                record: Some(entry.id.to_string()),
                ..failure(&entry.shard, format!("frame {} holds {found}", entry.frame))
            });
        }
    }
    for ((file, frame), id) in frames {
        failures.push(VerifyFailure {
            record: Some(id.to_string()),
            ..failure(file, format!("frame {frame} is not in the manifest's index"))
        });
    }
    if let Err(reason) = check_config(manifest) {
        failures.push(failure(MANIFEST, reason));
    }
    let all_read = read.iter().all(|shard| shard.failures.is_empty());
    let sums: BTreeMap<Split, SplitStatistics> =
        sums.into_iter().filter_map(|(split, sum)| Some((split, sum?))).collect();
    if all_read && sums != manifest.statistics {
        failures.push(failure(MANIFEST, "statistics differ from those of the records"));
    }
    check_separation(&splits, manifest, failures);
    splits.len()
}

fn read_shard(
    root: &Path,
    entry: &ShardEntry,
    manifest: &DatasetManifest,
    progress: &dyn Progress,
) -> ReadShard {
    let mut read = ReadShard { ids: Vec::new(), statistics: None, failures: Vec::new() };
    let digest = sha256_file(&root.join(&entry.file));
    if digest.as_ref().ok() != Some(&entry.digest) {
        let found = digest.map_or_else(|error| error.source.to_string(), |found| found.to_string());
        let reason = format!("is {found}, the manifest says {}", entry.digest);
        read.failures.push(failure(&entry.file, reason));
    }
    let mut shard = match ShardReader::open(&root.join(&entry.file)) {
        Ok(shard) => shard,
        Err(error) => {
            read.failures.push(failure(&entry.file, error.to_string()));
            return read;
        }
    };
    if shard.len() != entry.records as usize {
        let reason = format!("{} frames, the manifest says {}", shard.len(), entry.records);
        read.failures.push(failure(&entry.file, reason));
    }
    let mut buffer = match FrameBuffer::new() {
        Ok(buffer) => buffer,
        Err(error) => {
            read.failures.push(failure(&entry.file, error.to_string()));
            return read;
        }
    };
    for frame in 0..shard.len() {
        let checked = shard
            .record(frame, &mut buffer)
            .map_err(|error| (format!("frame {frame}"), error.to_string()))
            .and_then(|record| {
                let statistics = check_record(&record, entry, manifest)
                    .map_err(|reason| (record.id.to_string(), reason))?;
                Ok((record.id, statistics))
            });
        progress.advance(1);
        match checked {
            Ok((id, of_record)) => {
                statistics::add(&mut read.statistics, &of_record);
                read.ids.push(Some(id));
            }
            Err((record, reason)) => {
                let record = Some(record);
                read.failures.push(VerifyFailure { record, ..failure(&entry.file, reason) });
                read.ids.push(None);
            }
        }
    }
    read
}

/// The configuration decides what counts as apart, so it must be sound and that of the records.
fn check_config(manifest: &DatasetManifest) -> Result<(), String> {
    let DatasetConfig { grid, buildings, filter, rsrp, shard, split } = manifest.config.clone();
    let config = Config { grid, buildings, filter, rsrp, shard, split, ..Config::default() };
    config.validate().map_err(|error| error.to_string())?;
    let (cells, cell_m) =
        (config.shard.record_cells(&config.grid), config.shard.cell_m(&config.grid));
    let same = cells == manifest.cells as usize && cell_m.to_bits() == manifest.cell_m.to_bits();
    demand(Ok(same), "cells and cell_m are not those of its configuration")
}

/// A record's values, and its agreement with the manifest.
fn check_record(
    record: &Record,
    entry: &ShardEntry,
    manifest: &DatasetManifest,
) -> Result<SplitStatistics, String> {
    let grids = record.sound_grids(manifest.cells as usize).map_err(|error| error.to_string())?;
    let same = |holds: bool, field: &str| {
        demand(Ok(holds), &format!("{field} differs from the manifest's"))
    };
    same(record.split == entry.split, "split")?;
    same(record.cell_m.to_bits() == manifest.cell_m.to_bits(), "cell_m")?;
    same(record.epsg == manifest.epsg && record.id.utm.epsg() == manifest.epsg, "epsg")?;
    same(record.floor_dbm == manifest.config.rsrp.floor_dbm, "floor_dbm")?;
    let flight_height = manifest.config.buildings.flight_height_m;
    same(record.flight_height_m.to_bits() == flight_height.to_bits(), "flight_height_m")?;
    let at_center =
        record.center_m == record.id.center() && record.center_lon_lat == record.id.lon_lat();
    demand(Ok(at_center), "center_m or center_lon_lat differs from the id's")?;
    Ok(statistics::statistics_of(record, &grids))
}

/// No cell of a record of one split lies in a record of another.
fn check_separation(
    splits: &BTreeMap<TileId, Split>,
    manifest: &DatasetManifest,
    failures: &mut Vec<VerifyFailure>,
) {
    let grid = &manifest.config.grid;
    let apart = if manifest.config.split.strict { grid.side_m } else { grid.crop_m };
    // Names are sorted by easting, so only a stretch of neighbours can overlap.
    let tiles: Vec<(&TileId, &Split)> = splits.iter().collect();
    for (index, (a, split_a)) in tiles.iter().enumerate() {
        let near = tiles[index + 1..].iter().take_while(|(b, _)| {
            a.utm == b.utm && b.easting.abs_diff(a.easting) < u64::from(apart)
        });
        for (b, split_b) in near {
            if split_a != split_b && a.overlaps(**b, apart) {
                failures.push(VerifyFailure {
                    record: Some(a.to_string()),
                    ..failure(MANIFEST, format!("({split_a}) overlaps {b} ({split_b})"))
                });
            }
        }
    }
}

//! Datasets: every record is sound and where the index says, and splits are apart.

use std::collections::BTreeMap;
use std::path::Path;

use rayon::prelude::*;

use super::failure::{VerifyFailure, demand, failure};
use crate::config::{Config, Split};
use crate::dataset::{Record, ShardReader, add_statistics, statistics_of};
use crate::grid::TileId;
use crate::manifest::{DatasetConfig, DatasetManifest, ShardEntry, SplitStatistics};
use crate::progress::Progress;
use crate::store::{FrameBuffer, MANIFEST, sha256_file};

/// What a shard was found to hold.
struct ReadShard {
    ids: Vec<Option<TileId>>,
    statistics: Option<SplitStatistics>,
    failures: Vec<VerifyFailure>,
}

pub(super) fn check(
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
            add_statistics(sums.entry(entry.split).or_default(), statistics);
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
                add_statistics(&mut read.statistics, &of_record);
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
    Ok(statistics_of(record, &grids))
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

//! `holescout shard`: tiles and imported maps in, a dataset out.

use std::collections::BTreeMap;
use std::path::Path;

use ndarray::{Array2, s};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;

use super::card;
use super::croissant;
use super::downsample::{downsample_errors, downsample_heights, downsample_rsrp};
use super::grids::{Grids, RecordError};
use super::record::{Provenance, Record};
use super::split::assign_splits;
use super::statistics;
use crate::config::{Config, Split};
use crate::error::{Fault, FileError, HasFault};
use crate::grid::TileId;
use crate::manifest::{
    DatasetConfig, DatasetManifest, Dropped, IndexEntry, Manifest, ManifestError, MapEntry,
    RsrpFile, RsrpManifest, ShardEntry, Software, SplitStatistics, StageFileError, TileEntry,
    TileFile, TilesManifest, fingerprint, load, to_json,
};
use crate::manifest::{MASK_BUILDING, MASK_UNREACHED};
use crate::progress::Progress;
use crate::store::{
    Build, BuildMode, Built, Digest, Finished, Item, Items, Opened, OutputError, Parallel,
    SeekableWriter, compress_frame, sha256_bytes,
};

/// Why a dataset could not be built.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ShardError {
    /// An input's manifest cannot be used.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// A tile or map is damaged.
    #[error(transparent)]
    StageFile(#[from] StageFileError),
    /// The output directory cannot be used.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The maps were imported for other tiles.
    #[error(
        "the maps were imported for other tiles: their manifest has SHA-256 {expected}, \
         that of --tiles {found}; run `holescout import-rsrp` again with these tiles"
    )]
    OtherTiles {
        /// What the maps were imported for.
        expected: String,
        /// What was given.
        found: String,
    },
    /// No map was imported.
    #[error("no radio map was imported, {rejected} were rejected (see rejected.csv): no dataset")]
    NoMaps {
        /// Number of rejected maps.
        rejected: u64,
    },
    /// The configuration does not fit the maps.
    #[error(
        "tile {id}: its map has cells of {found} m, which make up no record cell of {expected} m"
    )]
    CellSize {
        /// The tile.
        id: TileId,
        /// Side of a map's cell, in metres.
        found: f64,
        /// Side of a record's cell, in metres.
        expected: f64,
    },
    /// The configuration does not fit the tiles.
    #[error("the tiles' window of {cells} cells is no multiple of shard.downsample = {factor}")]
    Downsample {
        /// Cells along the window.
        cells: usize,
        /// The factor.
        factor: usize,
    },
    /// A record that contradicts itself: a bug, or files changed during the run.
    #[error("tile {id}: unsound record: {source}")]
    Unsound {
        /// The tile.
        id: TileId,
        /// What is wrong.
        source: RecordError,
    },
}

impl HasFault for ShardError {
    fn fault(&self) -> Fault {
        match self {
            Self::Manifest(error) => error.fault(),
            Self::StageFile(error) => error.fault(),
            Self::Output(error) => error.fault(),
            Self::Unsound { .. } => Fault::Running,
            _ => Fault::Input,
        }
    }
}

impl From<FileError> for ShardError {
    fn from(error: FileError) -> Self {
        Self::Output(error.into())
    }
}

/// What to make a dataset of and where to.
#[derive(Debug, Clone, Copy)]
pub struct ShardJob<'a> {
    /// Output of `rasterise`.
    pub tiles: &'a Path,
    /// Output of `import-rsrp` for these tiles.
    pub rsrp: &'a Path,
    /// The configuration; `[shard]` and `[split]` are used, the rest is that of the inputs.
    pub config: &'a Config,
    /// The directory to fill.
    pub out: &'a Path,
    /// What to build, and whether to replace a dataset of other inputs that is there.
    pub mode: BuildMode,
}

/// A shard that is done: what the journal remembers.
#[derive(Debug, Serialize, Deserialize)]
struct DoneShard {
    entry: ShardEntry,
    statistics: SplitStatistics,
}

/// Everything that making a record needs to know.
struct ShardContext<'a> {
    job: ShardJob<'a>,
    tiles: BTreeMap<TileId, &'a TileEntry>,
    maps: BTreeMap<TileId, &'a MapEntry>,
    config: DatasetConfig,
}

/// The planned content of a shard.
struct PlannedShard {
    file: String,
    split: Split,
    ids: Vec<TileId>,
}

/// Builds a dataset, or a task's part of it.
///
/// # Errors
/// [`ShardError`]; the directory then holds no manifest.
pub fn shard(
    job: ShardJob<'_>,
    progress: &dyn Progress,
) -> Result<Built<DatasetManifest>, ShardError> {
    let (tiles, tiles_digest) = load::<TilesManifest>(job.tiles)?;
    let (rsrp, rsrp_digest) = load::<RsrpManifest>(job.rsrp)?;
    if rsrp.tiles_manifest_sha256 != tiles_digest.sha256 {
        let (expected, found) = (rsrp.tiles_manifest_sha256, tiles_digest.sha256);
        return Err(ShardError::OtherTiles { expected, found });
    }
    if rsrp.maps.is_empty() {
        return Err(ShardError::NoMaps { rejected: rsrp.rejected.values().sum() });
    }
    let config = DatasetConfig {
        grid: tiles.config.grid.clone(),
        buildings: tiles.config.buildings.clone(),
        filter: tiles.config.filter.clone(),
        rsrp: rsrp.config.clone(),
        shard: job.config.shard.clone(),
        split: job.config.split.clone(),
    };
    let (cells, factor) = (config.grid.crop_cells(), config.shard.downsample as usize);
    if cells % factor != 0 {
        return Err(ShardError::Downsample { cells, factor });
    }
    let fingerprint = fingerprint(&(DatasetManifest::SCHEMA, &config, &tiles_digest, &rsrp_digest));
    let build = match Build::open(job.out, "dataset", &fingerprint, job.mode, progress)? {
        Opened::Done(built) => return Ok(built),
        Opened::Ready(build) => build,
    };

    let ids: Vec<TileId> = rsrp.maps.iter().map(|map| map.id).collect();
    let splits = assign_splits(&ids, &config.grid, &config.split);
    let plan = plan(&splits.kept, &config);
    let context = ShardContext {
        job,
        tiles: tiles.tiles.iter().map(|entry| (entry.id, entry)).collect(),
        maps: rsrp.maps.iter().map(|entry| (entry.id, entry)).collect(),
        config,
    };

    let how = ("building shards", Parallel::Within);
    let key = |shard: &PlannedShard| shard.file.clone();
    let shard = |shard: &PlannedShard, item: Item<'_>| build_shard(shard, &context, item);
    let (done, output) = match build.run_items(how, &plan, key, shard, progress)? {
        Items::Part(report) => return Ok(Built::Part(report)),
        Items::All(done, output) => (done, output),
    };

    let mut sums: BTreeMap<Split, Option<SplitStatistics>> = BTreeMap::new();
    for DoneShard { entry, statistics } in &done {
        statistics::add(sums.entry(entry.split).or_default(), statistics);
    }
    let manifest = DatasetManifest {
        schema: DatasetManifest::SCHEMA.to_owned(),
        fingerprint,
        software: Software::this(),
        release: None,
        licence: tiles.licence.clone(),
        attribution: tiles.attribution.clone(),
        epsg: tiles.epsg,
        area: tiles.area.clone(),
        cells: context.config.shard.record_cells(&context.config.grid) as u32,
        cell_m: context.config.shard.cell_m(&context.config.grid),
        inputs: tiles.inputs.clone(),
        tiles_manifest_sha256: tiles_digest.sha256,
        rsrp_manifest_sha256: rsrp_digest.sha256,
        import: rsrp.inputs.clone(),
        buildings: tiles.buildings,
        statistics: sums.into_iter().filter_map(|(split, sum)| Some((split, sum?))).collect(),
        dropped: Dropped {
            tiles_without_map: (tiles.tiles.len() - ids.len()) as u64,
            rejected_maps: rsrp.rejected.clone(),
            overlapping_another_split: splits.dropped,
            osm_objects: tiles.problems.clone(),
        },
        overlapping_tile_pairs: splits.overlapping_tile_pairs,
        shards: done.into_iter().map(|shard| shard.entry).collect(),
        records: index(&plan),
        config: context.config,
    };
    let bytes = to_json(&manifest);
    output.write("README.md", card::readme(&manifest).as_bytes())?;
    output.write("NOTICE", card::notice(&manifest).as_bytes())?;
    output.write(croissant::FILE, &croissant::croissant(&manifest, &sha256_bytes(&bytes), None))?;
    output.complete(&bytes)?;
    Ok(Built::Whole(manifest))
}

/// Records in an order that depends on their names and the seed only, so that the records of
/// a shard are no neighbours: a reader that shuffles within a few shards sees all districts.
fn plan(kept: &BTreeMap<TileId, Split>, config: &DatasetConfig) -> Vec<PlannedShard> {
    let seed = config.shard.order_seed;
    let mut shards = Vec::new();
    for split in Split::ALL {
        let mut ids: Vec<TileId> =
            kept.iter().filter(|(_, of)| **of == split).map(|(id, _)| *id).collect();
        ids.sort_by_cached_key(|id| sha256_bytes(format!("{seed} {id}").as_bytes()).sha256);
        let chunks = ids.chunks(config.shard.records_per_shard as usize).enumerate();
        shards.extend(chunks.map(|(number, ids)| PlannedShard {
            file: format!("{split}/shard-{number:05}.msgpack.zst"),
            split,
            ids: ids.to_vec(),
        }));
    }
    shards.sort_by(|a, b| a.file.cmp(&b.file));
    shards
}

fn index(plan: &[PlannedShard]) -> Vec<IndexEntry> {
    let mut records: Vec<IndexEntry> = plan
        .iter()
        .flat_map(|shard| {
            let frames = shard.ids.iter().enumerate();
            frames.map(|(frame, &id)| IndexEntry {
                id,
                shard: shard.file.clone(),
                frame: frame as u32,
            })
        })
        .collect();
    records.sort_by_key(|entry| entry.id);
    records
}

fn build_shard(
    shard: &PlannedShard,
    context: &ShardContext<'_>,
    item: Item<'_>,
) -> Result<Finished<DoneShard>, ShardError> {
    let frames = shard
        .ids
        .par_iter()
        .map(|&id| {
            let (record, statistics) = build_record(id, shard.split, context)?;
            let bytes = record.encode();
            let frame = compress_frame(&bytes, context.config.shard.zstd_level)
                .map_err(FileError::new("compress", Path::new(&shard.file)))?;
            Ok((frame, bytes.len(), statistics))
        })
        .collect::<Result<Vec<_>, ShardError>>()?;

    let mut writer = SeekableWriter::new(Vec::new());
    let mut sum = None;
    for (frame, length, of_record) in &frames {
        writer.push(frame, *length).map_err(FileError::new("write", Path::new(&shard.file)))?;
        statistics::add(&mut sum, of_record);
    }
    let bytes = writer.finish().map_err(FileError::new("write", Path::new(&shard.file)))?;
    let done = |written: &[Digest]| DoneShard {
        entry: ShardEntry {
            file: shard.file.clone(),
            split: shard.split,
            digest: written[0].clone(),
            records: shard.ids.len() as u32,
        },
        statistics: sum.expect("a shard has at least one record"),
    };
    Ok(item.finish(&[(&shard.file, &bytes)], done)?)
}

fn build_record(
    id: TileId,
    split: Split,
    context: &ShardContext<'_>,
) -> Result<(Record, SplitStatistics), ShardError> {
    let ShardContext { job, config, .. } = context;
    let (tile_entry, map_entry) = (context.tiles[&id], context.maps[&id]);
    let heights = TileFile::read_heights(job.tiles, tile_entry)?;
    let map = RsrpFile::read(job.rsrp, map_entry)?;
    let grids = grids(&heights, &map, config)?;
    let cells = config.shard.record_cells(&config.grid);
    let record = Record {
        schema: Record::SCHEMA.to_owned(),
        id,
        split,
        epsg: id.utm.epsg(),
        center_m: id.center(),
        center_lon_lat: id.lon_lat(),
        cell_m: config.shard.cell_m(&config.grid),
        row_order: Record::ROW_ORDER.to_owned(),
        height_m: ByteBuf::new(),
        rsrp_dbm: ByteBuf::new(),
        mask: ByteBuf::new(),
        repeats: map.meta.repeats,
        std_error_db: None,
        first_half_share: None,
        floor_dbm: map.meta.floor_dbm,
        flight_height_m: config.buildings.flight_height_m,
        base_station: map.meta.base_station,
        radio: map.meta.radio,
        provenance: Provenance {
            radio_map: map.meta.source,
            tile_sha256: tile_entry.digest.sha256.clone(),
            rsrp_sha256: map_entry.digest.sha256.clone(),
            built_cells: tile_entry.statistics.built_cells,
            licence: config.buildings.licence.clone(),
            attribution: config.buildings.attribution.clone(),
        },
    }
    .with_grids(&grids);
    // As readers get them: levels with errors were rounded.
    let grids = record.sound_grids(cells).map_err(|source| ShardError::Unsound { id, source })?;
    let statistics = statistics::statistics_of(&record, &grids);
    Ok((record, statistics))
}

/// Crops, downsamples and lays the height grid's buildings over the mask.
fn grids(
    height_m: &Array2<f32>,
    map: &RsrpFile,
    config: &DatasetConfig,
) -> Result<Grids, ShardError> {
    let DatasetConfig { grid, shard, buildings, .. } = config;
    let crop = grid.crop_offset_cells()..grid.crop_offset_cells() + grid.crop_cells();
    let heights = height_m.slice(s![crop.clone(), crop]);
    let height_m = downsample_heights(heights, shard.downsample as usize, shard.height);

    let (found, expected) = (map.meta.cell_m, shard.cell_m(grid));
    let factor = (expected / found).round();
    if factor < 1.0 || (factor * found - expected).abs() > 1e-9 * expected {
        return Err(ShardError::CellSize { id: map.meta.id, found, expected });
    }
    let (rsrp, kinds, factor) = (map.rsrp_dbm.view(), map.mask.view(), factor as usize);
    let (rsrp_dbm, mut mask) = downsample_rsrp(rsrp, kinds, factor, shard.rsrp, map.meta.floor_dbm);
    let errors = map.errors.as_ref();
    let errors = errors.map(|errors| downsample_errors(rsrp, kinds, errors, factor, shard.rsrp));
    for (kind, &height) in mask.iter_mut().zip(&height_m) {
        if f64::from(height) >= buildings.flight_height_m {
            *kind = MASK_BUILDING;
        } else if *kind == MASK_BUILDING {
            // Methods other than the maximum may call a block outdoor of which no path is known.
            *kind = MASK_UNREACHED;
        }
    }
    Ok(Grids { height_m, rsrp_dbm, mask, errors })
}

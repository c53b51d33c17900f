//! `holescout import-rsrp`: anyone's maps in, a directory of aligned ones out.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use ndarray::{Array1, s};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::align::{AlignedMap, align};
use super::check;
use super::convert::power_per_re;
use super::load::{list, load_metadata, load_values, unreadable};
use super::metadata::RadioMapMetadata;
use super::rejection::{Rejection, RejectionCode};
use crate::building::HeightSource;
use crate::config::{Config, RsrpConfig};
use crate::error::{Fault, FileError, HasFault};
use crate::grid::TileId;
use crate::manifest::{
    BaseStation, ManifestError, MapEntry, Radio, RadioCount, RsrpManifest, RsrpMeta, Software,
    SourceMap, StageFileError, TileEntry, TileFile, TilesManifest, Verdict, dropped_tiles,
    fingerprint, load, to_json,
};
use crate::progress::Progress;
use crate::store::{Digest, OutputDir, OutputError, npy_bytes, npz_bytes, sha256_file};

/// Deflate level of imported maps; measured noise compresses hardly better at higher ones.
const DEFLATE_LEVEL: i64 = 1;

/// Why maps could not be imported at all. Single maps are rejected, not errors.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// The tiles cannot be used.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// A tile is damaged.
    #[error(transparent)]
    Tile(#[from] StageFileError),
    /// The output directory cannot be used.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// Nothing to import.
    #[error(
        "no radio maps in {}: expected .npz files, or .npy with .json beside them",
        directory.display()
    )]
    NoMaps {
        /// The directory.
        directory: PathBuf,
    },
}

impl HasFault for ImportError {
    fn fault(&self) -> Fault {
        match self {
            Self::Manifest(error) => error.fault(),
            Self::Tile(error) => error.fault(),
            Self::Output(error) => error.fault(),
            Self::NoMaps { .. } => Fault::Input,
        }
    }
}

impl From<FileError> for ImportError {
    fn from(error: FileError) -> Self {
        Self::Output(error.into())
    }
}

/// What to import and where to.
#[derive(Debug, Clone, Copy)]
pub struct ImportJob<'a> {
    /// Directory of maps; files in directories below it are not looked at.
    pub maps: &'a Path,
    /// Output of `rasterise`.
    pub tiles: &'a Path,
    /// The configuration; `[rsrp]` and the cell size of `[shard]` are used.
    pub config: &'a Config,
    /// The directory to fill.
    pub out: &'a Path,
    /// Replace maps of other inputs that are there.
    pub overwrite: bool,
}

/// A file of the maps' directory.
struct Source {
    path: PathBuf,
    name: String,
    digest: Result<Digest, Rejection>,
    /// Of the `.json` beside an `.npy`: other metadata, another map.
    sidecar: Option<Digest>,
}

/// What became of a file: what the journal remembers.
#[derive(Debug, Clone, Serialize, Deserialize)]
enum Outcome {
    Imported { entry: MapEntry, radio: Radio },
    Rejected { file: String, location: String, rejection: Rejection },
}

/// Everything that the import of one map needs to know.
struct Context<'a> {
    tiles: &'a Path,
    manifest: &'a TilesManifest,
    by_id: BTreeMap<TileId, &'a TileEntry>,
    dropped: BTreeMap<TileId, Verdict>,
    rsrp: &'a RsrpConfig,
    record_cell_m: f64,
    limit: u64,
}

/// Imports all maps of a directory and returns the manifest that was written.
///
/// # Errors
/// [`ImportError`]. Maps that do not follow the contract are no errors: `rejected.csv`
/// lists them with code, expected, found and mend.
pub fn import_maps(
    job: ImportJob<'_>,
    progress: &dyn Progress,
) -> Result<RsrpManifest, ImportError> {
    let (manifest, tiles_digest) =
        load::<TilesManifest>(job.tiles, "rasterise", TilesManifest::SCHEMA)?;
    let (paths, ignored) = list(job.maps).map_err(FileError::new("list", job.maps))?;
    if paths.is_empty() {
        return Err(ImportError::NoMaps { directory: job.maps.to_owned() });
    }
    let sources: Vec<Source> = paths.into_par_iter().map(source).collect();
    let config = &job.config.rsrp;
    let record_cell_m = job.config.shard.cell_m(&manifest.config.grid);
    let inputs: Vec<_> = sources
        .iter()
        .map(|source| (&source.name, source.digest.as_ref().ok(), &source.sidecar))
        .collect();
    let fingerprint = fingerprint(&(
        RsrpManifest::SCHEMA,
        config,
        record_cell_m,
        &tiles_digest,
        &inputs,
        &ignored,
    ));
    let output = OutputDir::begin(job.out, "rsrp", &fingerprint, job.overwrite)?;

    let context = Context {
        tiles: job.tiles,
        manifest: &manifest,
        by_id: manifest.tiles.iter().map(|entry| (entry.id, entry)).collect(),
        dropped: dropped_tiles(job.tiles)?,
        rsrp: config,
        record_cell_m,
        limit: u64::from(config.max_array_mib) << 20,
    };
    let outcomes = import_all(&sources, &context, &output, progress)?;
    output.write("rejected.csv", &rejected_csv(&outcomes))?;
    let manifest = summarise(&outcomes, &context, fingerprint, &tiles_digest, ignored);
    output.complete(&to_json(&manifest))?;
    Ok(manifest)
}

fn source(path: PathBuf) -> Source {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let digest = sha256_file(&path).map_err(|error| unreadable(&error));
    let is_npy = path.extension().is_some_and(|extension| extension == "npy");
    let sidecar = is_npy.then(|| sha256_file(&path.with_extension("json")).ok()).flatten();
    Source { path, name, digest, sidecar }
}

/// Metadata first, since two files may claim one tile; then the maps themselves.
fn import_all(
    sources: &[Source],
    context: &Context<'_>,
    output: &OutputDir,
    progress: &dyn Progress,
) -> Result<Vec<Outcome>, ImportError> {
    progress.begin("reading metadata", Some(sources.len() as u64));
    let metadata: Vec<Result<RadioMapMetadata, Rejection>> = sources
        .par_iter()
        .map(|source| {
            progress.advance(1);
            source.digest.as_ref().map_err(Clone::clone)?;
            load_metadata(&source.path, context.limit)
        })
        .collect();
    progress.end();
    let mut claims: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (source, metadata) in sources.iter().zip(&metadata) {
        if let Ok(metadata) = metadata {
            claims.entry(&metadata.location_id).or_default().push(&source.name);
        }
    }
    progress.begin("importing radio maps", Some(sources.len() as u64));
    let outcomes = sources
        .par_iter()
        .zip(&metadata)
        .map(|(source, metadata)| {
            let outcome = import_one(source, metadata.as_ref(), &claims, context, output);
            progress.advance(1);
            outcome
        })
        .collect();
    progress.end();
    outcomes
}

fn import_one(
    source: &Source,
    metadata: Result<&RadioMapMetadata, &Rejection>,
    claims: &BTreeMap<&str, Vec<&str>>,
    context: &Context<'_>,
    output: &OutputDir,
) -> Result<Outcome, ImportError> {
    if let Some(outcome) = output.finished(&source.name) {
        return Ok(outcome);
    }
    let location = metadata.map_or_else(|_| String::new(), |known| known.location_id.clone());
    let rejected = |rejection: Rejection| Outcome::Rejected {
        file: source.name.clone(),
        location: location.clone(),
        rejection,
    };
    let imported = match metadata {
        Err(rejection) => Err(rejection.clone()),
        Ok(metadata) => match locate(metadata, claims, context) {
            Err(rejection) => Err(rejection),
            Ok(tile) => {
                let tile_file = TileFile::read(context.tiles, tile)?;
                convert(source, metadata, tile, &tile_file, context)
            }
        },
    };
    match imported {
        Err(rejection) => Ok(output.finish_item(&source.name, &[], |_| rejected(rejection))?),
        Ok((meta, map, warnings)) => {
            let file = format!("{}.npz", meta.id);
            let bytes = rsrp_npz(&meta, &map);
            let outcome = |written: &[Digest]| Outcome::Imported {
                entry: MapEntry {
                    id: meta.id,
                    file: file.clone(),
                    digest: written[0].clone(),
                    source: meta.source.clone(),
                    cells: map.counts,
                    warnings,
                },
                radio: meta.radio.clone(),
            };
            Ok(output.finish_item(&source.name, &[(&file, &bytes)], outcome)?)
        }
    }
}

/// The tile that a map belongs to.
fn locate<'a>(
    metadata: &RadioMapMetadata,
    claims: &BTreeMap<&str, Vec<&str>>,
    context: &Context<'a>,
) -> Result<&'a TileEntry, Rejection> {
    let location = metadata.location_id.as_str();
    let files = &claims[location];
    if files.len() > 1 {
        return Err(Rejection::new(
            RejectionCode::DuplicateLocation,
            format!("one map of {location}"),
            format!("{} files: {}", files.len(), files.join(", ")),
            "keep one of them; none is taken, since nothing tells which is right",
        ));
    }
    let id: Option<TileId> = location.parse().ok();
    if let Some(entry) = id.and_then(|id| context.by_id.get(&id)) {
        return Ok(entry);
    }
    if let Some(verdict) = id.and_then(|id| context.dropped.get(&id)) {
        return Err(Rejection::new(
            RejectionCode::TileDropped,
            "a tile that passed the urban filter",
            format!("{location}, dropped as {} (tiles.csv)", verdict.name()),
            "rasterise with a lower --min-buildings or --min-built",
        ));
    }
    Err(Rejection::new(
        RejectionCode::UnknownLocation,
        format!("one of the {} tiles", context.manifest.tiles.len()),
        format!("location_id = {location:?}"),
        "rasterise the area and the lattice (grid.spacing_m) that the map was traced for",
    ))
}

type Converted = (RsrpMeta, AlignedMap, Vec<String>);

fn convert(
    source: &Source,
    metadata: &RadioMapMetadata,
    entry: &TileEntry,
    tile: &TileFile,
    context: &Context<'_>,
) -> Result<Converted, Rejection> {
    let grid = &context.manifest.config.grid;
    let digest = source.digest.clone()?;
    let map = load_values(&source.path, metadata, context.limit)?;
    let geometry = check::geometry(&map, metadata, entry.id, grid, context.record_cell_m)?;
    check::values(&map, metadata)?;
    let roof = |x: f64, y: f64| roof(tile, grid.cell_m, x, y);
    let warnings = check::transmitter(metadata, roof)?.into_iter().collect();

    let (start, length) = (grid.crop_offset_cells(), grid.crop_cells());
    let crop = start..start + length;
    let flight_height = context.manifest.config.buildings.flight_height_m;
    let occupied = tile
        .height_m
        .slice(s![crop.clone(), crop])
        .mapv(|height| f64::from(height) >= flight_height);
    let floor = context.rsrp.floor_dbm;
    let aligned = align(&map, metadata, &geometry, &occupied, grid, floor);
    if aligned.counts.reached == 0 {
        return Err(Rejection::new(
            RejectionCode::NothingReached,
            "at least one outdoor cell with a path",
            format!("{} outdoor cells, none reached", aligned.counts.unreached),
            "check the transmitter's position and the number of samples",
        ));
    }
    let meta = RsrpMeta {
        schema: RsrpMeta::SCHEMA.to_owned(),
        id: entry.id,
        epsg: entry.id.utm.epsg(),
        center_m: entry.id.center(),
        cell_m: geometry.cell_m,
        cells: geometry.cells as u32,
        row_order: "north_first".to_owned(),
        floor_dbm: floor,
        base_station: BaseStation {
            position_m: metadata.tx_position_m,
            power_per_re_dbm: power_per_re(metadata),
            pattern: metadata.tx_pattern.clone(),
        },
        radio: Radio {
            frequency_hz: metadata.frequency_hz,
            rx_height_m: metadata.rx_height_m,
            sionna_version: metadata.sionna_version.clone(),
            samples_per_tx: metadata.samples_per_tx,
            max_depth: metadata.max_depth,
            refraction: metadata.refraction,
            diffraction: metadata.diffraction,
        },
        source: SourceMap { file: source.name.clone(), digest, value_kind: map.kind },
        tile_sha256: entry.digest.sha256.clone(),
        licence: context.manifest.licence.clone(),
        attribution: context.manifest.attribution.clone(),
    };
    Ok((meta, aligned, warnings))
}

/// Height and its source under a place relative to the tile's centre, if a building is there.
fn roof(tile: &TileFile, cell_m: f64, x: f64, y: f64) -> Option<(f64, HeightSource)> {
    let half = tile.height_m.nrows() as f64 * cell_m / 2.0;
    let index = |distance: f64| {
        let cell = (distance / cell_m).floor();
        (cell >= 0.0).then_some(cell as usize)
    };
    let at = [index(half - y)?, index(half + x)?];
    let source = match tile.height_source.get(at)? {
        1 => HeightSource::Height,
        2 => HeightSource::Levels,
        3 => HeightSource::Default,
        _ => return None,
    };
    Some((f64::from(*tile.height_m.get(at)?), source))
}

fn rsrp_npz(meta: &RsrpMeta, map: &AlignedMap) -> Vec<u8> {
    let members = [
        ("rsrp_dbm", npy_bytes(&map.rsrp_dbm)),
        ("mask", npy_bytes(&map.mask)),
        ("meta_json", npy_bytes(&Array1::from_vec(to_json(meta)))),
    ];
    npz_bytes(&members, DEFLATE_LEVEL)
}

fn rejected_csv(outcomes: &[Outcome]) -> Vec<u8> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    let header = ["file", "location", "code", "expected", "found", "mend"];
    csv.write_record(header).expect("writing to memory cannot fail");
    for outcome in outcomes {
        if let Outcome::Rejected { file, location, rejection } = outcome {
            let Rejection { code, expected, found, mend } = rejection;
            csv.write_record([file, location, &code.name(), expected, found, mend])
                .expect("writing to memory cannot fail");
        }
    }
    csv.into_inner().expect("writing to memory cannot fail")
}

fn summarise(
    outcomes: &[Outcome],
    context: &Context<'_>,
    fingerprint: String,
    tiles_digest: &Digest,
    ignored: Vec<String>,
) -> RsrpManifest {
    let mut maps = Vec::new();
    let mut rejected = BTreeMap::new();
    let mut radios: Vec<RadioCount> = Vec::new();
    for outcome in outcomes {
        match outcome {
            Outcome::Rejected { rejection, .. } => {
                *rejected.entry(rejection.code.name()).or_default() += 1;
            }
            Outcome::Imported { entry, radio } => {
                maps.push(entry.clone());
                match radios.iter_mut().find(|known| known.radio == *radio) {
                    Some(known) => known.maps += 1,
                    None => radios.push(RadioCount { radio: radio.clone(), maps: 1 }),
                }
            }
        }
    }
    maps.sort_by_key(|entry| entry.id);
    RsrpManifest {
        schema: RsrpManifest::SCHEMA.to_owned(),
        fingerprint,
        software: Software::this(),
        licence: context.manifest.licence.clone(),
        attribution: context.manifest.attribution.clone(),
        epsg: context.manifest.epsg,
        config: context.rsrp.clone(),
        tiles_manifest_sha256: tiles_digest.sha256.clone(),
        radio: radios,
        rejected,
        ignored,
        maps,
    }
}

//! `holescout import-rsrp`: anyone's maps in, a directory of aligned ones out.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::complete::{Supplement, scene_facts};
use super::examine::{Examined, ImportContext, Refusal, SourceFile, examine};
use super::load::{Described, list, load_metadata};
use super::member::unreadable;
use super::metadata::{Object, RadioMapMetadata};
use super::rejection::{Rejection, RejectionCode};
use super::report::{ImportOutcome, imported_csv, rejected_csv, rsrp_npz, summarise};
use crate::config::{Config, RsrpConfig};
use crate::error::{Fault, FileError, HasFault};
use crate::grid::TileId;
use crate::manifest::{
    ImportInputs, Manifest, ManifestError, MapEntry, MapFile, RsrpManifest, ScenesManifest,
    StageFileError, TileEntry, TilesManifest, dropped_tiles, fingerprint, load, to_json,
};
use crate::progress::Progress;
use crate::store::{
    Build, BuildMode, Built, Digest, Finished, Item, Items, Opened, OutputError, Parallel, Part,
    sha256_file,
};

/// Why maps could not be imported at all. Single maps are rejected, not errors.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportRsrpError {
    /// The tiles cannot be used.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// A tile is damaged.
    #[error(transparent)]
    Tile(#[from] StageFileError),
    /// The output directory cannot be used.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The scenes stand on other tiles.
    #[error(
        "{}: made from other tiles than those given; run `holescout scenes` with these",
        scenes.display()
    )]
    OtherTiles {
        /// The directory of scenes.
        scenes: PathBuf,
    },
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

impl HasFault for ImportRsrpError {
    fn fault(&self) -> Fault {
        match self {
            Self::Manifest(error) => error.fault(),
            Self::Tile(error) => error.fault(),
            Self::Output(error) => error.fault(),
            Self::OtherTiles { .. } | Self::NoMaps { .. } => Fault::Input,
        }
    }
}

impl From<FileError> for ImportRsrpError {
    fn from(error: FileError) -> Self {
        Self::Output(error.into())
    }
}

/// What to import and where to.
#[derive(Debug, Clone, Copy)]
pub struct ImportRsrpJob<'a> {
    /// Directory of maps; files in directories below it are not looked at.
    pub maps: &'a Path,
    /// Output of `rasterise`.
    pub tiles: &'a Path,
    /// Output of `scenes` that the maps were traced from, where they do not tell their
    /// transmitters themselves.
    pub scenes: Option<&'a Path>,
    /// The configuration; `[rsrp]` and the cell size of `[shard]` are used.
    pub config: &'a Config,
    /// The directory to fill.
    pub out: &'a Path,
    /// What to build, and whether to replace maps of other inputs that are there.
    pub mode: BuildMode,
}

/// A file of the maps' directory.
struct SourceFiles {
    path: PathBuf,
    name: String,
    digest: Result<Digest, Rejection>,
    /// Of the `.json` of the same name, if there is one: other metadata, another map.
    sidecar: Option<Digest>,
}

/// Imports the maps of a directory, or a task's part of them.
///
/// # Errors
/// [`ImportRsrpError`]. Maps that do not follow the contract are no errors: `rejected.csv`
/// lists them with code, expected, found and mend.
pub fn import_rsrp(
    job: ImportRsrpJob<'_>,
    progress: &dyn Progress,
) -> Result<Built<RsrpManifest>, ImportRsrpError> {
    let (manifest, tiles_digest) = load::<TilesManifest>(job.tiles)?;
    let scenes = job.scenes.map(|scenes| read_scenes(scenes, &tiles_digest)).transpose()?;
    let (scenes, scenes_digest) = scenes.unzip();
    let (paths, ignored) = list(job.maps)?;
    if paths.is_empty() {
        return Err(ImportRsrpError::NoMaps { directory: job.maps.to_owned() });
    }
    let shared = job.mode.part != Part::Whole;
    let sources = paths.into_par_iter().map(|path| source(path, shared));
    let sources = sources.collect::<Result<Vec<_>, FileError>>()?;
    let config = &job.config.rsrp;
    let record_cell_m = job.config.shard.cell_m(&manifest.config.grid);
    let inputs = ImportInputs {
        record_cell_m,
        scenes_manifest_sha256: scenes_digest.map(|digest| digest.sha256),
        maps: sources.iter().map(map_file).collect(),
        ignored,
    };
    let fingerprint = fingerprint(&(RsrpManifest::SCHEMA, config, &tiles_digest, &inputs));
    let build = match Build::open(job.out, "rsrp", &fingerprint, job.mode, progress)? {
        Opened::Done(built) => return Ok(built),
        Opened::Ready(build) => build,
    };

    let context = ImportContext {
        tiles: job.tiles,
        scenes,
        manifest: &manifest,
        by_id: manifest.tiles.iter().map(|entry| (entry.id, entry)).collect(),
        dropped: dropped_tiles(job.tiles)?,
        rsrp: config,
        record_cell_m,
        limit: u64::from(config.max_array_mib) << 20,
    };
    let described = describe_all(&sources, &context, progress);
    let claims = claims(&sources, &described);
    let plan: Vec<_> = sources.iter().zip(&described).collect();
    let how = ("importing radio maps", Parallel::Across);
    let key = |(source, _): &(&SourceFiles, _)| source.name.clone();
    let import = |&(source, described): &(&SourceFiles, &Result<_, _>), item: Item<'_>| {
        import_one(source, described.as_ref(), &claims, &context, item)
    };
    let (outcomes, output) = match build.run_items(how, &plan, key, import, progress)? {
        Items::Part(report) => return Ok(Built::Part(report)),
        Items::All(outcomes, output) => (outcomes, output),
    };
    output.write("rejected.csv", &rejected_csv(&outcomes))?;
    output.write("import.csv", &imported_csv(&outcomes))?;
    let manifest = summarise(&outcomes, &context, fingerprint, &tiles_digest, inputs);
    output.complete(&to_json(&manifest))?;
    Ok(Built::Whole(manifest))
}

/// What scenes tell of maps, with the digest of their manifest.
fn read_scenes(
    directory: &Path,
    tiles: &Digest,
) -> Result<(BTreeMap<TileId, Object>, Digest), ImportRsrpError> {
    let (manifest, digest) = load::<ScenesManifest>(directory)?;
    if manifest.tiles_manifest_sha256 != tiles.sha256 {
        return Err(ImportRsrpError::OtherTiles { scenes: directory.to_owned() });
    }
    Ok((scene_facts(directory, &manifest)?, digest))
}

/// A file and its sidecar, either of which may be unreadable: then the map is rejected. Where tasks
/// share an import, what the next try may read ends the run instead: it would give this task other
/// inputs than the others have.
fn source(path: PathBuf, shared: bool) -> Result<SourceFiles, FileError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let digest_of = |path: &Path| match sha256_file(path) {
        Err(error) if shared && may_pass(&error) => Err(error),
        digest => Ok(digest),
    };
    let (sidecar, unread) = match digest_of(&path.with_extension("json"))? {
        Ok(digest) => (Some(digest), None),
        Err(error) if error.source.kind() == ErrorKind::NotFound => (None, None),
        Err(error) => (None, Some(error)),
    };
    let digest = unread.map_or(digest_of(&path)?, Err).map_err(|error| unreadable(&error));
    Ok(SourceFiles { path, name, digest, sidecar })
}

/// Whether a file that could not be read may be readable the next time.
fn may_pass(error: &FileError) -> bool {
    error.fault() == Fault::Running && error.source.kind() != ErrorKind::PermissionDenied
}

/// What the manifest says of a source.
fn map_file(source: &SourceFiles) -> MapFile {
    MapFile {
        file: source.name.clone(),
        digest: source.digest.as_ref().ok().cloned(),
        sidecar: source.sidecar.clone(),
    }
}

/// Metadata of all maps: two files may claim one tile.
fn describe_all(
    sources: &[SourceFiles],
    context: &ImportContext<'_>,
    progress: &dyn Progress,
) -> Vec<Result<Described, Rejection>> {
    let RsrpConfig { preset, assume, .. } = context.rsrp;
    let supplement =
        Supplement { preset: *preset, assume: Some(assume), scenes: context.scenes.as_ref() };
    progress.begin("reading metadata", Some(sources.len() as u64));
    let described = sources.par_iter().map(|source| {
        progress.advance(1);
        source.digest.as_ref().map_err(Clone::clone)?;
        load_metadata(&source.path, context.limit, &supplement)
    });
    let described = described.collect();
    progress.end();
    described
}

/// The files that say which tile is theirs, by tile.
fn claims<'a>(
    sources: &'a [SourceFiles],
    described: &'a [Result<Described, Rejection>],
) -> BTreeMap<&'a str, Vec<&'a str>> {
    let mut claims: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (source, described) in sources.iter().zip(described) {
        if let Ok(Described { metadata, .. }) = described {
            claims.entry(&metadata.location_id).or_default().push(&source.name);
        }
    }
    claims
}

fn import_one(
    source: &SourceFiles,
    described: Result<&Described, &Rejection>,
    claims: &BTreeMap<&str, Vec<&str>>,
    context: &ImportContext<'_>,
    item: Item<'_>,
) -> Result<Finished<ImportOutcome>, ImportRsrpError> {
    let examined = described.map_err(|rejection| rejection.clone().into()).and_then(|described| {
        let entry = locate(&described.metadata, claims, context)?;
        let digest = source.digest.as_ref().map_err(Clone::clone)?;
        let file = SourceFile { path: &source.path, name: &source.name, digest };
        Ok((examine(&file, described, entry, context)?, described))
    });
    match examined {
        Err(Refusal::Failed(error)) => Err(error.into()),
        Err(Refusal::Rejected(rejection)) => {
            let location = described.map_or("", |known| &known.metadata.location_id).to_owned();
            let file = source.name.clone();
            let outcome = |_: &[Digest]| ImportOutcome::Rejected { file, location, rejection };
            Ok(item.finish(&[], outcome)?)
        }
        Ok((Examined { meta, map, quality, warnings }, Described { assumed, .. })) => {
            let file = format!("{}.npz", meta.id);
            let bytes = rsrp_npz(&meta, &map);
            let outcome = |written: &[Digest]| ImportOutcome::Imported {
                entry: Box::new(MapEntry {
                    id: meta.id,
                    file: file.clone(),
                    digest: written[0].clone(),
                    source: meta.source.clone(),
                    cells: map.counts,
                    quality,
                    assumed: assumed.clone(),
                    warnings,
                }),
                radio: meta.radio.clone(),
            };
            Ok(item.finish(&[(&file, &bytes)], outcome)?)
        }
    }
}

/// The tile that a map belongs to.
fn locate<'a>(
    metadata: &RadioMapMetadata,
    claims: &BTreeMap<&str, Vec<&str>>,
    context: &ImportContext<'a>,
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

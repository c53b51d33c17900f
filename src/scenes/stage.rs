//! `holescout scenes`: extracts and tiles in, a directory of scenes out.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use geo::Rect;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::mesh::{Mesh, ply_bytes};
use super::place::{PlacedStations, Square};
use super::sites::{Site, SitesError, read_sites};
use super::solid::{Solid, Solids, extrude};
use super::xml::{BUILDINGS, GROUND, scene_xml};
use crate::config::{Config, ConfigError, GridConfig, Placement};
use crate::error::{Fault, FileError, HasFault};
use crate::grid::{Area, BoxIndex, TileId};
use crate::manifest::{
    LeftOutSolids, Manifest, ManifestError, SceneEntry, SceneFile, SceneMaterials, SceneMeta,
    SceneStation, ScenesConfig, ScenesManifest, SitesInput, Software, TileEntry, TilesManifest,
    fingerprint, load, to_json,
};
use crate::osm::{Extract, ExtractError, read_buildings};
use crate::progress::Progress;
use crate::rasterise::TileSource;
use crate::store::{
    Build, BuildMode, Built, Digest, Finished, Item, Items, Opened, OutputError, Parallel,
    sha256_file,
};

/// Why scenes could not be built.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScenesError {
    /// The manifest of the tiles cannot be used.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// The configuration does not fit the tiles.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The extracts cannot be used.
    #[error(transparent)]
    Read(#[from] ExtractError),
    /// The file of sites cannot be used.
    #[error(transparent)]
    Sites(#[from] SitesError),
    /// The output directory cannot be used.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// An extract is none of those that the tiles were made from.
    #[error(
        "{}: SHA-256 {found} is none of the extracts that the tiles were made from: {expected}; \
         give those, or run `holescout rasterise` with this one", path.display()
    )]
    OtherExtract {
        /// The extract.
        path: PathBuf,
        /// Its digest.
        found: String,
        /// Names and digests from the manifest of the tiles.
        expected: String,
    },
    /// The tiles were made from one extract more.
    #[error(
        "the tiles were made from {file} as well (SHA-256 {sha256}), which is not among the extracts \
         given; add it to --osm"
    )]
    MissingExtract {
        /// Name of the extract.
        file: String,
        /// Its digest.
        sha256: String,
    },
    /// A file of sites is needed, or must not be there.
    #[error("scenes.placement is {placement:?}, but {found}; {mend}")]
    Placement {
        /// The configuration.
        placement: Placement,
        /// What was given.
        found: &'static str,
        /// What to do.
        mend: &'static str,
    },
    /// No base station stands in any tile.
    #[error("no base station for any of {tiles} tiles: {reason}")]
    NoStation {
        /// Tiles looked at.
        tiles: usize,
        /// Why.
        reason: String,
    },
}

impl HasFault for ScenesError {
    fn fault(&self) -> Fault {
        match self {
            Self::Manifest(error) => error.fault(),
            Self::Read(error) => error.fault(),
            Self::Sites(error) => error.fault(),
            Self::Output(error) => error.fault(),
            _ => Fault::Input,
        }
    }
}

impl From<FileError> for ScenesError {
    fn from(error: FileError) -> Self {
        Self::Output(error.into())
    }
}

/// What to make scenes of and where to.
#[derive(Debug, Clone, Copy)]
pub struct ScenesJob<'a> {
    /// The extracts that the tiles were made from, in any order.
    pub osm: &'a [PathBuf],
    /// Output of `rasterise`.
    pub tiles: &'a Path,
    /// Base-station sites, for [`Placement::File`].
    pub sites: Option<&'a Path>,
    /// The configuration; `[scenes]` and the cell size of `[shard]` are used, the rest is that of
    /// the tiles.
    pub config: &'a Config,
    /// The directory to fill.
    pub out: &'a Path,
    /// What to build, and whether to replace scenes of other inputs that are there.
    pub mode: BuildMode,
}

/// What became of a tile: what the journal remembers.
#[derive(Debug, Serialize, Deserialize)]
struct SceneOutcome {
    id: TileId,
    /// `None` without a base station.
    entry: Option<SceneEntry>,
    repeated: u64,
    raised: u64,
}

/// Everything that making a scene needs to know.
struct SceneContext<'a> {
    config: ScenesConfig,
    map_size_m: u32,
    map_cell_m: f64,
    osm_sha256: Vec<String>,
    manifest: &'a TilesManifest,
    solids: &'a [Solid],
    index: BoxIndex,
    heights: TileSource<'a>,
    /// Places in metres of the projection.
    sites: Vec<([f64; 2], Site)>,
}

/// Builds the scenes of a job, or a task's part of them.
///
/// # Errors
/// [`ScenesError`]. The directory is not touched before the extracts have been read, and holds no
/// manifest unless everything was written.
pub fn scenes(
    job: ScenesJob<'_>,
    progress: &dyn Progress,
) -> Result<Built<ScenesManifest>, ScenesError> {
    let (tiles, tiles_digest) = load::<TilesManifest>(job.tiles)?;
    let config = ScenesConfig {
        grid: tiles.config.grid.clone(),
        buildings: tiles.config.buildings.clone(),
        scenes: job.config.scenes.clone(),
    };
    let map_cell_m = job.config.shard.cell_m(&config.grid);
    let map_size_m = config.scenes.map_size_m(&config.grid, map_cell_m)?;
    config.scenes.check_ground_height(config.buildings.flight_height_m)?;
    let osm = in_order_of(&tiles, job.osm)?;
    let mut sites_input = sites_input(job)?;
    let sites_digest = sites_input.as_ref().map(|input| &input.digest);
    let fingerprint =
        fingerprint(&(ScenesManifest::SCHEMA, &config, map_cell_m, &tiles_digest, sites_digest));
    let build = match Build::open(job.out, "scenes", &fingerprint, job.mode, progress)? {
        Opened::Done(built) => return Ok(built),
        Opened::Ready(build) => build,
    };

    let epsg = Some(tiles.epsg);
    let Extract { city, utm, .. } =
        read_buildings(&osm, &config.buildings, epsg, &Area::Whole, progress)?;
    progress.begin("extruding buildings", None);
    let Solids { solids, left_out } = extrude(&city);
    progress.end();
    // The grid of the square alone: a cell's height depends on its place only.
    let square = GridConfig { side_m: map_size_m, crop_m: map_size_m, ..config.grid.clone() };
    let sites = sites_near(job.sites, &tiles, map_size_m, sites_input.as_mut())?;
    let context = SceneContext {
        map_size_m,
        map_cell_m,
        osm_sha256: tiles.inputs.iter().map(|input| input.digest.sha256.clone()).collect(),
        manifest: &tiles,
        index: BoxIndex::new(
            solids.iter().map(Solid::bounds).collect(),
            config.grid.spacing_m.into(),
        ),
        config,
        solids: &solids,
        heights: TileSource::new(&city, &square, utm),
        sites,
    };

    let how = ("writing scenes", Parallel::Across);
    let key = |tile: &TileEntry| tile.id.to_string();
    let scene = |tile: &TileEntry, item: Item<'_>| build_scene(tile.id, &context, item);
    let (outcomes, output) = match build.run_items(how, &tiles.tiles, key, scene, progress)? {
        Items::Part(report) => return Ok(Built::Part(report)),
        Items::All(outcomes, output) => (outcomes, output),
    };
    let manifest =
        summarise(outcomes, &context, fingerprint, &tiles_digest, left_out, sites_input)?;
    output.complete(&to_json(&manifest))?;
    Ok(Built::Whole(manifest))
}

/// The extracts in the order of the tiles' manifest: of an object in several the first counts.
fn in_order_of(tiles: &TilesManifest, given: &[PathBuf]) -> Result<Vec<PathBuf>, ScenesError> {
    let digests: Vec<Digest> =
        given.par_iter().map(|path| sha256_file(path)).collect::<Result<_, _>>()?;
    for (path, digest) in given.iter().zip(&digests) {
        if !tiles.inputs.iter().any(|input| input.digest == *digest) {
            let known = tiles.inputs.iter();
            let known = known.map(|input| format!("{} ({})", input.file, input.digest.sha256));
            return Err(ScenesError::OtherExtract {
                path: path.clone(),
                found: digest.sha256.clone(),
                expected: known.collect::<Vec<_>>().join(", "),
            });
        }
    }
    let file = |input: &crate::manifest::Input| {
        let at = digests.iter().position(|digest| *digest == input.digest);
        at.map(|at| given[at].clone()).ok_or_else(|| ScenesError::MissingExtract {
            file: input.file.clone(),
            sha256: input.digest.sha256.clone(),
        })
    };
    tiles.inputs.iter().map(file).collect()
}

/// The file of sites, not read yet.
fn sites_input(job: ScenesJob<'_>) -> Result<Option<SitesInput>, ScenesError> {
    let placement = job.config.scenes.placement;
    match (job.sites, placement) {
        (None, Placement::File) => Err(ScenesError::Placement {
            placement,
            found: "no file of sites was given",
            mend: "give one by --sites",
        }),
        (Some(_), Placement::Any | Placement::Roof) => Err(ScenesError::Placement {
            placement,
            found: "a file of sites was given",
            mend: "leave --sites out, or choose --placement file",
        }),
        (None, _) => Ok(None),
        (Some(path), Placement::File) => Ok(Some(SitesInput {
            file: path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            digest: sha256_file(path)?,
            sites: 0,
            outside: 0,
            repeated: 0,
            raised: 0,
        })),
    }
}

/// The sites in the square of some tile, and the counts of all.
fn sites_near(
    file: Option<&Path>,
    tiles: &TilesManifest,
    map_size_m: u32,
    counts: Option<&mut SitesInput>,
) -> Result<Vec<([f64; 2], Site)>, ScenesError> {
    let (Some(path), Some(counts), Some(first)) = (file, counts, tiles.tiles.first()) else {
        return Ok(Vec::new());
    };
    let utm = first.id.utm;
    let squares = tiles.tiles.iter().map(|tile| tile.id.square(map_size_m.into())).collect();
    let index = BoxIndex::new(squares, map_size_m.into());
    let mut near = Vec::new();
    read_sites(path, |site| {
        let [lon, lat] = site.lon_lat;
        counts.sites += 1;
        let place = utm.forward(lon, lat).filter(|&place| {
            let squares = index.meeting(&Rect::new(place, place));
            squares.into_iter().any(|square| holds(&index.boxes()[square], place))
        });
        match place {
            Some(place) => near.push((place, site)),
            None => counts.outside += 1,
        }
    })?;
    if near.is_empty() {
        let SitesInput { file, sites, .. } = counts;
        let reason =
            format!("none of the {sites} sites of {file} lies in a square that is to be traced");
        return Err(ScenesError::NoStation { tiles: tiles.tiles.len(), reason });
    }
    Ok(near)
}

/// Whether a square holds a place; its western and northern borders belong to it, as the borders
/// of its cells do.
fn holds(square: &Rect<f64>, [x, y]: [f64; 2]) -> bool {
    (square.min().x..square.max().x).contains(&x) && square.min().y < y && y <= square.max().y
}

fn build_scene(
    id: TileId,
    context: &SceneContext<'_>,
    item: Item<'_>,
) -> Result<Finished<SceneOutcome>, ScenesError> {
    let ScenesConfig { grid, scenes: scene, .. } = &context.config;
    let meeting = context.index.meeting(&id.square(grid.side_m.into()));
    let solids: Vec<&Solid> = meeting.into_iter().map(|at| &context.solids[at]).collect();
    let heights = context.heights.rasterise(id);
    let square = Square::new(id, &heights, grid.cell_m, &solids);
    let rx_height_m = context.config.buildings.flight_height_m;
    let PlacedStations { stations, repeated, raised } = match scene.placement {
        Placement::File => {
            let bounds = id.square(context.map_size_m.into());
            let here = context.sites.iter().filter(|(place, _)| holds(&bounds, *place));
            square.of_sites(here, scene, rx_height_m)
        }
        Placement::Any | Placement::Roof => PlacedStations {
            stations: square.random(scene, rx_height_m),
            ..PlacedStations::default()
        },
    };
    let outcome = |entry| SceneOutcome { id, entry, repeated, raised };
    if stations.is_empty() {
        return Ok(item.finish(&[], |_| outcome(None))?);
    }
    let buildings = Mesh::of_solids(solids.iter().copied(), id);
    let meta = meta(id, context, &solids, &buildings, stations);
    let materials = meta.materials;
    let named = (!solids.is_empty()).then_some(materials.buildings);
    let contents = [
        ("scene.xml", scene_xml(named, materials.ground).into_bytes()),
        (GROUND, ply_bytes(&ground(grid.side_m, &buildings))),
        (BUILDINGS, ply_bytes(&buildings)),
        ("scene.json", to_json(&meta)),
    ];
    let names = contents.each_ref().map(|(name, _)| format!("{id}/{name}"));
    let files: Vec<(&str, &[u8])> =
        names.iter().zip(&contents).map(|(name, (_, bytes))| (name.as_str(), &bytes[..])).collect();
    let finished = item.finish(&files, |digests| {
        let named = names.iter().cloned().zip(digests);
        outcome(Some(SceneEntry {
            id,
            files: named.map(|(file, digest)| SceneFile { file, digest: digest.clone() }).collect(),
            solids: meta.solids,
            triangles: meta.triangles,
            base_stations: meta.base_stations.len() as u32,
        }))
    });
    Ok(finished?)
}

fn meta(
    id: TileId,
    context: &SceneContext<'_>,
    solids: &[&Solid],
    mesh: &Mesh,
    base_stations: Vec<SceneStation>,
) -> SceneMeta {
    let ScenesConfig { grid, buildings, scenes: scene } = &context.config;
    SceneMeta {
        schema: SceneMeta::SCHEMA.to_owned(),
        id,
        epsg: id.utm.epsg(),
        center_m: id.center(),
        center_lon_lat: id.lon_lat(),
        side_m: grid.side_m,
        cell_m: grid.cell_m,
        map_size_m: context.map_size_m,
        map_cell_m: context.map_cell_m,
        rx_height_m: buildings.flight_height_m,
        base_stations,
        materials: SceneMaterials {
            buildings: scene.building_material,
            ground: scene.ground_material,
        },
        solids: solids.len() as u64,
        triangles: mesh.triangles.len() as u64,
        osm_sha256: context.osm_sha256.clone(),
        licence: context.manifest.licence.clone(),
        attribution: context.manifest.attribution.clone(),
    }
}

/// The ground below a tile and all that is in its mesh.
fn ground(side_m: u32, mesh: &Mesh) -> Mesh {
    let half = (f64::from(side_m) / 2.0) as f32;
    let reach = mesh.vertices.iter().fold([-half, -half, half, half], |reach, &[x, y, _]| {
        let [west, south, east, north] = reach;
        [west.min(x), south.min(y), east.max(x), north.max(y)]
    });
    Mesh::ground(reach)
}

fn summarise(
    outcomes: Vec<SceneOutcome>,
    context: &SceneContext<'_>,
    fingerprint: String,
    tiles_digest: &Digest,
    left_out: LeftOutSolids,
    mut sites: Option<SitesInput>,
) -> Result<ScenesManifest, ScenesError> {
    if let Some(sites) = &mut sites {
        sites.repeated = outcomes.iter().map(|outcome| outcome.repeated).sum();
        sites.raised = outcomes.iter().map(|outcome| outcome.raised).sum();
    }
    let tiles = outcomes.len();
    let empty = outcomes.iter().filter(|outcome| outcome.entry.is_none());
    let without_base_station: BTreeSet<TileId> = empty.map(|outcome| outcome.id).collect();
    let scenes: Vec<SceneEntry> =
        outcomes.into_iter().filter_map(|outcome| outcome.entry).collect();
    if scenes.is_empty() {
        let reason = "no building on the ground in any square that is to be traced".to_owned();
        return Err(ScenesError::NoStation { tiles, reason });
    }
    let manifest = context.manifest;
    Ok(ScenesManifest {
        schema: ScenesManifest::SCHEMA.to_owned(),
        fingerprint,
        software: Software::this(),
        licence: manifest.licence.clone(),
        attribution: manifest.attribution.clone(),
        epsg: manifest.epsg,
        config: context.config.clone(),
        map_size_m: context.map_size_m,
        map_cell_m: context.map_cell_m,
        tiles_manifest_sha256: tiles_digest.sha256.clone(),
        inputs: manifest.inputs.clone(),
        sites,
        left_out,
        without_base_station: without_base_station.into_iter().collect(),
        scenes,
    })
}

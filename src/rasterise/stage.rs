//! `holescout rasterise`: extracts in, a directory of tiles out.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::Serialize;

use super::blocks::Blocks;
use super::pack::Packer;
use super::tile_source::TileSource;
use super::unseen::without_cells;
use crate::building::{Action, Building, Defect, HeightSource, Kind, Problem};
use crate::config::{Config, FilterConfig, GridConfig};
use crate::error::{Fault, FileError, HasFault};
use crate::grid::{Area, TileId};
use crate::manifest::{
    BuildingCounts, Input, Manifest, Software, TileEntry, TileMeta, TileStatistics, TilesConfig,
    TilesManifest, Verdict, fingerprint, to_json,
};
use crate::osm::{Extract, ExtractError, read_buildings};
use crate::progress::Progress;
use crate::store::{
    Build, BuildMode, Built, Digest, Finished, Item, Items, Opened, OutputError, Parallel, Part,
    sha256_file,
};

/// Why tiles could not be built.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RasteriseError {
    /// The extracts cannot be used.
    #[error(transparent)]
    Read(#[from] ExtractError),
    /// The output directory cannot be used.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// All buildings lie between the tiles.
    #[error(
        "no building meets a tile: tiles of grid.side_m = {side_m} m every \
         grid.spacing_m = {spacing_m} m leave gaps"
    )]
    NoTile {
        /// Side of a tile, in metres.
        side_m: u32,
        /// Distance between tile centres, in metres.
        spacing_m: u32,
    },
    /// No tile of the lattice has both its centre in the area and a building.
    #[error(
        "the area holds no tile: none of the {candidates} tiles with buildings has its centre \
         inside; the buildings lie around longitude {lon:.4}, latitude {lat:.4}"
    )]
    NothingInArea {
        /// Tiles of the extract with buildings.
        candidates: usize,
        /// Longitude of one of them, in degrees.
        lon: f64,
        /// Latitude of one of them, in degrees.
        lat: f64,
    },
}

impl HasFault for RasteriseError {
    fn fault(&self) -> Fault {
        match self {
            Self::Read(error) => error.fault(),
            Self::Output(error) => error.fault(),
            Self::NoTile { .. } | Self::NothingInArea { .. } => Fault::Input,
        }
    }
}

impl From<FileError> for RasteriseError {
    fn from(error: FileError) -> Self {
        Self::Output(error.into())
    }
}

/// What to rasterise and where to.
#[derive(Debug, Clone, Copy)]
pub struct RasteriseJob<'a> {
    /// Extracts; of an object in several, the whole copy is taken.
    pub osm: &'a [PathBuf],
    /// The part to cover.
    pub area: &'a Area,
    /// The configuration; `[grid]`, `[buildings]` and `[filter]` are used.
    pub config: &'a Config,
    /// The directory to fill.
    pub out: &'a Path,
    /// What to build, and whether to replace tiles of other inputs that are there.
    pub mode: BuildMode,
}

/// A candidate tile: what the journal remembers and `tiles.csv` lists.
#[derive(Debug, Serialize, serde::Deserialize)]
struct Candidate {
    id: TileId,
    statistics: TileStatistics,
    verdict: Verdict,
    digest: Option<Digest>,
}

/// Builds the tiles of a job, or a task's part of them.
///
/// # Errors
/// [`RasteriseError`]. The directory is not touched before the extracts have been read, and
/// holds no manifest unless everything was written.
pub fn rasterise(
    job: RasteriseJob<'_>,
    progress: &dyn Progress,
) -> Result<Built<TilesManifest>, RasteriseError> {
    let Config { grid, buildings, filter, .. } = job.config;
    let config =
        TilesConfig { grid: grid.clone(), buildings: buildings.clone(), filter: filter.clone() };
    let inputs = inputs(job.osm, &config)?;
    let area = job.area.coordinates();
    let digests: Vec<_> = inputs.iter().map(|input| &input.digest).collect();
    let fingerprint = fingerprint(&(TilesManifest::SCHEMA, &config, &digests, &area));
    let build = match Build::open(job.out, "tiles", &fingerprint, job.mode, progress)? {
        Opened::Done(built) => return Ok(built),
        Opened::Ready(build) => build,
    };

    let Extract { city, utm, mut problems, tagged } =
        read_buildings(job.osm, &config.buildings, grid.epsg, job.area, progress)?;
    problems.extend(without_cells(&city, grid));
    problems.sort_unstable();
    let source = TileSource::new(&city, grid, utm);
    let candidates = select(&source, job.area, grid)?;

    // The tiles of a task lie apart, and share little.
    let is_whole = job.mode.part == Part::Whole;
    let blocks = is_whole.then(|| Blocks::new(&city, grid, &candidates)).flatten();
    let packer = Packer::new(grid);
    let tile = |id: &TileId, item: Item<'_>| {
        let how = Painting { source: &source, blocks: blocks.as_ref(), packer: &packer };
        build_tile(*id, how, &config, item)
    };
    let how = ("rasterising tiles", Parallel::Across);
    let (candidates, output) =
        match build.run_items(how, &candidates, ToString::to_string, tile, progress)? {
            Items::Part(report) => return Ok(Built::Part(report)),
            Items::All(candidates, output) => (candidates, output),
        };

    output.write("tiles.csv", &tiles_csv(&candidates))?;
    output.write("problems.csv", &problems_csv(&problems))?;
    let mut verdicts = BTreeMap::new();
    for candidate in &candidates {
        *verdicts.entry(candidate.verdict).or_default() += 1;
    }
    let manifest = TilesManifest {
        schema: TilesManifest::SCHEMA.to_owned(),
        fingerprint,
        software: Software::this(),
        licence: config.buildings.licence.clone(),
        attribution: config.buildings.attribution.clone(),
        epsg: utm.epsg(),
        area,
        config,
        inputs,
        buildings: count_buildings(city.buildings(), tagged),
        problems: count_problems(&problems),
        verdicts,
        tiles: candidates.into_iter().filter_map(entry).collect(),
    };
    output.complete(&to_json(&manifest))?;
    Ok(Built::Whole(manifest))
}

fn inputs(files: &[PathBuf], config: &TilesConfig) -> Result<Vec<Input>, FileError> {
    files
        .par_iter()
        .map(|path| {
            Ok(Input {
                file: path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
                digest: sha256_file(path)?,
                licence: config.buildings.licence.clone(),
                attribution: config.buildings.attribution.clone(),
            })
        })
        .collect()
}

fn select(
    source: &TileSource<'_>,
    area: &Area,
    grid: &GridConfig,
) -> Result<Vec<TileId>, RasteriseError> {
    let candidates = source.candidates();
    let Some(first) = candidates.first() else {
        let (side_m, spacing_m) = (grid.side_m, grid.spacing_m);
        return Err(RasteriseError::NoTile { side_m, spacing_m });
    };
    let inside = |tile: &TileId| {
        let [lon, lat] = tile.lon_lat();
        area.contains(lon, lat)
    };
    let selected: Vec<TileId> = candidates.iter().copied().filter(inside).collect();
    if selected.is_empty() {
        let [lon, lat] = first.lon_lat();
        return Err(RasteriseError::NothingInArea { candidates: candidates.len(), lon, lat });
    }
    Ok(selected)
}

/// Where the cells of tiles come from: blocks, if tiles share them.
#[derive(Clone, Copy)]
struct Painting<'a> {
    source: &'a TileSource<'a>,
    blocks: Option<&'a Blocks<'a>>,
    packer: &'a Packer<'a>,
}

fn build_tile(
    id: TileId,
    Painting { source, blocks, packer }: Painting<'_>,
    config: &TilesConfig,
    item: Item<'_>,
) -> Result<Finished<Candidate>, RasteriseError> {
    // What is dropped is not put together.
    let finish = |statistics, pack: &dyn Fn(Vec<u8>) -> Vec<u8>| {
        let verdict = judge(&statistics, &config.filter);
        let bytes =
            (verdict == Verdict::Kept).then(|| pack(to_json(&tile_meta(id, statistics, config))));
        let name = file_name(id);
        let file = bytes.as_ref().map(|bytes| (&*name, &**bytes));
        let finished = item.finish(file.as_slice(), |written| Candidate {
            id,
            statistics,
            verdict,
            digest: written.first().cloned(),
        });
        Ok(finished?)
    };
    if let Some(blocks) = blocks {
        let tile = blocks.tile(id);
        finish(tile.statistics(source.city), &|meta| packer.blocks(&tile, meta))
    } else {
        let tile = source.rasterise(id);
        finish(tile.statistics, &|meta| packer.grid(&tile, meta))
    }
}

fn judge(statistics: &TileStatistics, filter: &FilterConfig) -> Verdict {
    if statistics.buildings < filter.min_buildings {
        Verdict::FewBuildings
    } else if statistics.built < filter.min_built {
        Verdict::LowBuilt
    } else {
        Verdict::Kept
    }
}

fn file_name(id: TileId) -> String {
    format!("{id}.npz")
}

fn tile_meta(id: TileId, statistics: TileStatistics, config: &TilesConfig) -> TileMeta {
    TileMeta {
        schema: TileMeta::SCHEMA.to_owned(),
        id,
        epsg: id.utm.epsg(),
        center_m: id.center(),
        center_lon_lat: id.lon_lat(),
        side_m: config.grid.side_m,
        cell_m: config.grid.cell_m,
        crop_m: config.grid.crop_m,
        row_order: "north_first".to_owned(),
        licence: config.buildings.licence.clone(),
        attribution: config.buildings.attribution.clone(),
        statistics,
    }
}

fn entry(candidate: Candidate) -> Option<TileEntry> {
    let Candidate { id, statistics, digest, .. } = candidate;
    Some(TileEntry { id, file: file_name(id), digest: digest?, statistics })
}

fn count_buildings(buildings: &[Building], tagged: u64) -> BuildingCounts {
    let mut counts = BuildingCounts { tagged, ..BuildingCounts::default() };
    // The pieces of a relation follow each other.
    for pieces in buildings.chunk_by(|a, b| a.object == b.object) {
        let Building { attributes, .. } = &pieces[0];
        *match (attributes.raised, attributes.kind) {
            (true, _) => &mut counts.raised,
            (false, Kind::Outline) => &mut counts.outlines,
            (false, Kind::Part) => &mut counts.parts,
        } += 1;
        *match attributes.source {
            HeightSource::Height => &mut counts.from_height,
            HeightSource::Levels => &mut counts.from_levels,
            HeightSource::Default => &mut counts.from_default,
        } += 1;
    }
    counts
}

fn count_problems(problems: &[Problem]) -> BTreeMap<Action, BTreeMap<Defect, u64>> {
    let mut counts: BTreeMap<Action, BTreeMap<Defect, u64>> = BTreeMap::new();
    for Problem { defect, action, .. } in problems {
        *counts.entry(*action).or_default().entry(*defect).or_default() += 1;
    }
    counts
}

fn tiles_csv(candidates: &[Candidate]) -> Vec<u8> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    let header = [
        "id",
        "lon",
        "lat",
        "verdict",
        "buildings",
        "built",
        "max_height_m",
        "cells_from_height",
        "cells_from_levels",
        "cells_from_default",
    ];
    let rows = candidates.iter().map(|Candidate { id, statistics, verdict, .. }| {
        let [lon, lat] = id.lon_lat();
        let cells = statistics.built_cells;
        [
            id.to_string(),
            format!("{lon:.7}"),
            format!("{lat:.7}"),
            verdict.name().to_owned(),
            statistics.buildings.to_string(),
            format!("{:.6}", statistics.built),
            statistics.max_height_m.to_string(),
            cells.height.to_string(),
            cells.levels.to_string(),
            cells.default.to_string(),
        ]
    });
    csv.write_record(header).expect("writing to memory cannot fail");
    for row in rows {
        csv.write_record(row).expect("writing to memory cannot fail");
    }
    csv.into_inner().expect("writing to memory cannot fail")
}

fn problems_csv(problems: &[Problem]) -> Vec<u8> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    csv.write_record(["object", "code", "action"]).expect("writing to memory cannot fail");
    for Problem { object, defect, action } in problems {
        let row = [&object.to_string(), defect.name(), action.name()];
        csv.write_record(row).expect("writing to memory cannot fail");
    }
    csv.into_inner().expect("writing to memory cannot fail")
}

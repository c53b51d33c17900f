//! Stages of the pipeline. What they built is told by the manifest in the directory that they filled.

use std::path::{Path, PathBuf};

use holescout::config::Config;
use holescout::dataset::ShardJob;
use holescout::error::HasFault;
use holescout::grid::Area;
use holescout::rasterise::RasteriseJob;
use holescout::rsrp::ImportRsrpJob;
use holescout::scenes::ScenesJob;
use holescout::store::BuildMode;
use pyo3::prelude::*;

use crate::dataset::config;
use crate::error::raise;
use crate::watch::{Watch, watched};

/// What all stages are told.
#[derive(FromPyObject)]
pub(crate) struct Common<'py> {
    /// The configuration as JSON.
    settings: String,
    out: PathBuf,
    overwrite: bool,
    progress: Option<Bound<'py, PyAny>>,
}

impl Common<'_> {
    /// Runs a stage with its settings, its directory and how it fills it.
    fn run<T, E: HasFault + 'static>(
        &self,
        py: Python<'_>,
        stage: impl FnOnce(&Config, &Path, BuildMode, &Watch) -> Result<T, E> + Send,
    ) -> PyResult<()> {
        let config = config(&self.settings)?;
        let mode = BuildMode { overwrite: self.overwrite, ..BuildMode::default() };
        let (out, config) = (self.out.as_path(), &config);
        watched(py, self.progress.as_ref(), move |watch| {
            stage(config, out, mode, watch).map(drop).map_err(raise)
        })
    }
}

/// Extracts to height grids; `area` is a bounding box in degrees or a GeoJSON file.
#[pyfunction]
pub(crate) fn rasterise(
    py: Python<'_>,
    osm: Vec<PathBuf>,
    bbox: Option<[f64; 4]>,
    geojson: Option<PathBuf>,
    common: Common<'_>,
) -> PyResult<()> {
    let area = match (bbox, geojson) {
        (Some(bbox), _) => Area::from_bbox(bbox).map_err(raise)?,
        (None, Some(path)) => Area::from_geojson(&path).map_err(raise)?,
        (None, None) => Area::Whole,
    };
    common.run(py, |config, out, mode, watch| {
        let job = RasteriseJob { osm: &osm, area: &area, config, out, mode };
        holescout::rasterise::rasterise(job, watch)
    })
}

/// Scenes of tiles for a ray tracer.
#[pyfunction]
pub(crate) fn scenes(
    py: Python<'_>,
    osm: Vec<PathBuf>,
    tiles: PathBuf,
    sites: Option<PathBuf>,
    common: Common<'_>,
) -> PyResult<()> {
    common.run(py, |config, out, mode, watch| {
        let sites = sites.as_deref();
        let job = ScenesJob { osm: &osm, tiles: &tiles, sites, config, out, mode };
        holescout::scenes::scenes(job, watch)
    })
}

/// Radio maps, checked and aligned with tiles.
#[pyfunction]
pub(crate) fn import_rsrp(
    py: Python<'_>,
    maps: PathBuf,
    tiles: PathBuf,
    scenes: Option<PathBuf>,
    common: Common<'_>,
) -> PyResult<()> {
    common.run(py, |config, out, mode, watch| {
        let scenes = scenes.as_deref();
        let job = ImportRsrpJob { maps: &maps, tiles: &tiles, scenes, config, out, mode };
        holescout::rsrp::import_rsrp(job, watch)
    })
}

/// Tiles and radio maps to a dataset.
#[pyfunction]
pub(crate) fn shard(
    py: Python<'_>,
    tiles: PathBuf,
    rsrp: PathBuf,
    common: Common<'_>,
) -> PyResult<()> {
    common.run(py, |config, out, mode, watch| {
        let job = ShardJob { tiles: &tiles, rsrp: &rsrp, config, out, mode };
        holescout::dataset::shard(job, watch)
    })
}

/// Whether an output is what its manifest says: schema, files, items and what is wrong.
#[pyfunction]
pub(crate) fn verify(
    py: Python<'_>,
    directory: PathBuf,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<(String, usize, usize, Vec<String>)> {
    watched(py, progress.as_ref(), |watch| {
        let found = holescout::verify::verify(&directory, watch).map_err(raise)?;
        let failures = found.failures.iter().map(ToString::to_string).collect();
        Ok((found.schema, found.files, found.items, failures))
    })
}

//! The stages with the configuration that a manifest records.

use std::path::{Path, PathBuf};

use super::{GivenInputs, RebuildError, compare_software, inputs};
use crate::config::{Config, GridConfig, RsrpConfig, ShardConfig};
use crate::dataset::{self, ShardJob};
use crate::grid::Area;
use crate::manifest::{
    DatasetConfig, DatasetManifest, ImportInputs, Input, Release, RsrpManifest, ScenesManifest,
    Software, TilesManifest, load,
};
use crate::progress::Progress;
use crate::rasterise::{RasteriseJob, rasterise};
use crate::release::{DateError, ReleaseJob, Version, release};
use crate::rsrp::{ImportRsrpJob, import_rsrp};
use crate::scenes::{ScenesJob, scenes};
use crate::store::{BuildMode, MANIFEST, sha256_file};
use crate::verify::VerifyFailure;

/// Polygons as GeoJSON coordinates.
type Coordinates = Vec<Vec<Vec<[f64; 2]>>>;

/// What all stages are rebuilt with.
pub(super) struct Bench<'a> {
    pub(super) directory: &'a Path,
    pub(super) given: GivenInputs<'a>,
    /// A temporary directory.
    pub(super) scratch: &'a Path,
    pub(super) progress: &'a dyn Progress,
    /// What is found to differ on the way.
    pub(super) failures: Vec<VerifyFailure>,
}

/// What an import is repeated with.
struct Traced<'a> {
    maps: PathBuf,
    scenes: Option<&'a Path>,
    record_cell_m: f64,
}

impl<'a> Bench<'a> {
    /// Tiles from extracts.
    pub(super) fn tiles(&mut self) -> Result<PathBuf, RebuildError> {
        let (manifest, _) = load::<TilesManifest>(self.directory)?;
        self.check_software(&manifest.software);
        let TilesManifest { config, inputs, area, .. } = manifest;
        let config = Config {
            grid: config.grid,
            buildings: config.buildings,
            filter: config.filter,
            ..Config::default()
        };
        self.rasterise(&config, &inputs, area.as_ref())
    }

    /// Scenes from tiles and extracts.
    pub(super) fn scenes(&mut self) -> Result<PathBuf, RebuildError> {
        let (manifest, _) = load::<ScenesManifest>(self.directory)?;
        self.check_software(&manifest.software);
        let tiles = &manifest.tiles_manifest_sha256;
        let tiles = inputs::stage("tiles", "--tiles", tiles, self.given.tiles)?;
        let osm = inputs::extracts(&manifest.inputs, self.given.osm, self.scratch)?;
        let sites = manifest.sites.as_ref().map(|sites| {
            inputs::file(&sites.file, &sites.digest, "--sites", self.given.sites, self.scratch)
        });
        let sites = sites.transpose()?;
        let config = Config {
            shard: counted_for(manifest.map_cell_m, &manifest.config.grid)?,
            grid: manifest.config.grid,
            buildings: manifest.config.buildings,
            scenes: manifest.config.scenes,
            ..Config::default()
        };
        config.validate()?;
        let out = self.scratch.join("scenes");
        let job = ScenesJob {
            osm: &osm,
            tiles,
            sites: sites.as_deref(),
            config: &config,
            out: &out,
            mode: BuildMode::default(),
        };
        scenes(job, self.progress)?;
        Ok(out)
    }

    /// Imported maps from tiles and maps.
    pub(super) fn maps(&mut self) -> Result<PathBuf, RebuildError> {
        let (manifest, _) = load::<RsrpManifest>(self.directory)?;
        self.check_software(&manifest.software);
        let tiles = &manifest.tiles_manifest_sha256;
        let tiles = inputs::stage("tiles", "--tiles", tiles, self.given.tiles)?;
        let (of_tiles, _) = load::<TilesManifest>(tiles)?;
        let traced = self.traced(&manifest.inputs)?;
        self.import(&of_tiles.config.grid, &manifest.config, &traced, tiles)
    }

    /// A dataset from extracts and maps.
    pub(super) fn dataset(&mut self) -> Result<PathBuf, RebuildError> {
        let (manifest, _) = load::<DatasetManifest>(self.directory)?;
        self.check_software(&manifest.software);
        let DatasetConfig { grid, buildings, filter, rsrp, shard, split } = manifest.config;
        let config = Config { grid, buildings, filter, rsrp, shard, split, ..Config::default() };
        let traced = self.traced(&manifest.import)?;
        let tiles = self.rasterise(&config, &manifest.inputs, manifest.area.as_ref())?;
        self.compare_manifest("tiles", &tiles, &manifest.tiles_manifest_sha256)?;
        let rsrp = self.import(&config.grid, &config.rsrp, &traced, &tiles)?;
        self.compare_manifest("imported maps", &rsrp, &manifest.rsrp_manifest_sha256)?;
        let out = self.scratch.join("dataset");
        let job = ShardJob {
            tiles: &tiles,
            rsrp: &rsrp,
            config: &config,
            out: &out,
            mode: BuildMode::default(),
        };
        dataset::shard(job, self.progress)?;
        manifest.release.as_ref().map_or(Ok(out.clone()), |release| self.release(release, &out))
    }

    /// What was made of a dataset to publish it.
    fn release(&self, recorded: &Release, dataset: &Path) -> Result<PathBuf, RebuildError> {
        let wrong = |reason: String| RebuildError::Contradiction { reason };
        let Release { name, version, date, url, creators, notes, .. } = recorded;
        let version = &Version::parse(version).map_err(|error| wrong(error.to_string()))?;
        let date = date.as_deref().map(str::parse).transpose();
        let out = self.scratch.join("release");
        let job = ReleaseJob {
            dataset,
            out: Some(&out),
            name: Some(name),
            version,
            date: date.map_err(|error: DateError| wrong(error.to_string()))?,
            url: url.as_deref(),
            creators,
            notes: notes.as_deref(),
            previous: None,
            archive: None,
            overwrite: false,
        };
        release(&job, self.progress)?;
        Ok(out)
    }

    fn rasterise(
        &self,
        config: &Config,
        recorded: &[Input],
        area: Option<&Coordinates>,
    ) -> Result<PathBuf, RebuildError> {
        config.validate()?;
        let osm = inputs::extracts(recorded, self.given.osm, self.scratch)?;
        let area = area.map_or(Area::Whole, |polygons| Area::from_coordinates(polygons));
        let out = self.scratch.join("tiles");
        let job =
            RasteriseJob { osm: &osm, area: &area, config, out: &out, mode: BuildMode::default() };
        rasterise(job, self.progress)?;
        Ok(out)
    }

    /// The maps that were imported, and the scenes that they were traced from.
    fn traced(&self, recorded: &ImportInputs) -> Result<Traced<'a>, RebuildError> {
        let scenes = recorded.scenes_manifest_sha256.as_ref();
        let scenes =
            scenes.map(|sha256| inputs::stage("scenes", "--scenes", sha256, self.given.scenes));
        Ok(Traced {
            scenes: scenes.transpose()?,
            maps: inputs::maps(recorded, self.given.maps, self.scratch)?,
            record_cell_m: recorded.record_cell_m,
        })
    }

    fn import(
        &self,
        grid: &GridConfig,
        rsrp: &RsrpConfig,
        traced: &Traced<'_>,
        tiles: &Path,
    ) -> Result<PathBuf, RebuildError> {
        let config = Config {
            shard: counted_for(traced.record_cell_m, grid)?,
            grid: grid.clone(),
            rsrp: rsrp.clone(),
            ..Config::default()
        };
        config.validate()?;
        let out = self.scratch.join("rsrp");
        let job = ImportRsrpJob {
            maps: &traced.maps,
            tiles,
            scenes: traced.scenes,
            config: &config,
            out: &out,
            mode: BuildMode::default(),
        };
        import_rsrp(job, self.progress)?;
        Ok(out)
    }

    fn check_software(&mut self, recorded: &Software) {
        self.failures.extend(compare_software(recorded));
    }

    /// Whether a stage on the way gave what the dataset was made from.
    fn compare_manifest(
        &mut self,
        what: &str,
        rebuilt: &Path,
        recorded: &str,
    ) -> Result<(), RebuildError> {
        let found = sha256_file(&rebuilt.join(MANIFEST))?.sha256;
        if found != recorded {
            let reason = format!(
                "records {what} whose manifest has SHA-256 {recorded}; that of those rebuilt has \
                 {found}"
            );
            self.failures.push(VerifyFailure { file: MANIFEST.to_owned(), record: None, reason });
        }
        Ok(())
    }
}

/// The sharding that a cell size is that of.
fn counted_for(record_cell_m: f64, grid: &GridConfig) -> Result<ShardConfig, RebuildError> {
    let downsample = (record_cell_m / grid.cell_m).round() as u32;
    let shard = ShardConfig { downsample, ..ShardConfig::default() };
    if shard.cell_m(grid).to_bits() == record_cell_m.to_bits() {
        return Ok(shard);
    }
    let cell_m = grid.cell_m;
    let reason = format!("cells of {record_cell_m} m cannot be made of cells of {cell_m} m");
    Err(RebuildError::Contradiction { reason })
}

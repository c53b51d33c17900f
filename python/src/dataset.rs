//! Datasets of records.

use std::path::PathBuf;
use std::sync::Arc;

use holescout::config::{Config, RemoteConfig, Split};
use holescout::dataset::{self, Grids, Record};
use holescout::grid::TileId;
use holescout::manifest::ErrorGrids;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::{array, grid};
use crate::error::{invalid, raise};

/// A dataset that is open for reading.
#[pyclass(frozen)]
pub(crate) struct Dataset {
    pub(crate) inner: Arc<dataset::Dataset>,
}

/// A split by its name.
pub(crate) fn split(name: &str) -> PyResult<Split> {
    name.parse().map_err(|error: holescout::config::UnknownSplit| invalid(error.to_string()))
}

/// Settings as JSON; what they do not tell is as by default.
pub(crate) fn config(json: &str) -> PyResult<Config> {
    let config: Config = serde_json::from_str(json)
        .map_err(|error| invalid(format!("settings: {error}; `holescout config` prints all")))?;
    config.validate().map_err(raise)?;
    Ok(config)
}

#[pymethods]
impl Dataset {
    /// Opens a dataset in a directory, or at http(s):// or s3://.
    #[new]
    fn new(py: Python<'_>, location: PathBuf, remote: &str) -> PyResult<Self> {
        let remote: RemoteConfig = serde_json::from_str(remote)
            .map_err(|error| invalid(format!("settings of [remote]: {error}")))?;
        let checked = Config { remote, ..Config::default() };
        checked.validate().map_err(raise)?;
        let opened = py.detach(|| dataset::Dataset::open_with(&location, &checked.remote));
        Ok(Self { inner: Arc::new(opened.map_err(raise)?) })
    }

    /// Names of the records of a split, or of all, in their order.
    fn ids(&self, split_name: Option<&str>) -> PyResult<Vec<String>> {
        let ids: Vec<TileId> = match split_name {
            Some(name) => self.inner.ids_of(split(name)?),
            None => self.inner.ids().into_iter().map(|(id, _)| id).collect(),
        };
        Ok(ids.iter().map(ToString::to_string).collect())
    }

    /// The manifest as JSON.
    fn manifest(&self) -> PyResult<String> {
        serde_json::to_string(self.inner.manifest()).map_err(|error| invalid(error.to_string()))
    }

    /// SHA-256 of the manifest, which names every shard by its own.
    fn sha256(&self) -> String {
        self.inner.digest().sha256.clone()
    }

    /// A record by its name: a dictionary of arrays.
    fn record<'py>(&self, py: Python<'py>, id: &str) -> PyResult<Bound<'py, PyDict>> {
        let (record, grids) = self.read(py, id)?;
        record_dict(py, &record, grids)
    }

    /// What a record says besides its arrays, as JSON.
    fn metadata(&self, py: Python<'_>, id: &str) -> PyResult<String> {
        let (record, _) = self.read(py, id)?;
        let mut value =
            serde_json::to_value(&record).map_err(|error| invalid(error.to_string()))?;
        if let Some(fields) = value.as_object_mut() {
            let arrays = ["height_m", "rsrp_dbm", "mask", "std_error_db", "first_half_share"];
            fields.retain(|name, _| !arrays.contains(&name.as_str()));
        }
        Ok(value.to_string())
    }
}

impl Dataset {
    fn read(&self, py: Python<'_>, id: &str) -> PyResult<(Record, Grids)> {
        let id: TileId =
            id.parse().map_err(|error: holescout::grid::TileIdError| invalid(error.to_string()))?;
        py.detach(|| self.inner.record_with_grids(id)).map_err(raise)
    }
}

/// A record as a dictionary of arrays, numbers and its name.
pub(crate) fn record_dict<'py>(
    py: Python<'py>,
    record: &Record,
    grids: Grids,
) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("id", record.id.to_string())?;
    let Grids { height_m, rsrp_dbm, mask, errors } = grids;
    dict.set_item("height_m", grid(py, height_m)?)?;
    dict.set_item("rsrp_dbm", grid(py, rsrp_dbm)?)?;
    dict.set_item("mask", grid(py, mask)?)?;
    if let Some(ErrorGrids { std_error_db, first_half_share }) = errors {
        dict.set_item("std_error_db", grid(py, std_error_db)?)?;
        if let Some(shares) = first_half_share {
            dict.set_item("first_half_share", grid(py, shares)?)?;
        }
    }
    dict.set_item("base_station_m", array(py, record.base_station.position_m.to_vec(), [3])?)?;
    dict.set_item("center_m", array(py, record.center_m.to_vec(), [2])?)?;
    dict.set_item("center_lon_lat", array(py, record.center_lon_lat.to_vec(), [2])?)?;
    dict.set_item("cell_m", record.cell_m)?;
    dict.set_item("floor_dbm", record.floor_dbm.0)?;
    Ok(dict)
}

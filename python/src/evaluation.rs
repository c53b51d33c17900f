//! Policies in Python, judged as the command judges those of its own.

use std::path::PathBuf;
use std::sync::Arc;

use holescout::config::{Config, Method};
use holescout::evaluate::EvaluateJob;
use holescout::rl::policy::{MakePolicy, Policy, View};
use holescout::rl::{Sight, World};
use numpy::{IntoPyArray, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::array;
use crate::compact::flags;
use crate::dataset::{config, split};
use crate::error::{invalid, mismatch, raise};
use crate::maps::Map;
use crate::watch::{Watch, watched};

/// A callable of Python as a policy for any map.
struct Callable<'a> {
    policy: Py<PyAny>,
    sight: Arc<Sight>,
    watch: &'a Watch,
}

impl std::fmt::Debug for Callable<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Callable").finish_non_exhaustive()
    }
}

impl MakePolicy for Callable<'_> {
    fn policy<'a>(&'a self, known: &World) -> Box<dyn Policy + 'a> {
        let map = Map::new(Arc::new(known.clone()), Arc::clone(&self.sight));
        let map = Python::attach(|py| Py::new(py, map));
        Box::new(OnMap { callable: self, map })
    }
}

struct OnMap<'a> {
    callable: &'a Callable<'a>,
    map: PyResult<Py<Map>>,
}

impl Policy for OnMap<'_> {
    fn predict(&self, views: &mut [View<'_, '_>]) -> Vec<[f64; 2]> {
        let watch = self.callable.watch;
        watch.check();
        Python::attach(|py| self.ask(py, views)).unwrap_or_else(|error| {
            watch.fail(error);
            watch.check();
            Vec::new()
        })
    }
}

impl OnMap<'_> {
    /// Calls `policy(map, observations)`.
    fn ask(&self, py: Python<'_>, views: &[View<'_, '_>]) -> PyResult<Vec<[f64; 2]>> {
        let map = self.map.as_ref().map_err(|error| error.clone_ref(py))?;
        let count = views.len();
        let measured = |view: &View<'_, '_>| view.flight.measurements().len();
        let length = views.iter().map(measured).max().unwrap_or(0);
        let actions = self.callable.sight.actions().count();
        let (mut rows, mut columns) = (vec![-1_i16; count * length], vec![-1_i16; count * length]);
        let (mut levels, mut masks) = (vec![f32::NAN; count * length], vec![0_u8; count * actions]);
        for (flight, view) in views.iter().enumerate() {
            for (step, measured) in view.flight.measurements().iter().enumerate() {
                let at = flight * length + step;
                (rows[at], columns[at]) = (measured.cell.row as i16, measured.cell.column as i16);
                levels[at] = measured.rsrp_dbm;
            }
            view.permissible().write_flags(&mut masks[flight * actions..][..actions]);
        }
        let dict = PyDict::new(py);
        dict.set_item("rows", array(py, rows, [count, length])?)?;
        dict.set_item("columns", array(py, columns, [count, length])?)?;
        dict.set_item("rsrp_dbm", array(py, levels, [count, length])?)?;
        dict.set_item("action_mask", flags(masks.into_pyarray(py), count)?)?;
        let waypoints = self.callable.policy.bind(py).call1((map, dict))?;
        let asarray = py.import("numpy")?.getattr("asarray")?;
        let waypoints = asarray.call1((waypoints, "float64"))?;
        let waypoints: PyReadonlyArray2<'_, f64> = waypoints.extract().map_err(|_| {
            mismatch("waypoints of the policy", shape(&waypoints), format!("({count}, 2)"))
        })?;
        if waypoints.shape() != [count, 2] {
            let found = format!("{:?}", waypoints.shape());
            return Err(mismatch(
                "shape of the policy's waypoints",
                found,
                format!("[{count}, 2]"),
            ));
        }
        let waypoints = waypoints.as_array();
        Ok(waypoints.rows().into_iter().map(|row| [row[0], row[1]]).collect())
    }
}

fn shape(array: &Bound<'_, PyAny>) -> String {
    array.getattr("shape").map_or_else(|_| "no array".to_owned(), |shape| shape.to_string())
}

/// Evaluates a policy beside the configured methods, and returns the report as JSON.
#[pyfunction]
#[pyo3(signature = (dataset, policy, name, *, split_name, settings, out, overwrite, progress))]
#[expect(clippy::too_many_arguments, reason = "they are keywords")]
pub(crate) fn evaluate(
    py: Python<'_>,
    dataset: PathBuf,
    policy: Option<Py<PyAny>>,
    name: &str,
    split_name: Option<&str>,
    settings: &str,
    out: PathBuf,
    overwrite: bool,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<String> {
    let mut config: Config = config(settings)?;
    config.evaluate.methods.retain(|&method| policy.is_some() || method != Method::Agent);
    let split = split_name.map(split).transpose()?;
    let sight = Arc::new(Sight::new(config.rl.reach_cells));
    let report = watched(py, progress.as_ref(), |watch| {
        let callable = policy.map(|policy| Callable { policy, sight, watch });
        let agent = callable.as_ref().map(|callable| (callable as &dyn MakePolicy, name));
        let job =
            EvaluateJob { dataset: &dataset, agent, split, config: &config, out: &out, overwrite };
        holescout::evaluate::evaluate(job, watch).map_err(raise)
    })?;
    serde_json::to_string(&report).map_err(|error| invalid(error.to_string()))
}

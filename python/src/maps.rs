//! Maps of the task.

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use holescout::config::{Config, Encoding, RlConfig, TrainConfig};
use holescout::grid::TileId;
use holescout::rl::{
    Cell, Hops, MapKey, MapList, Measurement, Sight, State, StateEncoder, Symmetry, World,
    load_maps,
};
use numpy::{PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::{array, grid};
use crate::compact::{GivenPaths, Paths};
use crate::dataset::{Dataset, config, split};
use crate::error::{invalid, mismatch, raise};
use crate::spare::Spare;
use crate::workers;

/// One map: what blocks, what is a coverage hole, what a receiver measures.
#[pyclass(frozen)]
pub(crate) struct Map {
    pub(crate) world: Arc<World>,
    sight: Arc<Sight>,
}

impl Map {
    pub(crate) fn new(world: Arc<World>, sight: Arc<Sight>) -> Self {
        Self { world, sight }
    }

    /// Something of each cell, `[L, L]`.
    fn each<'py, T: numpy::Element + Send>(
        &self,
        py: Python<'py>,
        value: impl Fn(Cell) -> T,
    ) -> PyResult<Bound<'py, PyAny>> {
        let n = self.world.cells();
        let values = (0..n * n).map(|at| value(self.world.cell(at))).collect();
        array(py, values, [n, n])
    }
}

#[pymethods]
impl Map {
    /// Name of the tile.
    #[getter]
    fn id(&self) -> String {
        self.world.id().to_string()
    }

    /// Cells along a side.
    #[getter]
    fn cells(&self) -> usize {
        self.world.cells()
    }

    /// Side of a cell in metres.
    #[getter]
    fn cell_m(&self) -> f64 {
        self.world.cell_m()
    }

    /// Below this an outdoor cell is a coverage hole, in dBm.
    #[getter]
    fn threshold_dbm(&self) -> f32 {
        self.world.threshold_dbm()
    }

    /// Heights in metres, float32 `[L, L]`.
    #[getter]
    fn height_m<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        grid(py, self.world.height_m().clone())
    }

    /// Levels in dBm, float32 `[L, L]`.
    #[getter]
    fn rsrp_dbm<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.each(py, |cell| self.world.rsrp_dbm(cell))
    }

    /// Where a UAV may fly, bool `[L, L]`.
    #[getter]
    fn free<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.each(py, |cell| self.world.is_free(cell))
    }

    /// Coverage holes, bool `[L, L]`.
    #[getter]
    fn holes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.each(py, |cell| self.world.is_hole(cell))
    }

    /// Row and column of the base station, which may lie outside of the map, and its height above the ground in metres.
    #[getter]
    fn base_station(&self) -> (f64, f64, f64) {
        self.world.base_station().into()
    }

    /// Where one step from a cell may lead (the paper's equation 3), bool `[(2 l + 1)²]`.
    fn permissible<'py>(&self, py: Python<'py>, cell: (i32, i32)) -> PyResult<Bound<'py, PyAny>> {
        let cell = Cell::new(cell.0, cell.1);
        if !self.world.is_free(cell) {
            let found = format!("row {}, column {}", cell.row, cell.column);
            return Err(mismatch("cell", found, format!("a free cell of {}", self.world.id())));
        }
        let count = self.sight.actions().count();
        let set = self.sight.permissible(&self.world, cell);
        array(py, (0..count).map(|action| set.contains(action)).collect(), [count])
    }

    /// Least steps to a coverage hole from each cell, int16 `[L, L]`: 0 in a hole, -1 where none can be reached.
    fn oracle<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let hops = py.detach(|| Hops::new(&self.world, &self.sight));
        self.each(py, |cell| hops.from(cell).map_or(-1, |hops| hops as i16))
    }
}

/// The maps of a split in memory, with the task that they pose.
#[pyclass(frozen)]
pub(crate) struct Maps {
    pub(crate) worlds: Arc<Vec<Arc<World>>>,
    pub(crate) rl: RlConfig,
    pub(crate) sight: Arc<Sight>,
    encoders: [OnceLock<StateEncoder>; 2],
    encoded: Spare<f32>,
}

#[pymethods]
impl Maps {
    /// The maps of some records, or of all of a split. `settings` are those of the configuration, as JSON.
    #[new]
    fn new(
        py: Python<'_>,
        dataset: &Dataset,
        split_name: Option<&str>,
        ids: Option<Vec<String>>,
        settings: &str,
    ) -> PyResult<Self> {
        let Config { rl, .. } = config(settings)?;
        let parse = |id: &String| id.parse::<TileId>().map_err(|error| invalid(error.to_string()));
        let ids: Vec<TileId> = match (&ids, split_name) {
            (Some(ids), _) => ids.iter().map(parse).collect::<PyResult<_>>()?,
            (None, Some(name)) => dataset.inner.ids_of(split(name)?),
            (None, None) => dataset.inner.ids().into_iter().map(|(id, _)| id).collect(),
        };
        if ids.is_empty() {
            let split = split_name.unwrap_or("selection");
            let root: PathBuf = dataset.inner.root().to_owned();
            return Err(mismatch(
                &format!("{split} of {}", root.display()),
                "no records",
                "at least one",
            ));
        }
        let worlds = py.detach(|| workers::install(|| load_maps(&dataset.inner, &ids, &rl)));
        let worlds = Arc::new(worlds.map_err(raise)?);
        let sight = Arc::new(Sight::new(rl.reach_cells));
        Ok(Self { worlds, rl, sight, encoders: Default::default(), encoded: Spare::default() })
    }

    fn __len__(&self) -> usize {
        self.worlds.len()
    }

    /// A map by its number.
    fn get(&self, number: usize) -> PyResult<Map> {
        let world = self.worlds.get(number);
        let world = world
            .ok_or_else(|| mismatch("map", number, format!("0 to {}", self.worlds.len() - 1)))?;
        Ok(Map::new(Arc::clone(world), Arc::clone(&self.sight)))
    }

    /// Names of the tiles, by number.
    fn ids(&self) -> Vec<String> {
        self.worlds.iter().map(|world| world.id().to_string()).collect()
    }

    /// Numbers of the maps that have both a coverage hole and a covered free cell.
    fn teaching(&self) -> Vec<usize> {
        (0..self.worlds.len()).filter(|&at| self.worlds[at].can_teach()).collect()
    }

    /// Cells along a side.
    fn cells(&self) -> usize {
        self.worlds[0].cells()
    }

    /// All settings of the task, as JSON.
    fn settings(&self) -> PyResult<String> {
        serde_json::to_string(&self.rl).map_err(|error| invalid(error.to_string()))
    }

    /// Shapes `[channels, rows, columns]` of the map and of the window of an encoding.
    fn shapes(&self, encoding: &str) -> PyResult<[[usize; 3]; 2]> {
        Ok(self.encoder(encoding)?.shapes())
    }

    /// What a network sees of states: `map` and `window`, float32 `[n, channels, rows, columns]`.
    fn encode<'py>(
        &self,
        py: Python<'py>,
        map: numpy::PyReadonlyArray1<'py, i64>,
        rows: PyReadonlyArray2<'py, i16>,
        columns: PyReadonlyArray2<'py, i16>,
        rsrp_dbm: PyReadonlyArray2<'py, f32>,
        encoding: &str,
    ) -> PyResult<Bound<'py, PyDict>> {
        if rsrp_dbm.shape() != rows.shape() {
            let [found, expected] =
                [rsrp_dbm.shape(), rows.shape()].map(|shape| format!("{shape:?}"));
            return Err(mismatch("shape of rsrp_dbm", found, expected));
        }
        let Paths { maps, paths } = GivenPaths { map, rows, columns }.read(&self.worlds)?;
        let levels = rsrp_dbm.as_array();
        let states = maps.iter().zip(&paths).zip(levels.rows());
        let measured: Vec<(&World, Vec<Measurement>)> = states
            .map(|((&map, path), levels)| {
                let world = &self.worlds[map as usize];
                let measured = path.iter().zip(levels);
                let measured =
                    measured.map(|(&cell, &rsrp_dbm)| Measurement { cell, rsrp_dbm }).collect();
                (&**world, measured)
            })
            .collect();
        let encoder = self.encoder(encoding)?;
        let count = measured.len();
        let arrays = encoder.shapes().map(|shape| {
            let values = count * shape.iter().product::<usize>();
            (shape, self.encoded.take(py, values))
        });
        {
            let [mut map, mut window] = arrays.each_ref().map(|(_, array)| array.readwrite());
            let (map, window) = (map.as_slice_mut()?, window.as_slice_mut()?);
            py.detach(|| {
                let symmetry = Symmetry::IDENTITY;
                let state = |(world, measurements)| State { world, measurements, symmetry };
                let states: Vec<State<'_>> = measured
                    .iter()
                    .map(|(world, measured)| state((*world, measured.as_slice())))
                    .collect();
                workers::install(|| encoder.encode_batch(&states, map, window));
            });
        }
        let dict = PyDict::new(py);
        for (name, ([channels, rows, columns], array)) in ["map", "window"].into_iter().zip(arrays)
        {
            let shaped = array.reshape(numpy::ndarray::Dim([count, channels, rows, columns]))?;
            dict.set_item(name, shaped)?;
        }
        Ok(dict)
    }
}

impl Maps {
    /// The encoder of a preset.
    fn encoder(&self, encoding: &str) -> PyResult<&StateEncoder> {
        let (at, train) = match encoding {
            "paper" => (0, TrainConfig::paper()),
            "best" => (1, TrainConfig::default()),
            _ => {
                return Err(mismatch("encoding", format!("{encoding:?}"), "\"paper\" or \"best\""));
            }
        };
        debug_assert_eq!(train.encoding == Encoding::Paper, at == 0);
        let cells = self.worlds[0].cells();
        Ok(self.encoders[at].get_or_init(|| StateEncoder::new(cells, &self.rl, &train)))
    }

    /// Those that can teach something, with their numbers as keys.
    pub(crate) fn list(&self) -> PyResult<MapList> {
        let keyed = (0..).zip(self.worlds.iter().map(Arc::clone)).collect::<Vec<(MapKey, _)>>();
        MapList::new(keyed).map_err(raise)
    }
}

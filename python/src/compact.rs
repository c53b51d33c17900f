//! States as arrays: where a UAV was and what it measured, and where it may go. An encoder makes of them what a
//! network sees; a replay buffer keeps them in 28 bytes each.

use std::borrow::Cow;

use holescout::rl::{ActionSet, Cell, Environment, Sight, World};
use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;

use crate::array::array;
use crate::error::{below, mismatch};

/// The arrays of states. Paths are as long as the longest: a start and `max_steps` steps; what is not flown yet is row
/// and column -1, and the level `floor_dbm`.
pub(crate) struct Compact {
    length: usize,
    map: Vec<i64>,
    rows: Vec<i16>,
    columns: Vec<i16>,
    rsrp_dbm: Vec<f32>,
}

/// Maps, rows, columns, levels and masks of some states.
type Part<'a> = ((((&'a mut [i64], &'a mut [i16]), &'a mut [i16]), &'a mut [f32]), &'a mut [u8]);

/// One state to be written.
pub(crate) struct Seen<'a> {
    pub(crate) map: u32,
    pub(crate) world: &'a World,
    pub(crate) path: &'a [Cell],
    pub(crate) permissible: Cow<'a, ActionSet>,
}

impl<'a> Seen<'a> {
    /// The state at the end of a path.
    pub(crate) fn after(map: u32, world: &'a World, path: &'a [Cell], sight: &Sight) -> Self {
        let &cell = path.last().expect("a path has a start");
        Self { map, world, path, permissible: Cow::Owned(sight.permissible(world, cell)) }
    }
}

impl Compact {
    /// Of `count` states that `state` tells; masks are written to `masks`, as many flags for each.
    pub(crate) fn new<'a>(
        count: usize,
        length: usize,
        floor_dbm: f32,
        masks: &mut [u8],
        state: impl Fn(usize) -> Seen<'a> + Sync,
    ) -> Self {
        let mut all = Self {
            length,
            map: vec![0; count],
            rows: vec![-1; count * length],
            columns: vec![-1; count * length],
            rsrp_dbm: vec![floor_dbm; count * length],
        };
        if count == 0 {
            return all;
        }
        let flags = masks.len() / count;
        // Each thread has so many states, one after the other; a few are not worth waking it for.
        let states = count.min(Environment::ALONE);
        let write = |(part, ((((map, rows), columns), levels), masks)): (usize, Part<'_>)| {
            let paths = rows.chunks_exact_mut(length).zip(columns.chunks_exact_mut(length));
            let paths =
                paths.zip(levels.chunks_exact_mut(length)).zip(masks.chunks_exact_mut(flags));
            for (at, (map, (((rows, columns), levels), mask))) in
                map.iter_mut().zip(paths).enumerate()
            {
                let seen = state(part * states + at);
                *map = seen.map.into();
                let places = rows.iter_mut().zip(columns).zip(levels);
                for (&cell, ((row, column), level)) in seen.path.iter().zip(places) {
                    (*row, *column) = (cell.row as i16, cell.column as i16);
                    *level = seen.world.rsrp_dbm(cell);
                }
                seen.permissible.write_flags(mask);
            }
        };
        let (rows, columns) = (&mut all.rows[..], &mut all.columns[..]);
        if states == count {
            write((0, ((((&mut all.map, rows), columns), &mut all.rsrp_dbm), masks)));
        } else {
            let paths = all.map.par_chunks_mut(states).zip(rows.par_chunks_mut(states * length));
            let paths = paths.zip(columns.par_chunks_mut(states * length));
            let paths = paths.zip(all.rsrp_dbm.par_chunks_mut(states * length));
            paths.zip(masks.par_chunks_mut(states * flags)).enumerate().for_each(write);
        }
        all
    }

    /// A dictionary of arrays, with those of the masks.
    pub(crate) fn into_dict(self, masks: Bound<'_, PyArray1<u8>>) -> PyResult<Bound<'_, PyDict>> {
        let (py, Self { length, map, rows, columns, rsrp_dbm }) = (masks.py(), self);
        let count = map.len();
        let dict = PyDict::new(py);
        dict.set_item("map", array(py, map, [count])?)?;
        dict.set_item("rows", array(py, rows, [count, length])?)?;
        dict.set_item("columns", array(py, columns, [count, length])?)?;
        dict.set_item("rsrp_dbm", array(py, rsrp_dbm, [count, length])?)?;
        dict.set_item("action_mask", flags(masks, count)?)?;
        Ok(dict)
    }
}

/// Flags of `count` states as `gymnasium.spaces.MultiBinary` has them: a view of int8, `[count, flags]`.
pub(crate) fn flags(masks: Bound<'_, PyArray1<u8>>, count: usize) -> PyResult<Bound<'_, PyAny>> {
    let flags = masks.len() / count.max(1);
    masks.call_method1("view", ("int8",))?.call_method1("reshape", (count, flags))
}

/// States that came from Python.
pub(crate) struct Paths {
    /// Number of the map of each.
    pub(crate) maps: Vec<u32>,
    /// The cells of each, the start first.
    pub(crate) paths: Vec<Vec<Cell>>,
}

/// The arrays `map`, `rows` and `columns` of states.
pub(crate) struct GivenPaths<'py> {
    pub(crate) map: PyReadonlyArray1<'py, i64>,
    pub(crate) rows: PyReadonlyArray2<'py, i16>,
    pub(crate) columns: PyReadonlyArray2<'py, i16>,
}

impl GivenPaths<'_> {
    /// Reads and checks them: each map is there, and each path has a start and free cells only.
    pub(crate) fn read(&self, worlds: &[std::sync::Arc<World>]) -> PyResult<Paths> {
        let count = self.map.len();
        let expected = [count, self.rows.shape()[1]];
        for (what, shape) in [("rows", self.rows.shape()), ("columns", self.columns.shape())] {
            if shape != expected {
                let (found, expected) = (format!("{shape:?}"), format!("{expected:?}"));
                return Err(mismatch(&format!("shape of {what}"), found, expected));
            }
        }
        let mut maps = Vec::with_capacity(count);
        let mut paths = Vec::with_capacity(count);
        let (rows, columns) = (self.rows.as_array(), self.columns.as_array());
        let states = self.map.as_array();
        for (&map, (rows, columns)) in
            states.iter().zip(rows.rows().into_iter().zip(columns.rows()))
        {
            let world = &worlds[below("map", map, worlds.len())?];
            let cells = rows.iter().zip(columns).take_while(|&(&row, _)| row >= 0);
            let path: Vec<Cell> =
                cells.map(|(&row, &column)| Cell::new(row.into(), column.into())).collect();
            if path.is_empty() {
                return Err(mismatch("a path", "no cell", "at least that of the start"));
            }
            if let Some(cell) = path.iter().find(|&&cell| !world.is_free(cell)) {
                let found = format!("row {}, column {}", cell.row, cell.column);
                return Err(mismatch("a path", found, format!("free cells of map {}", world.id())));
            }
            maps.push(map as u32);
            paths.push(path);
        }
        Ok(Paths { maps, paths })
    }
}

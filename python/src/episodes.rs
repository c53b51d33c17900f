//! Many episodes at a time.

use std::borrow::Cow;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use holescout::rl::{Cell, Environment, MapList, Outcome, Sight};
use numpy::{IntoPyArray, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::{array, values};
use crate::compact::{Compact, Seen};
use crate::error::{below, mismatch};
use crate::maps::Maps;
use crate::spare::Spare;
use crate::workers;

/// Episodes under way; those that end begin anew at once.
#[pyclass(frozen)]
pub(crate) struct Episodes {
    count: usize,
    maps: MapList,
    sight: Arc<Sight>,
    max_steps: u32,
    floor_dbm: f32,
    environment: Mutex<Environment>,
    masks: Spare<u8>,
}

/// Episodes before a step: what those that end had come to.
struct Before {
    length: usize,
    maps: Vec<u32>,
    lengths: Vec<usize>,
    /// `length` of each episode.
    cells: Vec<Cell>,
}

impl Before {
    fn of(environment: &Environment, length: usize) -> Self {
        let count = environment.len();
        let mut before = Self {
            length,
            maps: Vec::with_capacity(count),
            lengths: Vec::with_capacity(count),
            cells: vec![Cell::default(); count * length],
        };
        for (slot, cells) in before.cells.chunks_exact_mut(length).enumerate() {
            let (map, path) = environment.state(slot);
            before.maps.push(map);
            before.lengths.push(path.len());
            cells[..path.len()].copy_from_slice(path);
        }
        before
    }

    /// The map of an episode, and its path with the cell that its last step led to.
    fn ended(&self, slot: usize, next: Cell) -> (u32, Vec<Cell>) {
        let path = &self.cells[slot * self.length..][..self.lengths[slot]];
        (self.maps[slot], path.iter().copied().chain([next]).collect())
    }
}

/// What a step came to.
struct AfterStep {
    /// The observations after it; their masks are written elsewhere.
    observed: Compact,
    outcomes: Vec<Outcome>,
    /// The last observations of the episodes that have ended, if any has, and their masks.
    last: Option<Compact>,
    last_masks: Vec<u8>,
}

/// What a step returns to Python: observations, rewards, ended at a hole, ended at the time limit, and the last
/// observations of those that ended, if any did.
type Stepped<'py> = (
    Bound<'py, PyDict>,
    Bound<'py, PyAny>,
    Bound<'py, PyAny>,
    Bound<'py, PyAny>,
    Option<Bound<'py, PyDict>>,
);

#[pymethods]
impl Episodes {
    /// `count` episodes at a time over those of the maps that can teach something.
    #[new]
    fn new(maps: &Maps, count: usize, seed: u64) -> PyResult<Self> {
        if count == 0 {
            return Err(mismatch("num_envs", 0, "at least 1"));
        }
        let list = maps.list()?;
        let max_steps = maps.rl.max_steps;
        let environment = Environment::new(&list, count, max_steps, seed);
        Ok(Self {
            count,
            maps: list,
            sight: Arc::clone(&maps.sight),
            max_steps,
            floor_dbm: maps.rl.floor_dbm.0 as f32,
            environment: Mutex::new(environment),
            masks: Spare::default(),
        })
    }

    /// Begins the first episodes of a seed, or without one the next ones.
    fn reset<'py>(&self, py: Python<'py>, seed: Option<u64>) -> PyResult<Bound<'py, PyDict>> {
        py.detach(|| {
            let mut environment = self.locked();
            match seed {
                Some(seed) => {
                    *environment =
                        Environment::new(&self.maps, environment.len(), self.max_steps, seed);
                }
                None => environment.restart(&self.maps),
            }
        });
        self.observations(py)
    }

    /// The current observations.
    fn observations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let array = self.masks.take(py, self.count * self.actions());
        let mut masks = array.readwrite();
        let masks = masks.as_slice_mut()?;
        let observed =
            py.detach(|| workers::spread(self.count, || self.observe(&self.locked(), masks)));
        observed.into_dict(array)
    }

    /// One step of all episodes.
    fn step<'py>(
        &self,
        py: Python<'py>,
        actions: PyReadonlyArray1<'py, i64>,
    ) -> PyResult<Stepped<'py>> {
        let actions = values(&actions);
        let array_of_masks = self.masks.take(py, self.count * self.actions());
        let AfterStep { observed, outcomes, last, last_masks } = {
            let mut masks = array_of_masks.readwrite();
            let masks = masks.as_slice_mut()?;
            py.detach(|| self.stepped(&actions, masks))?
        };
        let each =
            |value: fn(&Outcome) -> bool| -> Vec<bool> { outcomes.iter().map(value).collect() };
        let rewards: Vec<f64> = outcomes.iter().map(|outcome| outcome.reward.into()).collect();
        let count = outcomes.len();
        Ok((
            observed.into_dict(array_of_masks)?,
            array(py, rewards, [count])?,
            array(py, each(|outcome| outcome.terminal), [count])?,
            array(py, each(|outcome| outcome.truncated), [count])?,
            last.map(|last| last.into_dict(last_masks.into_pyarray(py))).transpose()?,
        ))
    }
}

impl Episodes {
    fn locked(&self) -> MutexGuard<'_, Environment> {
        self.environment.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Cells of the longest path.
    fn length(&self) -> usize {
        self.max_steps as usize + 1
    }

    fn actions(&self) -> usize {
        self.sight.actions().count()
    }

    fn observe(&self, environment: &Environment, masks: &mut [u8]) -> Compact {
        Compact::new(environment.len(), self.length(), self.floor_dbm, masks, |slot| {
            let (map, path) = environment.state(slot);
            let permissible = Cow::Borrowed(environment.permissible(slot));
            Seen { map, world: self.maps.get(map), path, permissible }
        })
    }

    fn stepped(&self, actions: &[i64], masks: &mut [u8]) -> PyResult<AfterStep> {
        let mut environment = self.locked();
        let environment = &mut *environment;
        let count = self.actions();
        if actions.len() != environment.len() {
            return Err(mismatch(
                "actions",
                actions.len(),
                format!("{}, one of each environment", environment.len()),
            ));
        }
        let actions = actions.iter().map(|&action| below("action", action, count));
        let actions = actions.collect::<PyResult<Vec<usize>>>()?;
        Ok(workers::spread(self.count, || {
            let before = Before::of(environment, self.length());
            let outcomes = environment.step(&self.maps, &actions);
            let slots = outcomes.iter().enumerate();
            let ended: Vec<(u32, Vec<Cell>)> = slots
                .filter(|(_, outcome)| outcome.terminal || outcome.truncated)
                .map(|(slot, outcome)| before.ended(slot, outcome.next))
                .collect();
            let mut last_masks = vec![0; ended.len() * count];
            let last = (!ended.is_empty()).then(|| self.last(&ended, &mut last_masks));
            AfterStep { observed: self.observe(environment, masks), outcomes, last, last_masks }
        }))
    }

    /// The last observations of episodes that have ended.
    fn last(&self, ended: &[(u32, Vec<Cell>)], masks: &mut [u8]) -> Compact {
        Compact::new(ended.len(), self.length(), self.floor_dbm, masks, |at| {
            let (map, path) = &ended[at];
            Seen::after(*map, self.maps.get(*map), path, &self.sight)
        })
    }
}

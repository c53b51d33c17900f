//! Transitions to learn from, in 28 bytes each.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use holescout::rl::{self, Cell, MAX_STEPS, NStepBuffer, Random, Sight, World};
use numpy::{IntoPyArray, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::{array, values};
use crate::compact::{Compact, GivenPaths, Paths, Seen};
use crate::error::{below, mismatch};
use crate::maps::Maps;
use crate::workers;

/// A ring of transitions of one or more steps, all alike or the surprising ones more often.
#[pyclass(frozen)]
pub(crate) struct ReplayBuffer {
    worlds: Arc<Vec<Arc<World>>>,
    sight: Arc<Sight>,
    length: usize,
    floor_dbm: f32,
    n_steps: usize,
    discount: f64,
    kept: Mutex<Kept>,
}

struct Kept {
    buffer: rl::ReplayBuffer,
    /// The steps of each environment that no transition begins with yet.
    recent: Vec<NStepBuffer>,
    random: Random,
}

#[pymethods]
impl ReplayBuffer {
    /// For `capacity` transitions of `n_steps` steps; `alpha` above 0 draws them in proportion to their error to that power.
    #[new]
    fn new(
        maps: &Maps,
        capacity: usize,
        n_steps: usize,
        discount: f64,
        alpha: f64,
        seed: u64,
    ) -> PyResult<Self> {
        let (cells, max_steps) = (maps.worlds[0].cells(), maps.rl.max_steps as usize);
        let most = MAX_STEPS.min(max_steps);
        for (what, found, holds, expected) in [
            ("capacity", capacity, capacity > 0, "1 or more".to_owned()),
            ("n_steps", n_steps, (1..=most).contains(&n_steps), format!("1 to {most}")),
            (
                "cells of a map",
                cells,
                cells <= rl::ReplayBuffer::MAX_CELLS,
                "at most 256".to_owned(),
            ),
        ] {
            if !holds {
                return Err(mismatch(what, found, expected));
            }
        }
        for (what, found) in [("discount", discount), ("alpha", alpha)] {
            if !(0.0..=1.0).contains(&found) {
                return Err(mismatch(what, found, "0 to 1"));
            }
        }
        let buffer = rl::ReplayBuffer::new(capacity, cells, max_steps).prioritised(alpha);
        Ok(Self {
            worlds: Arc::clone(&maps.worlds),
            sight: Arc::clone(&maps.sight),
            length: max_steps + 1,
            floor_dbm: maps.rl.floor_dbm.0 as f32,
            n_steps,
            discount,
            kept: Mutex::new(Kept { buffer, recent: Vec::new(), random: Random::keyed(&[seed]) }),
        })
    }

    fn __len__(&self) -> usize {
        self.locked().buffer.len()
    }

    /// Bytes of a transition.
    #[getter]
    fn transition_bytes(&self) -> usize {
        self.locked().buffer.stride()
    }

    /// Adds a step of each environment: the paths after it, the last ones where episodes ended.
    #[expect(clippy::too_many_arguments, reason = "the arrays of a step")]
    fn add<'py>(
        &self,
        map: PyReadonlyArray1<'py, i64>,
        rows: PyReadonlyArray2<'py, i16>,
        columns: PyReadonlyArray2<'py, i16>,
        actions: PyReadonlyArray1<'py, i64>,
        rewards: PyReadonlyArray1<'py, f64>,
        terminations: PyReadonlyArray1<'py, bool>,
        truncations: PyReadonlyArray1<'py, bool>,
    ) -> PyResult<()> {
        let Paths { maps, paths } = GivenPaths { map, rows, columns }.read(&self.worlds)?;
        let (actions, rewards) = (values(&actions), values(&rewards));
        let (terminations, truncations) = (values(&terminations), values(&truncations));
        let count = paths.len();
        for (what, found) in [
            ("actions", actions.len()),
            ("rewards", rewards.len()),
            ("terminations", terminations.len()),
            ("truncations", truncations.len()),
        ] {
            if found != count {
                return Err(mismatch(what, found, count));
            }
        }
        let known = [rl::REWARD_HOLE, rl::REWARD_STEP, rl::REWARD_BLOCKED];
        for (at, path) in paths.iter().enumerate() {
            if !(2..=self.length).contains(&path.len()) {
                return Err(mismatch(
                    "cells of a path after a step",
                    path.len(),
                    format!("2 to {}", self.length),
                ));
            }
            below("action", actions[at], self.sight.actions().count())?;
            if !known.contains(&(rewards[at] as f32)) {
                return Err(mismatch("reward", rewards[at], format!("one of {known:?}")));
            }
        }
        let mut kept = self.locked();
        let Kept { buffer, recent, .. } = &mut *kept;
        recent.resize_with(recent.len().max(count), NStepBuffer::default);
        for (at, path) in paths.iter().enumerate() {
            let step = (actions[at] as usize, rewards[at] as f32);
            let ends = [terminations[at] || truncations[at], terminations[at]];
            recent[at].step((maps[at], path), step, ends, self.n_steps, |transition| {
                buffer.push(&transition);
            });
        }
        Ok(())
    }

    /// Draws transitions: a dictionary of arrays.
    fn sample<'py>(
        &self,
        py: Python<'py>,
        count: usize,
        beta: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        if self.locked().buffer.is_empty() {
            return Err(mismatch("transitions in the buffer", 0, "at least 1: add some first"));
        }
        let flags = count * self.sight.actions().count();
        let (sample, [before, after], [before_masks, after_masks]) = py.detach(|| {
            let mut kept = self.locked();
            let Kept { buffer, random, .. } = &mut *kept;
            let sample = buffer.sample(count, beta, |_| true, random);
            drop(kept);
            let mut masks = [vec![0; flags], vec![0; flags]];
            let [before, after] = &mut masks;
            let states = workers::install(|| {
                [(false, before), (true, after)]
                    .map(|(after, masks)| self.states(&sample.transitions, after, masks))
            });
            (sample, states, masks)
        });
        let discounted: Vec<(f64, f64)> =
            sample.transitions.iter().map(|one| one.discounted(self.discount)).collect();
        let dict = PyDict::new(py);
        dict.set_item("observations", before.into_dict(before_masks.into_pyarray(py))?)?;
        dict.set_item("next_observations", after.into_dict(after_masks.into_pyarray(py))?)?;
        let actions = sample.transitions.iter().map(|one| one.action as i64).collect();
        dict.set_item("actions", array(py, actions, [count])?)?;
        let returns = discounted.iter().map(|&(sum, _)| sum as f32).collect();
        dict.set_item("returns", array(py, returns, [count])?)?;
        let factors = discounted.iter().map(|&(_, factor)| factor as f32).collect();
        dict.set_item("discounts", array(py, factors, [count])?)?;
        let positions = sample.positions.iter().map(|&at| at as i64).collect();
        dict.set_item("positions", array(py, positions, [count])?)?;
        if let Some(weights) = sample.weights {
            dict.set_item("weights", array(py, weights, [count])?)?;
        }
        Ok(dict)
    }

    /// Sets the priorities of transitions that were learned from by their errors.
    fn update_priorities(
        &self,
        positions: PyReadonlyArray1<'_, i64>,
        errors: PyReadonlyArray1<'_, f32>,
    ) -> PyResult<()> {
        if positions.len() != errors.len() {
            return Err(mismatch("errors", errors.len(), positions.len()));
        }
        let mut kept = self.locked();
        let held = kept.buffer.len();
        let positions = values(&positions).into_iter().map(|at| below("position", at, held));
        let positions = positions.collect::<PyResult<Vec<usize>>>()?;
        kept.buffer.update_priorities(&positions, &values(&errors));
        Ok(())
    }
}

impl ReplayBuffer {
    fn locked(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The states that transitions begin with, or lead to.
    fn states(&self, transitions: &[rl::Transition], after: bool, masks: &mut [u8]) -> Compact {
        let path = |at: usize| -> &[Cell] {
            let transition: &rl::Transition = &transitions[at];
            if after { &transition.path } else { transition.before() }
        };
        Compact::new(transitions.len(), self.length, self.floor_dbm, masks, |at| {
            let map = transitions[at].map;
            Seen::after(map, &self.worlds[map as usize], path(at), &self.sight)
        })
    }
}

//! From steps to transitions over several of them (n-step returns).

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use super::cell::Cell;
use super::replay::Transition;

/// The latest steps of an episode that no transition begins with yet.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct NStepBuffer {
    steps: VecDeque<(usize, f32)>,
}

impl NStepBuffer {
    /// Adds a step, the last one of `path`; `push` receives the transition of `most` steps that it
    /// completes, and at the `end` of the episode those of fewer steps too.
    ///
    /// `terminal` tells whether the episode ended at a hole; at the time limit, or where it is cut
    /// off, its last state keeps its value.
    pub fn step(
        &mut self,
        (map, path): (u32, &[Cell]),
        (action, reward): (usize, f32),
        [end, terminal]: [bool; 2],
        most: usize,
        mut push: impl FnMut(Transition),
    ) {
        self.steps.push_back((action, reward));
        if self.steps.len() == most || end {
            push(self.first((map, path), terminal));
        }
        if end {
            self.cut((map, path), terminal, push);
        }
    }

    /// Ends the episode where it is.
    pub fn cut(
        &mut self,
        (map, path): (u32, &[Cell]),
        terminal: bool,
        mut push: impl FnMut(Transition),
    ) {
        while !self.steps.is_empty() {
            push(self.first((map, path), terminal));
        }
    }

    /// The transition of all steps, the first of which is forgotten.
    fn first(&mut self, (map, path): (u32, &[Cell]), terminal: bool) -> Transition {
        let rewards = self.steps.iter().map(|&(_, reward)| reward).collect();
        let (action, _) = self.steps.pop_front().expect("there is a step");
        Transition { map, path: path.to_vec(), action, rewards, terminal }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps 0, 1, 2 ... with rewards -0, -1, -2 ... over an episode of `steps` steps.
    fn transitions(steps: usize, most: usize, terminal: bool) -> Vec<(usize, usize, usize)> {
        let path: Vec<Cell> = (0..=steps as i32).map(|row| Cell::new(row, 0)).collect();
        let mut recent = NStepBuffer::default();
        let mut found = Vec::new();
        for step in 0..steps {
            let end = step + 1 == steps;
            let (path, of) = (&path[..step + 2], (step, -(step as f32)));
            recent.step((7, path), of, [end, end && terminal], most, |transition| {
                let Transition { path, action, rewards, .. } = &transition;
                assert_eq!(transition.before().len(), *action + 1, "it begins with its action");
                let expected: Vec<f32> = (*action..path.len() - 1).map(|at| -(at as f32)).collect();
                assert_eq!(*rewards, expected);
                assert_eq!(transition.terminal, terminal && path.len() == steps + 1);
                found.push((*action, rewards.len(), path.len()));
            });
        }
        assert_eq!(recent, NStepBuffer::default());
        found
    }

    #[test]
    fn every_step_begins_one_transition() {
        assert_eq!(transitions(3, 1, true), [(0, 1, 2), (1, 1, 3), (2, 1, 4)]);
        assert_eq!(transitions(4, 3, true), [(0, 3, 4), (1, 3, 5), (2, 2, 5), (3, 1, 5)]);
        assert_eq!(transitions(2, 5, false), [(0, 2, 3), (1, 1, 3)]);
    }
}

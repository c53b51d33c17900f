//! Prioritised replay (Schaul et al., 2016): transitions with greater errors come more often.
//!
//! A binary tree holds the sums of the priorities below each node, so drawing and changing one take
//! as many steps as the tree is high. A parent is always computed from its two children: nothing
//! drifts, and equal priorities make an equal tree whatever happened before.

use crate::random::Random;

/// What an error is raised by, so that no transition is never drawn.
const LEAST: f64 = 1e-3;

/// Priorities of the transitions of a replay buffer, by their positions.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Priorities {
    exponent: f64,
    /// The root at 1, the children of i at 2 i and 2 i + 1, the transitions in the second half.
    sums: Vec<f64>,
    greatest: f64,
}

impl Priorities {
    /// For `capacity` transitions, drawn in proportion to `|error|^exponent`.
    #[must_use]
    pub(super) fn new(capacity: usize, exponent: f64) -> Self {
        let leaves = capacity.next_power_of_two();
        Self { exponent, sums: vec![0.0; 2 * leaves], greatest: 1.0 }
    }

    /// Bytes that priorities for so many transitions take.
    #[must_use]
    pub(super) fn bytes(capacity: usize) -> usize {
        2 * capacity.next_power_of_two() * size_of::<f64>()
    }

    fn leaves(&self) -> usize {
        self.sums.len() / 2
    }

    fn set(&mut self, at: usize, priority: f64) {
        let mut node = self.leaves() + at;
        self.sums[node] = priority;
        while node > 1 {
            node /= 2;
            self.sums[node] = self.sums[2 * node] + self.sums[2 * node + 1];
        }
    }

    /// A new transition: it has the greatest priority so far, so that it is drawn soon.
    pub(super) fn add(&mut self, at: usize) {
        self.set(at, self.greatest);
    }

    /// The error that was found for a transition.
    pub(super) fn change(&mut self, at: usize, error: f32) {
        let priority = libm::pow(f64::from(error.abs()) + LEAST, self.exponent);
        self.greatest = self.greatest.max(priority);
        self.set(at, priority);
    }

    /// A position, each as likely as its priority.
    pub(super) fn draw(&self, random: &mut Random) -> usize {
        let mut rest = random.unit() * self.sums[1];
        let mut node = 1;
        while node < self.leaves() {
            let left = self.sums[2 * node];
            // Rounding may leave more than there is to the right.
            let goes_right = rest >= left && self.sums[2 * node + 1] > 0.0;
            if goes_right {
                rest -= left;
            }
            node = 2 * node + usize::from(goes_right);
        }
        node - self.leaves()
    }

    /// How likely a position is drawn.
    #[must_use]
    pub(super) fn likelihood(&self, at: usize) -> f64 {
        self.sums[self.leaves() + at] / self.sums[1]
    }

    /// What a checkpoint must keep: the priorities of the first `count` transitions, little-endian,
    /// after the greatest of all time.
    #[must_use]
    pub(super) fn state(&self, count: usize) -> Vec<u8> {
        let leaves = &self.sums[self.leaves()..][..count];
        [self.greatest].iter().chain(leaves).flat_map(|value| value.to_le_bytes()).collect()
    }

    /// Takes over what a checkpoint has kept; `false`, and nothing is changed, if it does not fit.
    #[must_use]
    pub(super) fn restore(&mut self, state: &[u8]) -> bool {
        let (values, rest) = state.as_chunks::<8>();
        let mut values = values.iter().map(|&bytes| f64::from_le_bytes(bytes));
        if !rest.is_empty() || !(1..=self.leaves() + 1).contains(&values.len()) {
            return false;
        }
        self.greatest = values.next().expect("one at least");
        self.sums.fill(0.0);
        values.enumerate().for_each(|(at, priority)| self.set(at, priority));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_are_drawn_as_often_as_their_priorities_tell() {
        let mut priorities = Priorities::new(5, 1.0);
        for (at, error) in [1.0, 0.0, 3.0, 0.5, 2.0].into_iter().enumerate() {
            priorities.add(at);
            priorities.change(at, error);
        }
        let mut random = Random::keyed(&[1]);
        let mut counts = [0_u32; 5];
        let draws = 100_000;
        (0..draws).for_each(|_| counts[priorities.draw(&mut random)] += 1);
        for (at, &count) in counts.iter().enumerate() {
            let (found, expected) =
                (f64::from(count) / f64::from(draws), priorities.likelihood(at));
            assert!((found - expected).abs() < 0.01, "{at}: {found} {expected}");
        }
        assert!((priorities.likelihood(2) - 3.0 / 6.5).abs() < 1e-3);
        assert!(counts[1] > 0, "none is never drawn");
    }

    /// Among a million alike, a few with the least priority are drawn as often as they should.
    #[test]
    fn small_priorities_are_not_lost_among_many() {
        let count = 1 << 20;
        let mut priorities = Priorities::new(count, 0.6);
        (0..count).for_each(|at| priorities.add(at));
        // The upper half of them.
        (count / 2..count).for_each(|at| priorities.change(at, 0.0));
        let mut random = Random::keyed(&[4]);
        let draws = 200_000;
        let drawn: Vec<usize> = (0..draws).map(|_| priorities.draw(&mut random)).collect();
        let small = drawn.iter().filter(|&&at| at >= count / 2);
        let share = small.clone().count() as f64 / f64::from(draws);
        let expected = priorities.likelihood(count - 1) * (count / 2) as f64;
        assert!((share - expected).abs() < 0.002, "{share} {expected}");
        let odd = small.clone().filter(|&&at| at % 2 == 1).count() as f64 / small.count() as f64;
        assert!((odd - 0.5).abs() < 0.05, "{odd}");
    }

    #[test]
    fn only_what_was_added_is_drawn() {
        let mut priorities = Priorities::new(1000, 0.6);
        (0..3).for_each(|at| priorities.add(at));
        let mut random = Random::keyed(&[2]);
        assert!((0..1000).all(|_| priorities.draw(&mut random) < 3));
    }

    #[test]
    fn restored_priorities_are_those_that_were_kept() {
        let mut priorities = Priorities::new(100, 0.7);
        for at in 0..60 {
            priorities.add(at);
            priorities.change(at, (at * 7 % 13) as f32 - 6.0);
        }
        let state = priorities.state(60);
        let mut restored = Priorities::new(100, 0.7);
        assert!(!restored.restore(&state[1..]) && !restored.restore(&[]));
        assert!(restored.restore(&state));
        assert_eq!(restored, priorities);
    }
}

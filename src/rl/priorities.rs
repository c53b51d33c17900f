//! Prioritised replay (Schaul et al., 2016): transitions with greater errors come more often.
//!
//! A binary tree holds the sums of the priorities below each node, so drawing and changing one take
//! as many steps as the tree is high. A parent is always computed from its two children: nothing
//! drifts, and equal priorities make an equal tree whatever happened before.

use super::random::Random;

/// What an error is raised by, so that no transition is never drawn.
const LEAST: f32 = 1e-3;

/// Priorities of the transitions of a replay buffer, by their positions.
#[derive(Debug, Clone, PartialEq)]
pub struct Priorities {
    exponent: f32,
    /// The root at 1, the children of i at 2 i and 2 i + 1, the transitions in the second half.
    sums: Vec<f32>,
    greatest: f32,
}

impl Priorities {
    /// For `capacity` transitions, drawn in proportion to `|error|^exponent`.
    #[must_use]
    pub fn new(capacity: usize, exponent: f64) -> Self {
        let leaves = capacity.next_power_of_two();
        Self { exponent: exponent as f32, sums: vec![0.0; 2 * leaves], greatest: 1.0 }
    }

    /// Bytes that priorities for so many transitions take.
    #[must_use]
    pub fn bytes(capacity: usize) -> usize {
        2 * capacity.next_power_of_two() * size_of::<f32>()
    }

    fn leaves(&self) -> usize {
        self.sums.len() / 2
    }

    fn set(&mut self, at: usize, priority: f32) {
        let mut node = self.leaves() + at;
        self.sums[node] = priority;
        while node > 1 {
            node /= 2;
            self.sums[node] = self.sums[2 * node] + self.sums[2 * node + 1];
        }
    }

    /// A new transition: it has the greatest priority so far, so that it is drawn soon.
    pub fn add(&mut self, at: usize) {
        self.set(at, self.greatest);
    }

    /// The error that was found for a transition.
    pub fn change(&mut self, at: usize, error: f32) {
        let priority = libm::powf(error.abs() + LEAST, self.exponent);
        self.greatest = self.greatest.max(priority);
        self.set(at, priority);
    }

    /// A position, each as likely as its priority.
    pub fn draw(&self, random: &mut Random) -> usize {
        let mut rest = (random.unit() * f64::from(self.sums[1])) as f32;
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
    pub fn likelihood(&self, at: usize) -> f64 {
        f64::from(self.sums[self.leaves() + at]) / f64::from(self.sums[1])
    }

    /// What a checkpoint must keep: the priorities of the first `count` transitions, little-endian,
    /// after the greatest of all time.
    #[must_use]
    pub fn state(&self, count: usize) -> Vec<u8> {
        let leaves = &self.sums[self.leaves()..][..count];
        [self.greatest].iter().chain(leaves).flat_map(|value| value.to_le_bytes()).collect()
    }

    /// Takes over what a checkpoint has kept; `false`, and nothing is changed, if it does not fit.
    #[must_use]
    pub fn restore(&mut self, state: &[u8]) -> bool {
        let (values, rest) = state.as_chunks::<4>();
        let mut values = values.iter().map(|&bytes| f32::from_le_bytes(bytes));
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

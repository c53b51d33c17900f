//! The replay buffer: references to what happened, not observations.
//!
//! A state of `I_A` and `I_B` is 187 kB; a million of them would take 187 GB. But it is a function
//! of the map and the visited cells, so a transition keeps just those: the map's number, the
//! cells as 16-bit positions, action, rewards and whether the episode ended there. With the default
//! limit of eight steps that is 28 bytes; a million transitions take 28 MB.

use super::cell::Cell;
use super::flight::{REWARD_BLOCKED, REWARD_HOLE, REWARD_STEP};
use super::priorities::Priorities;
use crate::random::Random;

/// One or more steps of an episode, from a state to a later one.
#[derive(Debug, Clone, PartialEq)]
pub struct Transition {
    /// Number of the map: its position among the records of the split.
    pub map: u32,
    /// The cells visited, the start of the episode first, the cell that the transition leads to
    /// last.
    pub path: Vec<Cell>,
    /// The action of the first step.
    pub action: usize,
    /// The rewards of the steps, equation 13. The first step begins before as many of the cells.
    pub rewards: Vec<f32>,
    /// Whether the episode ended at a coverage hole there, so that the state has no value. At the
    /// time limit it keeps its value.
    pub terminal: bool,
}

impl Transition {
    /// The cells visited before the first step.
    #[must_use]
    pub fn before(&self) -> &[Cell] {
        &self.path[..self.path.len() - self.rewards.len()]
    }

    /// The return of the steps, `Σ γ^i r_i`, and the factor `γ^n` of what the last state is worth
    /// (0 if the episode ended).
    #[must_use]
    pub fn discounted(&self, discount: f64) -> (f64, f64) {
        let add = |(sum, factor): (f64, f64), &reward: &f32| {
            (sum + factor * f64::from(reward), factor * discount)
        };
        let (sum, factor) = self.rewards.iter().fold((0.0, 1.0), add);
        (sum, if self.terminal { 0.0 } else { factor })
    }
}

const REWARDS: [f32; 3] = [REWARD_HOLE, REWARD_STEP, REWARD_BLOCKED];
/// Steps that a transition may span: their rewards take two bits each.
pub const MAX_STEPS: usize = 8;
/// Map, action, rewards, number of steps with the end, number of cells.
const FIXED_BYTES: usize = 4 + 2 + 2 + 1 + 1;

/// Transitions to learn from.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Where they stand in the buffer.
    pub positions: Vec<usize>,
    /// Themselves.
    pub transitions: Vec<Transition>,
    /// What makes good for drawing some more often than others, `(N p)^(-β)`, the greatest of them 1 (importance
    /// sampling, Schaul et al., 2016); of a buffer that is prioritised.
    pub weights: Option<Vec<f32>>,
}

/// A ring of transitions, each of a fixed number of bytes.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplayBuffer {
    cells: usize,
    max_steps: usize,
    capacity: usize,
    /// Transitions that were ever added.
    added: u64,
    bytes: Vec<u8>,
    /// Transitions in the buffer on each map, by its number.
    on_map: Vec<u32>,
    /// If some come more often than others.
    priorities: Option<Priorities>,
}

impl ReplayBuffer {
    /// Cells along a side that a map may have, so that positions fit into 16 bits.
    pub const MAX_CELLS: usize = 256;

    /// For `capacity` transitions of episodes of at most `max_steps` steps on maps of `cells` ×
    /// `cells`.
    ///
    /// # Panics
    /// If a map has more cells than [`ReplayBuffer::MAX_CELLS`], or an episode more than 254 steps.
    #[must_use]
    pub fn new(capacity: usize, cells: usize, max_steps: usize) -> Self {
        assert!(cells <= Self::MAX_CELLS && max_steps < 255, "what there is fits into its bits");
        let mut replay = Self {
            cells,
            max_steps,
            capacity,
            added: 0,
            bytes: Vec::new(),
            on_map: Vec::new(),
            priorities: None,
        };
        replay.bytes.reserve_exact(capacity * replay.stride());
        replay
    }

    /// The same, empty, with transitions drawn in proportion to their error to the power `alpha` (prioritised
    /// replay); 0 for all alike.
    #[must_use]
    pub fn prioritised(self, alpha: f64) -> Self {
        let priorities = (alpha > 0.0).then(|| Priorities::new(self.capacity, alpha));
        Self { priorities, ..self }
    }

    /// Bytes of a transition of an episode of at most `max_steps` steps.
    #[must_use]
    pub fn stride_of(max_steps: usize) -> usize {
        FIXED_BYTES + 2 * (max_steps + 1)
    }

    /// Bytes of a transition.
    #[must_use]
    pub fn stride(&self) -> usize {
        Self::stride_of(self.max_steps)
    }

    /// Number of transitions in the buffer.
    #[must_use]
    pub fn len(&self) -> usize {
        self.bytes.len() / self.stride()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Bytes of memory that a full buffer takes.
    #[must_use]
    pub fn memory(capacity: usize, max_steps: usize, alpha: f64) -> usize {
        let priorities = if alpha > 0.0 { Priorities::bytes(capacity) } else { 0 };
        Self::stride_of(max_steps) * capacity + priorities
    }

    /// What a checkpoint must keep: how many were ever added, the bytes, and those of priorities.
    #[must_use]
    pub fn state(&self) -> (u64, &[u8], Vec<u8>) {
        let priorities = self.priorities.as_ref().map(|priorities| priorities.state(self.len()));
        (self.added, &self.bytes, priorities.unwrap_or_default())
    }

    /// Takes over what a checkpoint has kept; `false` if it is of another buffer, which is then of no use.
    #[must_use]
    pub fn restore(&mut self, added: u64, bytes: Vec<u8>, priorities: &[u8]) -> bool {
        let stride = self.stride();
        let expected = (added as usize).min(self.capacity) * stride;
        let fits = bytes.len() == expected;
        if fits {
            self.added = added;
            self.bytes.clear();
            self.bytes.extend(bytes);
            self.on_map.clear();
            (0..self.len()).for_each(|at| self.count(at));
        }
        fits && self.priorities.as_mut().is_none_or(|own| own.restore(priorities))
    }

    /// Draws `count` transitions on maps that are held; `beta`, 0 to 1, says how far weights make good for
    /// priorities.
    ///
    /// # Panics
    /// If the buffer is empty. It does not end if no map is held.
    #[must_use]
    pub fn sample(
        &self,
        count: usize,
        beta: f64,
        holds: impl Fn(u32) -> bool,
        random: &mut Random,
    ) -> Sample {
        let mut draw = || loop {
            let at = match &self.priorities {
                Some(priorities) => priorities.draw(random),
                None => random.below(self.len()),
            };
            if holds(self.map(at)) {
                return at;
            }
        };
        let positions: Vec<usize> = (0..count).map(|_| draw()).collect();
        let weights = self.priorities.as_ref().map(|priorities| {
            let of = |&at: &usize| libm::pow(self.len() as f64 * priorities.likelihood(at), -beta);
            let weights: Vec<f64> = positions.iter().map(of).collect();
            let greatest = weights.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
            weights.iter().map(|weight| (weight / greatest) as f32).collect()
        });
        Sample {
            transitions: positions.iter().map(|&at| self.get(at)).collect(),
            positions,
            weights,
        }
    }

    /// Sets the priorities of transitions that were learned from by their errors.
    pub fn update_priorities(&mut self, positions: &[usize], errors: &[f32]) {
        let Some(priorities) = &mut self.priorities else { return };
        let errors = positions.iter().zip(errors).filter(|(_, error)| error.is_finite());
        errors.for_each(|(&at, &error)| priorities.change(at, error));
    }

    fn position(&self, cell: Cell) -> [u8; 2] {
        ((cell.row as usize * self.cells + cell.column as usize) as u16).to_le_bytes()
    }

    fn cell(&self, bytes: &[u8]) -> Cell {
        let at = usize::from(u16::from_le_bytes([bytes[0], bytes[1]]));
        Cell::new((at / self.cells) as i32, (at % self.cells) as i32)
    }

    /// Counts the transition at a position for its map.
    fn count(&mut self, at: usize) {
        let map = self.map(at) as usize;
        self.on_map.resize(self.on_map.len().max(map + 1), 0);
        self.on_map[map] += 1;
    }

    /// Adds a transition, in the place of the oldest if the buffer is full; returns its position.
    ///
    /// # Panics
    /// If it has more cells than the episodes that the buffer was made for, or another reward than
    /// those of equation 13.
    pub fn push(&mut self, transition: &Transition) -> usize {
        let Transition { map, path, action, rewards, terminal } = transition;
        assert!(path.len() <= self.max_steps + 1, "an episode within its limit");
        assert!((1..=MAX_STEPS.min(path.len() - 1)).contains(&rewards.len()), "steps and a start");
        let code = |reward| REWARDS.iter().position(|known| known == reward);
        let codes = rewards.iter().rev().fold(0_u16, |codes, reward| {
            codes << 2 | code(reward).expect("one of the three rewards") as u16
        });
        let mut bytes = Vec::with_capacity(self.stride());
        bytes.extend(map.to_le_bytes());
        bytes.extend((*action as u16).to_le_bytes());
        bytes.extend(codes.to_le_bytes());
        bytes.push(rewards.len() as u8 | u8::from(*terminal) << 7);
        bytes.push(path.len() as u8);
        bytes.extend(path.iter().flat_map(|&cell| self.position(cell)));
        bytes.resize(self.stride(), 0);
        let at = (self.added % self.capacity as u64) as usize;
        if self.len() < self.capacity {
            self.bytes.extend(bytes);
        } else {
            let oldest = self.map(at) as usize;
            self.on_map[oldest] -= 1;
            self.bytes[at * bytes.len()..(at + 1) * bytes.len()].copy_from_slice(&bytes);
        }
        self.added += 1;
        self.count(at);
        if let Some(priorities) = &mut self.priorities {
            priorities.add(at);
        }
        at
    }

    /// Number of the map of the transition at a position.
    ///
    /// # Panics
    /// If there is none.
    #[must_use]
    pub fn map(&self, at: usize) -> u32 {
        let bytes = &self.bytes[at * self.stride()..][..4];
        u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])
    }

    /// Number of transitions on a map.
    #[must_use]
    pub fn on_map(&self, number: u32) -> usize {
        self.on_map.get(number as usize).map_or(0, |&count| count as usize)
    }

    /// The transition at a position.
    ///
    /// # Panics
    /// If there is none.
    #[must_use]
    pub fn get(&self, at: usize) -> Transition {
        let bytes = &self.bytes[at * self.stride()..(at + 1) * self.stride()];
        let (fixed, cells) = bytes.split_at(FIXED_BYTES);
        let codes = u16::from_le_bytes([fixed[6], fixed[7]]);
        let [steps, count] = [fixed[8] & 0x7f, fixed[9]].map(usize::from);
        Transition {
            map: self.map(at),
            path: cells.chunks_exact(2).take(count).map(|position| self.cell(position)).collect(),
            action: u16::from_le_bytes([fixed[4], fixed[5]]).into(),
            rewards: (0..steps).map(|i| REWARDS[usize::from(codes >> (2 * i) & 3)]).collect(),
            terminal: fixed[8] >> 7 == 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn transition(n: u64) -> Transition {
        let mut random = Random::keyed(&[n]);
        let mut cell = || Cell::new(random.below(121) as i32, random.below(121) as i32);
        let path: Vec<Cell> = (0..n % 8 + 2).map(|_| cell()).collect();
        let steps = 1 + n as usize % (path.len() - 1);
        let rewards = (0..steps).map(|step| REWARDS[(n as usize + step) % 3]).collect();
        let (action, terminal) = ((n * 37 % 961) as usize, n.is_multiple_of(3));
        Transition { map: n as u32, path, action, rewards, terminal }
    }

    #[test]
    fn returns_by_hand() {
        let path = vec![Cell::default(); 5];
        let mut transition = Transition {
            map: 0,
            path,
            action: 0,
            rewards: vec![-0.25, -1.25, 0.0],
            terminal: true,
        };
        assert_eq!(transition.before().len(), 2);
        assert_eq!(transition.discounted(0.5), (-0.25 - 0.5 * 1.25, 0.0));
        transition.terminal = false;
        assert_eq!(transition.discounted(0.5), (-0.875, 0.125));
    }

    #[test]
    fn transitions_come_back_as_they_were_and_the_oldest_goes() {
        let mut replay = ReplayBuffer::new(10, 121, 8);
        (0..25).for_each(|n| assert_eq!(replay.push(&transition(n)), n as usize % 10));
        assert_eq!(replay.len(), 10);
        for at in 0..10 {
            // 25 were added: 20 to 24 over 10 to 14.
            let n = if at < 5 { 20 + at } else { 10 + at };
            assert_eq!(replay.get(at), transition(n as u64));
        }
        let counts: Vec<usize> = (0..25).map(|map| replay.on_map(map)).collect();
        assert_eq!(counts, [[0; 15].as_slice(), &[1; 10]].concat());
        assert!(replay.stride() <= 64, "{}", replay.stride());
    }

    #[test]
    fn a_million_transitions_fit_into_a_hundred_megabytes() {
        assert!(ReplayBuffer::new(1, 121, 8).stride() * 1_000_000 < 100_000_000);
    }

    #[test]
    fn a_restored_buffer_goes_on_as_the_old_one() {
        let mut replay = ReplayBuffer::new(10, 121, 8).prioritised(0.6);
        (0..13).for_each(|n| assert_eq!(replay.push(&transition(n)), n as usize % 10));
        let (added, bytes, priorities) = replay.state();
        let (added, bytes) = (added, bytes.to_vec());
        let new = || ReplayBuffer::new(10, 121, 8).prioritised(0.6);
        let mut restored = new();
        assert!(!restored.restore(added, bytes[1..].to_vec(), &priorities));
        assert!(!new().restore(added, bytes.clone(), &[]));
        assert!(restored.restore(added, bytes, &priorities));
        assert_eq!(replay.push(&transition(13)), restored.push(&transition(13)));
        assert_eq!(restored, replay);
    }

    /// Of maps that are held only; the greater an error, the more often, and the less it weighs.
    #[test]
    fn samples_are_of_held_maps_and_weighed_by_how_often_they_come() {
        let mut replay = ReplayBuffer::new(10, 121, 8).prioritised(1.0);
        (0..4).for_each(|n| assert_eq!(replay.push(&transition(n)), n as usize));
        replay.update_priorities(&[0, 1, 2, 3], &[1.0, 2.0, f32::NAN, 4.0]);
        let sample = replay.sample(900, 1.0, |map| map < 2, &mut Random::keyed(&[1]));
        let of_map = |map| sample.transitions.iter().filter(|one| one.map == map).count();
        assert_eq!(of_map(0) + of_map(1), 900);
        assert!((500..700).contains(&of_map(1)), "{}", of_map(1));
        let weights = sample.weights.expect("it is prioritised");
        for (transition, weight) in sample.transitions.iter().zip(weights) {
            let expected = if transition.map == 0 { 1.0 } else { 0.5 };
            assert!((weight - expected).abs() < 1e-3, "{weight}");
        }
    }
}

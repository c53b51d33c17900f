//! The replay buffer: references to what happened, not observations.
//!
//! A state of `I_A` and `I_B` is 187 kB; a million of them would take 187 GB. But it is a function
//! of the map and the visited cells, so a transition keeps just those: the map's number, the
//! cells as 16-bit positions, action, reward and whether the episode ended there. With the default
//! limit of eight steps that is 26 bytes; a million transitions take 26 MB.

use super::cell::Cell;
use super::flight::{REWARD_BLOCKED, REWARD_HOLE, REWARD_STEP};
use super::random::Random;

/// A step of an episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Transition {
    /// Number of the map in the pool.
    pub map: u32,
    /// The cells visited before the step, the start first.
    pub visited: Vec<Cell>,
    /// The action.
    pub action: usize,
    /// The reward, `eqn:reward`.
    pub reward: f32,
    /// The cell that the UAV came to.
    pub next: Cell,
    /// Whether the episode ended at a coverage hole there, so that the state has no value. At the
    /// time limit it keeps its value.
    pub terminal: bool,
}

const REWARDS: [f32; 3] = [REWARD_HOLE, REWARD_STEP, REWARD_BLOCKED];
/// Map, action, reward with the end, number of visited cells.
const FIXED_BYTES: usize = 4 + 2 + 1 + 1;

/// A ring of transitions, each of a fixed number of bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Replay {
    cells: usize,
    max_steps: usize,
    capacity: usize,
    /// Transitions that were ever added.
    added: u64,
    bytes: Vec<u8>,
}

impl Replay {
    /// For `capacity` transitions of episodes of at most `max_steps` steps on maps of `cells` ×
    /// `cells`.
    ///
    /// # Panics
    /// If a cell's position does not fit into 16 bits (more than 256 × 256 cells).
    #[must_use]
    pub fn new(capacity: usize, cells: usize, max_steps: usize) -> Self {
        assert!(cells <= 256 && max_steps < 256, "positions and steps fit into 16 and 8 bits");
        let mut replay = Self { cells, max_steps, capacity, added: 0, bytes: Vec::new() };
        replay.bytes.reserve_exact(capacity * replay.stride());
        replay
    }

    /// Bytes of a transition.
    #[must_use]
    pub fn stride(&self) -> usize {
        FIXED_BYTES + 2 * (self.max_steps + 1)
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

    /// What a checkpoint must keep: how many were ever added, and the bytes.
    #[must_use]
    pub fn state(&self) -> (u64, &[u8]) {
        (self.added, &self.bytes)
    }

    /// Takes over what a checkpoint has kept; `false`, and nothing is changed, if it is of
    /// another buffer.
    #[must_use]
    pub fn restore(&mut self, added: u64, bytes: Vec<u8>) -> bool {
        let stride = self.stride();
        let expected = (added as usize).min(self.capacity) * stride;
        let fits = bytes.len() == expected;
        if fits {
            (self.added, self.bytes) = (added, bytes);
        }
        fits
    }

    fn position(&self, cell: Cell) -> [u8; 2] {
        ((cell.row as usize * self.cells + cell.column as usize) as u16).to_le_bytes()
    }

    fn cell(&self, bytes: &[u8]) -> Cell {
        let at = usize::from(u16::from_le_bytes([bytes[0], bytes[1]]));
        Cell::new((at / self.cells) as i32, (at % self.cells) as i32)
    }

    /// Adds a transition, in the place of the oldest if the buffer is full.
    ///
    /// # Panics
    /// If it has more cells than the episodes that the buffer was made for, or another reward than
    /// those of `eqn:reward`.
    pub fn push(&mut self, transition: &Transition) {
        let Transition { map, visited, action, reward, next, terminal } = transition;
        assert!((1..=self.max_steps).contains(&visited.len()), "an episode within its limit");
        let reward = REWARDS.iter().position(|known| known == reward);
        let reward = reward.expect("one of the three rewards") as u8;
        let mut bytes = Vec::with_capacity(self.stride());
        bytes.extend(map.to_le_bytes());
        bytes.extend((*action as u16).to_le_bytes());
        bytes.push(reward | u8::from(*terminal) << 7);
        bytes.push(visited.len() as u8);
        bytes.extend(visited.iter().chain([next]).flat_map(|&cell| self.position(cell)));
        bytes.resize(self.stride(), 0);
        if self.len() < self.capacity {
            self.bytes.extend(bytes);
        } else {
            let at = (self.added as usize % self.capacity) * self.stride();
            self.bytes[at..at + bytes.len()].copy_from_slice(&bytes);
        }
        self.added += 1;
    }

    /// The transition at a position.
    ///
    /// # Panics
    /// If there is none.
    #[must_use]
    pub fn get(&self, at: usize) -> Transition {
        let bytes = &self.bytes[at * self.stride()..(at + 1) * self.stride()];
        let (fixed, cells) = bytes.split_at(FIXED_BYTES);
        let count = usize::from(fixed[7]);
        let mut visited: Vec<Cell> =
            cells.chunks_exact(2).take(count + 1).map(|position| self.cell(position)).collect();
        let next = visited.pop().expect("a step leads somewhere");
        Transition {
            map: u32::from_le_bytes([fixed[0], fixed[1], fixed[2], fixed[3]]),
            visited,
            action: u16::from_le_bytes([fixed[4], fixed[5]]).into(),
            reward: REWARDS[usize::from(fixed[6] & 0x7f)],
            next,
            terminal: fixed[6] >> 7 == 1,
        }
    }

    /// Transitions at random, each as likely as any other, some perhaps twice.
    ///
    /// # Panics
    /// If the buffer is empty.
    #[must_use]
    pub fn sample(&self, count: usize, random: &mut Random) -> Vec<Transition> {
        (0..count).map(|_| self.get(random.below(self.len()))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn transition(n: u64) -> Transition {
        let mut random = Random::keyed(&[n]);
        let mut cell = || Cell::new(random.below(121) as i32, random.below(121) as i32);
        let visited = (0..=n % 8).map(|_| cell()).collect();
        let (next, terminal) = (cell(), n.is_multiple_of(3));
        let reward = REWARDS[(n % 3) as usize];
        Transition {
            map: n as u32,
            visited,
            action: (n * 37 % 961) as usize,
            reward,
            next,
            terminal,
        }
    }

    #[test]
    fn transitions_come_back_as_they_were_and_the_oldest_goes() {
        let mut replay = Replay::new(10, 121, 8);
        (0..25).for_each(|n| replay.push(&transition(n)));
        assert_eq!(replay.len(), 10);
        for at in 0..10 {
            // 25 were added: 20 to 24 over 10 to 14.
            let n = if at < 5 { 20 + at } else { 10 + at };
            assert_eq!(replay.get(at), transition(n as u64));
        }
        assert!(replay.stride() <= 64, "{}", replay.stride());
    }

    #[test]
    fn a_million_transitions_fit_into_a_hundred_megabytes() {
        assert!(Replay::new(1, 121, 8).stride() * 1_000_000 < 100_000_000);
    }

    #[test]
    fn a_restored_buffer_goes_on_as_the_old_one() {
        let mut replay = Replay::new(10, 121, 8);
        (0..13).for_each(|n| replay.push(&transition(n)));
        let (added, bytes) = replay.state();
        let (added, bytes) = (added, bytes.to_vec());
        let mut restored = Replay::new(10, 121, 8);
        assert!(!restored.restore(added, bytes[1..].to_vec()));
        assert!(restored.restore(added, bytes));
        replay.push(&transition(13));
        restored.push(&transition(13));
        assert_eq!(restored, replay);
    }
}

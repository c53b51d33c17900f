//! The permissible set, equation 3: where one step may lead.
//!
//! A cell is permissible if it lies within l cells in each direction, is not occupied, and
//! the straight line to it touches no occupied cell. Cells are closed squares: a line that
//! passes through a corner touches all cells that meet there (a supercover line), so nothing
//! cuts corners.
//!
//! All (2l + 1)² targets are decided at once. For each cell of the window a table holds its
//! *shadow*, the set of targets whose lines touch it, as bits. The permissible set is what
//! the shadows of the walls in the window leave over: a hundred or so ORs of 128 bytes
//! instead of 961 rays. Only walls count, occupied cells with a free neighbour: any line that
//! touches an inner cell has touched a wall before. The table takes 123 KB for l = 15 and
//! stays in the second-level cache.

use super::cell::{Actions, Cell};
use super::world::World;

const WORD: usize = u64::BITS as usize;

/// A set of actions.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ActionSet {
    words: Vec<u64>,
}

impl ActionSet {
    /// Whether an action is in the set.
    #[must_use]
    pub fn contains(&self, action: usize) -> bool {
        self.words[action / WORD] >> (action % WORD) & 1 == 1
    }

    /// Number of actions in the set.
    #[must_use]
    pub fn count(&self) -> usize {
        self.words.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// The actions, rising.
    pub fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        self.words
            .iter()
            .enumerate()
            .flat_map(|(at, &word)| Ones(word).map(move |bit| at * WORD + bit))
    }

    /// 1 for each of `count` actions that is in the set, 0 for the others.
    #[must_use]
    pub fn flags(&self, count: usize) -> Vec<f32> {
        let mut flags = vec![0.0; count];
        self.iter().for_each(|action| flags[action] = 1.0);
        flags
    }

    /// Writes 1 for each action that is in the set, 0 for the others.
    ///
    /// # Panics
    /// If there are more flags than actions, rounded up to words.
    pub fn write_flags(&self, flags: &mut [u8]) {
        let bytes = self.words.iter().flat_map(|word| word.to_le_bytes());
        let (eights, rest) = flags.as_chunks_mut::<8>();
        let mut bytes = bytes.take(eights.len() + 1);
        for (eight, byte) in eights.iter_mut().zip(&mut bytes) {
            *eight = SPREAD[usize::from(byte)];
        }
        if !rest.is_empty() {
            let byte = bytes.next().expect("as many actions as flags");
            rest.copy_from_slice(&SPREAD[usize::from(byte)][..rest.len()]);
        }
    }

    /// The moves to cells that were not visited, which are known to be no holes; all moves if no
    /// others are left over. The UAV is in the cell visited last.
    #[must_use]
    pub fn unvisited(&self, actions: Actions, visited: &[Cell]) -> Self {
        let mut left = self.clone();
        for &cell in visited {
            let by = visited.last().map(|&here| cell - here);
            if let Some(action) = by.and_then(|by| actions.index(by)) {
                left.words[action / WORD] &= !(1 << (action % WORD));
            }
        }
        if left.words.iter().any(|&word| word > 0) { left } else { self.clone() }
    }

    /// The n-th action, from 0.
    #[must_use]
    pub fn nth(&self, n: usize) -> Option<usize> {
        let mut left = n;
        for (at, &word) in self.words.iter().enumerate() {
            let ones = word.count_ones() as usize;
            if left < ones {
                return Ones(word).nth(left).map(|bit| at * WORD + bit);
            }
            left -= ones;
        }
        None
    }
}

/// The bits of a byte, the lowest first.
const SPREAD: [[u8; 8]; 256] = {
    let mut spread = [[0; 8]; 256];
    let mut at = 0;
    while at < 256 * 8 {
        spread[at / 8][at % 8] = (((at / 8) >> (at % 8)) & 1) as u8;
        at += 1;
    }
    spread
};

/// The positions of the ones in a word, rising.
struct Ones(u64);

impl Iterator for Ones {
    type Item = usize;

    fn next(&mut self) -> Option<usize> {
        if self.0 == 0 {
            return None;
        }
        let bit = self.0.trailing_zeros() as usize;
        self.0 &= self.0 - 1;
        Some(bit)
    }
}

/// Shadows of all cells of a window.
#[derive(Debug)]
pub struct Sight {
    actions: Actions,
    words: usize,
    /// For each cell of the window its shadow, `words` words.
    shadows: Vec<u64>,
}

impl Sight {
    /// The table for steps of at most `reach` cells in each direction.
    #[must_use]
    pub fn new(reach: u32) -> Self {
        let actions = Actions::new(reach);
        let words = actions.count().div_ceil(WORD);
        let mut shadows = vec![0; actions.count() * words];
        for target in 0..actions.count() {
            let to = actions.offset(target);
            for row in to.row.min(0)..=to.row.max(0) {
                for column in to.column.min(0)..=to.column.max(0) {
                    let cell = Cell::new(row, column);
                    if touches(to, cell) {
                        let at = actions.index(cell).expect("cells on the way lie in the window");
                        shadows[at * words + target / WORD] |= 1 << (target % WORD);
                    }
                }
            }
        }
        Self { actions, words, shadows }
    }

    /// The actions that the table is made for.
    #[must_use]
    pub fn actions(&self) -> Actions {
        self.actions
    }

    /// An empty set, to be filled by [`Sight::permissible_into`].
    #[must_use]
    pub fn empty(&self) -> ActionSet {
        ActionSet { words: vec![0; self.words] }
    }

    /// The permissible set of a cell, `S_prm(k)` of equation 3; to stay is always permissible.
    ///
    /// # Panics
    /// If `from` is occupied or outside of the map, or the map was made for another reach.
    #[must_use]
    pub fn permissible(&self, world: &World, from: Cell) -> ActionSet {
        let mut set = self.empty();
        self.permissible_into(world, from, &mut set);
        set
    }

    /// As [`Sight::permissible`], without allocating.
    ///
    /// # Panics
    /// As [`Sight::permissible`].
    pub fn permissible_into(&self, world: &World, from: Cell, set: &mut ActionSet) {
        assert_eq!(world.reach(), self.actions.reach(), "the map is made for another reach");
        assert!(world.is_free(from), "{from:?} is no free cell of map {}", world.id());
        let side = self.actions.side();
        let blocked = &mut set.words[..];
        blocked.fill(0);
        for row in 0..side {
            let first = row * side;
            or_bits(blocked, first, world.closed_bits(from, row));
            for column in Ones(world.wall_bits(from, row)) {
                let at = (first + column) * self.words;
                let shadow = &self.shadows[at..at + self.words];
                blocked.iter_mut().zip(shadow).for_each(|(word, shade)| *word |= shade);
            }
        }
        for word in &mut *blocked {
            *word = !*word;
        }
        let rest = self.actions.count() % WORD;
        if rest > 0 {
            blocked[self.words - 1] &= (1 << rest) - 1;
        }
    }
}

/// Adds up to 63 bits to a set, beginning at a position.
fn or_bits(words: &mut [u64], first: usize, bits: u64) {
    let (at, shift) = (first / WORD, first % WORD);
    words[at] |= bits << shift;
    let above = bits.checked_shr((WORD - shift) as u32).unwrap_or(0);
    if above > 0 {
        words[at + 1] |= above;
    }
}

/// Whether the segment from the centre of cell 0 to that of `to` touches the closed square of
/// `cell`, which lies in the box of the segment: whether the square's corners lie on both
/// sides of the line, or one lies on it. Exact: all numbers are integers (half cells).
fn touches(to: Cell, cell: Cell) -> bool {
    let side = |row: i32, column: i32| {
        to.row * (2 * cell.column + column) - to.column * (2 * cell.row + row)
    };
    let corners = [side(-1, -1), side(-1, 1), side(1, -1), side(1, 1)];
    corners.iter().any(|&c| c <= 0) && corners.iter().any(|&c| c >= 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::world::tests::world;

    fn open(map: &str, from: Cell, to: Cell) -> bool {
        let world = world(map, 3);
        let sight = Sight::new(3);
        let set = sight.permissible(&world, from);
        set.contains(sight.actions().index(to - from).expect("within reach"))
    }

    /// `.` free, `#` occupied.
    #[test]
    fn lines_are_blocked_by_what_they_touch() {
        let map = "....\n.#..\n....\n....";
        assert!(open(map, Cell::new(0, 0), Cell::new(0, 3)), "along a free row");
        assert!(!open(map, Cell::new(0, 0), Cell::new(2, 2)), "through a building");
        assert!(!open(map, Cell::new(0, 0), Cell::new(1, 1)), "into a building");
        assert!(!open(map, Cell::new(0, 1), Cell::new(1, 2)), "past its corner");
        assert!(!open(map, Cell::new(1, 0), Cell::new(0, 1)), "past its corner");
        assert!(
            open(map, Cell::new(0, 0), Cell::new(3, 1))
                == open(map, Cell::new(3, 1), Cell::new(0, 0))
        );
        assert!(open(map, Cell::new(0, 0), Cell::new(3, 0)), "beside it");
        assert!(open(map, Cell::new(3, 3), Cell::new(3, 3)), "to stay");
    }

    /// 9, 25, 49 ... actions: bytes that are not full, and several words.
    #[test]
    fn flags_are_those_of_the_set_for_any_number_of_actions() {
        for reach in 1..6 {
            let world = world(".....\n.#.#.\n.....\n..#..\n.....", reach);
            let sight = Sight::new(reach);
            let set = sight.permissible(&world, Cell::new(2, 2));
            let mut flags = vec![9; sight.actions().count()];
            set.write_flags(&mut flags);
            let expected: Vec<u8> = (0..flags.len()).map(|at| set.contains(at).into()).collect();
            assert_eq!(flags, expected, "{reach}");
        }
    }

    #[test]
    fn unvisited_cells_are_left_over_while_there_are_any() {
        let world = world("..\n##", 3);
        let (sight, [here, beside]) = (Sight::new(3), [Cell::new(0, 0), Cell::new(0, 1)]);
        let set = sight.permissible(&world, here);
        let left = |visited: &[Cell]| {
            let left = set.unvisited(sight.actions(), visited);
            left.iter().map(|action| here + sight.actions().offset(action)).collect::<Vec<_>>()
        };
        assert_eq!(left(&[here]), [beside]);
        assert_eq!(left(&[beside, here]), [here, beside], "nowhere else to go");
        assert_eq!(left(&[Cell::new(0, 9), here]), [beside], "what is out of reach is no move");
    }

    #[test]
    fn nothing_beyond_the_map_is_permissible() {
        let world = world("..\n..", 3);
        let sight = Sight::new(3);
        let set = sight.permissible(&world, Cell::new(0, 1));
        assert_eq!(set.count(), 4);
        let offsets: Vec<Cell> = set.iter().map(|action| sight.actions().offset(action)).collect();
        let all = [Cell::new(0, -1), Cell::new(0, 0), Cell::new(1, -1), Cell::new(1, 0)];
        assert_eq!(offsets, all);
        assert_eq!((set.nth(3), set.nth(4)), (set.iter().nth(3), None));
    }

    #[test]
    fn the_whole_window_is_permissible_without_buildings() {
        let map = ["."; 41].concat() + "\n";
        let world = world(map.repeat(41).trim_end(), 15);
        let sight = Sight::new(15);
        assert_eq!(sight.permissible(&world, Cell::new(20, 20)).count(), 961);
        assert_eq!(sight.permissible(&world, Cell::new(0, 0)).count(), 256);
    }
}

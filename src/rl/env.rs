//! Episodes of training: flights that begin at random free cells, many at a time.

use std::collections::HashMap;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::cell::{Actions, Cell};
use super::flight::{fly, reward};
use super::maps::{MapKey, MapList};
use super::sight::{ActionSet, Sight};
use super::world::World;
use crate::random::Random;

/// Keys the random numbers of episodes.
const EPISODES: u64 = 20;

/// What an action came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// The reward, equation 13.
    pub reward: f32,
    /// A coverage hole is found: the state after it has no value.
    pub terminal: bool,
    /// The time limit is reached: the state after it keeps its value.
    pub truncated: bool,
    /// The cell that the UAV came to.
    pub next: Cell,
}

/// What a checkpoint must keep of an episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EpisodeState {
    episodes: u64,
    map: MapKey,
    visited: Vec<Cell>,
}

/// One episode after another, on maps drawn at random. The n-th episode of a slot is a function of seed,
/// slot, n and the maps alone.
#[derive(Debug)]
struct Slot {
    number: u64,
    episodes: u64,
    map: MapKey,
    visited: Vec<Cell>,
    permissible: ActionSet,
}

/// Where episodes begin on each map, as positions in row-major order.
type Starts = HashMap<MapKey, Vec<u32>>;

/// Many episodes at a time over a list of maps; actions in, rewards out. The list is always the same one: who
/// replaces a map in it says so by [`Environment::replace`].
#[derive(Debug)]
pub struct Environment {
    seed: u64,
    max_steps: usize,
    sight: Sight,
    starts: Starts,
    slots: Vec<Slot>,
}

/// Free cells that are no holes, as positions in row-major order.
fn covered(map: &World) -> Vec<u32> {
    map.covered().map(|cell| map.index(cell) as u32).collect()
}

impl Environment {
    /// So many episodes are stepped by one thread: others would not be awake before it is done.
    pub const ALONE: usize = 64;

    /// `slots` episodes at a time.
    #[must_use]
    pub fn new(maps: &MapList, slots: usize, max_steps: u32, seed: u64) -> Self {
        let starts = maps.all().iter().map(|(key, map)| (*key, covered(map))).collect();
        let sight = Sight::new(maps.all()[0].1.reach() as u32);
        let slots = (0..slots as u64).map(|number| Slot {
            number,
            episodes: 0,
            map: 0,
            visited: Vec::new(),
            permissible: sight.empty(),
        });
        let mut slots: Vec<Slot> = slots.collect();
        for slot in &mut slots {
            slot.begin(seed, &sight, maps, &starts);
        }
        Self { seed, max_steps: max_steps as usize, sight, starts, slots }
    }

    /// The actions.
    #[must_use]
    pub fn actions(&self) -> Actions {
        self.sight.actions()
    }

    /// Episodes at a time.
    #[must_use]
    pub fn len(&self) -> usize {
        self.slots.len()
    }

    /// Whether there are no episodes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// Map and visited cells of an episode, the start first.
    #[must_use]
    pub fn state(&self, slot: usize) -> (MapKey, &[Cell]) {
        let slot = &self.slots[slot];
        (slot.map, &slot.visited)
    }

    /// Where the next step of an episode may lead.
    #[must_use]
    pub fn permissible(&self, slot: usize) -> &ActionSet {
        &self.slots[slot].permissible
    }

    /// The table of lines of sight.
    #[must_use]
    pub fn sight(&self) -> &Sight {
        &self.sight
    }

    /// In the list the map `by` has taken the place of `gone`. Episodes on that one are over: `cut` receives
    /// their slots and visited cells.
    pub fn replace(
        &mut self,
        maps: &MapList,
        gone: MapKey,
        by: MapKey,
        mut cut: impl FnMut(usize, &[Cell]),
    ) {
        self.starts.remove(&gone);
        self.starts.insert(by, covered(maps.get(by)));
        let Self { seed, sight, starts, slots, .. } = self;
        for (number, slot) in slots.iter_mut().enumerate().filter(|(_, slot)| slot.map == gone) {
            cut(number, &slot.visited);
            slot.begin(*seed, sight, maps, starts);
        }
    }

    /// Ends all episodes where they are; the next ones begin.
    pub fn restart(&mut self, maps: &MapList) {
        let Self { seed, sight, starts, slots, .. } = self;
        for slot in slots {
            slot.begin(*seed, sight, maps, starts);
        }
    }

    /// What a checkpoint must keep.
    #[must_use]
    pub fn save(&self) -> Vec<EpisodeState> {
        let state = |slot: &Slot| EpisodeState {
            episodes: slot.episodes,
            map: slot.map,
            visited: slot.visited.clone(),
        };
        self.slots.iter().map(state).collect()
    }

    /// Goes on where a checkpoint was made; `false`, and nothing is changed, if it does not fit.
    #[must_use]
    pub fn restore(&mut self, maps: &MapList, episodes: &[EpisodeState]) -> bool {
        let fits = |state: &EpisodeState| {
            let last = state.visited.last();
            maps.contains(state.map) && last.is_some_and(|&last| maps.get(state.map).is_free(last))
        };
        if episodes.len() != self.slots.len() || !episodes.iter().all(fits) {
            return false;
        }
        for (slot, state) in self.slots.iter_mut().zip(episodes) {
            (slot.episodes, slot.map) = (state.episodes, state.map);
            slot.visited.clone_from(&state.visited);
            let last = *slot.visited.last().expect("checked above");
            self.sight.permissible_into(maps.get(slot.map), last, &mut slot.permissible);
        }
        true
    }

    /// One step of all episodes, in parallel if there are more than [`Environment::ALONE`]. Those that end begin anew at once: the state is
    /// then that of the next episode.
    ///
    /// # Panics
    /// If there is not an action for each episode, or one has no such number.
    pub fn step(&mut self, maps: &MapList, actions: &[usize]) -> Vec<Outcome> {
        assert_eq!(actions.len(), self.slots.len(), "an action for each episode");
        let Self { seed, max_steps, sight, starts, slots } = self;
        let step = |(slot, &action): (&mut Slot, &usize)| {
            slot.step(action, *seed, *max_steps, sight, maps, starts)
        };
        if slots.len() <= Self::ALONE {
            return slots.iter_mut().zip(actions).map(step).collect();
        }
        slots.par_iter_mut().zip(actions).with_min_len(Self::ALONE).map(step).collect()
    }
}

impl Slot {
    fn begin(&mut self, seed: u64, sight: &Sight, maps: &MapList, starts: &Starts) {
        let mut random = Random::keyed(&[seed, EPISODES, self.number, self.episodes]);
        self.episodes += 1;
        let (key, map) = &maps.all()[random.below(maps.len())];
        self.map = *key;
        let from = &starts[key];
        let start = map.cell(from[random.below(from.len())] as usize);
        self.visited.clear();
        self.visited.push(start);
        sight.permissible_into(map, start, &mut self.permissible);
    }

    fn step(
        &mut self,
        action: usize,
        seed: u64,
        max_steps: usize,
        sight: &Sight,
        maps: &MapList,
        starts: &Starts,
    ) -> Outcome {
        let world = &**maps.get(self.map);
        let from = *self.visited.last().expect("an episode has a start");
        let waypoint = from + sight.actions().offset(action);
        let (position, permissible) =
            fly(sight, &self.permissible, from.center(), waypoint.center(), |_| true);
        let cell = Cell::at(position);
        self.visited.push(cell);
        let terminal = world.is_hole(cell);
        let truncated = !terminal && self.visited.len() > max_steps;
        if terminal || truncated {
            self.begin(seed, sight, maps, starts);
        } else {
            sight.permissible_into(world, cell, &mut self.permissible);
        }
        Outcome { reward: reward(permissible, terminal), terminal, truncated, next: cell }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::rl::world::tests::world;

    fn environment(slots: usize) -> (MapList, Environment) {
        let maps = ["...\n.#o\n...", "...\n...\n...", "ooo\nooo\nooo"];
        let maps = maps.iter().map(|map| Arc::new(world(map, 2))).collect();
        let maps = MapList::of(maps).expect("the first map is usable");
        let environment = Environment::new(&maps, slots, 3, 5);
        (maps, environment)
    }

    /// A 5 × 5 window: 12 is to stay, 13 one to the east.
    #[test]
    fn episodes_end_at_holes_or_at_the_time_limit() {
        let (maps, mut environment) = environment(1);
        let stay = |environment: &mut Environment| environment.step(&maps, &[12])[0];
        let outcomes: Vec<Outcome> = (0..3).map(|_| stay(&mut environment)).collect();
        assert!(outcomes.iter().all(|outcome| outcome.reward == -0.25 && !outcome.terminal));
        assert_eq!(outcomes.iter().map(|o| o.truncated).collect::<Vec<_>>(), [false, false, true]);
        let (_, visited) = environment.state(0);
        assert_eq!(visited.len(), 1, "a new episode");

        let mut rewards = std::collections::BTreeSet::new();
        let mut found = 0;
        for step in 0..2000 {
            let outcome = environment.step(&maps, &[step * 7 % 25])[0];
            assert!(outcome.reward != 0.0 || outcome.terminal);
            found += usize::from(outcome.terminal);
            rewards.insert((outcome.reward * 100.0) as i32);
        }
        assert_eq!(rewards.into_iter().collect::<Vec<_>>(), [-125, -25, 0]);
        assert!(found > 20, "{found}");
    }

    #[test]
    fn episodes_do_not_depend_on_their_number() {
        let ((maps, mut few), (_, mut many)) = (environment(2), environment(200));
        for step in 0..50 {
            let actions =
                |slots: usize| (0..slots).map(|slot| (slot + step) % 25).collect::<Vec<_>>();
            assert_eq!(few.step(&maps, &actions(2)), many.step(&maps, &actions(200))[..2]);
            assert_eq!(few.state(1).1, many.state(1).1);
        }
    }

    #[test]
    fn restored_episodes_go_on_as_the_saved_ones() {
        let ((maps, mut saved), (_, mut restored)) = (environment(9), environment(9));
        let step = |environment: &mut Environment, step: usize| {
            environment.step(&maps, &(0..9).map(|slot| (slot * 5 + step) % 25).collect::<Vec<_>>())
        };
        (0..7).for_each(|at| drop(step(&mut saved, at)));
        let state = saved.save();
        assert!(!restored.restore(&maps, &state[1..]), "of another number");
        assert!(restored.restore(&maps, &state));
        for at in 7..30 {
            assert_eq!(step(&mut saved, at), step(&mut restored, at));
        }
    }

    #[test]
    fn restarted_episodes_are_those_after_the_ones_before() {
        let ((maps, mut restarted), (_, mut ended)) = (environment(3), environment(3));
        restarted.restart(&maps);
        (0..3).for_each(|_| drop(ended.step(&maps, &[12; 3])));
        assert_eq!(restarted.save(), ended.save(), "a limit of three steps");
    }

    #[test]
    fn a_replaced_map_ends_the_episodes_on_it() {
        let (mut maps, mut environment) = environment(4);
        environment.step(&maps, &[12; 4]);
        let other = Arc::new(world("o..\n...\n..#", 2));
        let mut ended = Vec::new();
        assert_eq!(maps.replace(0, 7, Arc::clone(&other)), 0);
        environment.replace(&maps, 0, 7, |slot, visited| ended.push((slot, visited.len())));
        assert_eq!(ended, [(0, 2), (1, 2), (2, 2), (3, 2)]);
        for slot in 0..4 {
            let (map, visited) = environment.state(slot);
            assert!(map == 7 && visited.len() == 1 && other.is_free(visited[0]));
        }
    }
}

//! From references in the replay to tensors: states are encoded when they are sampled.

use std::borrow::Cow;
use std::cell::RefCell;

use rayon::prelude::*;
use tch::{Device, Tensor};

use super::device::upload;
use super::device_encoder::{DeviceEncoder, Reference};
use crate::config::{RlConfig, TrainConfig};
use crate::rl::policy::View;
use crate::rl::{
    ActionSet, Cell, MapKey, MapList, Measurement, Random, Sight, State, StateEncoder, Symmetry,
    Transition, World, rewards_into,
};

/// A batch of transitions; states as [`StateEncoder`] writes them.
#[derive(Debug)]
pub struct Batch {
    /// The map before the step, `[batch, channels, rows, columns]`.
    pub map: Tensor,
    /// The window before the step, `[batch, channels, rows, columns]`.
    pub window: Tensor,
    /// The actions taken, `[batch]`.
    pub action: Tensor,
    /// What they brought: the return of the steps that the transition spans, `[batch]`.
    pub reward: Tensor,
    /// The states after the steps.
    pub next: Next,
    /// What is known of all actions before the step, if it is to be learned.
    pub all: Option<All>,
}

/// What is known of all actions in each state of a batch, `[batch, actions]` each.
#[derive(Debug)]
pub struct All {
    /// The rewards.
    pub rewards: Tensor,
    /// 1 for actions that would end the episode: permissible moves to holes.
    pub terminal: Tensor,
    /// 1 for actions that may be chosen: permissible ones, and if visited cells are avoided, those
    /// that lead elsewhere.
    pub allowed: Tensor,
}

/// The states after the steps of those transitions of a batch that do not end at a hole: no other
/// state is worth anything, so no other is looked at. For a factored network these are states after several
/// moves of a part of the transitions, see `train.value_moves`.
#[derive(Debug)]
pub struct Next {
    /// Positions of the transitions in the batch, `[nexts]`.
    pub of: Tensor,
    /// The moves that lead there, `[nexts]`.
    pub action: Tensor,
    /// The map, `[nexts, channels, rows, columns]`.
    pub map: Tensor,
    /// The window, `[nexts, channels, rows, columns]`.
    pub window: Tensor,
    /// 1 for actions that may be chosen, as in [`All::allowed`], `[nexts, actions]`.
    pub allowed: Tensor,
    /// What a Q-value is worth: γ for each step, `[nexts]`.
    pub discount: Tensor,
}

/// Makes batches of transitions on the maps of a list. The list is always the same one: who replaces a map
/// in it says so by [`Batcher::replace`].
#[derive(Debug)]
pub struct Batcher {
    choices: Choices,
    encoder: StateEncoder,
    buffers: RefCell<Buffers>,
    device: Device,
    /// If states are encoded elsewhere than on the CPU.
    on_device: Option<DeviceEncoder>,
    discount: f64,
    /// Moves of a state that V is learned from, if the network is factored.
    value_moves: Option<usize>,
}

/// A state after a move.
struct After<'a> {
    /// Position of the transition in the batch.
    of: usize,
    map: MapKey,
    path: Cow<'a, [Cell]>,
    action: i64,
    symmetry: Symmetry,
    /// What a value there is worth here.
    factor: f64,
}

/// What is known of actions on a map.
#[derive(Debug)]
struct Choices {
    sight: Sight,
    /// Whether anything is learned of all actions.
    learns_all: bool,
    avoids_visited: bool,
}

/// What a UAV has measured in cells of a map.
fn measured(world: &World, cells: &[Cell]) -> Vec<Measurement> {
    let measure = |&cell: &Cell| Measurement { cell, rsrp_dbm: world.rsrp_dbm(cell) };
    cells.iter().map(measure).collect()
}

impl Batcher {
    /// For transitions on the maps of a list.
    #[must_use]
    pub fn new(maps: &MapList, rl: &RlConfig, train: &TrainConfig, device: Device) -> Self {
        Self::encoding(maps, rl, train, device, device != Device::Cpu)
    }

    /// States are encoded on the device, or by the CPU for it.
    fn encoding(
        maps: &MapList,
        rl: &RlConfig,
        train: &TrainConfig,
        device: Device,
        there: bool,
    ) -> Self {
        let encoder = StateEncoder::new(maps.cells(), rl, train);
        let on_device = match &encoder {
            StateEncoder::Paper(encoder) if there => {
                Some(DeviceEncoder::new(encoder, maps.len(), rl, device))
            }
            _ => None,
        };
        let predicts = train.reward_prediction > 0.0 || train.hole_prediction > 0.0;
        let learns_all = predicts || train.dense_terminal;
        let sight = Sight::new(rl.reach_cells);
        let mut batcher = Self {
            choices: Choices { sight, learns_all, avoids_visited: train.avoid_visited },
            encoder,
            buffers: RefCell::default(),
            device,
            on_device,
            discount: train.gamma,
            value_moves: train.factored.then_some(train.value_moves as usize),
        };
        maps.all().iter().for_each(|&(key, _)| batcher.replace(maps, key));
        batcher
    }

    /// In the list a map has taken the place of another.
    pub fn replace(&mut self, maps: &MapList, by: MapKey) {
        if let Some(on_device) = &mut self.on_device {
            on_device.put(maps.place(by), maps.get(by));
        }
    }

    /// Map and window of episodes, each a map and the visited cells.
    ///
    /// # Panics
    /// If a map is not in the list.
    pub fn states(&self, maps: &MapList, states: &[(MapKey, &[Cell])]) -> [Tensor; 2] {
        let references = states.iter();
        let references =
            references.map(|&(key, visited)| reference(maps, key, visited, Symmetry::IDENTITY));
        self.encode(&references.collect::<Vec<_>>())
    }

    fn encode(&self, references: &[Reference<'_>]) -> [Tensor; 2] {
        if let Some(on_device) = &self.on_device {
            return on_device.encode(references);
        }
        let measured: Vec<Vec<Measurement>> =
            references.iter().map(|state| measured(state.world, state.visited)).collect();
        let states = references.iter().zip(&measured).map(|(state, measurements)| State {
            world: state.world,
            measurements,
            symmetry: state.symmetry,
        });
        let (states, buffers) = (states.collect::<Vec<_>>(), &mut self.buffers.borrow_mut());
        encode_states(&self.encoder, &states, self.device, buffers)
    }

    /// A batch of transitions; with `augment` each is turned or flipped at random.
    ///
    /// # Panics
    /// If a transition is on a map that is not in the list.
    #[must_use]
    pub fn batch(
        &self,
        maps: &MapList,
        transitions: &[Transition],
        augment: bool,
        random: &mut Random,
    ) -> Batch {
        let mut symmetry = |_: &Transition| {
            let random = augment.then(|| random.below(Symmetry::COUNT));
            random.map_or(Symmetry::IDENTITY, Symmetry::new)
        };
        let symmetries: Vec<Symmetry> = transitions.iter().map(&mut symmetry).collect();
        let turned: Vec<Turned<'_>> = transitions.iter().zip(symmetries).collect();
        let afters = self.afters(maps, &turned, random);
        let before = turned.iter().map(|&(transition, symmetry)| {
            reference(maps, transition.map, transition.before(), symmetry)
        });
        let [map, window] = self.encode(&before.collect::<Vec<_>>());
        let after =
            afters.iter().map(|after| reference(maps, after.map, &after.path, after.symmetry));
        let [next_map, next_window] = self.encode(&after.collect::<Vec<_>>());
        let floats = |numbers: &[f32]| upload(numbers, self.device);
        let count = self.encoder.actions().count() as i64;
        let choices = &self.choices;
        let allowed: Vec<f32> = afters
            .par_iter()
            .flat_map_iter(|after| {
                let (_, set) = choices.of(maps.get(after.map), &after.path);
                choices.turn(&set.flags(count as usize), after.symmetry)
            })
            .collect();
        let all = |rows: &[Vec<f32>]| floats(&rows.concat()).reshape([-1, count]);
        let all = choices.learns_all.then(|| {
            let rows = turned.par_iter().map(|at| choices.all(maps.get(at.0.map), at));
            let rows: Vec<[Vec<f32>; 3]> = rows.collect();
            let mut columns = [(); 3].map(|()| Vec::with_capacity(rows.len()));
            for row in rows {
                columns.iter_mut().zip(row).for_each(|(column, values)| column.push(values));
            }
            let [rewards, terminal, allowed] = columns.map(|rows| all(&rows));
            All { rewards, terminal, allowed }
        });
        let returns = transitions.iter().map(|transition| transition.discounted(self.discount).0);
        let returns: Vec<f32> = returns.map(|of| of as f32).collect();
        let factors: Vec<f32> = afters.iter().map(|after| after.factor as f32).collect();
        let of: Vec<i64> = afters.iter().map(|after| after.of as i64).collect();
        let next_actions: Vec<i64> = afters.iter().map(|after| after.action).collect();
        let taken =
            |&(transition, symmetry): &Turned<'_>| choices.turned(transition.action, symmetry);
        let actions: Vec<i64> = turned.iter().map(taken).collect();
        Batch {
            map,
            window,
            action: upload(&actions, self.device),
            reward: floats(&returns),
            next: Next {
                of: upload(&of, self.device),
                action: upload(&next_actions, self.device),
                map: next_map,
                window: next_window,
                allowed: floats(&allowed).reshape([-1, count]),
                discount: floats(&factors),
            },
            all,
        }
    }

    /// The states that are looked at beside those before the steps.
    fn afters<'a>(
        &self,
        maps: &MapList,
        turned: &[Turned<'a>],
        random: &mut Random,
    ) -> Vec<After<'a>> {
        let Some(moves) = self.value_moves else {
            let goes_on = turned.iter().enumerate().filter(|(_, (one, _))| !one.terminal);
            let after = |(of, at): (usize, &Turned<'a>)| {
                let &(transition, symmetry) = at;
                let action = self.choices.turned(transition.action, symmetry);
                let factor = transition.discounted(self.discount).1;
                let path = Cow::Borrowed(&transition.path[..]);
                After { of, map: transition.map, path, action, symmetry, factor }
            };
            return goes_on.map(after).collect();
        };
        let looked_at = turned.len().div_ceil(moves);
        let afters = turned[..looked_at].iter().enumerate().flat_map(|(of, &at)| {
            let (transition, symmetry) = at;
            let (map, before) = (transition.map, transition.before());
            let from = before[before.len() - 1];
            let after = move |action| {
                let to = from + self.choices.sight.actions().offset(action);
                let path = [before, &[to]].concat().into();
                let action = self.choices.turned(action, symmetry);
                After { of, map, path, action, symmetry, factor: self.discount }
            };
            self.choices.going_on(maps.get(map), transition, moves, random).into_iter().map(after)
        });
        afters.collect()
    }
}

fn reference<'a>(
    maps: &'a MapList,
    key: MapKey,
    visited: &'a [Cell],
    symmetry: Symmetry,
) -> Reference<'a> {
    Reference { place: maps.place(key), world: maps.get(key), visited, symmetry }
}

/// A transition, and how it is turned or flipped.
type Turned<'a> = (&'a Transition, Symmetry);

impl Choices {
    /// What becomes of an action when a state is turned.
    fn turned(&self, action: usize, symmetry: Symmetry) -> i64 {
        let side = self.sight.actions().side();
        let [row, column] = [action / side, action % side];
        let cell = symmetry.of(Cell::new(row as i32, column as i32), side);
        i64::from(cell.row) * side as i64 + i64::from(cell.column)
    }

    /// At most so many actions that may be chosen before a step and lead to no hole: the one taken first, if
    /// it does so, then others at random.
    fn going_on(
        &self,
        world: &World,
        transition: &Transition,
        count: usize,
        random: &mut Random,
    ) -> Vec<usize> {
        let before = transition.before();
        let (from, actions) = (before[before.len() - 1], self.sight.actions());
        let (_, allowed) = self.of(world, before);
        let goes_on = |&action: &usize| !world.is_hole(from + actions.offset(action));
        let taken = transition.action;
        let others: Vec<usize> =
            allowed.iter().filter(|&action| action != taken).filter(goes_on).collect();
        let taken = Some(taken).filter(|&taken| allowed.contains(taken)).filter(goes_on);
        let left = count - usize::from(taken.is_some());
        taken.into_iter().chain(random.sample(&others, left)).collect()
    }

    /// Where a step may lead from the last of the visited cells, and the actions that may be chosen.
    fn of(&self, world: &World, visited: &[Cell]) -> (ActionSet, ActionSet) {
        let from = *visited.last().expect("an episode has a start");
        let permissible = self.sight.permissible(world, from);
        let allowed = if self.avoids_visited {
            permissible.unvisited(self.sight.actions(), visited)
        } else {
            permissible.clone()
        };
        (permissible, allowed)
    }

    /// The rewards of all actions before the step, 1 for those that would end the episode, and 1
    /// for those that may be chosen.
    fn all(&self, world: &World, &(transition, symmetry): &Turned<'_>) -> [Vec<f32>; 3] {
        let count = self.sight.actions().count();
        let [mut rewards, mut terminal] = [(); 2].map(|()| vec![0.0; count]);
        let before = transition.before();
        let from = *before.last().expect("a step begins somewhere");
        let (permissible, allowed) = self.of(world, before);
        rewards_into(&self.sight, world, from, &permissible, |action, reward, ends| {
            (rewards[action], terminal[action]) = (reward, f32::from(u8::from(ends)));
        });
        [rewards, terminal, allowed.flags(count)].map(|values| self.turn(&values, symmetry))
    }

    fn turn(&self, values: &[f32], symmetry: Symmetry) -> Vec<f32> {
        let mut turned = vec![0.0; values.len()];
        symmetry.copy(values, &mut turned, self.sight.actions().side());
        turned
    }
}

/// 1 for the actions in each set, of `count` actions: `[sets, actions]`.
pub(super) fn flags<'a>(
    sets: impl Iterator<Item = &'a ActionSet>,
    count: usize,
    device: Device,
) -> Tensor {
    let flags: Vec<f32> = sets.flat_map(|set| set.flags(count)).collect();
    upload(&flags, device).reshape([-1, count as i64])
}

/// Map and window of flights, with the levels that they have measured: `count` states, of which
/// those beyond the flights are the first flight's.
pub(super) fn encode_views(
    encoder: &StateEncoder,
    views: &[View<'_, '_>],
    count: usize,
    device: Device,
) -> [Tensor; 2] {
    let views = (0..count).map(|at| views.get(at).unwrap_or(&views[0]));
    let states: Vec<State<'_>> =
        views.map(|view| State::new(view.known, view.flight.measurements())).collect();
    encode_states(encoder, &states, device, &mut Buffers::default())
}

/// Numbers of maps and windows, kept so that memory need not be had anew for each batch.
type Buffers = [Vec<f32>; 2];

/// States encoded by the CPU.
fn encode_states(
    encoder: &StateEncoder,
    states: &[State<'_>],
    device: Device,
    buffers: &mut Buffers,
) -> [Tensor; 2] {
    let shapes = encoder.shapes();
    for (buffer, shape) in buffers.iter_mut().zip(shapes) {
        buffer.resize(states.len() * shape.iter().product::<usize>(), 0.0);
    }
    let [maps, windows] = buffers;
    encoder.encode_batch(states, maps, windows);
    let tensor = |numbers: &[f32], [channels, rows, columns]: [usize; 3]| {
        let shape = [states.len(), channels, rows, columns].map(|side| side as i64);
        upload(numbers, device).reshape(shape)
    };
    [tensor(maps, shapes[0]), tensor(windows, shapes[1])]
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::rl::{Actions, drawn_world as world};

    fn step(map: u32, cells: &[(i32, i32)], terminal: bool) -> Transition {
        let path = cells.iter().map(|&(row, column)| Cell::new(row, column)).collect();
        Transition { map, path, action: 7, rewards: vec![-0.25], terminal }
    }

    /// Wherever states are encoded the batch is the same, also on a map that came later.
    #[test]
    fn batches_do_not_depend_on_where_states_are_encoded() {
        let maps = ["o..#.\n.#...\n...o.\n##...\n....o", "...#.\n.....\n.#.o.\n....#\no...."];
        let [first, second] = maps.map(|map| Arc::new(world(map, 2)));
        let later = Arc::new(world("#...o\n.....\n..#..\n.o...\n....#", 2));
        let (rl, train) =
            (RlConfig { reach_cells: 2, ..RlConfig::default() }, TrainConfig::paper());
        let mut maps = MapList::new(vec![(4, first), (9, second)]).expect("they teach");
        let mut batchers =
            [false, true].map(|there| Batcher::encoding(&maps, &rl, &train, Device::Cpu, there));
        let check = |maps: &MapList, batchers: &[Batcher; 2], transitions: &[Transition]| {
            let [here, there] = [&batchers[0], &batchers[1]]
                .map(|batcher| batcher.batch(maps, transitions, true, &mut Random::keyed(&[3])));
            for (here, there) in [
                (&here.map, &there.map),
                (&here.window, &there.window),
                (&here.next.map, &there.next.map),
                (&here.next.window, &there.next.window),
            ] {
                assert_eq!(here.size(), there.size());
                assert!((here - there).abs().max().double_value(&[]) < 1e-6);
            }
            let of = Vec::<i64>::try_from(&here.next.of).expect("numbers");
            let goes_on = (0..).zip(transitions).filter(|(_, transition)| !transition.terminal);
            assert_eq!(of, goes_on.map(|(at, _)| at).collect::<Vec<i64>>());
        };
        let on_second = step(9, &[(1, 1), (1, 2)], false);
        let transitions = [
            step(4, &[(0, 1), (0, 2), (1, 2)], false),
            step(4, &[(1, 2), (2, 3)], true),
            on_second,
        ];
        check(&maps, &batchers, &transitions);
        assert_eq!(maps.replace(0, 5, later), 4);
        for batcher in &mut batchers {
            batcher.replace(&maps, 5);
        }
        let [.., on_second] = transitions;
        check(&maps, &batchers, &[step(5, &[(1, 1), (0, 2)], false), on_second]);
    }

    /// V is learned from several moves of a part of the states: the one taken, and others that go on too.
    #[test]
    fn v_is_learned_from_moves_that_go_on() {
        let map = Arc::new(world("o..#.\n.#...\n...o.\n##...\n....o", 2));
        let rl = RlConfig { reach_cells: 2, ..RlConfig::default() };
        let train = TrainConfig { factored: true, value_moves: 2, ..TrainConfig::default() };
        let (batcher, maps) = {
            let maps = MapList::new(vec![(4, Arc::clone(&map))]).expect("it teaches");
            (Batcher::new(&maps, &rl, &train, Device::Cpu), maps)
        };
        let path = [(0, 1), (0, 2), (1, 2)].map(|(row, column)| Cell::new(row, column));
        // One cell to the south, of 5 × 5 moves.
        let taken = 17_usize;
        let one = Transition {
            map: 4,
            path: path.to_vec(),
            action: taken,
            rewards: vec![-0.25],
            terminal: false,
        };
        let batch = batcher.batch(&maps, &vec![one; 6], false, &mut Random::keyed(&[3]));
        let numbers = |of: &Tensor| Vec::<i64>::try_from(of).expect("numbers");
        assert_eq!(numbers(&batch.next.of), [0, 0, 1, 1, 2, 2]);
        let (actions, from) = (Actions::new(2), path[1]);
        for moves in numbers(&batch.next.action).chunks_exact(2) {
            assert_eq!(moves[0], taken as i64);
            let unique: std::collections::BTreeSet<_> = moves.iter().collect();
            assert_eq!(unique.len(), 2, "{moves:?}");
            for &action in moves {
                let to = from + actions.offset(action as usize);
                assert!(map.is_free(to) && !map.is_hole(to) && !path[..2].contains(&to), "{to:?}");
            }
        }
    }
}

//! States encoded where the network computes: a graphics card gets cells and levels, a few hundred
//! bytes a state, instead of 187 kB.

use tch::{Device, Kind, Tensor};

use super::device::upload;
use crate::config::RlConfig;
use crate::rl::{CHANNELS, Cell, Encoder, Symmetry, World, normalised_rsrp};

/// A state on one of the maps of a [`DeviceEncoder`].
#[derive(Debug)]
pub(super) struct Reference<'a> {
    /// Which map.
    pub(super) place: usize,
    pub(super) world: &'a World,
    /// The cells visited, the latest last.
    pub(super) visited: &'a [Cell],
    pub(super) symmetry: Symmetry,
}

/// What [`Encoder`] does, in operations on tensors.
#[derive(Debug)]
pub(super) struct DeviceEncoder {
    cells: usize,
    reach: i32,
    height_scale_m: f64,
    device: Device,
    /// The table of [`Encoder`], in a row.
    decay: Tensor,
    /// Where the cells of a map lie in the table, of a window in a map with its border; in a row.
    map_grid: Tensor,
    window_grid: Tensor,
    /// For each symmetry, where each cell's value comes from.
    sources: Tensor,
    /// Heights of the maps, `[maps, L²]`, as the network sees them.
    heights: Tensor,
}

/// Positions of a square's cells in rows of `width`.
fn grid(side: usize, width: usize, device: Device) -> Tensor {
    let at: Vec<i64> = (0..side * side).map(|at| (at / side * width + at % side) as i64).collect();
    upload(&at, device)
}

impl DeviceEncoder {
    pub(super) fn new(encoder: &Encoder, maps: usize, config: &RlConfig, device: Device) -> Self {
        let cells = encoder.cells();
        let positions: Vec<i64> = (0..(cells * cells) as i64).collect();
        let mut sources = vec![0; Symmetry::COUNT * positions.len()];
        for (n, sources) in sources.chunks_exact_mut(positions.len()).enumerate() {
            Symmetry::new(n).copy(&positions, sources, cells);
        }
        let (count, reach) = (positions.len() as i64, config.reach_cells as usize);
        Self {
            cells,
            reach: reach as i32,
            height_scale_m: config.height_scale_m,
            device,
            decay: upload(encoder.decay(), device),
            map_grid: grid(cells, 2 * cells - 1, device),
            window_grid: grid(2 * reach + 1, cells + 2 * reach, device),
            sources: upload(&sources, device).reshape([-1, count]),
            heights: Tensor::zeros([maps as i64, count], (Kind::Float, device)),
        }
    }

    /// Puts a map in a place.
    pub(super) fn put(&mut self, place: usize, world: &World) {
        let heights = upload(world.heights(), self.device) / self.height_scale_m;
        self.heights.get(place as i64).copy_(&heights);
    }

    /// `I_A` and `I_B` of states.
    pub(super) fn encode(&self, states: &[Reference<'_>]) -> [Tensor; 2] {
        let (n, count) = (self.cells as i64, states.len() as i64);
        let side = i64::from(2 * self.reach + 1);
        let turned = |state: &Reference<'_>, cell| state.symmetry.of(cell, self.cells);
        let here = |state: &Reference<'_>| {
            turned(state, *state.visited.last().expect("an episode has a start"))
        };
        // Where the north-western cell of the map lies in the table, seen from a cell.
        let corner = |cell: Cell| {
            let [row, column] = [cell.row, cell.column].map(|at| n - 1 - i64::from(at));
            row * (2 * n - 1) + column
        };
        let wide = n + 2 * i64::from(self.reach);
        let first = |cell: Cell| i64::from(cell.row) * wide + i64::from(cell.column);
        // All that the device must know, in two pieces: a row of numbers for each of these.
        let most = states.iter().map(|state| state.visited.len()).max().unwrap_or(0);
        let mut numbers: Vec<i64> = states.iter().map(|state| state.place as i64).collect();
        numbers.extend(states.iter().map(|state| state.symmetry.number() as i64));
        numbers.extend(states.iter().map(|state| first(here(state))));
        numbers.extend(states.iter().map(|state| corner(here(state))));
        let mut weights = Vec::new();
        for at in 0..most {
            let cells = || states.iter().map(|state| (state, state.visited.get(at)));
            numbers.extend(
                cells().map(|(state, cell)| cell.map_or(0, |&cell| corner(turned(state, cell)))),
            );
            weights.extend(cells().map(|(state, cell)| {
                let world = state.world;
                let level = |&cell| normalised_rsrp(world.rsrp_dbm(cell), world.threshold_dbm());
                cell.map_or(0.0, level)
            }));
        }
        let numbers = upload(&numbers, self.device).reshape([-1, count]);
        let weights = upload(&weights, self.device).reshape([-1, count, 1]);
        let decay = |row| self.decay.take(&(numbers.get(row).unsqueeze(1) + &self.map_grid));
        let location = decay(3);
        let mut levels = location.zeros_like();
        for at in 0..most as i64 {
            levels += weights.get(at) * decay(4 + at);
        }
        let (places, symmetries) = (numbers.get(0), numbers.get(1));
        let sources = self.sources.index_select(0, &symmetries);
        let heights = self.heights.index_select(0, &places).gather(1, &sources, false);
        let channels = CHANNELS as i64;
        let map = Tensor::stack(&[location, levels, heights], 1).reshape([count, channels, n, n]);
        // Beyond the map encodings are 0 and heights 1.
        let reach = i64::from(self.reach);
        let bordered = map.constant_pad_nd([reach; 4]);
        let inside = Tensor::ones([1, 1, n, n], (Kind::Float, self.device));
        let beyond: Tensor = 1.0 - inside.constant_pad_nd([reach; 4]);
        let _ = bordered.narrow(1, channels - 1, 1).g_add_(&beyond);
        let cut = (numbers.get(2).unsqueeze(1) + &self.window_grid)
            .unsqueeze(1)
            .expand([-1, channels, -1], true);
        let window = bordered.flatten(2, 3).gather(2, &cut, false);
        [map, window.reshape([count, channels, side, side])]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::{Measurement, Random, State, drawn_world as world};

    #[test]
    fn states_are_those_of_the_encoder() {
        let maps = ["o..#.\n.#...\n...o.\n##...\n....o", "...#.\n.....\n.#.o.\n....#\no...."];
        let worlds = maps.map(|map| world(map, 2));
        let config = RlConfig { reach_cells: 2, ..RlConfig::default() };
        let encoder = Encoder::new(5, &config);
        let mut on_device = DeviceEncoder::new(&encoder, 2, &config, Device::Cpu);
        worlds.iter().enumerate().for_each(|(place, world)| on_device.put(place, world));
        let mut random = Random::keyed(&[5]);
        let visited: Vec<Vec<Cell>> = (0..40)
            .map(|at| {
                let free = worlds[at % 2].free_cells();
                (0..=random.below(4)).map(|_| free[random.below(free.len())]).collect()
            })
            .collect();
        let references: Vec<Reference<'_>> = visited
            .iter()
            .enumerate()
            .map(|(at, visited)| Reference {
                place: at % 2,
                world: &worlds[at % 2],
                visited,
                symmetry: Symmetry::new(at % Symmetry::COUNT),
            })
            .collect();
        let [maps, windows] = on_device.encode(&references);
        for (at, reference) in references.iter().enumerate() {
            let Reference { world, symmetry, .. } = *reference;
            let measure = |&cell: &Cell| Measurement { cell, rsrp_dbm: world.rsrp_dbm(cell) };
            let measurements: Vec<_> = reference.visited.iter().map(measure).collect();
            let mut map = vec![0.0; encoder.map_len()];
            let mut window = vec![0.0; encoder.window_len()];
            let state = State { world, measurements: &measurements, symmetry };
            encoder.encode(state, &mut map, &mut window);
            for (found, expected) in [(&maps, map), (&windows, window)] {
                let found = Vec::<f32>::try_from(&found.get(at as i64).flatten(0, -1));
                let pairs = found.expect("numbers").into_iter().zip(&expected);
                let difference = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                assert!(difference < 1e-6, "state {at}: {difference}");
            }
        }
    }
}

//! Encodes states for the comparison with NumPy, on one thread.
//!
//! `encode_states DATASET STATES.json OUT`: reads states, measures how many are encoded in a
//! second, and writes the first ones to `OUT.map.npy` and `OUT.window.npy`. It prints the rate.

#![allow(clippy::print_stdout, reason = "an example prints its result")]

use std::time::{Duration, Instant};

use holescout::config::RlConfig;
use holescout::dataset::Dataset;
use holescout::rl::{Cell, Encoder, Measurement, State, World};
use holescout::store::npy_bytes;
use ndarray::Array2;

const LEAST: Duration = Duration::from_secs(2);
const COMPARED: usize = 16;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [dataset, states, out] = &arguments[..] else {
        return Err("usage: encode_states DATASET STATES.json OUT".into());
    };
    let config = RlConfig::default();
    let dataset = Dataset::open(dataset.as_ref())?;
    // (id, [[row, column], ...])
    let states: Vec<(String, Vec<[i32; 2]>)> = serde_json::from_slice(&std::fs::read(states)?)?;
    let mut worlds = Vec::new();
    for (id, visited) in &states {
        let (record, grids) = dataset.record_with_grids(id.parse()?)?;
        let world = World::new(&record, &grids, &config);
        let measured = visited.iter().map(|&[row, column]| {
            let cell = Cell::new(row, column);
            Measurement { cell, rsrp_dbm: world.rsrp_dbm(cell) }
        });
        worlds.push((measured.collect::<Vec<_>>(), world));
    }
    let encoder = Encoder::new(dataset.manifest().cells as usize, &config);
    let (mut map, mut window) = (vec![0.0; encoder.map_len()], vec![0.0; encoder.window_len()]);

    let (mut maps, mut windows) = (Vec::new(), Vec::new());
    for (measurements, world) in worlds.iter().take(COMPARED) {
        encoder.encode(State::new(world, measurements), &mut map, &mut window);
        maps.extend_from_slice(&map);
        windows.extend_from_slice(&window);
    }
    for (name, numbers) in [("map", maps), ("window", windows)] {
        let array = Array2::from_shape_vec((COMPARED, numbers.len() / COMPARED), numbers)?;
        std::fs::write(format!("{out}.{name}.npy"), npy_bytes(&array))?;
    }

    let (start, mut encoded) = (Instant::now(), 0);
    while start.elapsed() < LEAST {
        for (measurements, world) in &worlds {
            encoder.encode(State::new(world, measurements), &mut map, &mut window);
            std::hint::black_box((&map, &window));
        }
        encoded += worlds.len();
    }
    println!("{}", encoded as f64 / start.elapsed().as_secs_f64());
    Ok(())
}

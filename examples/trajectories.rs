//! Episodes of the environment, a line of JSON a step: for each of them the name of the map and the cells that were visited.
//!
//! `trajectories DATASET SPLIT SEED EPISODES STEPS`. Of the permissible actions of episode e at step s, the one of number
//! 31 s + 17 e is taken, counted round. Bindings to other languages are held against it.
#![expect(clippy::print_stdout, reason = "it is a program")]

use std::error::Error;
use std::path::PathBuf;

use holescout::config::RlConfig;
use holescout::dataset::Dataset;
use holescout::rl::{Environment, MapList, load_split};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [dataset, split, seed, episodes, steps] = arguments.as_slice() else {
        return Err("expected DATASET SPLIT SEED EPISODES STEPS".into());
    };
    let (config, dataset) = (RlConfig::default(), Dataset::open(&PathBuf::from(dataset))?);
    let maps = MapList::of(load_split(&dataset, split.parse()?, &config)?)?;
    let mut environment =
        Environment::new(&maps, episodes.parse()?, config.max_steps, seed.parse()?);
    for step in 0..=steps.parse::<usize>()? {
        let states = (0..environment.len()).map(|slot| {
            let (map, path) = environment.state(slot);
            let path: Vec<[i32; 2]> = path.iter().map(|cell| [cell.row, cell.column]).collect();
            (maps.get(map).id().to_string(), path)
        });
        println!("{}", serde_json::to_string(&states.collect::<Vec<_>>())?);
        let action = |slot: usize| {
            let set = environment.permissible(slot);
            set.nth((31 * step + 17 * slot) % set.count()).expect("to stay is permissible")
        };
        let actions: Vec<usize> = (0..environment.len()).map(action).collect();
        environment.step(&maps, &actions);
    }
    Ok(())
}

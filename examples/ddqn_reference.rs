//! Writes a batch with the losses and gradients that the trainer has for it, for the comparison with
//! a reference in `PyTorch`.
//!
//! `ddqn_reference DATASET OUT [paper|factored|other|POLICY]`: makes transitions at random on the train split, two networks
//! with different weights, and writes `OUT/{inputs,policy,target,outputs}.safetensors`.

use std::path::Path;

use holescout::config::{Encoding, Precision, RlConfig, Split, TrainConfig};
use holescout::dataset::Dataset;
use holescout::rl::agent::{Batcher, QNetwork, load_weights, loss};
use holescout::rl::{Environment, MapSource, NStepBuffer, Random, load_split};
use tch::{Device, Kind, Tensor};

const BATCH: usize = 16;
const STEPS: usize = 12;

/// A network with random weights, none of which are 0.
fn network(
    cells: usize,
    rl: &RlConfig,
    train: &TrainConfig,
) -> Result<QNetwork, Box<dyn std::error::Error>> {
    let new = |train: &TrainConfig| QNetwork::new(cells, rl.reach_cells, train, Device::Cpu);
    let mut network = new(train)?;
    if train.factored {
        // V is 0 at first; a dueling network has the same weights.
        let random = TrainConfig { factored: false, dueling: true, ..train.clone() };
        network.soft_update(&new(&random)?, 1.0);
    }
    Ok(network)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [dataset, out, preset @ ..] = &arguments[..] else {
        return Err("usage: ddqn_reference DATASET OUT [paper|factored|other|POLICY]".into());
    };
    let (rl, out) = (RlConfig::default(), Path::new(out));
    let best = TrainConfig::default();
    let (preset, loaded) = match preset {
        [] => (best, None),
        [name] if name == "paper" => (TrainConfig::paper(), None),
        [name] if name == "factored" => (TrainConfig { factored: true, ..best }, None),
        // What neither of the presets uses.
        [name] if name == "other" => {
            let other = TrainConfig {
                n_step: 3,
                dueling: true,
                priority_alpha: 0.6,
                factored: false,
                reward_prediction: 1.0,
                dense_terminal: true,
                avoid_visited: false,
                encoding: Encoding::Paper,
                ..best
            };
            (other, None)
        }
        [path, ..] => {
            let (train, network, _) = load_weights(path.as_ref(), 121, &rl, Device::Cpu)?;
            (train, Some(network))
        }
    };
    let train = TrainConfig { precision: Precision::Float32, ..preset };
    let dataset = Dataset::open(dataset.as_ref())?;
    let pool = MapSource::maps(load_split(&dataset, Split::Train, &rl)?).fill()?;
    let maps = pool.maps();
    let mut environment = Environment::new(maps, BATCH, rl.max_steps, 3);
    let mut random = Random::keyed(&[4]);
    let mut recent = vec![NStepBuffer::default(); BATCH];
    let mut transitions = Vec::new();
    for _ in 0..STEPS {
        let before: Vec<_> = (0..BATCH)
            .map(|slot| {
                let (map, visited) = environment.state(slot);
                (map, visited.to_vec())
            })
            .collect();
        let actions: Vec<usize> = (0..BATCH).map(|_| random.below(961)).collect();
        let outcomes = environment.step(maps, &actions);
        for (slot, ((map, mut path), outcome)) in before.into_iter().zip(outcomes).enumerate() {
            path.push(outcome.next);
            let ends = [outcome.terminal || outcome.truncated, outcome.terminal];
            let (step, most) = ((actions[slot], outcome.reward), train.n_step as usize);
            recent[slot].step((map, &path), step, ends, most, |one| transitions.push(one));
        }
    }
    let transitions = random.sample(&transitions.iter().collect::<Vec<_>>(), BATCH);
    let transitions: Vec<_> = transitions.into_iter().cloned().collect();
    let batcher = Batcher::new(maps, &rl, &train, Device::Cpu);
    let batch = batcher.batch(maps, &transitions, train.augment, &mut random);
    let weights: Vec<f32> = (0..BATCH).map(|_| random.unit() as f32).collect();
    let weights = (train.priority_alpha > 0.0).then(|| Tensor::from_slice(&weights));
    let cells = dataset.manifest().cells as usize;
    let network = |seed| network(cells, &rl, &TrainConfig { seed, ..train.clone() });
    let (mut policy, target) = (network(1)?, network(2)?);
    if let Some(loaded) = loaded {
        policy.soft_update(&loaded, 1.0);
    }
    let parts = loss(&policy, &target, &batch, weights.as_ref(), &train);
    let gradients = Tensor::run_backward(&[&parts.total], policy.leaves(), false, false);

    let none = Tensor::zeros([0], (Kind::Float, Device::Cpu));
    let inputs = [
        ("map", &batch.map),
        ("window", &batch.window),
        ("action", &batch.action),
        ("reward", &batch.reward),
        ("discount", &batch.next.discount),
        ("next_of", &batch.next.of),
        ("next_action", &batch.next.action),
        ("next_map", &batch.next.map),
        ("next_window", &batch.next.window),
        ("next_allowed", &batch.next.allowed),
        ("all_rewards", batch.all.as_ref().map_or(&none, |all| &all.rewards)),
        ("all_terminal", batch.all.as_ref().map_or(&none, |all| &all.terminal)),
        ("all_allowed", batch.all.as_ref().map_or(&none, |all| &all.allowed)),
        ("weights", weights.as_ref().unwrap_or(&none)),
    ];
    Tensor::write_safetensors(&inputs, out.join("inputs.safetensors"))?;
    for (name, network) in [("policy", &policy), ("target", &target)] {
        let weights: Vec<(&str, Tensor)> = network.named().collect();
        Tensor::write_safetensors(&weights, out.join(format!("{name}.safetensors")))?;
    }
    let mut outputs: Vec<(String, Tensor)> =
        policy.named().zip(gradients).map(|((name, _), one)| (name.to_owned(), one)).collect();
    let q_values = policy.forward(&policy.inputs(&batch.map, &batch.window)).q;
    outputs.push(("q_values".into(), q_values.detach().contiguous()));
    outputs.push(("loss".into(), parts.total.detach()));
    let parts = [("q_loss", Some(parts.q)), ("hole_loss", parts.holes)];
    let parts = parts.into_iter().filter_map(|(name, part)| Some((name, part?)));
    outputs.extend(parts.map(|(name, part)| (name.to_owned(), part.detach())));
    Tensor::write_safetensors(&outputs, out.join("outputs.safetensors"))?;
    Ok(())
}

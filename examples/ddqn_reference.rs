//! Writes a batch with the losses and gradients that the trainer has for it, for the comparison with
//! a reference in `PyTorch`.
//!
//! `ddqn_reference DATASET OUT [paper]`: makes transitions at random on the train split, two networks
//! with different weights, and writes `OUT/{inputs,policy,target,outputs}.safetensors`.

use std::path::Path;

use holescout::config::{Precision, RlConfig, Split, TrainConfig};
use holescout::dataset::Dataset;
use holescout::rl::agent::{Batcher, QNetwork, loss};
use holescout::rl::{Environment, Random, Transition, load_split};
use tch::{Device, Tensor};

const BATCH: usize = 16;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [dataset, out, preset @ ..] = &arguments[..] else {
        return Err("usage: ddqn_reference DATASET OUT [paper]".into());
    };
    let (rl, out) = (RlConfig::default(), Path::new(out));
    let preset = if preset.is_empty() { TrainConfig::default() } else { TrainConfig::paper() };
    let train = TrainConfig { precision: Precision::Float32, ..preset };
    let dataset = Dataset::open(dataset.as_ref())?;
    let maps = load_split(&dataset, Split::Train, &rl)?;
    let mut environment = Environment::new(&maps, BATCH, rl.max_steps, 3)?;
    let mut random = Random::keyed(&[4]);
    let mut transitions = Vec::new();
    for _ in 0..4 {
        let before: Vec<_> = (0..BATCH)
            .map(|slot| (environment.map(slot) as u32, environment.state(slot).1.to_vec()))
            .collect();
        let actions: Vec<usize> = (0..BATCH).map(|_| random.below(961)).collect();
        let outcomes = environment.step(&actions);
        transitions.clear();
        for (((map, visited), &action), outcome) in before.into_iter().zip(&actions).zip(outcomes) {
            let (reward, next, terminal) = (outcome.reward, outcome.next, outcome.terminal);
            transitions.push(Transition { map, visited, action, reward, next, terminal });
        }
    }
    let batcher = Batcher::new(environment.maps(), &rl, Device::Cpu);
    let batch = batcher.batch(&transitions, train.augment.then_some(&mut random));
    let network = |seed| {
        let train = TrainConfig { seed, ..train.clone() };
        QNetwork::new(dataset.manifest().cells as usize, rl.reach_cells, &train, Device::Cpu)
    };
    let (policy, target) = (network(1)?, network(2)?);
    let parts = loss(&policy, &target, &batch, &train);
    parts.total.backward();

    let inputs = [
        ("map", &batch.map),
        ("window", &batch.window),
        ("action", &batch.action),
        ("reward", &batch.reward),
        ("terminal", &batch.terminal),
        ("next_map", &batch.next_map),
        ("next_window", &batch.next_window),
        ("next_permissible", &batch.next_permissible),
        ("all_rewards", &batch.all_rewards),
        ("all_terminal", &batch.all_terminal),
    ];
    Tensor::write_safetensors(&inputs, out.join("inputs.safetensors"))?;
    for (name, network) in [("policy", &policy), ("target", &target)] {
        let weights: Vec<(&str, Tensor)> =
            network.named().map(|(name, one)| (name, one.detach())).collect();
        Tensor::write_safetensors(&weights, out.join(format!("{name}.safetensors")))?;
    }
    let mut outputs: Vec<(String, Tensor)> =
        policy.named().map(|(name, one)| (name.to_owned(), one.grad())).collect();
    outputs.push((
        "q_values".into(),
        policy.forward(&batch.map, &batch.window).0.detach().contiguous(),
    ));
    outputs.push(("loss".into(), parts.total.detach()));
    outputs.push(("q_loss".into(), parts.q.detach()));
    Tensor::write_safetensors(&outputs, out.join("outputs.safetensors"))?;
    Ok(())
}

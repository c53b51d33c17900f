//! `cargo bench --features torch --bench train -- DATASET [SECONDS]`: training samples a second, and
//! where the time goes. Alone it prints a table; with SECONDS one line of JSON, for comparisons.

#![allow(clippy::print_stdout, reason = "it is a report")]

use std::sync::Arc;
use std::time::Instant;

use holescout::config::{Loss, RlConfig, Split, TrainConfig};
use holescout::dataset::Dataset;
use holescout::rl::agent::{
    Adam, Batch, Batcher, QNetwork, Trainer, TrainerSetup, keep_freed_memory, loss,
};
use holescout::rl::{Cell, MapPool, MapSource, Random, Transition};
use tch::{Device, Kind, Tensor};

const REPETITIONS: usize = 30;

/// Median seconds of many runs.
fn median(mut run: impl FnMut()) -> f64 {
    let mut seconds: Vec<f64> = (0..REPETITIONS + 3)
        .map(|_| {
            let begin = Instant::now();
            run();
            begin.elapsed().as_secs_f64()
        })
        .skip(3)
        .collect();
    seconds.sort_by(f64::total_cmp);
    seconds[REPETITIONS / 2]
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|one| one != "--bench").collect();
    let [dataset, rest @ ..] = &arguments[..] else {
        return Err("usage: train DATASET [SECONDS]".into());
    };
    let seconds = rest.first().map(|text| text.parse::<f64>()).transpose()?;
    let device = Device::Cpu;
    keep_freed_memory();
    let dataset = Arc::new(Dataset::open(dataset.as_ref())?);
    let rl = RlConfig::default();
    // The exploration of a run's second half; all of it would make acting free. The network is the one that
    // the programs it is compared with have: the paper's with a reward head, among permissible actions.
    let train = TrainConfig {
        start_e: 0.05,
        learning_starts: 1024,
        loss: Loss::Huber,
        max_grad_norm: 10.0,
        squared_reward: 0.0,
        reward_prediction: 1.0,
        dense_terminal: true,
        mask_actions: true,
        augment: true,
        ..TrainConfig::paper()
    };
    let pool = || MapSource::split(&dataset, Split::Train, &rl, 1 << 30, 0).fill();
    let setup = TrainerSetup { dataset_sha256: "", rl: &rl, train: &train, device };
    let mut trainer = Trainer::new(setup, pool()?)?;
    (0..5).try_for_each(|_| trainer.update())?;
    match seconds {
        Some(seconds) => rates(&mut trainer, &train, seconds),
        None => profile(&mut trainer, &pool()?, &rl, &train, device),
    }
}

/// Samples a second of whole updates, and of learning alone.
fn rates(
    trainer: &mut Trainer<'_>,
    train: &TrainConfig,
    seconds: f64,
) -> Result<(), Box<dyn std::error::Error>> {
    let mut rate = |whole: bool| -> Result<f64, Box<dyn std::error::Error>> {
        let (begin, mut updates) = (Instant::now(), 0_u32);
        while begin.elapsed().as_secs_f64() < seconds {
            if whole {
                trainer.update()?;
            } else {
                trainer.learn();
            }
            updates += 1;
        }
        // Waits for a graphics card.
        trainer.report()?;
        Ok(f64::from(updates * train.batch_size) / begin.elapsed().as_secs_f64())
    };
    let (whole, learning) = (rate(true)?, rate(false)?);
    println!("{{\"full_samples_per_s\": {whole:.1}, \"update_samples_per_s\": {learning:.1}}}");
    Ok(())
}

/// Transitions at random, each of one step.
fn transitions(pool: &MapPool, count: u32) -> Vec<Transition> {
    let mut random = Random::keyed(&[9]);
    let transition = |_| {
        let (number, map) = &pool.maps().all()[random.below(pool.maps().len())];
        let free = map.free_cells();
        let mut cell = || free[random.below(free.len())];
        let path: Vec<Cell> = (0..5).map(|_| cell()).collect();
        let (map, action) = (*number, random.below(961));
        Transition { map, path, action, rewards: vec![-0.25], terminal: false }
    };
    (0..count).map(transition).collect()
}

/// The convolutions of the network, on inputs as they come, and nothing else.
struct Convolutions {
    /// Input, weight, stride, whether it is transposed.
    layers: Vec<(Tensor, Tensor, i64, bool)>,
}

impl Convolutions {
    fn new(network: &QNetwork, batch: i64, cells: i64, window: i64) -> Self {
        let kind = network.computing().kind;
        let random = |channels: i64, side: i64| {
            let input = Tensor::rand([batch, side, side, channels], (kind, network.device()));
            if kind == Kind::Float {
                input.permute([0, 3, 1, 2]).contiguous()
            } else {
                input.permute([0, 3, 1, 2])
            }
        };
        let weights = network.leaves().iter().step_by(2);
        let [half, quarter, eighth] = [2, 4, 8].map(|by: i64| (cells + by - 1) / by);
        let sides = [cells, half, quarter, eighth, window, window, window, window];
        let layers = weights.zip(sides).enumerate().map(|(at, (weight, side))| {
            let transposed = at == 3 || at >= 6;
            let channels = weight.size()[usize::from(!transposed)];
            let stride = if at < 4 { 2 } else { 1 };
            (random(channels, side), weight.detach(), stride, transposed)
        });
        Self { layers: layers.collect() }
    }

    /// Forward, and with `learning` backward too, as far as training needs it.
    fn run(&self, learning: bool) {
        for (at, (input, weight, stride, transposed)) in self.layers.iter().enumerate() {
            let of_inputs = learning && at != 0 && at != 4;
            let input = input.detach().set_requires_grad(of_inputs);
            let weight = weight.detach().set_requires_grad(learning);
            let padding = weight.size()[2] / 2;
            let (stride, padding) = ([*stride; 2], [padding; 2]);
            let bias = None::<Tensor>;
            let out = if *transposed {
                input.conv_transpose2d(&weight, bias, stride, padding, [0, 0], 1, [1, 1])
            } else {
                input.conv2d(&weight, bias, stride, padding, [1, 1], 1)
            };
            if learning {
                let total = out.sum(Kind::Float);
                let leaves = if of_inputs { vec![&input, &weight] } else { vec![&weight] };
                let _ = Tensor::run_backward(&[total], &leaves, false, false);
            }
        }
    }
}

fn profile(
    trainer: &mut Trainer<'_>,
    pool: &MapPool,
    rl: &RlConfig,
    train: &TrainConfig,
    device: Device,
) -> Result<(), Box<dyn std::error::Error>> {
    let cells = pool.maps().cells();
    let network = || QNetwork::new(cells, rl.reach_cells, train, device);
    let (mut policy, target) = (network()?, network()?);
    let batcher = Batcher::new(pool.maps(), rl, train, device);
    let transitions = transitions(pool, train.batch_size);
    let mut random = Random::keyed(&[1]);
    let batch: Batch = batcher.batch(pool.maps(), &transitions, true, &mut random);
    let gradients = |policy: &QNetwork| {
        let parts = loss(policy, &target, &batch, None, train);
        Tensor::run_backward(&[&parts.total], policy.leaves(), false, false)
    };
    let mut adam = Adam::new(&policy);
    let some = gradients(&policy);
    let convolutions = Convolutions::new(
        &policy,
        train.batch_size.into(),
        cells as i64,
        i64::from(2 * rl.reach_cells + 1),
    );

    // oneDNN compiles a kernel for every new number of states: most of them come up in a while.
    (0..60).for_each(|_| trainer.update().expect("maps are in memory"));
    let whole = median(|| trainer.update().expect("maps are in memory"));
    let acting = median(|| trainer.act().expect("maps are in memory"));
    let learning = median(|| trainer.learn());
    let encoding = median(|| drop(batcher.batch(pool.maps(), &transitions, true, &mut random)));
    let inputs = policy.inputs(&batch.map, &batch.window);
    let preparing = median(|| drop(policy.inputs(&batch.map, &batch.window)));
    let forward = median(|| drop(policy.best_actions(&inputs, None)));
    let actions = policy.best_actions(&inputs, None);
    let single = median(|| drop(tch::no_grad(|| target.values_of(&inputs, &actions))));
    let losses = median(|| drop(tch::no_grad(|| loss(&policy, &target, &batch, None, train))));
    let backward = median(|| drop(gradients(&policy)));
    let optimiser = median(|| drop(adam.step(&mut policy, &some, 1e-9, 10.0)));
    let convolved = median(|| tch::no_grad(|| convolutions.run(false)));
    let learned = median(|| convolutions.run(true));
    let only_convolutions = 2.0 * convolved + learned;
    // The machine is not equally fast all the time: both in turn.
    let mut shares: Vec<f64> = (0..REPETITIONS)
        .map(|_| {
            let begin = Instant::now();
            trainer.update().expect("maps are in memory");
            let update = begin.elapsed().as_secs_f64();
            let begin = Instant::now();
            (0..2).for_each(|_| tch::no_grad(|| convolutions.run(false)));
            convolutions.run(true);
            1.0 - begin.elapsed().as_secs_f64() / update
        })
        .collect();
    shares.sort_by(f64::total_cmp);
    println!("{:?} on {device:?}, batch {}", policy.computing().kind, train.batch_size);
    let samples = f64::from(train.batch_size);
    for (name, seconds) in [
        ("update with one step of 64 episodes", whole),
        ("  a step of all episodes", acting),
        ("  learning", learning),
        ("    encoding the batch", encoding),
        ("    preparing inputs (twice)", 2.0 * preparing),
        ("    losses, no gradient (2 passes, single values)", losses),
        ("      single values", single),
        ("    losses and gradients", backward),
        ("    Adam", optimiser),
        ("  a pass of 64 states", forward),
        ("    its convolutions alone", convolved),
        ("    those of a pass with gradients", learned),
        ("convolutions of the update (3 passes, 1 of them with gradients)", only_convolutions),
    ] {
        println!("{name:<64} {:>8.2} ms {:>7.0} samples/s", 1e3 * seconds, samples / seconds);
    }
    println!("all but convolutions: {:.1} %", 100.0 * shares[REPETITIONS / 2]);
    Ok(())
}

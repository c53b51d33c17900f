use tch::{Device, Kind, Tensor};

use super::*;
use crate::config::{Channel, Encoding, Precision, RlConfig, TrainConfig};
use crate::rl::StateEncoder;

#[test]
fn actions_are_chosen_among_those_allowed() {
    let q_values = Tensor::from_slice2(&[[1.0_f32, 3.0, 2.0], [5.0, 4.0, 6.0]]);
    let found = |allowed: Option<[[f32; 3]; 2]>| -> Vec<i64> {
        let allowed = allowed.map(|allowed| Tensor::from_slice2(&allowed));
        Vec::try_from(super::network::best(&q_values, allowed.as_ref())).expect("numbers")
    };
    assert_eq!(found(None), [1, 2]);
    assert_eq!(found(Some([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]])), [2, 1]);
}

fn network(config: &TrainConfig) -> QNetwork {
    QNetwork::new(121, 15, config, Device::Cpu).expect("it fits")
}

fn small() -> TrainConfig {
    TrainConfig { widths: [2; 7], precision: Precision::Float32, ..TrainConfig::paper() }
}

fn values(network: &QNetwork) -> Vec<f32> {
    network
        .named()
        .flat_map(|(_, one)| Vec::try_from(one.flatten(0, -1)).expect("numbers"))
        .collect()
}

/// The first steps of Adam move each parameter by the learning rate, against its gradient, however
/// long that is.
#[test]
fn adam_by_hand() {
    let mut network = network(&small());
    let mut adam = Adam::new(&network);
    let before = values(&network);
    let gradients: Vec<Tensor> = network.leaves().iter().map(|leaf| leaf.full_like(-4.0)).collect();
    let norm = adam.step(&mut network, &gradients, 0.1, 0.0).double_value(&[]);
    let expected = 4.0 * (network.size() as f64).sqrt();
    assert!((norm - expected).abs() < 1e-3 * expected, "{norm}");
    let moved = |by: f32| {
        let pairs = before.iter().zip(values(&network));
        pairs.map(|(old, new)| (new - old - by).abs()).fold(0.0, f32::max)
    };
    assert!(moved(0.1) < 1e-5, "{}", moved(0.1));
    let _ = adam.step(&mut network, &gradients, 0.1, 1e-3);
    // Of 4 and almost nothing, with the weights that Adam has for them.
    let (first, second) = (0.9 * 0.4 / 0.19, 0.999 * 0.016 / 0.001_999);
    let by = 0.1 + 0.1 * first / f64::sqrt(second);
    let pairs = before.iter().zip(values(&network));
    let off = pairs.map(|(old, new)| (new - old - by as f32).abs()).fold(0.0, f32::max);
    assert!(off < 1e-4, "{off}");
}

#[test]
fn a_target_network_comes_closer_by_its_share() {
    let (mut target, policy) = (network(&small()), network(&TrainConfig { seed: 1, ..small() }));
    let (before, goal) = (values(&target), values(&policy));
    target.soft_update(&policy, 0.25);
    for ((old, goal), new) in before.iter().zip(&goal).zip(values(&target)) {
        assert!((old + 0.25 * (goal - old) - new).abs() < 1e-6);
    }
    target.soft_update(&policy, 1.0);
    assert_eq!(values(&target), goal);
}

/// A pass computes with what was learned, rounded if it computes with 16 bits.
#[test]
fn leaves_follow_what_is_learned() {
    for precision in [Precision::Float32, Precision::Bfloat16] {
        let config = TrainConfig { precision, ..small() };
        let (mut changed, other) = (network(&config), network(&TrainConfig { seed: 1, ..config }));
        changed.soft_update(&other, 1.0);
        for (leaf, (name, learned)) in changed.leaves().iter().zip(other.named()) {
            assert_eq!(leaf.kind(), changed.computing().kind);
            assert!(leaf.equal(&learned.to_kind(leaf.kind())), "{name}");
        }
    }
}

/// In a dueling network the mean of all Q-values is the value of the state, whatever advantages are.
#[test]
fn advantages_have_no_mean() {
    let config = TrainConfig { dueling: true, ..small() };
    let dueling = network(&config);
    let names: Vec<&str> = dueling.named().map(|(name, _)| name).collect();
    assert_eq!(names[names.len() - 2..], ["value.weight", "value.bias"]);
    let inputs = [121, 31].map(|side| Tensor::rand([2, 3, side, side], (Kind::Float, Device::Cpu)));
    let q_values = |network: &QNetwork| {
        let inputs = network.inputs(&inputs[0], &inputs[1]);
        tch::no_grad(|| network.forward(&inputs).q)
    };
    let (plain, dueling) = (q_values(&network(&small())), q_values(&dueling));
    let centred = |q: &Tensor| q - q.mean_dim(1, true, None);
    let off = (centred(&plain) - centred(&dueling)).abs().max().double_value(&[]);
    assert!(off < 1e-5, "the same advantages: {off}");
    let means = (&plain.mean(Kind::Float) - dueling.mean(Kind::Float)).abs().double_value(&[]);
    assert!(means > 1e-3, "another value: {means}");
}

#[test]
fn networks_have_the_shape_of_the_design_and_seeded_weights() {
    let config = TrainConfig::paper();
    let network = |seed| {
        QNetwork::new(121, 15, &TrainConfig { seed, ..config.clone() }, Device::Cpu)
            .expect("it fits")
    };
    let [a, b, other] = [network(0), network(0), network(1)];
    let expected = 3 * 25 * 32
        + 32
        + 9 * (32 * 64 + 64 * 128 + 128 * 64)
        + 64
        + 128
        + 64
        + 9 * (3 * 32 + 32 * 64)
        + 32
        + 64
        + 9 * (128 * 32 + 32)
        + 32
        + 1;
    assert_eq!(a.size(), expected);
    let first = |network: &QNetwork| values(network)[0];
    assert_eq!(first(&a), first(&b));
    assert_ne!(first(&a), first(&other));
    assert!(QNetwork::new(121, 14, &config, Device::Cpu).is_err());
    let inputs =
        [121, 31].map(|side| Tensor::zeros([2, 3, side, side], (Kind::Float, Device::Cpu)));
    let outputs = a.forward(&a.inputs(&inputs[0], &inputs[1]));
    assert_eq!((outputs.q.size(), outputs.rewards.is_none()), (vec![2, 961], true));
}

/// The part that a Q-value depends on gives that Q-value, at borders and corners too.
#[test]
fn values_of_single_actions_are_those_of_a_whole_pass() {
    let config = TrainConfig { widths: [3, 4, 5, 6, 3, 4, 5], ..small() };
    let kinds = [(Precision::Float32, 1e-6), (Precision::Bfloat16, 2e-2)];
    for ((precision, tolerance), dueling) in
        kinds.into_iter().flat_map(|kind| [(kind, false), (kind, true)])
    {
        let network = network(&TrainConfig { dueling, precision, ..config.clone() });
        let options = (Kind::Float, Device::Cpu);
        let inputs = [121, 31].map(|side| Tensor::rand([31, 3, side, side], options) - 0.5);
        let inputs = network.inputs(&inputs[0], &inputs[1]);
        let all = tch::no_grad(|| network.forward(&inputs).q);
        for row in 0..31 {
            // Another action for each of the 31 states: a row of the square.
            let actions = Tensor::arange(31, (Kind::Int64, Device::Cpu)) + 31 * row;
            let found = tch::no_grad(|| network.values_of(&inputs, &actions));
            let expected = all.gather(1, &actions.unsqueeze(1), false).squeeze_dim(1);
            let off = (found - expected).abs().max().double_value(&[]);
            assert!(off < tolerance, "row {row}: {off}");
        }
    }
}

fn centered(config: &TrainConfig, reach: u32) -> (QNetwork, [Tensor; 2]) {
    let network = QNetwork::new(121, reach, config, Device::Cpu).expect("any size fits");
    let rl = RlConfig { reach_cells: reach, ..RlConfig::default() };
    let shapes = StateEncoder::new(121, &rl, config).shapes();
    let inputs = shapes.map(|[channels, rows, columns]| {
        let shape = [3, channels, rows, columns].map(|side| side as i64);
        Tensor::rand(shape, (Kind::Float, Device::Cpu))
    });
    (network, inputs)
}

/// A value for each move, whatever the reach and whatever is shown.
#[test]
fn centered_networks_take_any_reach_and_channels() {
    let all = TrainConfig { encoding: Encoding::Centered, ..small() };
    let few = TrainConfig { channels: vec![Channel::Visited, Channel::Level], ..all.clone() };
    let auxiliary = TrainConfig { reward_prediction: 1.0, dueling: true, ..all.clone() };
    for (reach, config) in [(15, &all), (4, &all), (1, &few), (7, &few), (14, &auxiliary)] {
        let (network, inputs) = centered(config, reach);
        let outputs = tch::no_grad(|| network.forward(&network.inputs(&inputs[0], &inputs[1])));
        let moves = i64::from((2 * reach + 1).pow(2));
        assert_eq!(outputs.q.size(), [3, moves]);
        assert!(outputs.holes.is_none() && outputs.following.is_none());
        assert_eq!(outputs.rewards.is_some(), config.reward_prediction > 0.0);
    }
}

/// All squares are centred: turning the inputs and all kernels turns the Q-values.
#[test]
fn centered_networks_are_centered() {
    let config = TrainConfig { encoding: Encoding::Centered, ..small() };
    let (mut network, inputs) = centered(&config, 15);
    let pass = |network: &QNetwork, inputs: &[Tensor; 2]| {
        let inputs = network.inputs(&inputs[0], &inputs[1]);
        tch::no_grad(|| network.forward(&inputs).q.view([-1, 31, 31]))
    };
    let straight = pass(&network, &inputs);
    let turn = |of: &Tensor| if of.dim() == 4 { of.rot90(2, [2, 3]) } else { of.copy() };
    let kernels: Vec<Tensor> = network.named().map(|(_, one)| turn(&one)).collect();
    network.set(&kernels);
    let turned = pass(&network, &[turn(&inputs[0]), turn(&inputs[1])]).rot90(2, [1, 2]);
    let off = (straight - turned).abs().max().double_value(&[]);
    assert!(off < 1e-5, "{off}");
}

/// `Q = (1 - P(hole)) (r + γ V)`, whichever way it is computed.
#[test]
fn factored_q_values_by_hand() {
    for encoding in [Encoding::Paper, Encoding::Centered] {
        let config = TrainConfig {
            encoding,
            hole_prediction: 1.0,
            mask_actions: true,
            factored: true,
            ..small()
        };
        let (mut network, inputs) = centered(&config, 15);
        assert!(values(&network).contains(&0.0), "V is 0 at first");
        // A dueling network has the same weights, of which none are 0.
        let random = TrainConfig { factored: false, dueling: true, ..config.clone() };
        network.soft_update(&centered(&random, 15).0, 1.0);
        let inputs = network.inputs(&inputs[0], &inputs[1]);
        let outputs = tch::no_grad(|| network.forward(&inputs));
        let level = outputs.level.expect("it is");
        assert!(level.abs().min().double_value(&[]) > 0.0, "{level:?}");
        let (following, odds) = (outputs.following.expect("it is"), outputs.holes.expect("it is"));
        let chance: Tensor = 1.0 / (1.0 + (-odds).exp());
        let expected = (1.0 - chance) * (0.99 * following - 0.25);
        assert!((&outputs.q - &expected).abs().max().double_value(&[]) < 1e-6);
        let actions = Tensor::from_slice(&[0_i64, 480, 960]);
        let single = tch::no_grad(|| network.values_of(&inputs, &actions));
        let expected = expected.gather(1, &actions.unsqueeze(1), false).squeeze_dim(1);
        assert!((single - expected).abs().max().double_value(&[]) < 1e-6);
    }
}

use tch::{Device, Kind, Tensor};

use super::*;
use crate::config::TrainConfig;

/// `eq:discounted_reward` by hand: two states of three actions.
#[test]
fn targets_by_hand() {
    let reward = Tensor::from_slice(&[-0.25_f32, -1.25]);
    let q_policy = Tensor::from_slice2(&[[1.0_f32, 3.0, 2.0], [5.0, 4.0, 6.0]]);
    let q_target = Tensor::from_slice2(&[[10.0_f32, 20.0, 30.0], [7.0, 8.0, 9.0]]);
    let found = |terminal: [f32; 2], allowed: Option<[[f32; 3]; 2]>| -> Vec<f32> {
        let terminal = Tensor::from_slice(&terminal);
        let allowed = allowed.map(|allowed| Tensor::from_slice2(&allowed));
        let y = target(&reward, &terminal, &q_policy, &q_target, allowed.as_ref(), 0.9);
        Vec::try_from(&y).expect("numbers")
    };
    // The policy chooses (actions 1 and 2), the target values: 20 and 9.
    assert_eq!(found([0.0, 0.0], None), [-0.25 + 0.9 * 20.0, -1.25 + 0.9 * 9.0]);
    assert_eq!(found([0.0, 1.0], None), [-0.25 + 0.9 * 20.0, -1.25]);
    let allowed = [[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]];
    assert_eq!(found([0.0, 0.0], Some(allowed)), [-0.25 + 0.9 * 30.0, -1.25 + 0.9 * 8.0]);
}

/// The first step of Adam moves each parameter by the learning rate, against its gradient.
#[test]
fn adam_by_hand() {
    let mut parameters = [Tensor::from_slice(&[1.0_f32, -2.0]).set_requires_grad(true)];
    let mut adam = Adam::new(&parameters);
    let step = |parameters: &mut [Tensor], adam: &mut Adam| {
        (&parameters[0] * Tensor::from_slice(&[3.0_f32, -4.0])).sum(Kind::Float).backward();
        adam.step(parameters, 0.1, 0.0)
    };
    assert!((step(&mut parameters, &mut adam) - 5.0).abs() < 1e-6, "the norm of (3, -4)");
    let values = Vec::<f32>::try_from(&parameters[0].detach()).expect("numbers");
    assert!((values[0] - 0.9).abs() < 1e-6 && (values[1] + 1.9).abs() < 1e-6, "{values:?}");
    // Constant gradients keep the pace, as they were set to zero in between.
    step(&mut parameters, &mut adam);
    let values = Vec::<f32>::try_from(&parameters[0].detach()).expect("numbers");
    assert!((values[0] - 0.8).abs() < 1e-5 && (values[1] + 1.8).abs() < 1e-5, "{values:?}");
}

#[test]
fn networks_have_the_shape_of_the_design_and_seeded_weights() {
    let config = TrainConfig { reward_prediction: 0.0, ..TrainConfig::default() };
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
    let first = |network: &QNetwork| network.parameters()[0].double_value(&[0, 0, 0, 0]);
    assert_eq!(first(&a), first(&b));
    assert_ne!(first(&a), first(&other));
    assert!(QNetwork::new(121, 14, &config, Device::Cpu).is_err());
    let inputs =
        [121, 31].map(|side| Tensor::zeros([2, 3, side, side], (Kind::Float, Device::Cpu)));
    let (q_values, rewards) = a.forward(&inputs[0], &inputs[1]);
    assert_eq!((q_values.size(), rewards.is_none()), (vec![2, 961], true));
}

//! The Q-network: two inputs, five convolutions, three transposed ones, a Q-value for each action.
//!
//! `I_A` (3 × L × L) goes through convolutions of 5×5, 3×3 and 3×3 with stride 2 and a transposed one
//! of 3×3 with stride 2 (121 → 61 → 31 → 16 → 31); `I_B` (3 × 31 × 31) through two of 3×3. Both are
//! joined and go through two transposed convolutions of 3×3. All but the last end in a
//! rectifier. A second channel of the last layer predicts the rewards of all actions, if there is such
//! a head. In a dueling network (Wang et al., 2016) the first channel holds advantages, and the
//! value of the state is linear in the means of the joined features.

use tch::{Device, Kind, Tensor};

use super::device::{Computing, upload};
use super::layer::{Layer, Part, conv, transposed};
use crate::config::TrainConfig;
use crate::rl::Random;

const WEIGHTS: u64 = 11;

const MAP: [Layer; 4] =
    [conv("map.0", 5, 2), conv("map.1", 3, 2), conv("map.2", 3, 2), transposed("map.3", 2)];
const WINDOW: [Layer; 2] = [conv("window.0", 3, 1), conv("window.1", 3, 1)];
const HEAD: [Layer; 2] = [transposed("head.0", 1), transposed("head.1", 1)];

/// Maps that the network cannot take.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error(
    "the network halves maps of {cells} × {cells} cells to {found} × {found}, but moves of \
     {reach} cells make a window of {window} × {window}: choose rl.reach_cells or the dataset so that \
     both are equal (121 cells and 15)"
)]
pub struct ShapeError {
    /// Cells along a side of a map.
    pub cells: usize,
    /// `rl.reach_cells`.
    pub reach: u32,
    found: i64,
    window: i64,
}

impl crate::error::HasFault for ShapeError {
    fn fault(&self) -> crate::error::Fault {
        crate::error::Fault::Input
    }
}

/// Numbers that all layers make of one state.
pub(super) fn activations(cells: usize, reach: u32, widths: [u32; 7]) -> usize {
    let [map, window, head] = [&MAP[..], &WINDOW, &HEAD];
    let mut widths = widths.into_iter().chain([2]).map(i64::from);
    let mut sides = |layers: &[Layer], first: i64| -> i64 {
        let sides = layers.iter().scan(first, |side, layer| {
            *side = layer.side(*side);
            Some(*side)
        });
        sides.zip(widths.by_ref()).map(|(side, width)| side * side * width).sum()
    };
    let side = 2 * i64::from(reach) + 1;
    (sides(map, cells as i64) + sides(window, side) + sides(head, side)) as usize
}

/// A parameter: its name and shape.
#[derive(Debug, Clone)]
struct Parameter {
    name: String,
    shape: Vec<i64>,
}

impl Parameter {
    fn count(&self) -> i64 {
        self.shape.iter().product()
    }
}

/// `I_A` and `I_B` of a batch of states, in the numbers and the order that a network computes with.
#[derive(Debug)]
pub struct Inputs {
    map: Tensor,
    window: Tensor,
}

/// A Q-network.
///
/// What is learned are `float32` numbers, all parameters in a row; a pass computes with them or
/// with a copy of 16 bits, which is renewed when they change.
#[derive(Debug)]
pub struct QNetwork {
    parameters: Vec<Parameter>,
    learned: Tensor,
    /// The copy, if there is one.
    rounded: Option<Tensor>,
    /// Views of the one or the other, which gradients are of.
    working: Vec<Tensor>,
    computing: Computing,
    has_reward_head: bool,
    is_dueling: bool,
}

/// The parts of a row of numbers, as tensors that share its memory.
fn views(parameters: &[Parameter], row: &Tensor) -> Vec<Tensor> {
    let counts: Vec<i64> = parameters.iter().map(Parameter::count).collect();
    let parts = row.split_with_sizes(&counts[..], 0).into_iter();
    parts.zip(parameters).map(|(part, parameter)| part.view(&parameter.shape[..])).collect()
}

impl QNetwork {
    /// Random weights, as `PyTorch` draws them by default (uniform within ±1/√fan-in), by our own
    /// generator.
    ///
    /// # Errors
    /// If maps of so many cells do not fit the window.
    pub fn new(
        cells: usize,
        reach: u32,
        config: &TrainConfig,
        device: Device,
    ) -> Result<Self, ShapeError> {
        let found = MAP.iter().fold(cells as i64, |side, layer| layer.side(side));
        let window = 2 * i64::from(reach) + 1;
        if found != window {
            return Err(ShapeError { cells, reach, found, window });
        }
        let has_reward_head = config.reward_prediction > 0.0;
        let [a, b, c, d, e, f, g] = config.widths.map(i64::from);
        let outputs = if has_reward_head { 2 } else { 1 };
        let widths = [(3, a), (a, b), (b, c), (c, d), (3, e), (e, f), (d + f, g), (g, outputs)];
        let mut random = Random::keyed(&[config.seed, WEIGHTS]);
        let (mut parameters, mut values) = (Vec::new(), Vec::new());
        let mut pair = |name: &str, weight: &[i64], outputs: i64| {
            // PyTorch takes the second dimension for the fan-in of all kinds of layers.
            let bound = 1.0 / (weight[1..].iter().product::<i64>() as f64).sqrt();
            for (part, shape) in [("weight", weight), ("bias", &[outputs])] {
                let parameter = Parameter { name: format!("{name}.{part}"), shape: shape.to_vec() };
                let uniform = |_| (bound * (2.0 * random.unit() - 1.0)) as f32;
                values.extend((0..parameter.count()).map(uniform));
                parameters.push(parameter);
            }
        };
        for (layer, (from, to)) in MAP.iter().chain(&WINDOW).chain(&HEAD).zip(widths) {
            let [first, second] = if layer.transposed { [from, to] } else { [to, from] };
            pair(layer.name, &[first, second, layer.kernel, layer.kernel], to);
        }
        if config.dueling {
            pair("value", &[1, g], 1);
        }
        let computing = Computing::new(config.precision, device);
        let learned = upload(&values, device);
        Ok(Self::of(parameters, learned, computing, [has_reward_head, config.dueling]))
    }

    fn of(
        parameters: Vec<Parameter>,
        learned: Tensor,
        computing: Computing,
        [has_reward_head, is_dueling]: [bool; 2],
    ) -> Self {
        let rounded = (computing.kind != Kind::Float).then(|| learned.to_kind(computing.kind));
        let working = views(&parameters, rounded.as_ref().unwrap_or(&learned));
        let working =
            working.into_iter().map(|view| view.detach().set_requires_grad(true)).collect();
        Self { parameters, learned, rounded, working, computing, has_reward_head, is_dueling }
    }

    /// The parameters by name, in the order of the layers: `float32`.
    pub fn named(&self) -> impl Iterator<Item = (&str, Tensor)> {
        let names = self.parameters.iter().map(|parameter| &*parameter.name);
        names.zip(views(&self.parameters, &self.learned))
    }

    /// All parameters in a row.
    pub(super) fn learned(&self) -> &Tensor {
        &self.learned
    }

    /// What gradients are of, in the order of [`QNetwork::named`].
    pub fn leaves(&self) -> &[Tensor] {
        &self.working
    }

    /// The device that it computes on.
    #[must_use]
    pub fn device(&self) -> Device {
        self.learned.device()
    }

    /// What it computes with.
    #[must_use]
    pub fn computing(&self) -> Computing {
        self.computing
    }

    /// Number of parameters.
    #[must_use]
    pub fn size(&self) -> usize {
        self.learned.numel()
    }

    /// A copy that does not change with this one.
    #[must_use]
    pub fn duplicate(&self) -> Self {
        let heads = [self.has_reward_head, self.is_dueling];
        Self::of(self.parameters.clone(), self.learned.copy(), self.computing, heads)
    }

    /// Changes what is learned; a pass computes with it from then on.
    pub(super) fn change(&mut self, change: impl FnOnce(&mut Tensor)) {
        tch::no_grad(|| {
            change(&mut self.learned);
            if let Some(rounded) = &mut self.rounded {
                rounded.copy_(&self.learned);
            }
        });
    }

    /// Takes over a share of the weights of a network of the same shape: all of them, or fewer
    /// (Polyak averaging).
    ///
    /// # Panics
    /// If the shapes differ.
    pub fn approach(&mut self, other: &Self, share: f64) {
        self.change(|learned| {
            if share < 1.0 {
                let _ = learned.lerp_(&other.learned, share);
            } else {
                learned.copy_(&other.learned);
            }
        });
    }

    /// Takes over weights in the order of [`QNetwork::named`].
    ///
    /// # Panics
    /// If the shapes differ.
    pub(super) fn set(&mut self, tensors: &[Tensor]) {
        let row: Vec<Tensor> = tensors.iter().map(|tensor| tensor.flatten(0, -1)).collect();
        self.change(|learned| learned.copy_(&Tensor::cat(&row, 0)));
    }

    /// Weights and biases of the layers over the map, over the window, of the head, of the value.
    fn pairs(&self) -> [Vec<[&Tensor; 2]>; 4] {
        let mut pairs = self.working.chunks_exact(2).map(|pair| [&pair[0], &pair[1]]);
        let mut next = |count| pairs.by_ref().take(count).collect();
        [next(MAP.len()), next(WINDOW.len()), next(HEAD.len()), next(1)]
    }

    /// Prepares a batch: `map` is `[batch, 3, L, L]`, `window` `[batch, 3, 2l + 1, 2l + 1]`.
    #[must_use]
    pub fn inputs(&self, map: &Tensor, window: &Tensor) -> Inputs {
        // Convolutions of 16 bits are fast in the order rows, columns, channels.
        let prepare = |input: &Tensor| match self.computing.kind {
            Kind::Float => input.shallow_clone(),
            kind => input.permute([0, 2, 3, 1]).to_kind(kind).contiguous().permute([0, 3, 1, 2]),
        };
        Inputs { map: prepare(map), window: prepare(window) }
    }

    /// Q-values of all actions, `[batch, (2l + 1)²]`, and the predicted rewards if there is a head
    /// for them; `float32`.
    pub fn forward(&self, inputs: &Inputs) -> (Tensor, Option<Tensor>) {
        let [of_map, of_window, of_head, of_value] = &self.pairs();
        let through = |input: &Tensor, layers: &[Layer], parameters: &[[&Tensor; 2]]| {
            let layers = layers.iter().zip(parameters);
            layers.fold(input.shallow_clone(), |input, (layer, &parameters)| {
                layer.apply(&input, parameters).relu_()
            })
        };
        let map = through(&inputs.map, &MAP, of_map);
        let window = through(&inputs.window, &WINDOW, of_window);
        let hidden = through(&Tensor::cat(&[map, window], 1), &HEAD[..1], &of_head[..1]);
        let out = HEAD[1].apply(&hidden, of_head[1]).to_kind(Kind::Float);
        let channel = |at| out.select(1, at).flatten(1, 2);
        let q_values = match of_value[..] {
            [[weight, bias]] => {
                let means = hidden.mean_dim(&[2_i64, 3][..], false, None);
                let value = means.linear(weight, Some(bias)).to_kind(Kind::Float);
                let advantages = channel(0);
                let mean = advantages.mean_dim(1, true, None);
                advantages - mean + value
            }
            _ => channel(0),
        };
        (q_values, self.has_reward_head.then(|| channel(1)))
    }

    /// The Q-value of one action for each state: `actions` and the result are `[batch]`. It depends on
    /// a small part of the inputs, which is all that is computed: a twentieth of a whole pass.
    pub fn values_of(&self, inputs: &Inputs, actions: &Tensor) -> Tensor {
        if self.is_dueling {
            // The value of a state depends on all of it.
            let (q_values, _) = self.forward(inputs);
            return q_values.gather(1, &actions.unsqueeze(1), false).squeeze_dim(1);
        }
        let [of_map, of_window, of_head, _] = &self.pairs();
        let side = inputs.window.size()[3];
        let out = Part::cells(actions, side);
        let hidden = HEAD[1].source(&out);
        let joined = HEAD[0].source(&hidden);
        let map = local(&inputs.map, &MAP, of_map, &joined);
        let window = local(&inputs.window, &WINDOW, of_window, &joined);
        let features = Tensor::cat(&[map, window], 1);
        let features = HEAD[0].apply_to_part(&features, of_head[0], &joined, &hidden).relu_();
        let features = hidden.inside(&features, side);
        let outputs = HEAD[1].apply_to_part(&features, of_head[1], &hidden, &out);
        outputs.select(1, 0).flatten(0, -1).to_kind(Kind::Float)
    }

    /// The first of the allowed actions with the greatest Q-value, for each state: `[batch]`.
    /// Actions where `allowed`, `[batch, actions]`, is 0 are left out.
    pub fn best_actions(&self, inputs: &Inputs, allowed: Option<&Tensor>) -> Tensor {
        tch::no_grad(|| best(&self.forward(inputs).0, allowed))
    }
}

/// A part of what layers make of a batch, computed from what it depends on.
fn local(inputs: &Tensor, layers: &[Layer], parameters: &[[&Tensor; 2]], part: &Part) -> Tensor {
    let [rest @ .., layer] = layers else { return part.cut(inputs) };
    let (rest_parameters, own) = parameters.split_at(rest.len());
    let source = layer.source(part);
    let below = local(inputs, rest, rest_parameters, &source);
    let side = layers.iter().fold(inputs.size()[3], |side, layer| layer.side(side));
    let out = layer.apply_to_part(&below, own[0], &source, part).relu_();
    part.inside(&out, side)
}

/// The actions with the greatest values, of the allowed ones if only some are.
pub(super) fn best(q_values: &Tensor, allowed: Option<&Tensor>) -> Tensor {
    let masked = allowed.map(|allowed| q_values.masked_fill(&allowed.eq(0.0), f64::NEG_INFINITY));
    masked.as_ref().unwrap_or(q_values).argmax(1, false)
}

//! The Q-network: two inputs, a Q-value for each action.
//!
//! Layers and their order are those of `paper` or `centered`, as `train.encoding` tells. The channels of
//! the last layer are: Q-values; predicted rewards, if there is a head for them; the log-odds that each
//! move leads to a hole, if there is one for these. In a dueling network (Wang et al., 2016) the first
//! channel holds advantages, and the value of the state is linear in the means of what the last
//! layer gets. In a factored network it holds V, the value of what follows a move that leads to no
//! hole, and Q = (1 - P(hole)) (r + γ V), with r the reward of a step: that a hole is worth 0 need
//! not be learned, and whether a move leads to one is learned from all moves at once.

use tch::{Device, Kind, Tensor};

use super::device::{Computing, upload};
use super::inputs::{Inputs, ShapeError};
use super::{centered, paper};
use crate::config::{Encoding, TrainConfig};
use crate::rl::{REWARD_STEP, Random};

const WEIGHTS: u64 = 11;

/// Numbers that all layers make of one state.
pub(super) fn activations(cells: usize, reach: u32, config: &TrainConfig) -> usize {
    match config.encoding {
        Encoding::Paper => paper::activations(cells, reach, config.widths),
        Encoding::Centered => centered::activations(reach, config.widths),
    }
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

/// What a network makes of a batch of states, `[batch, (2l + 1)²]` each, `float32`.
#[derive(Debug)]
pub struct Outputs {
    /// Q-values of all actions.
    pub q: Tensor,
    /// V, the value of what follows each move if it leads to no hole, in a factored network.
    pub following: Option<Tensor>,
    /// The part of V that is the same for all moves, `[batch, 1]`, in a factored network.
    pub level: Option<Tensor>,
    /// The predicted rewards, if there is a head for them.
    pub rewards: Option<Tensor>,
    /// The log-odds that each move leads to a hole, if there is a head for them.
    pub holes: Option<Tensor>,
}

/// What the channels of the last layer are.
#[derive(Debug, Clone, Copy)]
struct Heads {
    encoding: Encoding,
    rewards: bool,
    holes: bool,
    dueling: bool,
    /// γ, in a factored network.
    factored: Option<f64>,
}

impl Heads {
    fn new(config: &TrainConfig) -> Self {
        Self {
            encoding: config.encoding,
            rewards: config.reward_prediction > 0.0,
            holes: config.hole_prediction > 0.0,
            dueling: config.dueling,
            factored: config.factored.then_some(config.gamma),
        }
    }

    fn count(self) -> i64 {
        1 + i64::from(self.rewards) + i64::from(self.holes)
    }

    /// The log-odds of holes, of the last layer's channels `[batch, channels, ...]`.
    fn holes(self, channels: &Tensor) -> Option<Tensor> {
        self.holes.then(|| channels.select(1, self.count() - 1))
    }

    /// Whether a part of the values is linear in the means of what the last layer gets.
    fn has_level(self) -> bool {
        self.dueling || self.factored.is_some()
    }
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
    heads: Heads,
}

/// The parts of a row of numbers, as tensors that share its memory.
fn views(parameters: &[Parameter], row: &Tensor) -> Vec<Tensor> {
    let counts: Vec<i64> = parameters.iter().map(Parameter::count).collect();
    let parts = row.split_with_sizes(&counts[..], 0).into_iter();
    parts.zip(parameters).map(|(part, parameter)| part.view(&parameter.shape[..])).collect()
}

impl QNetwork {
    /// Random weights, as `PyTorch` draws them by default (uniform within ±1/√fan-in), by our own
    /// generator; V is 0.
    ///
    /// # Errors
    /// If maps of so many cells do not fit the window.
    pub fn new(
        cells: usize,
        reach: u32,
        config: &TrainConfig,
        device: Device,
    ) -> Result<Self, ShapeError> {
        let heads = Heads::new(config);
        let layers = match config.encoding {
            Encoding::Paper => {
                paper::demand(cells, reach)?;
                paper::layers(config.widths, heads.count())
            }
            Encoding::Centered => centered::layers(config.inputs(), config.widths, heads.count()),
        };
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
        for (layer, from, to) in layers {
            let [first, second] = if layer.transposed { [from, to] } else { [to, from] };
            pair(layer.name, &[first, second, layer.kernel, layer.kernel], to);
        }
        if heads.has_level() {
            pair("value", &[1, config.widths[6].into()], 1);
        }
        if heads.factored.is_some() {
            // V is the same everywhere until something is learned of it: a random one would lead astray.
            let [.., weight, bias, level, last] = &parameters[..] else {
                unreachable!("the last layer and the value have weights and biases")
            };
            let counts = [weight, bias, level, last].map(|one| one.count() as usize);
            let first = values.len() - counts.iter().sum::<usize>();
            let outputs = heads.count() as usize;
            values[first..first + counts[0] / outputs].fill(0.0);
            values[first + counts[0]] = 0.0;
            let of_level = values.len() - counts[2] - counts[3];
            values[of_level..].fill(0.0);
        }
        let computing = Computing::new(config.precision, device);
        let learned = upload(&values, device);
        Ok(Self::of(parameters, learned, computing, heads))
    }

    fn of(parameters: Vec<Parameter>, learned: Tensor, computing: Computing, heads: Heads) -> Self {
        let rounded = (computing.kind != Kind::Float).then(|| learned.to_kind(computing.kind));
        let working = views(&parameters, rounded.as_ref().unwrap_or(&learned));
        let working =
            working.into_iter().map(|view| view.detach().set_requires_grad(true)).collect();
        Self { parameters, learned, rounded, working, computing, heads }
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
        Self::of(self.parameters.clone(), self.learned.copy(), self.computing, self.heads)
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
    pub fn soft_update(&mut self, other: &Self, share: f64) {
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

    /// Whether it predicts P(hole).
    #[must_use]
    pub fn predicts_holes(&self) -> bool {
        self.heads.holes
    }

    /// Weights and biases, in the order of the layers.
    fn pairs(&self) -> Vec<[&Tensor; 2]> {
        self.working.chunks_exact(2).map(|pair| [&pair[0], &pair[1]]).collect()
    }

    /// Prepares a batch: both in the shapes of [`StateEncoder`](crate::rl::StateEncoder).
    #[must_use]
    pub fn inputs(&self, map: &Tensor, window: &Tensor) -> Inputs {
        // Convolutions of 16 bits are fast in the order rows, columns, channels.
        let prepare = |input: &Tensor| match self.computing.kind {
            Kind::Float => input.shallow_clone(),
            kind => input.permute([0, 2, 3, 1]).to_kind(kind).contiguous().permute([0, 3, 1, 2]),
        };
        Inputs { map: prepare(map), window: prepare(window) }
    }

    /// What it makes of a batch.
    #[must_use]
    pub fn forward(&self, inputs: &Inputs) -> Outputs {
        let pairs = self.pairs();
        let [hidden, out] = match self.heads.encoding {
            Encoding::Paper => paper::forward(inputs, &pairs),
            Encoding::Centered => centered::forward(inputs, &pairs),
        };
        let (heads, out) = (self.heads, out.to_kind(Kind::Float).flatten(2, 3));
        let level = heads.has_level().then(|| {
            let [.., [weight, bias]] = &pairs[..] else { unreachable!("it is the last pair") };
            let means = hidden.mean_dim(&[2_i64, 3][..], false, None);
            means.linear(weight, Some(*bias)).to_kind(Kind::Float)
        });
        let (first, holes) = (out.select(1, 0), heads.holes(&out));
        let values = match &level {
            Some(level) if heads.dueling => &first - first.mean_dim(1, true, None) + level,
            Some(level) => first + level,
            None => first,
        };
        let q = match (heads.factored, &holes) {
            (Some(discount), Some(odds)) => {
                (discount * &values + f64::from(REWARD_STEP)) * (-odds).sigmoid()
            }
            _ => values.shallow_clone(),
        };
        let is_factored = heads.factored.is_some();
        Outputs {
            q,
            following: is_factored.then_some(values),
            level: level.filter(|_| is_factored),
            rewards: heads.rewards.then(|| out.select(1, 1)),
            holes,
        }
    }

    /// The Q-value of one action for each state: `actions` and the result are `[batch]`.
    pub fn values_of(&self, inputs: &Inputs, actions: &Tensor) -> Tensor {
        // The value of a state depends on all of it, and so do Q-values in a U-Net.
        if self.heads.has_level() || self.heads.encoding == Encoding::Centered {
            let q_values = self.forward(inputs).q;
            return q_values.gather(1, &actions.unsqueeze(1), false).squeeze_dim(1);
        }
        let outputs = paper::outputs_of(inputs, &self.pairs(), actions);
        outputs.to_kind(Kind::Float).select(1, 0)
    }

    /// The first of the allowed actions with the greatest Q-value, for each state: `[batch]`.
    /// Actions where `allowed`, `[batch, actions]`, is 0 are left out.
    pub fn best_actions(&self, inputs: &Inputs, allowed: Option<&Tensor>) -> Tensor {
        tch::no_grad(|| best(&self.forward(inputs).q, allowed))
    }
}

/// The actions with the greatest values, of the allowed ones if only some are.
pub(super) fn best(q_values: &Tensor, allowed: Option<&Tensor>) -> Tensor {
    let masked = allowed.map(|allowed| q_values.masked_fill(&allowed.eq(0.0), f64::NEG_INFINITY));
    masked.as_ref().unwrap_or(q_values).argmax(1, false)
}

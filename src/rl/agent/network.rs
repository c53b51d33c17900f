//! The Q-network: two inputs, five convolutions, three transposed ones, a Q-value for each action.
//!
//! `I_A` (3 × L × L) goes through convolutions of 5×5, 3×3 and 3×3 with stride 2 and a transposed one
//! of 3×3 with stride 2 (121 → 61 → 31 → 16 → 31); `I_B` (3 × 31 × 31) through two of 3×3. Both are
//! joined and go through two transposed convolutions of 3×3. All but the last end in a
//! rectifier. A second channel of the last layer predicts the rewards of all actions, if there is such
//! a head.

use tch::{Device, Kind, Tensor};

use crate::config::{Precision, TrainConfig};
use crate::rl::Random;

const WEIGHTS: u64 = 11;

/// One layer: name, whether it is transposed, kernel, stride, padding.
struct Layer {
    name: &'static str,
    transposed: bool,
    kernel: i64,
    stride: i64,
    padding: i64,
}

const fn conv(name: &'static str, kernel: i64, stride: i64) -> Layer {
    Layer { name, transposed: false, kernel, stride, padding: kernel / 2 }
}

const fn transposed(name: &'static str, stride: i64) -> Layer {
    Layer { name, transposed: true, kernel: 3, stride, padding: 1 }
}

const MAP: [Layer; 4] =
    [conv("map.0", 5, 2), conv("map.1", 3, 2), conv("map.2", 3, 2), transposed("map.3", 2)];
const WINDOW: [Layer; 2] = [conv("window.0", 3, 1), conv("window.1", 3, 1)];
const HEAD: [Layer; 2] = [transposed("head.0", 1), transposed("head.1", 1)];

impl Layer {
    /// Cells along a side after the layer.
    fn side(&self, side: i64) -> i64 {
        if self.transposed {
            (side - 1) * self.stride - 2 * self.padding + self.kernel
        } else {
            (side + 2 * self.padding - self.kernel) / self.stride + 1
        }
    }

    fn apply(&self, input: &Tensor, [weight, bias]: &[Tensor; 2]) -> Tensor {
        let (stride, padding) = ([self.stride; 2], [self.padding; 2]);
        if self.transposed {
            input.conv_transpose2d(weight, Some(bias), stride, padding, [0, 0], 1, [1, 1])
        } else {
            input.conv2d(weight, Some(bias), stride, padding, [1, 1], 1)
        }
    }
}

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

/// What a network computes with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Computing {
    /// `Float` or `BFloat16`.
    pub kind: Kind,
}

impl Computing {
    /// The kind of numbers that a configuration asks for on this machine.
    #[must_use]
    pub fn new(precision: Precision) -> Self {
        #[cfg(target_arch = "x86_64")]
        let native = std::arch::is_x86_feature_detected!("avx512bf16");
        #[cfg(not(target_arch = "x86_64"))]
        let native = false;
        let kind = match precision {
            Precision::Bfloat16 => Kind::BFloat16,
            Precision::Auto if native => Kind::BFloat16,
            _ => Kind::Float,
        };
        Self { kind }
    }
}

/// A Q-network. Its parameters are `float32`, whatever it computes with.
#[derive(Debug)]
pub struct QNetwork {
    names: Vec<String>,
    parameters: Vec<Tensor>,
    computing: Computing,
    has_reward_head: bool,
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
        let (mut names, mut parameters) = (Vec::new(), Vec::new());
        for (layer, (from, to)) in MAP.iter().chain(&WINDOW).chain(&HEAD).zip(widths) {
            let shape = if layer.transposed { [from, to] } else { [to, from] };
            let shape = [shape[0], shape[1], layer.kernel, layer.kernel];
            // PyTorch takes the second dimension for the fan-in of both kinds of layers.
            let bound = 1.0 / ((shape[1] * layer.kernel * layer.kernel) as f64).sqrt();
            for (part, shape) in [("weight", &shape[..]), ("bias", &[to])] {
                let count = shape.iter().product::<i64>();
                let values: Vec<f32> =
                    (0..count).map(|_| (bound * (2.0 * random.unit() - 1.0)) as f32).collect();
                names.push(format!("{}.{part}", layer.name));
                let values = Tensor::from_slice(&values).reshape(shape).to_device(device);
                parameters.push(values.set_requires_grad(true));
            }
        }
        let computing = Computing::new(config.precision);
        Ok(Self { names, parameters, computing, has_reward_head })
    }

    /// The parameters by name, in the order of the layers.
    pub fn named(&self) -> impl Iterator<Item = (&str, &Tensor)> {
        self.names.iter().map(String::as_str).zip(&self.parameters)
    }

    /// The parameters.
    pub fn parameters(&self) -> &[Tensor] {
        &self.parameters
    }

    pub(super) fn parameters_mut(&mut self) -> &mut [Tensor] {
        &mut self.parameters
    }

    /// Number of parameters.
    #[must_use]
    pub fn size(&self) -> usize {
        self.parameters.iter().map(Tensor::numel).sum()
    }

    /// A copy that does not change with this one.
    #[must_use]
    pub fn duplicate(&self) -> Self {
        Self {
            names: self.names.clone(),
            parameters: self.parameters.iter().map(|one| one.detach().copy()).collect(),
            computing: self.computing,
            has_reward_head: self.has_reward_head,
        }
    }

    /// Takes over the weights of a network of the same shape.
    ///
    /// # Panics
    /// If the shapes differ.
    pub fn copy_from(&mut self, parameters: &[Tensor]) {
        tch::no_grad(|| {
            for (own, other) in self.parameters.iter_mut().zip(parameters) {
                own.copy_(other);
            }
        });
    }

    /// Q-values of all actions, `[batch, (2l + 1)²]`, and the predicted rewards if there is a head
    /// for them. `map` is `[batch, 3, L, L]`, `window` `[batch, 3, 2l + 1, 2l + 1]`.
    pub fn forward(&self, map: &Tensor, window: &Tensor) -> (Tensor, Option<Tensor>) {
        // Convolutions of 16 bits are fast in the order rows, columns, channels.
        let prepared = |input: &Tensor| match self.computing.kind {
            Kind::Float => input.shallow_clone(),
            kind => input.to_kind(kind).permute([0, 2, 3, 1]).contiguous().permute([0, 3, 1, 2]),
        };
        let parameters: Vec<[Tensor; 2]> = self
            .parameters
            .chunks_exact(2)
            .map(|pair| {
                [pair[0].to_kind(self.computing.kind), pair[1].to_kind(self.computing.kind)]
            })
            .collect();
        let (of_map, rest) = parameters.split_at(MAP.len());
        let (of_window, of_head) = rest.split_at(WINDOW.len());
        let through = |input: Tensor, layers: &[Layer], parameters: &[[Tensor; 2]]| {
            let layers = layers.iter().zip(parameters);
            layers.fold(input, |input, (layer, parameters)| layer.apply(&input, parameters).relu())
        };
        let map = through(prepared(map), &MAP, of_map);
        let window = through(prepared(window), &WINDOW, of_window);
        let joined = Tensor::cat(&[map, window], 1);
        let hidden = HEAD[0].apply(&joined, &of_head[0]).relu();
        let out = HEAD[1].apply(&hidden, &of_head[1]).to_kind(Kind::Float).contiguous();
        let channel = |at| out.select(1, at).flatten(1, 2);
        (channel(0), self.has_reward_head.then(|| channel(1)))
    }
}

//! Adam (Kingma and Ba, 2015), whose whole state can be saved.

use tch::{Kind, Tensor};

use super::network::QNetwork;

const BETA_1: f64 = 0.9;
const BETA_2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// The optimiser's state: first and second moments of the gradients, all parameters in a row, and
/// the number of updates.
#[derive(Debug)]
pub struct Adam {
    moments: [Tensor; 2],
    updates: i32,
}

impl Adam {
    /// For a network; all moments are zero.
    #[must_use]
    pub fn new(network: &QNetwork) -> Self {
        let zeros = || network.learned().zeros_like();
        Self { moments: [zeros(), zeros()], updates: 0 }
    }

    /// First and second moments, and the number of updates.
    pub(super) fn state(&self) -> (&[Tensor; 2], i32) {
        (&self.moments, self.updates)
    }

    /// Takes over a state.
    pub(super) fn restore(&mut self, moments: &[Tensor; 2], updates: i32) {
        self.updates = updates;
        self.moments.iter_mut().zip(moments).for_each(|(own, other)| own.copy_(other));
    }

    /// One update by the gradients of a network's [leaves](QNetwork::leaves). Gradients whose norm
    /// over all parameters is above `max_grad_norm` are shortened to it (0 for never). Returns that norm,
    /// a scalar, for which nobody waits.
    pub fn step(
        &mut self,
        network: &mut QNetwork,
        gradients: &[Tensor],
        rate: f64,
        max_grad_norm: f64,
    ) -> Tensor {
        tch::no_grad(|| {
            let row: Vec<Tensor> = gradients.iter().map(|one| one.flatten(0, -1)).collect();
            let mut gradient = Tensor::cat(&row, 0).to_kind(Kind::Float);
            let norm = gradient.norm();
            if max_grad_norm > 0.0 {
                let _ = gradient.g_mul_(&(max_grad_norm / &norm).clamp_max(1.0));
            }
            self.updates += 1;
            let [bias_1, bias_2] = [BETA_1, BETA_2].map(|beta| 1.0 - beta.powi(self.updates));
            let [first, second] = &mut self.moments;
            let _ = first.lerp_(&gradient, 1.0 - BETA_1);
            let _ = second.g_mul_scalar_(BETA_2);
            let _ = second.addcmul_(&gradient, &(&gradient * (1.0 - BETA_2)));
            // rate · (first / bias_1) / (√(second / bias_2) + ε)
            let root = second.sqrt().g_mul_scalar_(1.0 / bias_2.sqrt()).g_add_scalar_(EPSILON);
            let change = (&*first / root).g_mul_scalar_(rate / bias_1);
            network.change(|learned| drop(learned.g_sub_(&change)));
            norm
        })
    }
}

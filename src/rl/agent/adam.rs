//! Adam (Kingma and Ba, 2015), whose whole state can be saved.

use tch::Tensor;

const BETA_1: f64 = 0.9;
const BETA_2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// The optimiser's state: first and second moments of the gradients, and the number of updates.
#[derive(Debug)]
pub struct Adam {
    moments: Vec<[Tensor; 2]>,
    updates: i32,
}

impl Adam {
    /// For some parameters; all moments are zero.
    #[must_use]
    pub fn new(parameters: &[Tensor]) -> Self {
        let zero = |parameter: &Tensor| [parameter.zeros_like(), parameter.zeros_like()];
        Self { moments: parameters.iter().map(|one| zero(&one.detach())).collect(), updates: 0 }
    }

    /// First and second moments, in the order of the parameters, and the number of updates.
    pub fn state(&self) -> (&[[Tensor; 2]], i32) {
        (&self.moments, self.updates)
    }

    /// Takes over a state.
    pub fn restore(&mut self, moments: &[[Tensor; 2]], updates: i32) {
        self.updates = updates;
        for (own, other) in self.moments.iter_mut().zip(moments) {
            own.iter_mut().zip(other).for_each(|(own, other)| own.copy_(other));
        }
    }

    /// One update by the gradients of the parameters, which are zero afterwards. Gradients whose
    /// norm over all parameters is above `clip_norm` are shortened to it (0 for never). Returns
    /// that norm.
    pub fn step(&mut self, parameters: &mut [Tensor], rate: f64, clip_norm: f64) -> f64 {
        tch::no_grad(|| {
            let mut gradients: Vec<Tensor> = parameters.iter().map(Tensor::grad).collect();
            let squares: Vec<Tensor> = gradients.iter().map(|g| g.square().sum(g.kind())).collect();
            let norm = Tensor::stack(&squares, 0).sum(tch::Kind::Double).double_value(&[]).sqrt();
            let scale = if clip_norm > 0.0 && norm > clip_norm { clip_norm / norm } else { 1.0 };
            self.updates += 1;
            let [bias_1, bias_2] = [BETA_1, BETA_2].map(|beta| 1.0 - beta.powi(self.updates));
            for ((parameter, gradient), [first, second]) in
                parameters.iter_mut().zip(&mut gradients).zip(&mut self.moments)
            {
                let scaled = &*gradient * scale;
                let _ = first.g_mul_scalar_(BETA_1).g_add_(&(&scaled * (1.0 - BETA_1)));
                let _ = second.g_mul_scalar_(BETA_2).g_add_(&(scaled.square() * (1.0 - BETA_2)));
                let change = (&*first / bias_1) / ((&*second / bias_2).sqrt() + EPSILON) * rate;
                let _ = parameter.g_sub_(&change);
                let _ = gradient.zero_();
            }
            norm
        })
    }
}

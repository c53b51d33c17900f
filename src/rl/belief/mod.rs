//! Where the base station may stand, given the map of buildings and what was measured.
//!
//! A UAV knows the buildings, but not the base station. For every candidate place the shadows follow from
//! the heights ([`Shadows`]), and a small model of propagation that was fitted on other maps ([`Propagation`])
//! tells which levels to expect there. Each measurement weighs the candidates by Bayes' rule ([`Belief`]); the
//! chance that a cell is a coverage hole is the mean of what the candidates say, by their weights.
//!
//! Levels beside a measured cell are as far off as that one is: residuals of cells near each other are
//! correlated, by a function of their distance that is fitted too.

mod candidates;
mod normal;
mod posterior;
mod propagation;
mod shadows;

pub use candidates::Candidates;
pub use posterior::Belief;
pub use propagation::Propagation;
pub use shadows::Shadows;

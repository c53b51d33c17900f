//! The task: a UAV over a city looks for a coverage hole.
//!
//! Everything of the paper but the network, on records of a dataset: what blocks a move
//! ([`Sight`], equation 3), how a UAV moves and what that is worth ([`Flight`], Algorithm 1 and
//! Equation 13), what a network sees ([`Encoder`], equations 7 and 9), episodes
//! of training ([`Environment`]), where the base station may stand ([`belief`]), methods without a network ([`policy`]) and the exact
//! optimum ([`Hops`]). Nothing here needs libtorch.
//!
//! The paper is M. Rahman, İ. Güvenç, D. Ramirez and C.-W. Wong, *UAV-Assisted Coverage Hole Detection Using
//! Reinforcement Learning in Urban Cellular Networks*. Comments of this project cite its equations by their
//! numbers:
//!
//! | equation | what | where |
//! |---|---|---|
//! | 3 | the permissible set | [`Sight`] |
//! | 7 | the encoded location | [`Encoder`] |
//! | 9 | the encoded measurements | [`Encoder`] |
//! | 11 | the moves of one step | [`Actions`] |
//! | 12 | the predicted location | `agent::Agent` |
//! | 13 | the reward | [`Flight`], [`rewards_into`] |
//! | 14, 15, 16 | the loss of Double DQN, its target, the loss with predicted rewards | `agent::loss` |
//! | 17 | descent of the coverage map (G-RSP, G-BNP) | [`policy::Descent`] |
//! | Algorithm 1 | the flight and its pull-back | [`Flight`] |
//!
//! Positions are rows from the north and columns from the west, in cells; all randomness comes
//! from keyed streams ([`Random`]), so nothing depends on threads.

#[cfg(feature = "torch")]
pub mod agent;
pub mod belief;
mod cell;
mod centered_encoder;
mod distance;
mod encoder;
mod env;
mod flight;
mod maps;
mod oracle;
pub mod policy;
mod pool;
mod priorities;
mod replay;
mod returns;
mod sight;
mod state_encoder;
mod symmetry;
mod world;

pub use crate::random::Random;
pub use cell::{Actions, Cell};
pub use centered_encoder::CenteredEncoder;
pub use distance::{neighbourhood, wall_distances_m};
pub use encoder::{CHANNELS, Encoder, State, normalised_rsrp};
pub use env::{Environment, EpisodeState, Outcome};
pub use flight::{
    Flight, Measurement, REWARD_BLOCKED, REWARD_HOLE, REWARD_STEP, Step, rewards_into,
};
pub use maps::{MapKey, MapList, NothingToLearn};
pub use oracle::Hops;
pub use pool::{MapPool, MapSource, PoolError, PoolState, load_maps, load_sample, load_split};
pub use replay::{MAX_STEPS, ReplayBuffer, Sample, Transition};
pub use returns::NStepBuffer;
pub use sight::{ActionSet, Sight};
pub use state_encoder::StateEncoder;
pub use symmetry::Symmetry;
pub use world::World;
pub(crate) use world::neighbours;
#[cfg(test)]
pub(crate) use world::tests::world as drawn_world;

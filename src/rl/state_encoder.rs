//! What a network is shown of a state, in either of the encodings.

use rayon::prelude::*;

use super::cell::Actions;
use super::centered_encoder::CenteredEncoder;
use super::encoder::{CHANNELS, Encoder, State};
use crate::config::{Encoding, RlConfig, TrainConfig};

/// The encoder that a network is trained with.
#[derive(Debug)]
pub enum StateEncoder {
    /// `I_A` and `I_B` as published.
    Paper(Encoder),
    /// Centred on the UAV.
    Centered(CenteredEncoder),
}

impl StateEncoder {
    /// For maps of `cells` × `cells`.
    #[must_use]
    pub fn new(cells: usize, rl: &RlConfig, train: &TrainConfig) -> Self {
        match train.encoding {
            Encoding::Paper => Self::Paper(Encoder::new(cells, rl)),
            Encoding::Centered => Self::Centered(CenteredEncoder::new(cells, rl, &train.channels)),
        }
    }

    /// The moves.
    #[must_use]
    pub fn actions(&self) -> Actions {
        match self {
            Self::Paper(encoder) => encoder.actions(),
            Self::Centered(encoder) => encoder.actions(),
        }
    }

    /// `[channels, rows, columns]` of the map and of the window.
    #[must_use]
    pub fn shapes(&self) -> [[usize; 3]; 2] {
        match self {
            Self::Paper(encoder) => {
                [encoder.cells(), encoder.actions().side()].map(|side| [CHANNELS, side, side])
            }
            Self::Centered(encoder) => encoder.shapes(),
        }
    }

    /// Writes map and window of many states, one after the other, in parallel.
    ///
    /// # Panics
    /// If a map has another size, or a buffer another length.
    pub fn encode_batch(&self, states: &[State<'_>], maps: &mut [f32], windows: &mut [f32]) {
        let encoder = match self {
            Self::Paper(encoder) => return encoder.encode_batch(states, maps, windows),
            Self::Centered(encoder) => encoder,
        };
        let [map, window] = self.shapes().map(|shape| shape.iter().product::<usize>());
        assert_eq!([maps.len(), windows.len()], [map, window].map(|one| states.len() * one));
        let buffers = maps.par_chunks_exact_mut(map).zip(windows.par_chunks_exact_mut(window));
        states.par_iter().zip(buffers).for_each(|(state, (map, window))| {
            encoder.encode(*state, map, window);
        });
    }
}

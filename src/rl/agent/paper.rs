//! The network's shape with the paper's encoding: five convolutions, three transposed ones.
//!
//! `I_A` (3 × L × L) goes through convolutions of 5×5, 3×3 and 3×3 with stride 2 and a transposed one
//! of 3×3 with stride 2 (121 → 61 → 31 → 16 → 31); `I_B` (3 × 31 × 31) through two of 3×3. Both are
//! joined and go through two transposed convolutions of 3×3. All but the last end in a rectifier.

use tch::Tensor;

use super::inputs::{Inputs, ShapeError};
use super::layer::{Layer, Rectangle, conv, transposed};

const MAP: [Layer; 4] =
    [conv("map.0", 5, 2), conv("map.1", 3, 2), conv("map.2", 3, 2), transposed("map.3", 2)];
const WINDOW: [Layer; 2] = [conv("window.0", 3, 1), conv("window.1", 3, 1)];
const HEAD: [Layer; 2] = [transposed("head.0", 1), transposed("head.1", 1)];

/// The layers in the order of their parameters, each with its channels in and out.
pub(super) fn layers(widths: [u32; 7], outputs: i64) -> Vec<(Layer, i64, i64)> {
    let [a, b, c, d, e, f, g] = widths.map(i64::from);
    let widths = [(3, a), (a, b), (b, c), (c, d), (3, e), (e, f), (d + f, g), (g, outputs)];
    let layers = MAP.into_iter().chain(WINDOW).chain(HEAD).zip(widths);
    layers.map(|(layer, (from, to))| (layer, from, to)).collect()
}

/// Demands that the halved map fits the window.
pub(super) fn demand(cells: usize, reach: u32) -> Result<(), ShapeError> {
    let found = MAP.iter().fold(cells as i64, |side, layer| layer.side(side));
    let window = 2 * i64::from(reach) + 1;
    if found == window { Ok(()) } else { Err(ShapeError { cells, reach, found, window }) }
}

/// Numbers that all layers make of one state.
pub(super) fn activations(cells: usize, reach: u32, widths: [u32; 7]) -> usize {
    let mut widths = widths.into_iter().chain([3]).map(i64::from);
    let mut sides = |layers: &[Layer], first: i64| -> i64 {
        let sides = layers.iter().scan(first, |side, layer| {
            *side = layer.side(*side);
            Some(*side)
        });
        sides.zip(widths.by_ref()).map(|(side, width)| side * side * width).sum()
    };
    let side = 2 * i64::from(reach) + 1;
    (sides(&MAP, cells as i64) + sides(&WINDOW, side) + sides(&HEAD, side)) as usize
}

/// What the last layer gets, and what it makes of that: `[batch, channels, 2l + 1, 2l + 1]`.
pub(super) fn forward(inputs: &Inputs, parameters: &[[&Tensor; 2]]) -> [Tensor; 2] {
    let (of_map, rest) = parameters.split_at(MAP.len());
    let (of_window, of_head) = rest.split_at(WINDOW.len());
    let through = |input: &Tensor, layers: &[Layer], parameters: &[[&Tensor; 2]]| {
        let layers = layers.iter().zip(parameters);
        layers.fold(input.shallow_clone(), |input, (layer, &parameters)| {
            layer.apply(&input, parameters).relu_()
        })
    };
    let map = through(&inputs.map, &MAP, of_map);
    let window = through(&inputs.window, &WINDOW, of_window);
    let hidden = through(&Tensor::cat(&[map, window], 1), &HEAD[..1], &of_head[..1]);
    let out = HEAD[1].apply(&hidden, of_head[1]);
    [hidden, out]
}

/// The outputs for one action of each state, `[batch, channels]`; `actions` is `[batch]`. They
/// depend on a small part of the inputs, which is all that is computed: a twentieth of a whole pass.
pub(super) fn outputs_of(inputs: &Inputs, parameters: &[[&Tensor; 2]], actions: &Tensor) -> Tensor {
    let (of_map, rest) = parameters.split_at(MAP.len());
    let (of_window, of_head) = rest.split_at(WINDOW.len());
    let side = inputs.window.size()[3];
    let out = Rectangle::cells(actions, side);
    let hidden = HEAD[1].source(&out);
    let joined = HEAD[0].source(&hidden);
    let map = local(&inputs.map, &MAP, of_map, &joined);
    let window = local(&inputs.window, &WINDOW, of_window, &joined);
    let features = Tensor::cat(&[map, window], 1);
    let features = HEAD[0].apply_to_part(&features, of_head[0], &joined, &hidden).relu_();
    let features = hidden.inside(&features, side);
    HEAD[1].apply_to_part(&features, of_head[1], &hidden, &out).flatten(1, -1)
}

/// A part of what layers make of a batch, computed from what it depends on.
fn local(
    inputs: &Tensor,
    layers: &[Layer],
    parameters: &[[&Tensor; 2]],
    part: &Rectangle,
) -> Tensor {
    let [rest @ .., layer] = layers else { return part.cut(inputs) };
    let (rest_parameters, own) = parameters.split_at(rest.len());
    let source = layer.source(part);
    let below = local(inputs, rest, rest_parameters, &source);
    let side = layers.iter().fold(inputs.size()[3], |side, layer| layer.side(side));
    let out = layer.apply_to_part(&below, own[0], &source, part).relu_();
    part.inside(&out, side)
}

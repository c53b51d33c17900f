//! The network's shape with the centred encoding: a small U-Net (Ronneberger et al., 2015), all of whose
//! squares are centred on the UAV.
//!
//! The whole map (49 × 49 blocks) goes through three convolutions with stride 2 and one that sees all
//! that is left, to one number a channel. The window goes through convolutions at full, half and
//! quarter resolution; there those numbers are added in every cell. Two transposed convolutions lead back,
//! each joined with what the same resolution had before, and cut to what moves need as soon as
//! that is possible. All but the last layer end in a rectifier. The shape depends on the reach alone:
//! weights fit maps of any size. A window has l + 15 cells beside the UAV's, so its half
//! resolution has l + 16 along a side, of which the l + 2 in the middle lie within reach.

use tch::Tensor;

use super::inputs::Inputs;
use super::layer::{Layer, conv, transposed, valid};

const MAP: [Layer; 4] =
    [conv("map.0", 3, 2), conv("map.1", 3, 2), conv("map.2", 3, 2), valid("map.3", 7)];
const FULL: Layer = conv("window.0", 3, 1);
const HALF: [Layer; 2] = [conv("window.1", 3, 2), conv("window.2", 3, 1)];
const QUARTER: [Layer; 2] = [conv("window.3", 3, 2), conv("window.4", 3, 1)];
const UP: [Layer; 3] = [transposed("up.0", 2), conv("up.1", 3, 1), transposed("up.2", 2)];
const HEAD: [Layer; 2] = [conv("head.0", 3, 1), conv("head.1", 3, 1)];
const CONTEXT: i64 = crate::rl::centered_encoder::CONTEXT as i64;
const BLOCKS: i64 = crate::rl::centered_encoder::BLOCKS as i64;

/// The layers in the order of their parameters, each with its channels in and out.
pub(super) fn layers(
    [coarse, fine]: [usize; 2],
    widths: [u32; 7],
    outputs: i64,
) -> Vec<(Layer, i64, i64)> {
    let [a, b, c, full, half, quarter, head] = widths.map(i64::from);
    let (coarse, fine) = (coarse as i64, fine as i64);
    let of_map = [(coarse, a), (a, b), (b, c), (c, quarter)];
    let down = [(fine, full), (full, half), (half, half), (half, quarter), (quarter, quarter)];
    let up = [(quarter, half), (2 * half, half), (half, full)];
    let of_head = [(2 * full, head), (head, outputs)];
    let layers = MAP.into_iter().chain([FULL]).chain(HALF).chain(QUARTER).chain(UP).chain(HEAD);
    let widths = of_map.into_iter().chain(down).chain(up).chain(of_head);
    layers.zip(widths).map(|(layer, (from, to))| (layer, from, to)).collect()
}

/// Numbers that all layers make of one state, at most.
pub(super) fn activations(reach: u32, widths: [u32; 7]) -> usize {
    let [a, b, c, full, half, quarter, head] = widths.map(i64::from);
    let side = 2 * (i64::from(reach) + CONTEXT) + 1;
    let halved = |side: i64| HALF[0].side(side);
    let blocks = [halved(BLOCKS), halved(halved(BLOCKS)), halved(halved(halved(BLOCKS)))];
    let [window, second, fourth] = [side, halved(side), halved(halved(side))];
    let all = [
        (blocks[0], a),
        (blocks[1], b),
        (blocks[2], c),
        (window, 3 * full + head + 3),
        (second, 5 * half),
        (fourth, 3 * quarter),
    ];
    all.into_iter().map(|(side, width)| side * side * width).sum::<i64>() as usize
}

/// The square of `side` cells in the middle.
fn middle(of: &Tensor, side: i64) -> Tensor {
    let first = (of.size()[3] - side) / 2;
    of.narrow(2, first, side).narrow(3, first, side)
}

/// What the last layer gets, and what it makes of that: `[batch, channels, 2l + 1, 2l + 1]`.
pub(super) fn forward(inputs: &Inputs, parameters: &[[&Tensor; 2]]) -> [Tensor; 2] {
    let (of_map, rest) = parameters.split_at(MAP.len());
    let [full, half_in, half, quarter_in, quarter, up, join, out, head, last, ..] = rest else {
        unreachable!("the parameters are those of `layers`")
    };
    let layers = MAP.iter().zip(of_map);
    let map = layers.fold(inputs.map.shallow_clone(), |map, (layer, &parameters)| {
        layer.apply(&map, parameters).relu_()
    });
    let fine = FULL.apply(&inputs.window, *full).relu_();
    let second = HALF[0].apply(&fine, *half_in).relu_();
    let second = HALF[1].apply(&second, *half).relu_();
    let fourth = (QUARTER[0].apply(&second, *quarter_in) + map).relu_();
    let fourth = QUARTER[1].apply(&fourth, *quarter).relu_();
    let (window, side) = (inputs.window.size()[3], second.size()[3]);
    let moves = window - 2 * CONTEXT;
    let within = moves / 2 + 2;
    let raised = UP[0].apply_to_side(&fourth, *up, side).relu_();
    // One cell more for the convolution, whose padding must not be seen.
    let joined = Tensor::cat(&[middle(&raised, within + 2), middle(&second, within + 2)], 1);
    let joined = middle(&UP[1].apply(&joined, *join).relu_(), within);
    let raised = UP[2].apply(&joined, *out).relu_();
    let joined = Tensor::cat(&[middle(&raised, moves), middle(&fine, moves)], 1);
    let hidden = HEAD[0].apply(&joined, *head).relu_();
    let out = HEAD[1].apply(&hidden, *last);
    [hidden, out]
}

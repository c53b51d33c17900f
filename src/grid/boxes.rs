//! Which of many boxes meet a given one.

use std::collections::HashMap;

use geo::Rect;

use super::tile_id::TileId;

/// Boxes sorted into square blocks. With blocks wider than most boxes, most lie in one: about
/// 4 bytes each, besides the boxes themselves.
#[derive(Debug)]
pub struct BoxIndex {
    boxes: Vec<Rect<f64>>,
    blocks: HashMap<[i64; 2], Vec<u32>>,
    block_m: f64,
}

impl BoxIndex {
    /// Sorts boxes into blocks of a side in metres.
    #[must_use]
    pub fn new(boxes: Vec<Rect<f64>>, block_m: f64) -> Self {
        let mut blocks: HashMap<[i64; 2], Vec<u32>> = HashMap::new();
        for (index, bounds) in boxes.iter().enumerate() {
            for block in blocks_of(bounds, block_m) {
                blocks.entry(block).or_default().push(index as u32);
            }
        }
        Self { boxes, blocks, block_m }
    }

    /// All boxes, in the order given.
    #[must_use]
    pub fn boxes(&self) -> &[Rect<f64>] {
        &self.boxes
    }

    /// Indices of the boxes that share at least a point with one, ascending.
    #[must_use]
    pub fn meeting(&self, bounds: &Rect<f64>) -> Vec<usize> {
        let mut indices: Vec<usize> = blocks_of(bounds, self.block_m)
            .filter_map(|block| self.blocks.get(&block))
            .flatten()
            .map(|&index| index as usize)
            .filter(|&index| meet(&self.boxes[index], bounds))
            .collect();
        indices.sort_unstable();
        indices.dedup();
        indices
    }
}

fn blocks_of(bounds: &Rect<f64>, side: f64) -> impl Iterator<Item = [i64; 2]> + use<> {
    let block = |coordinate: f64| (coordinate / side).floor() as i64;
    let rows = block(bounds.min().y)..=block(bounds.max().y);
    let columns = block(bounds.min().x)..=block(bounds.max().x);
    columns.flat_map(move |column| rows.clone().map(move |row| [column, row]))
}

fn meet(a: &Rect<f64>, b: &Rect<f64>) -> bool {
    a.min().x <= b.max().x
        && b.min().x <= a.max().x
        && a.min().y <= b.max().y
        && b.min().y <= a.max().y
}

impl TileId {
    /// The square of a side around the centre, in metres of the projection.
    #[must_use]
    pub fn square(self, side_m: f64) -> Rect<f64> {
        let half = side_m / 2.0;
        let [x, y] = self.center();
        Rect::new([x - half, y - half], [x + half, y + half])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Against a look at every box; borders count, and boxes may span many blocks.
        #[test]
        fn finds_what_a_look_at_every_box_finds(
            corners in prop::collection::vec((-50_i32..50, -50_i32..50, 0_i32..40, 0_i32..40), 1..40),
        ) {
            let boxes: Vec<Rect<f64>> = corners
                .into_iter()
                .map(|(x, y, width, height)| {
                    let corner = [f64::from(x), f64::from(y)];
                    Rect::new(corner, [corner[0] + f64::from(width), corner[1] + f64::from(height)])
                })
                .collect();
            let index = BoxIndex::new(boxes.clone(), 10.0);
            for one in &boxes {
                let wanted: Vec<usize> =
                    (0..boxes.len()).filter(|&other| meet(&boxes[other], one)).collect();
                prop_assert_eq!(index.meeting(one), wanted);
            }
        }
    }
}

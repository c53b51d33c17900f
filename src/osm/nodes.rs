//! Coordinates of the nodes that kept buildings use, and of no others.
//!
//! Memory: 8 bytes for the id and 8 for the place of each node in use.

use std::collections::HashMap;

use rayon::prelude::*;

use super::block::BlockView;

/// A place that no node has: latitudes end at 90°, far below 214°.
const UNKNOWN: [i32; 2] = [i32::MAX, i32::MAX];
/// Degrees in a unit of OSM coordinates.
const DEGREES_PER_UNIT: f64 = 1e-7;

/// Wanted nodes, sorted by id, with their places once known.
pub(super) struct NodeTable {
    ids: Vec<i64>,
    places: Vec<[i32; 2]>,
}

impl NodeTable {
    /// A table of nodes whose places are yet unknown.
    pub(super) fn new(mut ids: Vec<i64>) -> Self {
        ids.par_sort_unstable();
        ids.dedup();
        ids.shrink_to_fit();
        let places = vec![UNKNOWN; ids.len()];
        Self { ids, places }
    }

    /// The wanted nodes of a block, by their index in the table.
    pub(super) fn find(&self, block: &BlockView<'_>) -> Vec<(u32, [i32; 2])> {
        let mut found = Vec::new();
        // Extracts are sorted by id, so one walk through both lists finds everything; a step
        // back, which the format allows, costs a binary search.
        let (mut cursor, mut previous) = (usize::MAX, i64::MAX);
        for (id, place) in block.places() {
            if id < previous {
                cursor = self.ids.partition_point(|&wanted| wanted < id);
            }
            previous = id;
            while self.ids.get(cursor).is_some_and(|&wanted| wanted < id) {
                cursor += 1;
            }
            if self.ids.get(cursor) == Some(&id) {
                found.push((cursor as u32, place));
            }
        }
        found
    }

    /// Enters places; the first that is known of a node stays.
    pub(super) fn enter(&mut self, found: Vec<(u32, [i32; 2])>) {
        for (index, place) in found {
            self.set(index as usize, place);
        }
    }

    fn set(&mut self, index: usize, place: [i32; 2]) {
        if self.places[index] == UNKNOWN {
            self.places[index] = place;
        }
    }

    /// The same for places that a file keeps with its ways.
    pub(super) fn enter_places(&mut self, ids: &[i64], places: &[[i32; 2]]) {
        for (id, &place) in ids.iter().zip(places) {
            if let Ok(index) = self.ids.binary_search(id) {
                self.set(index, place);
            }
        }
    }

    /// A node that one file places twice, differently: it holds several versions. `found` is what
    /// the blocks of the file hold.
    pub(super) fn contradiction(&self, found: &[Vec<(u32, [i32; 2])>]) -> Option<i64> {
        let mut last = None;
        let mut is_mixed = false;
        for &(index, place) in found.iter().flatten() {
            match last {
                Some((before, there)) if before == index && there != place => {
                    return Some(self.ids[index as usize]);
                }
                Some((before, _)) => is_mixed |= index < before,
                None => {}
            }
            last = Some((index, place));
        }
        if !is_mixed {
            return None;
        }
        let mut places = HashMap::new();
        let mut found = found.iter().flatten();
        let other = found.find(|(index, place)| *places.entry(*index).or_insert(*place) != *place);
        other.map(|&(index, _)| self.ids[index as usize])
    }

    /// Whether the places of all these nodes are known.
    pub(super) fn has_all(&self, ids: &[i64]) -> bool {
        self.places(ids).all(|place| place.is_some())
    }

    /// Longitude and latitude of nodes, in degrees, each if the extract has it.
    ///
    /// Ids of a way's nodes mostly follow each other, so the entry after the last one is
    /// tried before a search through the table.
    pub(super) fn places(&self, ids: &[i64]) -> impl Iterator<Item = Option<[f64; 2]>> {
        let mut next = 0;
        ids.iter().map(move |id| {
            let index = match self.ids.get(next) {
                Some(candidate) if candidate == id => next,
                _ => self.ids.binary_search(id).ok()?,
            };
            next = index + 1;
            let place = self.places[index];
            (place != UNKNOWN).then(|| degrees(place))
        })
    }
}

fn degrees(place: [i32; 2]) -> [f64; 2] {
    place.map(|units| f64::from(units) * DEGREES_PER_UNIT)
}

//! The buildings of an extract as one: their groups, and the prisms that follow.

use geo::Rect;
use rayon::prelude::*;

use super::Building;
use super::groups::{Grouped, Named};
use super::prism::{Prism, prisms_of};
use crate::config::BuildingsConfig;

/// Buildings whose prisms are made at a time.
const CHUNK: usize = 1024;

/// All buildings of an extract.
#[derive(Debug)]
pub struct City {
    grouped: Grouped,
    prisms: Vec<Prism>,
    /// Where each building's prisms begin; one more for the end.
    first_prism: Vec<u32>,
}

impl City {
    /// Groups buildings whose footprints are in metres of one projection.
    ///
    /// A part belongs to the outlines that hold at least half of it, to the one that holds most of
    /// it, and to those that a relation names. What it does not tell of its height it inherits
    /// from them: first from those that a relation names, then from the smallest.
    ///
    /// # Panics
    /// If a footprint has no ring at all.
    #[must_use]
    pub fn new(buildings: Vec<Building>, named: &[Named], config: &BuildingsConfig) -> Self {
        let grouped = Grouped::new(buildings, named, config);
        let prisms: Vec<(Vec<Prism>, Vec<u32>)> = grouped
            .buildings()
            .par_chunks(CHUNK)
            .enumerate()
            .map(|(index, chunk)| {
                let (mut prisms, mut ends) = (Vec::with_capacity(chunk.len()), Vec::new());
                for at in 0..chunk.len() {
                    prisms_of(&grouped, index * CHUNK + at, &mut prisms);
                    ends.push(prisms.len() as u32);
                }
                (prisms, ends)
            })
            .collect();
        let mut city = Self { grouped, prisms: Vec::new(), first_prism: vec![0] };
        for (of_chunk, ends) in prisms {
            let before = city.prisms.len() as u32;
            city.prisms.extend(of_chunk);
            city.first_prism.extend(ends.into_iter().map(|end| before + end));
        }
        city
    }

    /// The buildings, in the order given.
    #[must_use]
    pub fn buildings(&self) -> &[Building] {
        self.grouped.buildings()
    }

    /// Bounding boxes of the footprints, in the order of the buildings.
    #[must_use]
    pub fn boxes(&self) -> &[Rect<f64>] {
        self.grouped.boxes()
    }

    /// Indices of the buildings whose bounding boxes meet a box, ascending.
    #[must_use]
    pub fn meeting(&self, bounds: &Rect<f64>) -> Vec<usize> {
        self.grouped.meeting(bounds)
    }

    /// The outlines that a part belongs to.
    #[must_use]
    pub fn outlines_of(&self, part: usize) -> &[u32] {
        self.grouped.outlines_of(part)
    }

    /// What a building is made of.
    #[must_use]
    pub fn prisms_of(&self, building: usize) -> &[Prism] {
        let [first, end] = [building, building + 1].map(|at| self.first_prism[at] as usize);
        &self.prisms[first..end]
    }
}

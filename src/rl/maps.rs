//! The maps that are trained on, in one list: environment, replay buffer and batches all refer to a map
//! by its key.

use std::collections::HashMap;
use std::sync::Arc;

use super::world::World;

/// Names a map: its position among the records of the split.
pub type MapKey = u32;

/// There is nowhere to begin.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("none of {maps} maps has both a coverage hole and a covered free cell: nothing to learn")]
pub struct NothingToLearn {
    /// Number of maps.
    pub maps: usize,
}

impl crate::error::HasFault for NothingToLearn {
    fn fault(&self) -> crate::error::Fault {
        crate::error::Fault::Input
    }
}

/// Maps that [can teach](World::can_teach) something, at least one.
#[derive(Debug, Clone)]
pub struct MapList {
    maps: Vec<(MapKey, Arc<World>)>,
    places: HashMap<MapKey, usize>,
}

impl MapList {
    /// Those of the maps that can teach something.
    ///
    /// # Errors
    /// If none can.
    ///
    /// # Panics
    /// If two maps have one key.
    pub fn new(mut maps: Vec<(MapKey, Arc<World>)>) -> Result<Self, NothingToLearn> {
        let all = maps.len();
        maps.retain(|(_, map)| map.can_teach());
        if maps.is_empty() {
            return Err(NothingToLearn { maps: all });
        }
        let places: HashMap<MapKey, usize> =
            maps.iter().enumerate().map(|(place, &(key, _))| (key, place)).collect();
        assert_eq!(places.len(), maps.len(), "each map has a key of its own");
        Ok(Self { maps, places })
    }

    /// The same of maps whose keys are their positions.
    ///
    /// # Errors
    /// If none can teach something.
    pub fn of(maps: Vec<Arc<World>>) -> Result<Self, NothingToLearn> {
        Self::new((0..).zip(maps).collect())
    }

    /// Number of maps.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "there is at least one")]
    pub fn len(&self) -> usize {
        self.maps.len()
    }

    /// Cells along a side of each map.
    #[must_use]
    pub fn cells(&self) -> usize {
        self.maps[0].1.cells()
    }

    /// All maps, in the order of their places.
    #[must_use]
    pub fn all(&self) -> &[(MapKey, Arc<World>)] {
        &self.maps
    }

    /// Whether a map is in the list.
    #[must_use]
    pub fn contains(&self, key: MapKey) -> bool {
        self.places.contains_key(&key)
    }

    /// A map.
    ///
    /// # Panics
    /// If there is none of this key.
    #[must_use]
    pub fn get(&self, key: MapKey) -> &Arc<World> {
        &self.maps[self.places[&key]].1
    }

    /// The place of a map.
    ///
    /// # Panics
    /// If there is none of this key.
    #[must_use]
    pub fn place(&self, key: MapKey) -> usize {
        self.places[&key]
    }

    /// Puts a map that can teach something in the place of another, and returns the key of that one.
    ///
    /// # Panics
    /// If there is no such place, or the list has a map of this key.
    pub fn replace(&mut self, place: usize, key: MapKey, map: Arc<World>) -> MapKey {
        assert!(!self.contains(key), "map {key} is in the list");
        let (gone, _) = std::mem::replace(&mut self.maps[place], (key, map));
        self.places.remove(&gone);
        self.places.insert(key, place);
        gone
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::world::tests::world;

    #[test]
    fn maps_without_a_hole_teach_nothing() {
        let maps = vec![Arc::new(world("..\n..", 2)), Arc::new(world("oo\noo", 2))];
        assert_eq!(MapList::of(maps).expect_err("nothing to learn"), NothingToLearn { maps: 2 });
    }

    #[test]
    fn a_key_names_one_map_also_when_others_come_and_go() {
        let maps = ["..\n..", "o.\n..", ".o\n.."].map(|map| Arc::new(world(map, 2)));
        let [nothing, first, second] = maps;
        let maps = vec![(3, nothing), (5, Arc::clone(&first)), (9, Arc::clone(&second))];
        let mut list = MapList::new(maps).expect("two of them teach");
        assert_eq!((list.len(), list.place(9), list.contains(3)), (2, 1, false));
        assert_eq!(list.replace(1, 3, Arc::clone(&first)), 9);
        assert!(Arc::ptr_eq(list.get(3), &first) && !list.contains(9));
        assert_eq!(list.all().iter().map(|(key, _)| *key).collect::<Vec<_>>(), [5, 3]);
    }
}

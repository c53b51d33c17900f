//! The UTM zone of an extract: that of most buildings. One corner that lies astray does not count.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::assemble::{Members, member_ways};
use super::nodes::NodeTable;
use super::scan::{RawRelation, RawWay};
use crate::crs::Utm;

/// The zone that most buildings lie in and the place of one of them, in degrees; `None` if the
/// place of none is known. Of equally many the first counts, by number of the zone.
pub(super) fn of_most(
    ways: &[RawWay],
    relations: &[RawRelation],
    members: &Members,
    nodes: &NodeTable,
) -> Option<(Utm, [f64; 2])> {
    let first_place = |refs: &[i64]| nodes.places(refs).flatten().next();
    let of_ways: Vec<[f64; 2]> = ways.par_iter().filter_map(|way| first_place(&way.refs)).collect();
    let of_relations = relations.iter().filter(|relation| relation.attributes.is_some());
    let of_relations = of_relations.filter_map(|relation| {
        let ways = member_ways(&relation.members, members, &mut vec![]);
        let mut ways = ways.into_iter().filter_map(|(way, _)| members.ways.get(&way));
        ways.find_map(|way| first_place(&way.refs))
    });
    let mut zones: BTreeMap<Utm, (u64, [f64; 2])> = BTreeMap::new();
    for place in of_ways.into_iter().chain(of_relations) {
        if let Ok(utm) = Utm::of_place(place[0], place[1]) {
            zones.entry(utm).or_insert((0, place)).0 += 1;
        }
    }
    let most = zones.iter().map(|(_, (count, _))| *count).max()?;
    let mut zones = zones.into_iter();
    zones.find(|(_, (count, _))| *count == most).map(|(utm, (_, place))| (utm, place))
}

//! One building out of a way or a relation, its member ways and their nodes.

use std::collections::HashMap;

use geo::{Coord, LineString, MultiPolygon, Polygon};

use super::footprint::{self, Ring, Role};
use super::nodes::NodeTable;
use super::rings::{Rings, assemble};
use crate::building::{Attributes, Defect};
use crate::crs::Utm;

/// A way with building tags.
#[derive(Debug)]
pub(super) struct RawWay {
    pub(super) id: i64,
    pub(super) refs: Vec<i64>,
    pub(super) attributes: Attributes,
}

/// A multipolygon relation with building tags.
#[derive(Debug)]
pub(super) struct RawRelation {
    pub(super) id: i64,
    pub(super) members: Vec<(i64, Role)>,
    pub(super) attributes: Attributes,
}

/// Turns node ids into places.
pub(super) struct Projector<'a> {
    pub(super) nodes: &'a NodeTable,
    pub(super) utm: Utm,
}

impl Projector<'_> {
    fn ring(&self, refs: &[i64], defects: &mut Vec<Defect>) -> Result<LineString<f64>, Defect> {
        let mut points = Vec::with_capacity(refs.len());
        for place in self.nodes.places(refs) {
            let [lon, lat] = place.ok_or(Defect::MissingNodes)?;
            let [x, y] = self.utm.forward(lon, lat).ok_or(Defect::NotProjectable)?;
            points.push(Coord { x, y });
        }
        footprint::clean(points, defects)
    }
}

/// The footprint of a closed way. Mends are appended to `defects`.
pub(super) fn way_footprint(
    way: &RawWay,
    projector: &Projector<'_>,
    defects: &mut Vec<Defect>,
) -> Result<MultiPolygon<f64>, Defect> {
    if way.refs.len() < 2 || way.refs.first() != way.refs.last() {
        return Err(Defect::OpenWay);
    }
    footprint::check_size(way.refs.len())?;
    let ring = projector.ring(&way.refs, defects)?;
    footprint::check_width(MultiPolygon(vec![Polygon::new(ring, vec![])]))
}

/// The footprint of a multipolygon relation. Whatever of it is sound is kept; mends are
/// appended to `defects`.
pub(super) fn relation_footprint(
    relation: &RawRelation,
    ways: &HashMap<i64, Vec<i64>>,
    projector: &Projector<'_>,
    defects: &mut Vec<Defect>,
) -> Result<MultiPolygon<f64>, Defect> {
    let mut members: Vec<(&[i64], Role)> = Vec::new();
    let mut seen = std::collections::HashSet::new();
    for &(id, role) in &relation.members {
        match ways.get(&id) {
            _ if !seen.insert(id) => defects.push(Defect::DuplicateMember),
            Some(refs) => members.push((refs, role)),
            None => defects.push(Defect::MissingMembers),
        }
    }
    footprint::check_size(members.iter().map(|(refs, _)| refs.len()).sum())?;
    let mut rings = Vec::new();
    let (closed, leftover) = assemble_by_role(&members);
    if leftover {
        defects.push(Defect::UnclosedRing);
    }
    for (refs, role) in closed {
        match projector.ring(&refs, defects) {
            Ok(line) => rings.push(Ring { line, role }),
            Err(defect) => defects.push(defect),
        }
    }
    let footprint = footprint::nest(rings, defects);
    if footprint.0.is_empty() {
        return Err(Defect::NoOuterRing);
    }
    footprint::check_width(footprint)
}

/// Rings of outer and of inner ways apart, since holes that touch the outline share nodes
/// with it; all together where roles are too wrong for that.
fn assemble_by_role(members: &[(&[i64], Role)]) -> (Vec<(Vec<i64>, Role)>, bool) {
    let of_role = |wanted: Role| {
        let ways: Vec<&[i64]> =
            members.iter().filter(|(_, role)| *role == wanted).map(|(refs, _)| *refs).collect();
        (wanted, assemble(&ways))
    };
    let apart = [Role::Outer, Role::Inner, Role::Any].map(of_role);
    if apart.iter().any(|(_, rings)| rings.leftover) {
        let all: Vec<&[i64]> = members.iter().map(|(refs, _)| *refs).collect();
        let Rings { closed, leftover } = assemble(&all);
        if !leftover {
            return (closed.into_iter().map(|ring| (ring, Role::Any)).collect(), false);
        }
    }
    let leftover = apart.iter().any(|(_, rings)| rings.leftover);
    let closed = apart
        .into_iter()
        .flat_map(|(role, rings)| rings.closed.into_iter().map(move |ring| (ring, role)));
    (closed.collect(), leftover)
}

//! One building out of a way or a relation, its member ways and their nodes.

use std::collections::{HashMap, HashSet};

use geo::{Coord, LineString, MultiPolygon, Polygon};

use super::block::MemberId;
use super::copies::MemberWay;
use super::footprint::{self, Nested, Ring, Role};
use super::nodes::NodeTable;
use super::rings::{Rings, assemble};
use super::scan::{RawRelation, RawWay};
use crate::building::{Defect, Told};
use crate::crs::Utm;

/// Relations within relations within relations ...: nobody needs more.
pub(super) const MAX_DEPTH: usize = 8;

/// What relations refer to.
pub(super) struct Members {
    pub(super) ways: HashMap<i64, MemberWay>,
    /// Members of relations that are members themselves.
    pub(super) relations: HashMap<i64, Vec<(MemberId, Role)>>,
}

/// Turns node ids into places.
pub(super) struct Projector<'a> {
    pub(super) nodes: &'a NodeTable,
    pub(super) utm: Utm,
}

impl Projector<'_> {
    fn ring(&self, refs: &[i64], defects: &mut Vec<Defect>) -> Result<LineString<f64>, Defect> {
        // A ring ends where it begins, and projecting is what takes longest.
        let (open, closing) = match refs {
            [first, .., last] if first == last => (&refs[..refs.len() - 1], true),
            _ => (refs, false),
        };
        let mut points = Vec::with_capacity(refs.len());
        for place in self.nodes.places(open) {
            let [lon, lat] = place.ok_or(Defect::MissingNodes)?;
            let [x, y] = self.utm.forward(lon, lat).ok_or(Defect::NotProjectable)?;
            points.push(Coord { x, y });
        }
        if closing {
            points.push(points[0]);
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
    let footprint = MultiPolygon(vec![Polygon::new(ring, vec![])]);
    footprint::check_width(&footprint)?;
    Ok(footprint)
}

/// The footprint of a relation, in pieces. Whatever of it is sound is kept; mends are appended to
/// `defects`.
pub(super) fn relation_footprint(
    relation: &RawRelation,
    members: &Members,
    projector: &Projector<'_>,
    defects: &mut Vec<Defect>,
) -> Result<Nested, Defect> {
    let mut found: Vec<(&MemberWay, Role)> = Vec::new();
    let mut seen = HashSet::new();
    for (id, role) in member_ways(&relation.members, members, defects) {
        match members.ways.get(&id) {
            _ if !seen.insert(id) => defects.push(Defect::DuplicateMember),
            Some(way) => found.push((way, role)),
            None => defects.push(Defect::MissingMembers),
        }
    }
    footprint::check_size(found.iter().map(|(way, _)| way.refs.len()).sum())?;
    let mut rings = Vec::new();
    let (closed, leftover) = assemble_by_role(&found);
    if leftover {
        defects.push(Defect::UnclosedRing);
    }
    for (refs, ways, role) in closed {
        let told = Told::best(ways.iter().filter_map(|way| way.told));
        match projector.ring(&refs, defects) {
            Ok(line) => rings.push(Ring { line, role, told }),
            Err(defect) => defects.push(defect),
        }
    }
    let nested = footprint::nest(rings, defects);
    if nested.pieces.is_empty() {
        return Err(Defect::NoOuterRing);
    }
    footprint::check_width(nested.pieces.iter().map(|piece| &piece.polygon))?;
    Ok(nested)
}

/// The member ways of a relation and of relations within it. A ring of an inner relation has the
/// role of that relation; what is a hole in it may be either, where it lies decides.
pub(super) fn member_ways(
    relation: &[(MemberId, Role)],
    members: &Members,
    defects: &mut Vec<Defect>,
) -> Vec<(i64, Role)> {
    let mut ways = Vec::new();
    let mut open: Vec<(MemberId, Role, usize)> =
        relation.iter().rev().map(|&(id, role)| (id, role, 0)).collect();
    while let Some((id, role, depth)) = open.pop() {
        match id {
            MemberId::Way(id) => ways.push((id, role)),
            MemberId::Relation(id) => match members.relations.get(&id) {
                Some(inner) if depth < MAX_DEPTH => {
                    let role_of = |inner: Role| if inner == Role::Inner { Role::Any } else { role };
                    let inner = inner.iter().rev();
                    open.extend(inner.map(|&(id, inner)| (id, role_of(inner), depth + 1)));
                }
                _ => defects.push(Defect::MissingMembers),
            },
        }
    }
    ways
}

/// A ring's nodes, the ways around it, and their role.
type RoleRing<'a> = (Vec<i64>, Vec<&'a MemberWay>, Role);

/// Rings of outer and of inner ways apart, since holes that touch the outline share nodes
/// with it; all together where roles are too wrong for that.
fn assemble_by_role<'a>(members: &[(&'a MemberWay, Role)]) -> (Vec<RoleRing<'a>>, bool) {
    let of_role = |wanted: Option<Role>| {
        let ways = members.iter().filter(|(_, role)| wanted.is_none_or(|wanted| *role == wanted));
        let ways: Vec<&'a MemberWay> = ways.map(|(way, _)| *way).collect();
        let refs: Vec<&[i64]> = ways.iter().map(|way| &way.refs[..]).collect();
        let Rings { closed, leftover } = assemble(&refs);
        let ring = |ring: super::rings::ClosedRing| {
            let around = ring.ways.iter().map(|&way| ways[way]).collect();
            (ring.nodes, around, wanted.unwrap_or(Role::Any))
        };
        (closed.into_iter().map(ring).collect::<Vec<_>>(), leftover)
    };
    let apart = [Role::Outer, Role::Inner, Role::Any].map(|role| of_role(Some(role)));
    let leftover = apart.iter().any(|(_, leftover)| *leftover);
    if leftover {
        let (closed, leftover) = of_role(None);
        if !leftover {
            return (closed, false);
        }
    }
    (apart.into_iter().flat_map(|(closed, _)| closed).collect(), leftover)
}

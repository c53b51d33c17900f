//! From what the passes found to buildings: footprints of all objects, which object stands for
//! which, what relations inherit from their ways and outlines from their relations.

use std::collections::{HashMap, HashSet};

use geo::{LineString, MultiPolygon, Polygon};
use rayon::prelude::*;

use super::assemble::{Members, Projector, member_ways, relation_footprint, way_footprint};
use super::block::MemberId;
use super::footprint::{Nested, Piece};
use super::scan::{RawRelation, RawWay, RelationKind};
use crate::building::{Attributes, Building, Defect, Kind, Named, ObjectId, Problem, Told};

/// The buildings of all extracts.
pub(super) struct Found {
    /// Ways first, each in the order of the files; the pieces of a relation follow each other.
    pub(super) buildings: Vec<Building>,
    /// Parts that relations name.
    pub(super) named: Vec<Named>,
}

/// Everything about a relation `type=building`.
struct RelationGroup {
    outlines: Vec<ObjectId>,
    parts: Vec<ObjectId>,
    /// A height that the relation tells.
    told: Option<Told>,
}

/// What a relation becomes.
struct BuiltRelation {
    buildings: Vec<Building>,
    problems: Vec<Problem>,
    /// Its outer rings, as they were drawn.
    outers: Vec<LineString<f64>>,
}

/// Footprints of all objects, in parallel and in order.
pub(super) fn build(
    ways: &[RawWay],
    relations: &[RawRelation],
    members: &Members,
    projector: &Projector<'_>,
    problems: &mut Vec<Problem>,
) -> Found {
    let tagged = tagged_outlines(ways, relations);
    let from_relations: Vec<BuiltRelation> = relations
        .par_iter()
        .map(|relation| build_relation(relation, &tagged, members, projector))
        .collect();

    let mut parents: HashMap<i64, Vec<usize>> = HashMap::new();
    for (at, (relation, built)) in relations.iter().zip(&from_relations).enumerate() {
        if !built.buildings.is_empty() {
            for (way, _) in member_ways(&relation.members, members, &mut vec![]) {
                parents.entry(way).or_default().push(at);
            }
        }
    }
    let from_ways: Vec<(Option<Building>, Vec<Problem>)> = ways
        .par_iter()
        .map(|way| {
            let mut defects = Vec::new();
            let mut footprint = way_footprint(way, projector, &mut defects);
            let mut parents = parents.get(&way.id).into_iter().flatten();
            if parents.any(|&parent| stands_for(&from_relations[parent], way, footprint.as_ref())) {
                defects.clear();
                footprint = Err(Defect::CoveredByRelation);
            }
            build_way(way, footprint, defects)
        })
        .collect();

    let groups: Vec<RelationGroup> = relations
        .iter()
        .filter(|relation| relation.kind == RelationKind::Building)
        .map(|relation| group(relation, &tagged))
        .collect();
    let mut buildings = Vec::with_capacity(from_ways.len() + from_relations.len());
    for (building, found) in from_ways {
        buildings.extend(building);
        problems.extend(found);
    }
    for built in from_relations {
        buildings.extend(built.buildings);
        problems.extend(built.problems);
    }
    inherit_from_groups(&mut buildings, &groups);
    let named = groups.iter().flat_map(|group| {
        let parts = group.parts.iter();
        parts.flat_map(|&part| group.outlines.iter().map(move |&outline| Named { outline, part }))
    });
    Found { buildings, named: named.collect() }
}

/// The outlines of relations `type=building` that carry building tags themselves.
fn tagged_outlines(ways: &[RawWay], relations: &[RawRelation]) -> HashSet<ObjectId> {
    let of_kind =
        |kind: RelationKind| relations.iter().filter(move |relation| relation.kind == kind);
    let outlines = of_kind(RelationKind::Building).flat_map(|relation| &relation.members);
    let outlines: HashSet<ObjectId> = outlines.map(|(member, _)| object(*member)).collect();
    let ways = ways.iter().map(|way| ObjectId::Way(way.id));
    let multipolygons = of_kind(RelationKind::Multipolygon);
    let multipolygons = multipolygons.map(|relation| ObjectId::Relation(relation.id));
    ways.chain(multipolygons).filter(|object| outlines.contains(object)).collect()
}

fn object(member: MemberId) -> ObjectId {
    match member {
        MemberId::Way(id) => ObjectId::Way(id),
        MemberId::Relation(id) => ObjectId::Relation(id),
    }
}

fn build_way(
    way: &RawWay,
    footprint: Result<MultiPolygon<f64>, Defect>,
    defects: Vec<Defect>,
) -> (Option<Building>, Vec<Problem>) {
    let object = ObjectId::Way(way.id);
    let mut problems: Vec<_> =
        defects.into_iter().map(|defect| Problem::of_piece(object, defect)).collect();
    match footprint {
        Ok(footprint) => {
            (Some(Building { object, footprint, attributes: way.attributes }), problems)
        }
        Err(defect) => {
            problems.push(Problem::new(object, defect));
            (None, problems)
        }
    }
}

fn build_relation(
    relation: &RawRelation,
    tagged: &HashSet<ObjectId>,
    members: &Members,
    projector: &Projector<'_>,
) -> BuiltRelation {
    let object_id = ObjectId::Relation(relation.id);
    let mut built =
        BuiltRelation { buildings: Vec::new(), problems: Vec::new(), outers: Vec::new() };
    let Some(attributes) = relation.attributes else { return built };
    let mut defects = Vec::new();
    let is_tagged = |(member, _): &(MemberId, _)| tagged.contains(&object(*member));
    let made = if relation.kind == RelationKind::Building && relation.members.iter().any(is_tagged)
    {
        Err(Defect::CoveredByOutline)
    } else {
        relation_footprint(relation, members, projector, &mut defects)
    };
    let of_piece = |defect| Problem::of_piece(object_id, defect);
    built.problems.extend(defects.into_iter().map(of_piece));
    match made {
        Ok(Nested { pieces, outers }) => {
            built.buildings = by_height(object_id, attributes, pieces);
            built.outers = outers;
        }
        Err(defect) => built.problems.push(Problem::new(object_id, defect)),
    }
    built
}

/// A relation that does not tell its height inherits it from its outer ways, ring by ring.
fn by_height(object: ObjectId, attributes: Attributes, pieces: Vec<Piece>) -> Vec<Building> {
    let mut buildings: Vec<Building> = Vec::new();
    for Piece { polygon, told } in pieces {
        let mut attributes = attributes;
        if let Some(told) = told {
            attributes.inherit(told);
        }
        let same = buildings.iter_mut().find(|building| building.attributes == attributes);
        if let Some(building) = same {
            building.footprint.0.push(polygon);
        } else {
            let footprint = MultiPolygon(vec![polygon]);
            buildings.push(Building { object, footprint, attributes });
        }
    }
    // The best known one first: it stands for the object where that is counted.
    buildings.sort_by_key(|building| building.attributes.source);
    buildings
}

/// Whether a relation stands for one of its member ways that carries building tags itself:
/// an outer ring would fill the relation's holes, a piece of a ring is no building.
fn stands_for(
    relation: &BuiltRelation,
    way: &RawWay,
    footprint: Result<&MultiPolygon<f64>, &Defect>,
) -> bool {
    let Some(Building { attributes, .. }) = relation.buildings.first() else { return false };
    attributes.kind == way.attributes.kind
        && match footprint {
            Ok(footprint) => {
                let ring = footprint.0.first().map(Polygon::exterior);
                relation.outers.iter().any(|outer| Some(outer) == ring)
            }
            Err(defect) => *defect == Defect::OpenWay,
        }
}

fn group(relation: &RawRelation, tagged: &HashSet<ObjectId>) -> RelationGroup {
    let members = relation.members.iter().map(|(member, _)| object(*member));
    let mut outlines: Vec<ObjectId> = members.filter(|member| tagged.contains(member)).collect();
    if outlines.is_empty() && relation.attributes.is_some() {
        outlines.push(ObjectId::Relation(relation.id));
    }
    RelationGroup {
        outlines,
        parts: relation.parts.iter().map(|&part| object(part)).collect(),
        told: relation.attributes.and_then(|attributes| attributes.told()),
    }
}

/// What neither an outline nor the parts of a group without one tell, their relation may.
fn inherit_from_groups(buildings: &mut [Building], groups: &[RelationGroup]) {
    if groups.iter().all(|group| group.told.is_none()) {
        return;
    }
    let is_outline = |building: &&Building| building.attributes.kind == Kind::Outline;
    let outlines: HashSet<ObjectId> =
        buildings.iter().filter(is_outline).map(|building| building.object).collect();
    let mut told: HashMap<ObjectId, Told> = HashMap::new();
    for group in groups {
        let Some(height) = group.told else { continue };
        told.extend(group.outlines.iter().map(|&outline| (outline, height)));
        if !group.outlines.iter().any(|outline| outlines.contains(outline)) {
            told.extend(group.parts.iter().map(|&part| (part, height)));
        }
    }
    for building in buildings {
        if let Some(&height) = told.get(&building.object) {
            building.attributes.inherit(height);
        }
    }
}

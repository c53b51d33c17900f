//! First pass: what a block holds of buildings, by its tags.

use osmpbfreader::osmformat::{PrimitiveBlock, PrimitiveGroup, Relation, Way};

use super::block::{self, MemberId};
use super::footprint::Role;
use crate::building::{Attributes, Classified, Defect, ObjectId, Problem, classify};
use crate::config::BuildingsConfig;

/// A way with building tags.
#[derive(Debug)]
pub(super) struct RawWay {
    pub(super) id: i64,
    pub(super) version: i32,
    pub(super) refs: Vec<i64>,
    /// Where the nodes are, if the file keeps that with the way.
    pub(super) places: Option<Box<[[i32; 2]]>>,
    pub(super) attributes: Attributes,
}

/// What kind of relation makes or groups buildings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RelationKind {
    /// `type=multipolygon`.
    Multipolygon,
    /// `type=building`: an outline and its parts.
    Building,
}

/// A multipolygon with building tags, or a relation `type=building`.
#[derive(Debug)]
pub(super) struct RawRelation {
    pub(super) id: i64,
    pub(super) version: i32,
    pub(super) kind: RelationKind,
    /// `None` for a relation that only groups what has tags of its own.
    pub(super) attributes: Option<Attributes>,
    /// The rings: members that are part of the outline.
    pub(super) members: Vec<(MemberId, Role)>,
    /// Members with the role of a part.
    pub(super) parts: Vec<MemberId>,
}

/// What one block holds.
#[derive(Default)]
pub(super) struct Finds {
    pub(super) has_nodes: bool,
    pub(super) has_ways: bool,
    pub(super) has_relations: bool,
    pub(super) ways: Vec<RawWay>,
    pub(super) relations: Vec<RawRelation>,
    pub(super) problems: Vec<Problem>,
    pub(super) order: FileOrder,
}

/// Looks through a block.
pub(super) fn find_buildings(block: &PrimitiveBlock, config: &BuildingsConfig) -> Finds {
    let mut finds = Finds::default();
    for group in &block.primitivegroup {
        finds.has_nodes |= !group.nodes.is_empty() || !group.dense.id.is_empty();
        finds.has_ways |= !group.ways.is_empty();
        finds.has_relations |= !group.relations.is_empty();
        let of_nodes = block::building_nodes(block, group).into_iter().map(ObjectId::Node);
        finds.problems.extend(of_nodes.map(|object| Problem::new(object, Defect::Node)));
        finds.order.take(group);
        let exists = |way: &&Way| block::is_visible(way.info.as_ref());
        for way in group.ways.iter().filter(exists) {
            finds.take_way(block, way, config);
        }
        let exists = |relation: &&Relation| block::is_visible(relation.info.as_ref());
        for relation in group.relations.iter().filter(exists) {
            finds.take_relation(block, relation, config);
        }
    }
    finds
}

impl Finds {
    fn take_way(&mut self, block: &PrimitiveBlock, way: &Way, config: &BuildingsConfig) {
        let classified = classify(|key| block::way_tag(block, way, key), config);
        if let Some(attributes) = self.note(ObjectId::Way(way.id()), classified) {
            self.ways.push(RawWay {
                id: way.id(),
                version: block::version(way.info.as_ref()),
                refs: block::way_refs(way),
                places: block::way_places(block, way),
                attributes,
            });
        }
    }

    fn take_relation(
        &mut self,
        block: &PrimitiveBlock,
        relation: &Relation,
        config: &BuildingsConfig,
    ) {
        let tag = |key: &str| block::relation_tag(block, relation, key);
        let object = ObjectId::Relation(relation.id());
        let classified = classify(tag, config);
        let kind = match tag("type") {
            Some("multipolygon") if classified != Classified::Unrelated => {
                RelationKind::Multipolygon
            }
            Some("building") => RelationKind::Building,
            _ => {
                match classified {
                    Classified::Building(..) => {
                        self.problems.push(Problem::new(object, Defect::NotAnArea));
                    }
                    other => drop(self.note(object, other)),
                }
                return;
            }
        };
        let attributes = self.note(object, classified);
        if attributes.is_none() && kind == RelationKind::Multipolygon {
            return;
        }
        let (mut members, mut parts, mut foreign) = (Vec::new(), Vec::new(), false);
        for (member, role) in block::members(block, relation) {
            match (kind, role, Role::of(role)) {
                (RelationKind::Building, "outline", _) => members.push((member, Role::Outer)),
                (RelationKind::Building, "part", _) => parts.push(member),
                // Entrances, edges, ridges and the like, mostly without a role.
                (RelationKind::Building, _, None | Some(Role::Any)) => {}
                (_, _, Some(role)) => members.push((member, role)),
                (RelationKind::Multipolygon, _, None) => foreign = true,
            }
        }
        if foreign {
            self.problems.push(Problem::new(object, Defect::ForeignRole));
        }
        let version = block::version(relation.info.as_ref());
        let id = relation.id();
        self.relations.push(RawRelation { id, version, kind, attributes, members, parts });
    }

    /// Keeps what is wrong with an object, and returns its attributes if it is a building.
    fn note(&mut self, object: ObjectId, classified: Classified) -> Option<Attributes> {
        let (attributes, defects) = match classified {
            Classified::Unrelated => (None, vec![]),
            Classified::LeftOut(defect) => (None, vec![defect]),
            Classified::Building(attributes, defects) => (Some(attributes), defects),
        };
        self.problems.extend(defects.into_iter().map(|defect| Problem::new(object, defect)));
        attributes
    }
}

/// The objects of a block in their order, as far as that tells whether the file holds several
/// versions of one: in files that are sorted they follow each other.
#[derive(Debug, Default)]
pub(super) struct FileOrder {
    first: Option<(ObjectId, i32)>,
    last: Option<(ObjectId, i32)>,
    /// An object that follows another version of itself.
    pub(super) repeated: Option<ObjectId>,
    /// Some object follows one with a larger id: versions may be anywhere.
    pub(super) is_mixed: bool,
}

impl FileOrder {
    fn take(&mut self, group: &PrimitiveGroup) {
        for way in &group.ways {
            self.next(ObjectId::Way(way.id()), block::version(way.info.as_ref()));
        }
        for relation in &group.relations {
            let version = block::version(relation.info.as_ref());
            self.next(ObjectId::Relation(relation.id()), version);
        }
    }

    fn next(&mut self, object: ObjectId, version: i32) {
        let this = Some((object, version));
        self.first = self.first.or(this);
        self.follow(this);
        self.last = this;
    }

    /// Goes on with the next block of the same file.
    pub(super) fn append(&mut self, next: &Self) {
        self.follow(next.first);
        self.repeated = self.repeated.or(next.repeated);
        self.is_mixed |= next.is_mixed;
        self.first = self.first.or(next.first);
        self.last = next.last.or(self.last);
    }

    fn follow(&mut self, next: Option<(ObjectId, i32)>) {
        let (Some((last, version)), Some((next, next_version))) = (self.last, next) else {
            return;
        };
        self.is_mixed |= next < last;
        if last == next && version != next_version {
            self.repeated = self.repeated.or(Some(last));
        }
    }
}

//! First pass: what a block holds of buildings, by its tags.

use super::block::{BlockView, MemberId, Relation, Way};
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
pub(super) fn find_buildings(block: &BlockView<'_>, config: &BuildingsConfig) -> Finds {
    let mut finds = Finds {
        has_nodes: block.has_nodes(),
        has_ways: !block.ways.is_empty(),
        has_relations: !block.relations.is_empty(),
        order: FileOrder::of(block),
        ..Finds::default()
    };
    let of_nodes = block.building_nodes().into_iter().map(ObjectId::Node);
    finds.problems.extend(of_nodes.map(|object| Problem::new(object, Defect::Node)));
    for way in block.ways.iter().filter(|way| way.info.is_visible) {
        finds.take_way(block, way, config);
    }
    for relation in block.relations.iter().filter(|relation| relation.info.is_visible) {
        finds.take_relation(block, relation, config);
    }
    finds
}

impl Finds {
    fn take_way<'a>(&mut self, block: &BlockView<'a>, way: &Way<'a>, config: &BuildingsConfig) {
        let classified = classify(|key| block.way_tag(way, key), config);
        if let Some(attributes) = self.note(ObjectId::Way(way.id), classified) {
            self.ways.push(RawWay {
                id: way.id,
                version: way.info.version,
                refs: way.refs(),
                places: block.way_places(way),
                attributes,
            });
        }
    }

    fn take_relation<'a>(
        &mut self,
        block: &BlockView<'a>,
        relation: &Relation<'a>,
        config: &BuildingsConfig,
    ) {
        let tag = |key: &str| block.relation_tag(relation, key);
        let object = ObjectId::Relation(relation.id);
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
        for (member, role) in block.members(relation) {
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
        let Relation { id, info, .. } = *relation;
        let version = info.version;
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
    fn of(block: &BlockView<'_>) -> Self {
        let mut order = Self::default();
        for way in &block.ways {
            order.next(ObjectId::Way(way.id), way.info.version);
        }
        for relation in &block.relations {
            order.next(ObjectId::Relation(relation.id), relation.info.version);
        }
        order
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

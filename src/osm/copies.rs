//! Of an object that is there more than once, the whole copy: in one extract a building may be cut
//! at the border that is whole in the next.

use std::collections::HashMap;

use super::block::MemberId;
use super::nodes::NodeTable;
use super::scan::{RawRelation, RawWay};
use crate::building::{Defect, ObjectId, Problem, Told};

/// A member way of a relation.
#[derive(Debug, Clone)]
pub(super) struct MemberWay {
    pub(super) version: i32,
    pub(super) refs: Vec<i64>,
    /// Where the nodes are, if the file keeps that with the way.
    pub(super) places: Option<Box<[[i32; 2]]>>,
    /// A height that its tags tell.
    pub(super) told: Option<Told>,
}

/// How good a copy of a way is: whether all its nodes are there, its version, how many it has, and,
/// so that the order of files does not matter, which.
fn rank<'a>(nodes: &NodeTable, version: i32, refs: &'a [i64]) -> (bool, i32, usize, &'a [i64]) {
    (nodes.has_all(refs), version, refs.len(), refs)
}

/// Keeps the best copy of each member way.
pub(super) fn whole_members(
    found: Vec<(i64, MemberWay)>,
    nodes: &NodeTable,
) -> HashMap<i64, MemberWay> {
    let mut whole: HashMap<i64, MemberWay> = HashMap::with_capacity(found.len());
    for (id, way) in found {
        let is_better = |other: &MemberWay| {
            rank(nodes, way.version, &way.refs) > rank(nodes, other.version, &other.refs)
        };
        if whole.get(&id).is_none_or(is_better) {
            whole.insert(id, way);
        }
    }
    whole
}

/// Keeps the best copy of each way, in the order of the first ones.
pub(super) fn whole_ways(
    ways: Vec<RawWay>,
    nodes: &NodeTable,
    problems: &mut Vec<Problem>,
) -> Vec<RawWay> {
    let is_better = |one: &RawWay, other: &RawWay| {
        rank(nodes, one.version, &one.refs) > rank(nodes, other.version, &other.refs)
    };
    best(ways, |way| ObjectId::Way(way.id), is_better, problems)
}

/// Keeps the best copy of each relation, in the order of the first ones.
pub(super) fn whole_relations(
    relations: Vec<RawRelation>,
    members: &HashMap<i64, MemberWay>,
    problems: &mut Vec<Problem>,
) -> Vec<RawRelation> {
    let is_there = |(member, _): &(MemberId, _)| match member {
        MemberId::Way(id) => members.contains_key(id),
        MemberId::Relation(_) => true,
    };
    let rank = |relation: &RawRelation| {
        let whole = relation.members.iter().all(is_there);
        (whole, relation.version, relation.members.len())
    };
    let is_better = |one: &RawRelation, other: &RawRelation| rank(one) > rank(other);
    best(relations, |relation| ObjectId::Relation(relation.id), is_better, problems)
}

fn best<T>(
    found: Vec<T>,
    object: impl Fn(&T) -> ObjectId,
    is_better: impl Fn(&T, &T) -> bool,
    problems: &mut Vec<Problem>,
) -> Vec<T> {
    // As in any single extract that is sorted.
    if found.is_sorted_by(|a, b| object(a) < object(b)) {
        return found;
    }
    let mut at: HashMap<ObjectId, usize> = HashMap::with_capacity(found.len());
    let mut whole: Vec<T> = Vec::with_capacity(found.len());
    for one in found {
        match at.get(&object(&one)) {
            None => {
                at.insert(object(&one), whole.len());
                whole.push(one);
            }
            Some(&other) => {
                problems.push(Problem::new(object(&one), Defect::DuplicateObject));
                if is_better(&one, &whole[other]) {
                    whole[other] = one;
                }
            }
        }
    }
    whole
}

//! Nothing vanishes without a row: every object with building tags is an outline, a part, raised, or
//! listed with what was done about it, whatever is in the extract.

#![allow(clippy::panic, reason = "helpers of tests fail by panicking")]

mod common;

use std::collections::{BTreeMap, BTreeSet};

use holescout::building::{Action, ObjectId};
use holescout::config::BuildingsConfig;
use holescout::grid::Area;
use holescout::osm::{ExtractError, read_buildings};
use holescout::progress::Silent;
use osmpbfreader::osmformat::relation::MemberType;
use osmpbfreader::osmformat::{HeaderBlock, Node, PrimitiveBlock, PrimitiveGroup, Relation, Way};
use proptest::prelude::*;
use protobuf::Message;

use common::pbf::{Packing, framed};
use common::{scratch, write};

/// Tags as odd as people's; those with `building` or `building:part` must not vanish.
const TAGS: [&[(&str, &str)]; 16] = [
    &[],
    &[("building", "yes")],
    &[("building", "yes"), ("height", "12")],
    &[("building", "roof")],
    &[("building", "no")],
    &[("building", "proposed"), ("height", "30")],
    &[("building", "yes"), ("location", "underground")],
    &[("building", "yes"), ("building:levels", "-1")],
    &[("building", "no"), ("building:part", "yes")],
    &[("building:part", "yes")],
    &[("building:part", "yes"), ("height", "8"), ("min_height", "20")],
    &[("building:part", "yes"), ("min_height", "10")],
    &[("building:part", "no")],
    &[("height", "10")],
    &[("demolished:building", "yes")],
    &[("building", "")],
];
const TYPES: [&str; 5] = ["multipolygon", "building", "site", "boundary", ""];
const ROLES: [&str; 6] = ["outer", "inner", "", "outline", "part", "entrance"];
/// Nodes lie on a lattice of so many columns; ways may also name nodes that are not there.
const COLUMNS: i64 = 6;
const NODES: i64 = COLUMNS * COLUMNS;

#[derive(Debug, Clone)]
struct Odd {
    nodes: Vec<usize>,
    ways: Vec<(usize, Vec<i64>, bool)>,
    relations: Vec<(usize, usize, Vec<Member>)>,
}

/// Whether it is a way, its id, and its role.
type Member = (bool, i64, usize);

fn odd() -> impl Strategy<Value = Odd> {
    let nodes = prop::collection::vec(0..TAGS.len(), NODES as usize);
    let way = (0..TAGS.len(), prop::collection::vec(1..NODES + 2, 1..7), any::<bool>());
    let member = (any::<bool>(), 1_i64..9, 0..ROLES.len());
    let relation = (0..TAGS.len(), 0..TYPES.len(), prop::collection::vec(member, 0..5));
    (nodes, prop::collection::vec(way, 1..9), prop::collection::vec(relation, 0..7))
        .prop_map(|(nodes, ways, relations)| Odd { nodes, ways, relations })
}

/// The strings of a block.
#[derive(Default)]
struct Strings(Vec<Vec<u8>>);

impl Strings {
    fn index(&mut self, text: &str) -> u32 {
        if self.0.is_empty() {
            self.0.push(Vec::new());
        }
        let at = self.0.iter().skip(1).position(|known| known == text.as_bytes());
        let at = at.map_or(self.0.len(), |at| at + 1);
        if at == self.0.len() {
            self.0.push(text.as_bytes().to_vec());
        }
        u32::try_from(at).expect("a short table")
    }

    fn tags(&mut self, tags: &[(&str, &str)]) -> (Vec<u32>, Vec<u32>) {
        tags.iter().map(|(key, value)| (self.index(key), self.index(value))).unzip()
    }
}

fn deltas(ids: impl Iterator<Item = i64>) -> Vec<i64> {
    let mut last = 0;
    ids.map(|id| id - std::mem::replace(&mut last, id)).collect()
}

fn extract(odd: &Odd) -> Vec<u8> {
    let mut strings = Strings::default();
    let mut group = PrimitiveGroup::new();
    for (id, &tags) in (1..).zip(&odd.nodes) {
        let mut node = Node::new();
        node.set_id(id);
        // About 10 m apart, near Helsinki.
        node.set_lon(249_400_000 + id % COLUMNS * 1800);
        node.set_lat(601_700_000 + id / COLUMNS * 900);
        // Most nodes have no tags.
        if id % 9 == 0 {
            (node.keys, node.vals) = strings.tags(TAGS[tags]);
        }
        group.nodes.push(node);
    }
    for (id, (tags, refs, closed)) in (1..).zip(&odd.ways) {
        let mut way = Way::new();
        way.set_id(id);
        (way.keys, way.vals) = strings.tags(TAGS[*tags]);
        way.refs = deltas(refs.iter().copied().chain(closed.then_some(refs[0])));
        group.ways.push(way);
    }
    for (id, (tags, kind, members)) in (1..).zip(&odd.relations) {
        let mut relation = Relation::new();
        relation.set_id(id);
        let tags: Vec<_> = TAGS[*tags].iter().copied().chain([("type", TYPES[*kind])]).collect();
        (relation.keys, relation.vals) = strings.tags(&tags);
        relation.memids = deltas(members.iter().map(|(_, id, _)| *id));
        for (is_way, _, role) in members {
            let kind = if *is_way { MemberType::WAY } else { MemberType::RELATION };
            relation.types.push(kind.into());
            relation.roles_sid.push(strings.index(ROLES[*role]).cast_signed());
        }
        group.relations.push(relation);
    }
    let mut block = PrimitiveBlock::new();
    block.primitivegroup.push(group);
    block.stringtable.mut_or_insert_default().s = strings.0;
    let mut header = HeaderBlock::new();
    header.required_features.push("OsmSchema-V0.6".to_owned());
    let header = header.write_to_bytes().expect("a complete message");
    let block = block.write_to_bytes().expect("a complete message");
    [framed("OSMHeader", &header, Packing::Raw), framed("OSMData", &block, Packing::Raw)].concat()
}

/// The objects with building tags.
fn tagged(odd: &Odd) -> BTreeSet<ObjectId> {
    let is_tagged = |tags: &usize| {
        TAGS[*tags].iter().any(|(key, _)| ["building", "building:part"].contains(key))
    };
    let nodes = (1_i64..).zip(&odd.nodes).filter(|(id, tags)| id % 9 == 0 && is_tagged(tags));
    let ways = (1_i64..).zip(&odd.ways).filter(|(_, (tags, ..))| is_tagged(tags));
    let relations = (1_i64..).zip(&odd.relations).filter(|(_, (tags, ..))| is_tagged(tags));
    nodes
        .map(|(id, _)| ObjectId::Node(id))
        .chain(ways.map(|(id, _)| ObjectId::Way(id)))
        .chain(relations.map(|(id, _)| ObjectId::Relation(id)))
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, ..ProptestConfig::default() })]

    #[test]
    fn every_object_with_building_tags_is_there_or_listed(odd in odd()) {
        let tagged = tagged(&odd);
        let dir = scratch();
        let path = dir.path().join("odd.osm.pbf");
        write(&path, extract(&odd));
        let config = BuildingsConfig::default();
        let extract = match read_buildings(&[path], &config, None, &Area::Whole, &Silent) {
            Ok(extract) => extract,
            Err(ExtractError::NoBuildings { found, .. }) => {
                prop_assert_eq!(found, tagged.len());
                return Ok(());
            }
            Err(error) => return Err(TestCaseError::fail(error.to_string())),
        };
        prop_assert_eq!(extract.tagged, tagged.len() as u64);
        let there: BTreeSet<ObjectId> =
            extract.city.buildings().iter().map(|building| building.object).collect();
        let mut out: BTreeMap<ObjectId, usize> = BTreeMap::new();
        for problem in &extract.problems {
            if matches!(problem.action, Action::Skipped | Action::LeftOut) {
                *out.entry(problem.object).or_default() += 1;
            }
        }
        prop_assert!(out.values().all(|rows| *rows == 1), "{out:?}");
        let listed: BTreeSet<ObjectId> = out.into_keys().collect();
        prop_assert!(there.is_disjoint(&listed), "{there:?} {listed:?}");
        prop_assert_eq!(there.union(&listed).copied().collect::<BTreeSet<_>>(), tagged);
    }
}

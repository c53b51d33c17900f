//! What the head of an extract demands, and objects that are there in several versions or deleted.

#![allow(clippy::panic, reason = "helpers of tests fail by panicking")]

mod common;

use osmpbfreader::osmformat::{HeaderBlock, Info, Node};
use protobuf::Message;

use common::pbf::{Packing, content, edited, framed, frames};
use common::{INVALID_INPUT, Run, fixture, read, run, scratch, write};

fn plain() -> Vec<u8> {
    read(&fixture("geometry/closed_way.osm.pbf"))
}

fn rasterise(extract: &[u8]) -> Run {
    let scratch = scratch();
    let (osm, out) = (scratch.path().join("some.osm.pbf"), scratch.path().join("tiles"));
    write(&osm, extract);
    run(args![
        "rasterise",
        "--osm",
        &osm,
        "--out",
        &out,
        "--min-buildings",
        "0",
        "--min-built",
        "0"
    ])
}

/// The file with another head.
fn with_header(file: &[u8], edit: impl Fn(&mut HeaderBlock)) -> Vec<u8> {
    let frames = frames(file);
    let mut header = HeaderBlock::parse_from_bytes(&content(file, &frames[0])).expect("a header");
    edit(&mut header);
    let header = header.write_to_bytes().expect("a complete message");
    [&framed("OSMHeader", &header, Packing::Raw), &file[frames[0].blob.end..]].concat()
}

#[test]
fn features_are_handled_or_named() {
    let optional = |name: &str| {
        let file = with_header(&plain(), |header| header.optional_features.push(name.to_owned()));
        rasterise(&file).succeeded()
    };
    for known in ["Sort.Type_then_ID", "Has_Metadata", "LocationsOnWays", "timestamp=2026-01-01"] {
        let said = optional(known).stderr;
        assert!(!said.contains(known), "{said}");
    }
    let said = optional("Wings").stderr;
    assert!(said.contains("some.osm.pbf") && said.contains("\"Wings\" is not known"), "{said}");

    let file = with_header(&plain(), |header| header.required_features.push("Wings".to_owned()));
    let refused = rasterise(&file);
    assert_eq!(refused.code, Some(INVALID_INPUT), "{refused:?}");
    assert!(refused.stderr.contains("Wings"), "{refused:?}");
}

#[test]
fn deleted_objects_are_none() {
    let deleted = edited(&plain(), |block| {
        for way in block.primitivegroup.iter_mut().flat_map(|group| &mut group.ways) {
            let mut info = Info::new();
            info.set_visible(false);
            way.info = Some(info).into();
        }
    });
    let refused = rasterise(&deleted);
    assert_eq!(refused.code, Some(INVALID_INPUT), "{refused:?}");
    assert!(refused.stderr.contains("no buildings"), "{refused:?}");
}

#[test]
fn several_versions_of_an_object_are_refused_with_the_command_that_mends_them() {
    let way_twice = edited(&plain(), |block| {
        for group in &mut block.primitivegroup {
            if let Some(way) = group.ways.first().cloned() {
                let mut info = Info::new();
                info.set_version(7);
                let mut other = way;
                other.info = Some(info).into();
                group.ways.insert(1, other);
            }
        }
    });
    let node_twice = edited(&plain(), |block| {
        let groups = &mut block.primitivegroup;
        if let Some(dense) = groups.iter_mut().find(|group| !group.dense.id.is_empty()) {
            let mut node = Node::new();
            node.set_id(dense.dense.id[0]);
            node.set_lon(1);
            node.set_lat(1);
            dense.nodes.push(node);
        }
    });
    for (file, object) in [(way_twice, "w"), (node_twice, "n")] {
        let refused = rasterise(&file);
        assert_eq!(refused.code, Some(INVALID_INPUT), "{refused:?}");
        let words = ["some.osm.pbf", "several versions", "osmium sort", "time-filter"];
        assert!(words.iter().all(|word| refused.stderr.contains(word)), "{refused:?}");
        assert!(refused.stderr.contains(&format!(": {object}")), "{refused:?}");
    }
}

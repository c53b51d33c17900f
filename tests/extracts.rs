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

/// The fields of a message as they are in the file: number, wire type, and content without its length.
fn fields(mut bytes: &[u8]) -> Vec<(u64, u64, Vec<u8>)> {
    fn varint(bytes: &mut &[u8]) -> u64 {
        let end = bytes.iter().position(|byte| *byte < 0x80).expect("a number ends") + 1;
        let value =
            bytes[..end].iter().rev().fold(0, |sum, byte| sum << 7 | u64::from(byte & 0x7f));
        *bytes = &bytes[end..];
        value
    }
    let mut fields = Vec::new();
    while !bytes.is_empty() {
        let tag = varint(&mut bytes);
        let length = match tag & 7 {
            0 => bytes.iter().position(|byte| *byte < 0x80).expect("a number ends") + 1,
            2 => varint(&mut bytes) as usize,
            other => panic!("wire type {other}"),
        };
        fields.push((tag >> 3, tag & 7, bytes[..length].to_vec()));
        bytes = &bytes[length..];
    }
    fields
}

/// A field as bytes.
fn field(number: u64, wire: u64, content: &[u8]) -> Vec<u8> {
    let varint = |mut value: u64| {
        let mut bytes = Vec::new();
        while value >= 0x80 {
            bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        bytes.push(value as u8);
        bytes
    };
    let length = if wire == 2 { varint(content.len() as u64) } else { Vec::new() };
    [varint(number << 3 | wire), length, content.to_vec()].concat()
}

/// A message with its lists written in another way that Protobuf allows: number by number, or in two pieces.
fn relisted(message: &[u8], lists: &[u64], in_pieces: bool) -> Vec<u8> {
    let rewritten = fields(message).into_iter().flat_map(|(number, wire, content)| {
        if wire != 2 || !lists.contains(&number) {
            return field(number, wire, &content);
        }
        let mut numbers: Vec<&[u8]> = content.split_inclusive(|byte| *byte < 0x80).collect();
        if in_pieces {
            let rest = numbers.split_off(numbers.len() / 2);
            return [numbers, rest]
                .iter()
                .flat_map(|piece| field(number, 2, &piece.concat()))
                .collect();
        }
        numbers.iter().flat_map(|one| field(number, 0, one)).collect()
    });
    rewritten.collect()
}

#[test]
fn lists_may_be_written_in_any_way_that_protobuf_allows() {
    let tile = |extract: &[u8]| {
        let scratch = scratch();
        let (osm, out) = (scratch.path().join("some.osm.pbf"), scratch.path().join("tiles"));
        write(&osm, extract);
        let filter = ["--min-buildings", "0", "--min-built", "0"];
        let out_text = out.to_str().expect("UTF-8");
        let osm_text = osm.to_str().expect("UTF-8");
        let arguments =
            [&["rasterise", "--osm", osm_text, "--out", out_text][..], &filter].concat();
        run(arguments).succeeded();
        let sums = String::from_utf8(read(&out.join("SHA256SUMS"))).expect("UTF-8");
        let tiles: Vec<String> =
            sums.lines().filter(|line| line.contains(".npz")).map(str::to_owned).collect();
        assert!(!tiles.is_empty(), "{sums}");
        tiles
    };
    let expected = tile(&plain());
    for in_pieces in [false, true] {
        let file = plain();
        let mut changed = 0;
        let blobs = frames(&file).into_iter().map(|frame| {
            let block = content(&file, &frame);
            if frame.kind != "OSMData" {
                return framed(&frame.kind, &block, Packing::Raw);
            }
            let group = |group: &[u8]| -> Vec<u8> {
                let objects = fields(group).into_iter();
                let objects = objects.flat_map(|(number, wire, object)| {
                    let lists: &[u64] = if number == 3 { &[2, 3, 8] } else { &[1, 8, 9, 10] };
                    let object = match number {
                        2 | 3 => relisted(&object, lists, in_pieces),
                        _ => object,
                    };
                    field(number, wire, &object)
                });
                objects.collect()
            };
            let parts = fields(&block).into_iter().flat_map(|(number, wire, part)| {
                let part = if number == 2 { group(&part) } else { part };
                field(number, wire, &part)
            });
            let rewritten: Vec<u8> = parts.collect();
            changed += usize::from(rewritten != block);
            framed("OSMData", &rewritten, Packing::Zlib)
        });
        let rewritten: Vec<u8> = blobs.flatten().collect();
        assert!(changed > 0);
        assert_eq!(tile(&rewritten), expected);
    }
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

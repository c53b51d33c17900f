//! The content of one decoded blob: strings, nodes, ways, relations.
//!
//! [`check`] establishes once per block what the accessors rely on, so that no index from
//! a file is used unchecked.

use osmpbfreader::osmformat::relation::MemberType;
use osmpbfreader::osmformat::{PrimitiveBlock, Relation, Way};

/// Nodes are stored in units of 10⁻⁷ degrees, OSM's own resolution.
const NANODEGREES_PER_UNIT: i64 = 100;

/// Checks all indices and lengths of a block.
pub(super) fn check(block: &PrimitiveBlock) -> Result<(), String> {
    let strings = block.stringtable.s.len();
    let tags = |what: &str, id: i64, keys: &[u32], values: &[u32]| {
        let inside = keys.iter().chain(values).all(|&index| (index as usize) < strings);
        if keys.len() == values.len() && inside {
            Ok(())
        } else {
            Err(format!("tags of {what} {id} do not fit the string table"))
        }
    };
    for group in &block.primitivegroup {
        let dense = &group.dense;
        if dense.lat.len() != dense.id.len() || dense.lon.len() != dense.id.len() {
            return Err("a dense group has more ids than coordinates, or fewer".to_owned());
        }
        for way in &group.ways {
            tags("way", way.id(), &way.keys, &way.vals)?;
        }
        for relation in &group.relations {
            tags("relation", relation.id(), &relation.keys, &relation.vals)?;
            let members = relation.memids.len();
            let roles = relation
                .roles_sid
                .iter()
                .all(|&role| usize::try_from(role).is_ok_and(|role| role < strings));
            if relation.types.len() != members || relation.roles_sid.len() != members || !roles {
                return Err(format!("members of relation {} are damaged", relation.id()));
            }
        }
    }
    Ok(())
}

/// The text at an index of the string table; text that is not UTF-8 matches no key or value.
fn string(block: &PrimitiveBlock, index: u32) -> &str {
    std::str::from_utf8(&block.stringtable.s[index as usize]).unwrap_or("\u{fffd}")
}

/// The value of a key, by way of parallel index lists.
fn tag<'a>(block: &'a PrimitiveBlock, keys: &[u32], values: &[u32], key: &str) -> Option<&'a str> {
    let matches = |&index: &u32| block.stringtable.s[index as usize].as_slice() == key.as_bytes();
    let position = keys.iter().position(matches)?;
    Some(string(block, values[position]))
}

/// The value of a way's tag.
pub(super) fn way_tag<'a>(block: &'a PrimitiveBlock, way: &Way, key: &str) -> Option<&'a str> {
    tag(block, &way.keys, &way.vals, key)
}

/// The value of a relation's tag.
pub(super) fn relation_tag<'a>(
    block: &'a PrimitiveBlock,
    relation: &Relation,
    key: &str,
) -> Option<&'a str> {
    tag(block, &relation.keys, &relation.vals, key)
}

/// Node ids of a way, in order.
pub(super) fn way_refs(way: &Way) -> Vec<i64> {
    undelta(&way.refs).collect()
}

/// Member ways of a relation with their roles, in order.
pub(super) fn member_ways<'a>(
    block: &'a PrimitiveBlock,
    relation: &'a Relation,
) -> impl Iterator<Item = (i64, &'a str)> {
    undelta(&relation.memids)
        .zip(&relation.types)
        .zip(&relation.roles_sid)
        .filter(|((_, kind), _)| kind.enum_value() == Ok(MemberType::WAY))
        .map(|((id, _), &role)| (id, string(block, role as u32)))
}

/// All nodes of a block: id, longitude and latitude in 10⁻⁷ degrees.
pub(super) fn nodes(block: &PrimitiveBlock) -> impl Iterator<Item = (i64, [i32; 2])> {
    let granularity = i64::from(block.granularity());
    let unit = move |offset: i64, value: i64| {
        let nanodegrees = offset.saturating_add(granularity.saturating_mul(value));
        // Out of range is caught as "not projectable" later on.
        (nanodegrees / NANODEGREES_PER_UNIT).clamp(i32::MIN.into(), i32::MAX.into()) as i32
    };
    let place =
        move |lon: i64, lat: i64| [unit(block.lon_offset(), lon), unit(block.lat_offset(), lat)];
    block.primitivegroup.iter().flat_map(move |group| {
        let plain = group.nodes.iter().map(move |node| (node.id(), place(node.lon(), node.lat())));
        let dense = undelta(&group.dense.id)
            .zip(undelta(&group.dense.lon).zip(undelta(&group.dense.lat)))
            .map(move |(id, (lon, lat))| (id, place(lon, lat)));
        plain.chain(dense)
    })
}

/// Undoes delta coding; sums of a hostile file wrap instead of panicking.
fn undelta(deltas: &[i64]) -> impl Iterator<Item = i64> {
    deltas.iter().scan(0_i64, |sum, &delta| {
        *sum = sum.wrapping_add(delta);
        Some(*sum)
    })
}

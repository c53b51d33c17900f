//! The content of one decoded blob: strings, nodes, ways, relations.
//!
//! [`check`] establishes once per block what the accessors rely on, so that no index from
//! a file is used unchecked.

use osmpbfreader::osmformat::relation::MemberType;
use osmpbfreader::osmformat::{Info, Node, PrimitiveBlock, PrimitiveGroup, Relation, Way};
use protobuf::{CodedInputStream, Message, UnknownValueRef};

use crate::building::{BUILDING, BUILDING_PART};

/// Nodes are stored in units of 10⁻⁷ degrees, OSM's own resolution.
const NANODEGREES_PER_UNIT: i64 = 100;
/// Fields of a way that the feature `LocationsOnWays` adds (OSM wiki, "PBF Format"); the protobuf
/// types do not have them yet.
const WAY_LATITUDES: u32 = 9;
const WAY_LONGITUDES: u32 = 10;

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
        let flags = dense.denseinfo.visible.len();
        if flags > 0 && flags != dense.id.len() {
            return Err("a dense group has more ids than flags, or fewer".to_owned());
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

/// Places of a way's nodes in 10⁻⁷ degrees, where the file keeps them with the way
/// (`LocationsOnWays`); `None` where it does not, or not for all.
pub(super) fn way_places(block: &PrimitiveBlock, way: &Way) -> Option<Box<[[i32; 2]]>> {
    let field = |wanted: u32| {
        let mut fields = way.unknown_fields().iter();
        fields.find_map(|(number, value)| match value {
            UnknownValueRef::LengthDelimited(bytes) if number == wanted => packed(bytes),
            _ => None,
        })
    };
    let (latitudes, longitudes) = (field(WAY_LATITUDES)?, field(WAY_LONGITUDES)?);
    let fits = latitudes.len() == way.refs.len() && longitudes.len() == way.refs.len();
    let place = place_of(block);
    let places = undelta(&longitudes).zip(undelta(&latitudes)).map(|(lon, lat)| place(lon, lat));
    fits.then(|| places.collect())
}

/// Packed signed integers.
fn packed(bytes: &[u8]) -> Option<Vec<i64>> {
    let mut stream = CodedInputStream::from_bytes(bytes);
    let mut values = Vec::new();
    while !stream.eof().ok()? {
        values.push(stream.read_sint64().ok()?);
    }
    Some(values)
}

/// What a relation refers to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MemberId {
    Way(i64),
    Relation(i64),
}

/// Member ways and relations of a relation with their roles, in order.
pub(super) fn members<'a>(
    block: &'a PrimitiveBlock,
    relation: &'a Relation,
) -> impl Iterator<Item = (MemberId, &'a str)> {
    undelta(&relation.memids).zip(&relation.types).zip(&relation.roles_sid).filter_map(
        |((id, kind), &role)| {
            let member = match kind.enum_value() {
                Ok(MemberType::WAY) => MemberId::Way(id),
                Ok(MemberType::RELATION) => MemberId::Relation(id),
                _ => return None,
            };
            Some((member, string(block, role as u32)))
        },
    )
}

/// Whether an object exists, as far as the file says: deleted ones are kept in histories.
pub(super) fn is_visible(info: Option<&Info>) -> bool {
    info.is_none_or(|info| !info.has_visible() || info.visible())
}

/// The version of an object; -1 where the file keeps none.
pub(super) fn version(info: Option<&Info>) -> i32 {
    info.map_or(-1, Info::version)
}

/// All nodes of a block that exist: id, longitude and latitude in 10⁻⁷ degrees.
pub(super) fn nodes(block: &PrimitiveBlock) -> impl Iterator<Item = (i64, [i32; 2])> {
    let place = place_of(block);
    block.primitivegroup.iter().flat_map(move |group| {
        let exists = |node: &&Node| is_visible(node.info.as_ref());
        let plain = group.nodes.iter().filter(exists);
        let plain = plain.map(move |node| (node.id(), place(node.lon(), node.lat())));
        let flags = &group.dense.denseinfo.visible;
        let dense = undelta(&group.dense.id)
            .zip(undelta(&group.dense.lon).zip(undelta(&group.dense.lat)))
            .enumerate()
            .filter(move |(index, _)| flags.get(*index).copied().unwrap_or(true))
            .map(move |(_, (id, (lon, lat)))| (id, place(lon, lat)));
        plain.chain(dense)
    })
}

/// Stored coordinates to longitude and latitude in 10⁻⁷ degrees.
fn place_of(block: &PrimitiveBlock) -> impl Fn(i64, i64) -> [i32; 2] + Copy + use<> {
    let granularity = i64::from(block.granularity());
    let (lon_offset, lat_offset) = (block.lon_offset(), block.lat_offset());
    let unit = move |offset: i64, value: i64| {
        let nanodegrees = offset.saturating_add(granularity.saturating_mul(value));
        // Out of range is caught as "not projectable" later on.
        (nanodegrees / NANODEGREES_PER_UNIT).clamp(i32::MIN.into(), i32::MAX.into()) as i32
    };
    move |lon: i64, lat: i64| [unit(lon_offset, lon), unit(lat_offset, lat)]
}

/// Ids of the nodes of a group that carry building tags. Most blocks do not even have the words.
pub(super) fn building_nodes(block: &PrimitiveBlock, group: &PrimitiveGroup) -> Vec<i64> {
    let strings = block.stringtable.s.iter().enumerate().skip(1);
    let is_key = |text: &[u8]| text == BUILDING.as_bytes() || text == BUILDING_PART.as_bytes();
    let keys: Vec<u32> =
        strings.filter(|(_, text)| is_key(text)).map(|(index, _)| index as u32).collect();
    if keys.is_empty() {
        return Vec::new();
    }
    let plain = group.nodes.iter();
    let plain = plain.filter(|node| node.keys.iter().any(|key| keys.contains(key)));
    let mut found: Vec<i64> = plain.map(Node::id).collect();
    // Tags of dense nodes: pairs of key and value, a zero after those of each node.
    let mut ids = undelta(&group.dense.id);
    let mut tags = group.dense.keys_vals.iter();
    let (mut id, mut is_building) = (ids.next(), false);
    while let (Some(node), Some(&key)) = (id, tags.next()) {
        if key == 0 {
            found.extend(is_building.then_some(node));
            (id, is_building) = (ids.next(), false);
        } else {
            is_building |= u32::try_from(key).is_ok_and(|key| keys.contains(&key));
            tags.next();
        }
    }
    found
}

/// Undoes delta coding; sums of a hostile file wrap instead of panicking.
fn undelta(deltas: &[i64]) -> impl Iterator<Item = i64> {
    deltas.iter().scan(0_i64, |sum, &delta| {
        *sum = sum.wrapping_add(delta);
        Some(*sum)
    })
}

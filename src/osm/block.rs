//! The content of one unpacked blob: strings, nodes, ways, relations (OSM wiki, "PBF Format").
//!
//! A [`BlockView`] points into the bytes. [`BlockView::read`] establishes once what the accessors rely on, so
//! that no index from a file is used unchecked.

use super::wire::{Fields, Malformed, Varints, WireValue};
use crate::building::{BUILDING, BUILDING_PART};

/// Nodes are stored in units of 10⁻⁷ degrees, OSM's own resolution.
const NANODEGREES_PER_UNIT: i64 = 100;

/// Why bytes are no block.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum BlockError {
    /// The bytes are no message, or one that no usual writer writes: a list that is not packed, or in
    /// several pieces. The crate `protobuf` can tell which, and rewrite it.
    #[error("no message of the format")]
    Malformed,
    /// Indices or lengths do not fit each other.
    #[error("{0}")]
    Inconsistent(String),
}

impl From<Malformed> for BlockError {
    fn from(_: Malformed) -> Self {
        Self::Malformed
    }
}

/// One block of a file (`PrimitiveBlock`).
#[derive(Debug)]
pub(super) struct BlockView<'a> {
    strings: Vec<&'a [u8]>,
    pub(super) nodes: Vec<Node>,
    pub(super) dense: Vec<DenseNodes<'a>>,
    pub(super) ways: Vec<Way<'a>>,
    pub(super) relations: Vec<Relation<'a>>,
    unit: Unit,
    /// Indices of the keys that make a node a building, of the few blocks that have one.
    building_keys: Vec<u64>,
}

/// What an object's metadata tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Info {
    /// -1 where the file keeps none.
    pub(super) version: i32,
    /// Whether the object exists, as far as the file says: deleted ones are kept in histories.
    pub(super) is_visible: bool,
}

/// A single node.
#[derive(Debug)]
pub(super) struct Node {
    id: i64,
    place: [i32; 2],
    is_visible: bool,
    is_building: bool,
}

/// Many nodes, column by column.
#[derive(Debug)]
pub(super) struct DenseNodes<'a> {
    ids: Varints<'a>,
    latitudes: Varints<'a>,
    longitudes: Varints<'a>,
    /// Pairs of key and value, a zero after those of each node.
    tags: Varints<'a>,
    visible: Varints<'a>,
}

/// A way.
#[derive(Debug)]
pub(super) struct Way<'a> {
    pub(super) id: i64,
    pub(super) info: Info,
    tags: Tags<'a>,
    refs: Varints<'a>,
    /// Places of the nodes: the feature `LocationsOnWays`.
    latitudes: Varints<'a>,
    longitudes: Varints<'a>,
}

/// A relation.
#[derive(Debug)]
pub(super) struct Relation<'a> {
    pub(super) id: i64,
    pub(super) info: Info,
    tags: Tags<'a>,
    roles: Varints<'a>,
    members: Varints<'a>,
    kinds: Varints<'a>,
}

/// What ways and relations have in common, by their fields: tags, and the lists 8 to 10.
struct TaggedLists<'a> {
    id: i64,
    info: Info,
    tags: Tags<'a>,
    lists: [Varints<'a>; 3],
}

/// What a relation refers to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MemberId {
    Way(i64),
    Relation(i64),
}

/// Keys and values of an object, by their indices in the string table.
#[derive(Debug, Clone, Copy, Default)]
struct Tags<'a> {
    keys: Varints<'a>,
    values: Varints<'a>,
}

/// How stored coordinates count.
#[derive(Debug, Clone, Copy)]
struct Unit {
    granularity: i64,
    lon_offset: i64,
    lat_offset: i64,
}

impl Unit {
    /// Longitude and latitude in 10⁻⁷ degrees.
    fn place(self, lon: i64, lat: i64) -> [i32; 2] {
        let unit = |offset: i64, value: i64| {
            let nanodegrees = offset.saturating_add(self.granularity.saturating_mul(value));
            // Out of range is caught as "not projectable" later on.
            (nanodegrees / NANODEGREES_PER_UNIT).clamp(i32::MIN.into(), i32::MAX.into()) as i32
        };
        [unit(self.lon_offset, lon), unit(self.lat_offset, lat)]
    }
}

/// Takes a list that a message holds once.
fn once<'a>(list: &mut Varints<'a>, value: WireValue<'a>) -> Result<(), Malformed> {
    let is_first = list.is_empty();
    *list = value.packed()?;
    if is_first { Ok(()) } else { Err(Malformed) }
}

impl<'a> BlockView<'a> {
    /// Finds the objects of a block, and checks all indices and lengths.
    pub(super) fn read(bytes: &'a [u8]) -> Result<Self, BlockError> {
        let mut block = Self {
            strings: Vec::new(),
            nodes: Vec::new(),
            dense: Vec::new(),
            ways: Vec::new(),
            relations: Vec::new(),
            unit: Unit { granularity: 100, lon_offset: 0, lat_offset: 0 },
            building_keys: Vec::new(),
        };
        let mut groups = Vec::new();
        for field in Fields::of(bytes) {
            match field? {
                (1, table) => block.read_strings(table.bytes()?)?,
                (2, group) => groups.push(group.bytes()?),
                (17, granularity) => block.unit.granularity = granularity.int()?,
                (19, offset) => block.unit.lat_offset = offset.int()?,
                (20, offset) => block.unit.lon_offset = offset.int()?,
                _ => {}
            }
        }
        // The table and the units may follow the groups.
        for group in groups {
            block.read_group(group)?;
        }
        Ok(block)
    }

    fn read_strings(&mut self, table: &'a [u8]) -> Result<(), Malformed> {
        for field in Fields::of(table) {
            let (number, text) = field?;
            if number == 1 {
                let text = text.bytes()?;
                let is_key = text == BUILDING.as_bytes() || text == BUILDING_PART.as_bytes();
                // The first string is empty and stands for nothing.
                if is_key && !self.strings.is_empty() {
                    self.building_keys.push(self.strings.len() as u64);
                }
                self.strings.push(text);
            }
        }
        Ok(())
    }

    fn read_group(&mut self, group: &'a [u8]) -> Result<(), BlockError> {
        for field in Fields::of(group) {
            match field? {
                (1, node) => {
                    let node = Node::read(node.bytes()?, self)?;
                    self.nodes.push(node);
                }
                (2, nodes) => self.dense.push(DenseNodes::read(nodes.bytes()?)?),
                (3, way) => {
                    let way = Way::read(way.bytes()?)?;
                    self.check_tags("way", way.id, way.tags)?;
                    self.ways.push(way);
                }
                (4, relation) => {
                    let relation = Relation::read(relation.bytes()?)?;
                    self.check_tags("relation", relation.id, relation.tags)?;
                    self.check_members(&relation)?;
                    self.relations.push(relation);
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn check_tags(
        &self,
        what: &str,
        id: i64,
        Tags { keys, values }: Tags<'_>,
    ) -> Result<(), BlockError> {
        let strings = self.strings.len() as u64;
        let inside = keys.varints().chain(values.varints()).all(|index| index < strings);
        if keys.len() == values.len() && inside {
            return Ok(());
        }
        Err(BlockError::Inconsistent(format!("tags of {what} {id} do not fit the string table")))
    }

    fn check_members(&self, relation: &Relation<'_>) -> Result<(), BlockError> {
        let Relation { id, roles, members, kinds, .. } = relation;
        let strings = self.strings.len() as u64;
        let inside = roles.varints().all(|role| role < strings);
        if members.len() == kinds.len() && members.len() == roles.len() && inside {
            return Ok(());
        }
        Err(BlockError::Inconsistent(format!("members of relation {id} are damaged")))
    }

    pub(super) fn has_nodes(&self) -> bool {
        !self.nodes.is_empty() || self.dense.iter().any(|dense| !dense.ids.is_empty())
    }

    /// The text at an index of the string table; text that is not UTF-8 matches no key or value.
    fn string(&self, index: u64) -> &'a str {
        std::str::from_utf8(self.strings[index as usize]).unwrap_or("\u{fffd}")
    }

    fn tag(&self, tags: Tags<'a>, key: &str) -> Option<&'a str> {
        let is_key = |index: u64| self.strings[index as usize] == key.as_bytes();
        let mut tags = tags.keys.varints().zip(tags.values.varints());
        tags.find(|(index, _)| is_key(*index)).map(|(_, value)| self.string(value))
    }

    /// The value of a way's tag.
    pub(super) fn way_tag(&self, way: &Way<'a>, key: &str) -> Option<&'a str> {
        self.tag(way.tags, key)
    }

    /// The value of a relation's tag.
    pub(super) fn relation_tag(&self, relation: &Relation<'a>, key: &str) -> Option<&'a str> {
        self.tag(relation.tags, key)
    }

    /// Places of a way's nodes in 10⁻⁷ degrees, where the file keeps them with the way
    /// (`LocationsOnWays`); `None` where it does not, or not for all.
    pub(super) fn way_places(&self, way: &Way<'_>) -> Option<Box<[[i32; 2]]>> {
        let nodes = way.refs.len();
        let fits = way.latitudes.len() == nodes && way.longitudes.len() == nodes && nodes > 0;
        let places = way.longitudes.undelta().zip(way.latitudes.undelta());
        fits.then(|| places.map(|(lon, lat)| self.unit.place(lon, lat)).collect())
    }

    /// Member ways and relations of a relation with their roles, in order.
    pub(super) fn members(
        &self,
        relation: &Relation<'a>,
    ) -> impl Iterator<Item = (MemberId, &'a str)> {
        let Relation { members, kinds, roles, .. } = *relation;
        members.undelta().zip(kinds.varints()).zip(roles.varints()).filter_map(
            |((id, kind), role)| {
                let member = match kind {
                    1 => MemberId::Way(id),
                    2 => MemberId::Relation(id),
                    _ => return None,
                };
                Some((member, self.string(role)))
            },
        )
    }

    /// All nodes of a block that exist: id, longitude and latitude in 10⁻⁷ degrees.
    pub(super) fn places(&self) -> impl Iterator<Item = (i64, [i32; 2])> {
        let plain = self.nodes.iter().filter(|node| node.is_visible);
        let plain = plain.map(|node| (node.id, node.place));
        plain.chain(self.dense.iter().flat_map(|dense| {
            let mut visible = dense.visible.varints();
            let places = dense.longitudes.undelta().zip(dense.latitudes.undelta());
            let nodes = dense.ids.undelta().zip(places);
            let nodes = nodes.filter(move |_| visible.next().is_none_or(|flag| flag != 0));
            nodes.map(|(id, (lon, lat))| (id, self.unit.place(lon, lat)))
        }))
    }

    /// Ids of the nodes that carry building tags. Most blocks do not even have the words.
    pub(super) fn building_nodes(&self) -> Vec<i64> {
        if self.building_keys.is_empty() {
            return Vec::new();
        }
        let plain = self.nodes.iter().filter(|node| node.is_building);
        let mut found: Vec<i64> = plain.map(|node| node.id).collect();
        for dense in &self.dense {
            let mut ids = dense.ids.undelta();
            let mut tags = dense.tags.varints();
            let (mut id, mut is_building) = (ids.next(), false);
            while let (Some(node), Some(key)) = (id, tags.next()) {
                if key == 0 {
                    found.extend(is_building.then_some(node));
                    (id, is_building) = (ids.next(), false);
                } else {
                    is_building |= self.building_keys.contains(&key);
                    tags.next();
                }
            }
        }
        found
    }
}

impl Node {
    fn read(bytes: &[u8], block: &BlockView<'_>) -> Result<Self, Malformed> {
        let (mut id, mut lat, mut lon) = (None, None, None);
        let (mut keys, mut info) = (Varints::default(), Info::default());
        for field in Fields::of(bytes) {
            match field? {
                (1, value) => id = Some(value.sint()?),
                (2, list) => once(&mut keys, list)?,
                (4, message) => info.merge(message.bytes()?)?,
                (8, value) => lat = Some(value.sint()?),
                (9, value) => lon = Some(value.sint()?),
                _ => {}
            }
        }
        let (Some(id), Some(lat), Some(lon)) = (id, lat, lon) else { return Err(Malformed) };
        let is_building = keys.varints().any(|key| block.building_keys.contains(&key));
        let place = block.unit.place(lon, lat);
        Ok(Self { id, place, is_visible: info.is_visible, is_building })
    }
}

impl<'a> DenseNodes<'a> {
    fn read(bytes: &'a [u8]) -> Result<Self, BlockError> {
        let [mut ids, mut latitudes, mut longitudes, mut tags, mut visible] =
            [Varints::default(); 5];
        for field in Fields::of(bytes) {
            match field? {
                (1, list) => once(&mut ids, list)?,
                (5, info) => {
                    for field in Fields::of(info.bytes()?) {
                        if let (6, list) = field? {
                            once(&mut visible, list)?;
                        }
                    }
                }
                (8, list) => once(&mut latitudes, list)?,
                (9, list) => once(&mut longitudes, list)?,
                (10, list) => once(&mut tags, list)?,
                _ => {}
            }
        }
        let nodes = ids.len();
        let unlike = |what: &str| {
            let text = format!("a dense group has more ids than {what}, or fewer");
            Err(BlockError::Inconsistent(text))
        };
        if latitudes.len() != nodes || longitudes.len() != nodes {
            return unlike("coordinates");
        }
        if !visible.is_empty() && visible.len() != nodes {
            return unlike("flags");
        }
        Ok(Self { ids, latitudes, longitudes, tags, visible })
    }
}

impl<'a> TaggedLists<'a> {
    fn read(bytes: &'a [u8]) -> Result<Self, Malformed> {
        let (mut id, mut info, mut tags) = (None, Info::default(), Tags::default());
        let mut lists = [Varints::default(); 3];
        for field in Fields::of(bytes) {
            match field? {
                (1, value) => id = Some(value.int()?),
                (2, list) => once(&mut tags.keys, list)?,
                (3, list) => once(&mut tags.values, list)?,
                (4, message) => info.merge(message.bytes()?)?,
                (8, list) => once(&mut lists[0], list)?,
                (9, list) => once(&mut lists[1], list)?,
                (10, list) => once(&mut lists[2], list)?,
                _ => {}
            }
        }
        Ok(Self { id: id.ok_or(Malformed)?, info, tags, lists })
    }
}

impl<'a> Way<'a> {
    fn read(bytes: &'a [u8]) -> Result<Self, Malformed> {
        let TaggedLists { id, info, tags, lists } = TaggedLists::read(bytes)?;
        let [refs, latitudes, longitudes] = lists;
        Ok(Self { id, info, tags, refs, latitudes, longitudes })
    }

    /// Ids of its nodes, in order.
    pub(super) fn refs(&self) -> Vec<i64> {
        let mut refs = Vec::with_capacity(self.refs.len());
        refs.extend(self.refs.undelta());
        refs
    }
}

impl<'a> Relation<'a> {
    fn read(bytes: &'a [u8]) -> Result<Self, Malformed> {
        let TaggedLists { id, info, tags, lists } = TaggedLists::read(bytes)?;
        let [roles, members, kinds] = lists;
        Ok(Self { id, info, tags, roles, members, kinds })
    }
}

impl Default for Info {
    fn default() -> Self {
        Self { version: -1, is_visible: true }
    }
}

impl Info {
    fn merge(&mut self, bytes: &[u8]) -> Result<(), Malformed> {
        for field in Fields::of(bytes) {
            match field? {
                // An int32 is written as 64 bits.
                (1, version) => self.version = version.int()? as i32,
                (6, flag) => self.is_visible = flag.varint()? != 0,
                _ => {}
            }
        }
        Ok(())
    }
}

//! The passes over the extracts, and their result.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::PathBuf;

use super::assemble::{MAX_DEPTH, Members, Projector};
use super::block::{MemberId, Way};
use super::build::{Found, build};
use super::copies::{MemberWay, whole_members, whole_relations, whole_ways};
use super::footprint::Role;
use super::nodes::NodeTable;
use super::pbf::{PbfError, PbfFile};
use super::scan::{FileOrder, Finds, RawRelation, RawWay, find_buildings};
use super::zone;
use crate::building::{Action, City, Defect, Kind, ObjectId, Problem, told_height};
use crate::config::BuildingsConfig;
use crate::crs::{CrsError, Utm};
use crate::error::{Fault, HasFault};
use crate::grid::Area;
use crate::progress::Progress;

/// Why no buildings could be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExtractError {
    /// A file cannot be read.
    #[error(transparent)]
    Pbf(#[from] PbfError),
    /// The area has no UTM zone, or the configured code is none.
    #[error(transparent)]
    Crs(#[from] CrsError),
    /// The buildings lie in another part of the world than the area.
    #[error(
        "the area lies elsewhere: the buildings are around longitude {lon:.4}, latitude {lat:.4}, \
         out of reach of EPSG:{epsg}; check --bbox, --area and --epsg"
    )]
    Elsewhere {
        /// The projection of the area.
        epsg: u32,
        /// Longitude of one of most buildings, in degrees.
        lon: f64,
        /// Latitude of one of most buildings, in degrees.
        lat: f64,
    },
    /// There is nothing to rasterise.
    #[error(
        "no buildings in {}: {found} objects have building tags, none has a usable footprint; \
         extracts made with a tag filter must keep building=* and the nodes of ways",
        list(files)
    )]
    NoBuildings {
        /// The extracts.
        files: Vec<PathBuf>,
        /// Objects with building tags.
        found: usize,
    },
}

impl HasFault for ExtractError {
    fn fault(&self) -> Fault {
        match self {
            Self::Pbf(error) => error.fault(),
            Self::Crs(_) | Self::Elsewhere { .. } | Self::NoBuildings { .. } => Fault::Input,
        }
    }
}

fn list(files: &[PathBuf]) -> String {
    files.iter().map(|file| file.display().to_string()).collect::<Vec<_>>().join(", ")
}

/// All buildings of the extracts.
#[derive(Debug)]
pub struct Extract {
    /// Buildings and parts, ways first, each in the order of the files.
    pub city: City,
    /// The projection of their footprints.
    pub utm: Utm,
    /// What was skipped, repaired, left out or noted; sorted, at most once for each object and code.
    pub problems: Vec<Problem>,
    /// Objects with building tags: those of the city, and those that a problem's action says are not.
    pub tagged: u64,
}

/// An open file and which of its blobs hold what.
struct Extracted {
    file: PbfFile,
    node_blobs: Vec<usize>,
    way_blobs: Vec<usize>,
    relation_blobs: Vec<usize>,
}

/// Reads the buildings of one or several extracts. Of an object that several hold the whole copy is
/// taken.
///
/// The projection is `epsg` if given, else the UTM zone of the area's middle, else that of most
/// buildings.
///
/// # Errors
/// [`ExtractError`]; defects of single objects are no errors but listed in the result.
pub fn read_buildings(
    files: &[PathBuf],
    config: &BuildingsConfig,
    epsg: Option<u32>,
    area: &Area,
    progress: &dyn Progress,
) -> Result<Extract, ExtractError> {
    let open = files.iter().map(|path| PbfFile::open(path)).collect::<Result<Vec<_>, _>>()?;
    for file in &open {
        for feature in file.unknown_features() {
            let path = file.path().display();
            progress.note(&format!(
                "{path}: the optional feature {feature:?} is not known, and not used"
            ));
        }
    }
    let (extracts, Finds { ways, relations, mut problems, .. }) =
        read_tags(open, config, progress)?;

    let relations_within = read_relations(&extracts, &relations, progress)?;
    let members = read_members(&extracts, &relations, &relations_within, config, progress)?;
    let nodes = read_nodes(&extracts, &ways, &members, progress)?;
    drop(extracts);
    let members = Members { ways: whole_members(members, &nodes), relations: relations_within };
    let ways = whole_ways(ways, &nodes, &mut problems);
    let relations = whole_relations(relations, &members.ways, &mut problems);
    let tagged = count_tagged(&ways, &relations, &mut problems);

    let of_most = || zone::of_most(&ways, &relations, &members, &nodes);
    let no_buildings =
        || ExtractError::NoBuildings { files: files.to_owned(), found: tagged as usize };
    let utm = match (epsg, area.middle()) {
        (Some(epsg), _) => Utm::from_epsg(epsg)?,
        (None, Some([lon, lat])) => Utm::of_place(lon, lat)?,
        (None, None) => of_most().ok_or_else(no_buildings)?.0,
    };
    let projector = Projector { nodes: &nodes, utm };
    let Found { buildings, named } = build(&ways, &relations, &members, &projector, &mut problems);
    if buildings.is_empty() {
        let is_far = problems.iter().any(|problem| problem.defect == Defect::NotProjectable);
        return Err(match of_most() {
            Some((_, [lon, lat])) if is_far => {
                ExtractError::Elsewhere { epsg: utm.epsg(), lon, lat }
            }
            _ => no_buildings(),
        });
    }
    progress.begin("grouping buildings and parts", None);
    let city = City::new(buildings, &named, config);
    progress.end();
    problems.extend(raised(&city));
    problems.sort_unstable();
    problems.dedup();
    Ok(Extract { city, utm, problems, tagged })
}

/// First pass: ways and relations with building tags.
fn read_tags(
    files: Vec<PbfFile>,
    config: &BuildingsConfig,
    progress: &dyn Progress,
) -> Result<(Vec<Extracted>, Finds), PbfError> {
    let blobs = files.iter().map(|file| file.len() as u64).sum();
    progress.begin("reading building tags", Some(blobs));
    let (mut all, mut extracts) = (Finds::default(), Vec::new());
    for file in files {
        let every: Vec<usize> = (0..file.len()).collect();
        let finds = file.map(&every, progress, |block| find_buildings(block, config))?;
        let blobs = |holds: &dyn Fn(&Finds) -> bool| {
            every.iter().copied().filter(|&blob| holds(&finds[blob])).collect::<Vec<_>>()
        };
        let node_blobs = blobs(&|finds| finds.has_nodes);
        let way_blobs = blobs(&|finds| finds.has_ways);
        let relation_blobs = blobs(&|finds| finds.has_relations);
        let (mut order, ways_before) = (FileOrder::default(), all.ways.len());
        let relations_before = all.relations.len();
        for find in finds {
            order.append(&find.order);
            all.ways.extend(find.ways);
            all.relations.extend(find.relations);
            all.problems.extend(find.problems);
        }
        let of_file = (&all.ways[ways_before..], &all.relations[relations_before..]);
        let repeated = order
            .repeated
            .or_else(|| order.is_mixed.then(|| another_version(of_file.0, of_file.1)).flatten());
        if let Some(object) = repeated {
            return Err(file.several_versions(object));
        }
        extracts.push(Extracted { file, node_blobs, way_blobs, relation_blobs });
    }
    progress.end();
    Ok((extracts, all))
}

/// An object of a file that is there in two versions, in a file that is not sorted.
fn another_version(ways: &[RawWay], relations: &[RawRelation]) -> Option<ObjectId> {
    let ways = ways.iter().map(|way| (ObjectId::Way(way.id), way.version));
    let relations =
        relations.iter().map(|relation| (ObjectId::Relation(relation.id), relation.version));
    let mut versions = HashMap::new();
    let mut objects = ways.chain(relations);
    let other =
        objects.find(|(object, version)| *versions.entry(*object).or_insert(*version) != *version);
    other.map(|(object, _)| object)
}

/// Members of relations that are members of relations, as far as they are needed.
fn read_relations(
    extracts: &[Extracted],
    relations: &[RawRelation],
    progress: &dyn Progress,
) -> Result<HashMap<i64, Vec<(MemberId, Role)>>, PbfError> {
    let inner = |members: &[(MemberId, Role)]| -> Vec<i64> {
        let ids = members.iter().filter_map(|(member, _)| match member {
            MemberId::Relation(id) => Some(*id),
            MemberId::Way(_) => None,
        });
        ids.collect()
    };
    let mut found: HashMap<i64, Vec<(MemberId, Role)>> = HashMap::new();
    let mut wanted: HashSet<i64> =
        relations.iter().flat_map(|relation| inner(&relation.members)).collect();
    for _ in 0..MAX_DEPTH {
        if wanted.is_empty() {
            break;
        }
        let blobs = extracts.iter().map(|extract| extract.relation_blobs.len() as u64).sum();
        progress.begin("reading relations in relations", Some(blobs));
        let mut next = HashSet::new();
        for Extracted { file, relation_blobs, .. } in extracts {
            let finds = file.map(relation_blobs, progress, |block| {
                let relations = block.relations.iter();
                let wanted = relations.filter(|relation| wanted.contains(&relation.id));
                let rings = wanted.map(|relation| {
                    let members = block.members(relation);
                    let rings = members.filter_map(|(member, role)| match role {
                        "outline" => Some((member, Role::Outer)),
                        role => Some((member, Role::of(role)?)),
                    });
                    (relation.id, rings.collect::<Vec<_>>())
                });
                rings.collect::<Vec<_>>()
            })?;
            for (id, members) in finds.into_iter().flatten() {
                next.extend(inner(&members));
                // Of several copies the one with most members.
                let known = found.entry(id).or_default();
                if members.len() > known.len() {
                    *known = members;
                }
            }
        }
        progress.end();
        next.retain(|id| !found.contains_key(id));
        wanted = next;
    }
    Ok(found)
}

/// The nodes and heights of member ways of relations, all copies of each.
fn read_members(
    extracts: &[Extracted],
    relations: &[RawRelation],
    within: &HashMap<i64, Vec<(MemberId, Role)>>,
    config: &BuildingsConfig,
    progress: &dyn Progress,
) -> Result<Vec<(i64, MemberWay)>, PbfError> {
    let members = relations.iter().map(|relation| &relation.members).chain(within.values());
    let wanted: HashSet<i64> = members
        .flatten()
        .filter_map(|(member, _)| match member {
            MemberId::Way(id) => Some(*id),
            MemberId::Relation(_) => None,
        })
        .collect();
    let mut found = Vec::with_capacity(wanted.len());
    if wanted.is_empty() {
        return Ok(found);
    }
    let blobs = extracts.iter().map(|extract| extract.way_blobs.len() as u64).sum();
    progress.begin("reading multipolygon members", Some(blobs));
    for Extracted { file, way_blobs, .. } in extracts {
        let finds = file.map(way_blobs, progress, |block| {
            let wanted = |way: &&Way<'_>| way.info.is_visible && wanted.contains(&way.id);
            let wanted = block.ways.iter().filter(wanted);
            let member = |way| {
                let tag = |key: &str| block.way_tag(way, key);
                let found = MemberWay {
                    version: way.info.version,
                    refs: way.refs(),
                    places: block.way_places(way),
                    told: told_height(&tag, 0.0, config, &mut vec![]),
                };
                (way.id, found)
            };
            wanted.map(member).collect::<Vec<_>>()
        })?;
        found.extend(finds.into_iter().flatten());
    }
    progress.end();
    Ok(found)
}

/// Last pass: coordinates of the nodes in use.
fn read_nodes(
    extracts: &[Extracted],
    ways: &[RawWay],
    members: &[(i64, MemberWay)],
    progress: &dyn Progress,
) -> Result<NodeTable, PbfError> {
    let of_ways = ways.iter().map(|way| (&way.refs, &way.places));
    let of_members = members.iter().map(|(_, way)| (&way.refs, &way.places));
    let used = || of_ways.clone().chain(of_members.clone());
    let mut nodes = NodeTable::new(used().flat_map(|(refs, _)| refs).copied().collect());
    let blobs = extracts.iter().map(|extract| extract.node_blobs.len() as u64).sum();
    progress.begin("reading node coordinates", Some(blobs));
    for Extracted { file, node_blobs, .. } in extracts {
        let finds = file.map(node_blobs, progress, |block| nodes.find(block))?;
        if let Some(id) = nodes.contradiction(&finds) {
            return Err(file.several_versions(ObjectId::Node(id)));
        }
        for found in finds {
            nodes.enter(found);
        }
    }
    for (refs, places) in used() {
        if let Some(places) = places {
            nodes.enter_places(refs, places);
        }
    }
    progress.end();
    Ok(nodes)
}

/// Counts the objects with building tags. One that is a building in one copy and none in another
/// is a building.
fn count_tagged(ways: &[RawWay], relations: &[RawRelation], problems: &mut Vec<Problem>) -> u64 {
    let is_out = |problem: &Problem| matches!(problem.action, Action::LeftOut | Action::Skipped);
    let mut out: BTreeMap<ObjectId, Defect> = BTreeMap::new();
    for problem in problems.iter().filter(|problem| is_out(problem)) {
        out.entry(problem.object).or_insert(problem.defect);
    }
    let ways = ways.iter().map(|way| ObjectId::Way(way.id));
    let relations = relations.iter().filter(|relation| relation.attributes.is_some());
    let relations = relations.map(|relation| ObjectId::Relation(relation.id));
    let mut kept = 0;
    for object in ways.chain(relations) {
        kept += 1;
        out.remove(&object);
    }
    problems.retain(|problem| {
        !is_out(problem) || out.get(&problem.object).is_some_and(|first| *first == problem.defect)
    });
    kept + out.len() as u64
}

/// A row for what is raised outside of every outline.
fn raised(city: &City) -> impl Iterator<Item = Problem> {
    let buildings = city.buildings().iter().enumerate();
    let raised = buildings.filter(|(at, building)| {
        let attributes = &building.attributes;
        attributes.raised && (attributes.kind == Kind::Outline || city.outlines_of(*at).is_empty())
    });
    raised.map(|(_, building)| Problem::new(building.object, Defect::Raised))
}

//! The three passes over the extracts, and their result.

use std::collections::{HashMap, HashSet};
use std::path::PathBuf;

use geo::{MultiPolygon, Polygon};
use osmpbfreader::osmformat::PrimitiveBlock;
use rayon::prelude::*;

use super::assemble::{Projector, RawRelation, RawWay, relation_footprint, way_footprint};
use super::block;
use super::footprint::Role;
use super::nodes::NodeTable;
use super::pbf::{PbfError, PbfFile};
use crate::building::{Building, Classified, Defect, ObjectId, Problem, classify};
use crate::config::BuildingsConfig;
use crate::crs::{CrsError, Utm};
use crate::error::{Fault, HasFault};
use crate::grid::Area;
use crate::progress::Progress;

/// Why no buildings could be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
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
        /// Longitude of the middle of all buildings, in degrees.
        lon: f64,
        /// Latitude of the middle of all buildings, in degrees.
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

impl HasFault for ReadError {
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
    pub buildings: Vec<Building>,
    /// The projection of their footprints.
    pub utm: Utm,
    /// What was skipped, repaired or left out; sorted, at most once for each object and code.
    pub problems: Vec<Problem>,
}

/// What the first pass finds in one block.
#[derive(Default)]
struct Finds {
    has_nodes: bool,
    has_ways: bool,
    ways: Vec<RawWay>,
    relations: Vec<RawRelation>,
    problems: Vec<Problem>,
}

/// Reads the buildings of one or several extracts. An object that several hold is taken
/// from the first.
///
/// The projection is `epsg` if given, else the UTM zone of the area's middle, else that of
/// the middle of all buildings.
///
/// # Errors
/// [`ReadError`]; defects of single objects are no errors but listed in the result.
pub fn read_buildings(
    files: &[PathBuf],
    config: &BuildingsConfig,
    epsg: Option<u32>,
    area: &Area,
    progress: &dyn Progress,
) -> Result<Extract, ReadError> {
    let files_open = files.iter().map(|path| PbfFile::open(path)).collect::<Result<Vec<_>, _>>()?;
    let blobs = files_open.iter().map(|file| file.len() as u64).sum();

    progress.begin("reading building tags", Some(blobs));
    let mut found = Finds::default();
    // Which blobs of each file hold nodes, and which ways.
    let (mut node_blobs, mut way_blobs) = (Vec::new(), Vec::new());
    for file in &files_open {
        let every: Vec<usize> = (0..file.len()).collect();
        let finds = file.map(&every, progress, |block| find_buildings(block, config))?;
        node_blobs.push(every.iter().copied().filter(|&blob| finds[blob].has_nodes).collect());
        way_blobs.push(every.iter().copied().filter(|&blob| finds[blob].has_ways).collect());
        for find in finds {
            found.ways.extend(find.ways);
            found.relations.extend(find.relations);
            found.problems.extend(find.problems);
        }
    }
    progress.end();
    let Finds { mut ways, mut relations, mut problems, .. } = found;
    drop_duplicates(&mut ways, &mut relations, &mut problems);
    let found = ways.len() + relations.len();

    let members = read_members(&files_open, &way_blobs, &relations, progress)?;
    let nodes = read_nodes(&files_open, &node_blobs, &ways, &members, progress)?;
    drop(files_open);

    let utm = match (epsg, area.middle().or_else(|| nodes.middle())) {
        (Some(epsg), _) => Utm::from_epsg(epsg)?,
        (None, Some([lon, lat])) => Utm::of_place(lon, lat)?,
        (None, None) => {
            return Err(ReadError::NoBuildings { files: files.to_owned(), found });
        }
    };
    let projector = Projector { nodes: &nodes, utm };
    let buildings = build(&ways, &relations, &members, &projector, &mut problems);
    let unprojectable = |problem: &Problem| problem.defect == Defect::NotProjectable;
    if buildings.is_empty() && problems.iter().any(unprojectable) {
        let [lon, lat] = nodes.middle().unwrap_or([f64::NAN; 2]);
        return Err(ReadError::Elsewhere { epsg: utm.epsg(), lon, lat });
    }
    if buildings.is_empty() {
        return Err(ReadError::NoBuildings { files: files.to_owned(), found });
    }
    problems.sort_unstable();
    problems.dedup();
    Ok(Extract { buildings, utm, problems })
}

/// First pass: ways and relations with building tags.
fn find_buildings(block: &PrimitiveBlock, config: &BuildingsConfig) -> Finds {
    let mut finds = Finds::default();
    for group in &block.primitivegroup {
        finds.has_nodes |= !group.nodes.is_empty() || !group.dense.id.is_empty();
        finds.has_ways |= !group.ways.is_empty();
        for way in &group.ways {
            let classified = classify(|key| block::way_tag(block, way, key), config);
            let object = ObjectId::Way(way.id());
            if let Some(attributes) = finds.note(object, classified) {
                finds.ways.push(RawWay { id: way.id(), refs: block::way_refs(way), attributes });
            }
        }
        for relation in &group.relations {
            let tag = |key: &str| block::relation_tag(block, relation, key);
            if tag("type") != Some("multipolygon") {
                continue;
            }
            let object = ObjectId::Relation(relation.id());
            if let Some(attributes) = finds.note(object, classify(tag, config)) {
                let members = block::member_ways(block, relation)
                    .map(|(id, role)| match role {
                        "outer" => (id, Role::Outer),
                        "inner" => (id, Role::Inner),
                        _ => (id, Role::Any),
                    })
                    .collect();
                finds.relations.push(RawRelation { id: relation.id(), members, attributes });
            }
        }
    }
    finds
}

impl Finds {
    /// Keeps what is wrong with an object, and returns its attributes if it is a building.
    fn note(
        &mut self,
        object: ObjectId,
        classified: Classified,
    ) -> Option<crate::building::Attributes> {
        let (attributes, defects) = match classified {
            Classified::Unrelated => (None, vec![]),
            Classified::LeftOut(defect) => (None, vec![defect]),
            Classified::Building(attributes, defects) => (Some(attributes), defects),
        };
        self.problems.extend(defects.into_iter().map(|defect| Problem { object, defect }));
        attributes
    }
}

/// Keeps the first of several objects with one id.
fn drop_duplicates(
    ways: &mut Vec<RawWay>,
    relations: &mut Vec<RawRelation>,
    problems: &mut Vec<Problem>,
) {
    let mut seen = HashSet::new();
    let mut is_first = |object: ObjectId| {
        let first = seen.insert(object);
        if !first {
            problems.push(Problem { object, defect: Defect::DuplicateObject });
        }
        first
    };
    ways.retain(|way| is_first(ObjectId::Way(way.id)));
    relations.retain(|relation| is_first(ObjectId::Relation(relation.id)));
}

/// Second pass: the nodes of member ways of kept relations.
fn read_members(
    files: &[PbfFile],
    way_blobs: &[Vec<usize>],
    relations: &[RawRelation],
    progress: &dyn Progress,
) -> Result<HashMap<i64, Vec<i64>>, PbfError> {
    let wanted: HashSet<i64> =
        relations.iter().flat_map(|relation| relation.members.iter().map(|(id, _)| *id)).collect();
    let mut members = HashMap::with_capacity(wanted.len());
    if wanted.is_empty() {
        return Ok(members);
    }
    progress.begin("reading multipolygon members", Some(count(way_blobs)));
    for (file, blobs) in files.iter().zip(way_blobs) {
        let finds = file.map(blobs, progress, |block| {
            let ways = block.primitivegroup.iter().flat_map(|group| &group.ways);
            ways.filter(|way| wanted.contains(&way.id()))
                .map(|way| (way.id(), block::way_refs(way)))
                .collect::<Vec<_>>()
        })?;
        for (id, refs) in finds.into_iter().flatten() {
            members.entry(id).or_insert(refs);
        }
    }
    progress.end();
    Ok(members)
}

/// Third pass: coordinates of the nodes in use.
fn read_nodes(
    files: &[PbfFile],
    node_blobs: &[Vec<usize>],
    ways: &[RawWay],
    members: &HashMap<i64, Vec<i64>>,
    progress: &dyn Progress,
) -> Result<NodeTable, PbfError> {
    let of_ways = ways.iter().flat_map(|way| &way.refs);
    let mut nodes = NodeTable::new(of_ways.chain(members.values().flatten()).copied().collect());
    progress.begin("reading node coordinates", Some(count(node_blobs)));
    for (file, blobs) in files.iter().zip(node_blobs) {
        let finds = file.map(blobs, progress, |block| nodes.find(block))?;
        for found in finds {
            nodes.enter(found);
        }
    }
    progress.end();
    Ok(nodes)
}

fn count(blobs: &[Vec<usize>]) -> u64 {
    blobs.iter().map(|blobs| blobs.len() as u64).sum()
}

/// Whether a relation stands for one of its member ways that carries building tags itself:
/// an outer ring would fill the relation's holes, a piece of a ring is no building.
fn stands_for(
    relation: &Building,
    way: &RawWay,
    footprint: Result<&MultiPolygon<f64>, &Defect>,
) -> bool {
    relation.attributes.kind == way.attributes.kind
        && match footprint {
            Ok(footprint) => {
                let mut outers = relation.footprint.iter().map(Polygon::exterior);
                outers.any(|outer| Some(outer) == footprint.0.first().map(Polygon::exterior))
            }
            Err(defect) => *defect == Defect::OpenWay,
        }
}

/// Footprints of all objects, in parallel and in order.
fn build(
    ways: &[RawWay],
    relations: &[RawRelation],
    members: &HashMap<i64, Vec<i64>>,
    projector: &Projector<'_>,
    problems: &mut Vec<Problem>,
) -> Vec<Building> {
    type Built = (Option<Building>, Vec<Problem>);
    let built = |object, attributes, defects: Vec<Defect>, footprint: Result<_, Defect>| {
        let (footprint, fatal) = match footprint {
            Ok(footprint) => (Some(footprint), None),
            Err(defect) => (None, Some(defect)),
        };
        let problems: Vec<_> =
            defects.into_iter().chain(fatal).map(|defect| Problem { object, defect }).collect();
        (footprint.map(|footprint| Building { object, footprint, attributes }), problems)
    };
    let from_relations: Vec<Built> = relations
        .par_iter()
        .map(|relation| {
            let mut defects = Vec::new();
            let footprint = relation_footprint(relation, members, projector, &mut defects);
            built(ObjectId::Relation(relation.id), relation.attributes, defects, footprint)
        })
        .collect();
    let mut parents: HashMap<i64, Vec<&Building>> = HashMap::new();
    for (relation, (building, _)) in relations.iter().zip(&from_relations) {
        for (way, _) in building.iter().flat_map(|_| &relation.members) {
            parents.entry(*way).or_default().extend(building);
        }
    }
    let from_ways: Vec<Built> = ways
        .par_iter()
        .map(|way| {
            let mut defects = Vec::new();
            let mut footprint = way_footprint(way, projector, &mut defects);
            let parents = parents.get(&way.id).into_iter().flatten();
            if parents.into_iter().any(|parent| stands_for(parent, way, footprint.as_ref())) {
                defects.clear();
                footprint = Err(Defect::CoveredByRelation);
            }
            built(ObjectId::Way(way.id), way.attributes, defects, footprint)
        })
        .collect();
    let mut buildings = Vec::with_capacity(from_ways.len() + from_relations.len());
    for (building, found) in from_ways.into_iter().chain(from_relations) {
        buildings.extend(building);
        problems.extend(found);
    }
    buildings
}

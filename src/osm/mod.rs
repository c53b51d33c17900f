//! Buildings out of OpenStreetMap extracts (`.osm.pbf`).
//!
//! The file is read in passes, each decoding its blobs in parallel: tags decide
//! which ways and relations are kept; the members of kept relations follow; last the
//! coordinates of exactly the nodes that all these use. Memory is therefore bounded by
//! the buildings kept, not by the file. Only this module knows the PBF format.

mod assemble;
mod block;
mod build;
mod copies;
mod footprint;
mod nodes;
mod passes;
mod pbf;
mod rings;
mod scan;
mod wire;
mod zone;

pub use passes::{Extract, ExtractError, read_buildings};
pub use pbf::PbfError;

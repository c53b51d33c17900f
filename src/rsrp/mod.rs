//! Import of radio maps that a ray tracer produced elsewhere.
//!
//! A map is somebody else's file: it is taken if it follows the contract of
//! `schemas/radio_map.v1.json`, else rejected with a named reason and the mend. The
//! result is one orientation, one unit and a mask:
//! `rsrp_dbm` float32, row 0 north, in dBm per resource element, and `mask` uint8 with
//! {0 outdoor reached, 1 building, 2 outdoor unreached}.

mod align;
mod array;
mod check;
mod complete;
mod convert;
mod examine;
mod free_space;
mod load;
mod map;
mod member;
mod metadata;
mod orientation;
mod rejection;
mod repeats;
mod report;
mod stage;
mod window;

pub use complete::Supplement;
pub use convert::to_rsrp;
pub use load::{Described, load_archive, load_metadata, load_values};
pub use map::{AlignedMap, LoadedMap, Repeats};
pub use metadata::{
    DirectionShift, Marker, NoPathValue, Object, PowerReference, RadioMapMetadata, RowOrder,
    TxPosition,
};
pub use rejection::{Rejection, RejectionCode};
pub use stage::{ImportRsrpError, ImportRsrpJob, import_rsrp};

//! Files: written whole or not at all, hashed, read with suspicion.
//!
//! Everything that touches the disk passes through here, so that crash safety,
//! determinism and size limits are each kept in one place.

mod atomic;
mod hash;
mod npy;
mod npz;
mod output;
#[cfg(feature = "remote")]
mod remote;
mod sealed;
mod seekable;

pub use atomic::{write_atomic, write_atomic_with};
#[cfg(feature = "remote")]
use hash::sha256_reader;
pub use hash::{Digest, sha256_bytes, sha256_file};
pub use npy::{DType, Element, Npy, NpyError, npy_bytes, read_npy};
pub use npz::{MAX_METADATA, NpzError, NpzReader, npz_bytes};
pub use output::{
    Build, BuildMode, Built, Finished, Gap, Item, Items, MANIFEST, Opened, Output, OutputError,
    Parallel, Part, SUMS, Task, TaskReport, demand_outside, lock, parse_sums, stays_inside,
};
#[cfg(feature = "remote")]
pub use remote::{Remote, RemoteError};
pub use sealed::{
    SealError, read_sealed, remove_sealed, remove_unsealed, sealed_files, write_sealed,
};
pub use seekable::{FrameBuffer, SeekError, SeekTable, SeekableWriter, compress_frame};

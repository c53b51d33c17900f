//! Files: written whole or not at all, hashed, read with suspicion.
//!
//! Everything that touches the disk passes through here, so that crash safety,
//! determinism and size limits are each kept in one place.

#[cfg(any(feature = "build", feature = "remote"))]
mod atomic;
#[cfg(feature = "build")]
mod deflate;
mod hash;
mod list;
mod npy;
#[cfg(feature = "build")]
mod npz;
#[cfg(feature = "build")]
mod output;
#[cfg(feature = "remote")]
mod remote;
#[cfg(feature = "torch")]
mod seal;
#[cfg(feature = "build")]
mod sealed;
mod seekable;
#[cfg(feature = "build")]
mod zip;

#[cfg(feature = "build")]
pub use atomic::{write_atomic, write_atomic_with};
#[cfg(feature = "build")]
pub(crate) use deflate::{ArrayFormat, Deflater, Segment, Strip, StripWriter, deflate_small};
#[cfg(feature = "remote")]
use hash::sha256_reader;
pub use hash::{Digest, sha256_bytes, sha256_file};
pub use list::{MANIFEST, SUMS, parse_sums, stays_inside};
#[cfg(feature = "build")]
pub use npy::npy_bytes;
pub use npy::{DType, Element, Npy, NpyError, read_npy};
#[cfg(feature = "build")]
pub use npz::{MAX_METADATA, NpzError, NpzReader, npz_bytes};
#[cfg(feature = "build")]
pub(crate) use output::{Build, Finished, Item, Items, Opened, Output, Parallel};
#[cfg(feature = "build")]
pub use output::{BuildMode, Built, Gap, OutputError, Part, Task, TaskReport};
#[cfg(feature = "torch")]
pub(crate) use output::{demand_outside, lock};
#[cfg(feature = "remote")]
pub use remote::{Remote, RemoteError};
#[cfg(feature = "torch")]
pub(crate) use seal::{remove_sealed, remove_unsealed, write_sealed};
#[cfg(feature = "build")]
pub use sealed::SealError;
#[cfg(feature = "build")]
pub(crate) use sealed::{read_sealed, sealed_files};
pub use seekable::{FrameBuffer, SeekError, SeekTable, SeekableWriter, compress_frame};
#[cfg(feature = "build")]
pub(crate) use zip::npz_of_deflated;

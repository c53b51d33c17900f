//! Why a map is not taken: code, what was expected, what was found, how to mend it.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The named reasons.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum RejectionCode {
    /// The operating system could not read the file.
    Unreadable,
    /// A kind of file that is not read.
    UnsupportedFormat,
    /// The file is damaged or no NumPy file.
    Damaged,
    /// Python objects, which are never unpickled.
    Pickled,
    /// Larger than `rsrp.max_array_mib`.
    TooLarge,
    /// No array with a known name.
    NoValueArray,
    /// Several arrays that may be the map.
    SeveralValueArrays,
    /// The name of the array leaves the kind open and the metadata do not tell it.
    UnknownValueKind,
    /// Name of the array and metadata contradict each other.
    ContradictingValueKind,
    /// An element type that loses the values.
    UnsupportedType,
    /// No metadata, or not all of them.
    MissingMetadata,
    /// Metadata that cannot be understood.
    InvalidMetadata,
    /// Not a square matrix.
    WrongShape,
    /// Maps of several transmitters in one file, and no choice.
    SeveralTransmitters,
    /// The file holds no map of the transmitter that was chosen.
    NoSuchTransmitter,
    /// Shape, cell size and map size contradict each other.
    CellSizeContradictsShape,
    /// Cells that do not make up the cells of the grid or of a record.
    IncompatibleCellSize,
    /// Smaller than the central window.
    WindowTooSmall,
    /// The central window would cut through cells.
    MisalignedWindow,
    /// Another projection than the tiles'.
    WrongCrs,
    /// The centre is not the tile's.
    CenterOff,
    /// NaN, but `no_path_value` is something else.
    NanUndeclared,
    /// Infinite values, but `no_path_value` is something else.
    InfinityUndeclared,
    /// Many cells share one value that is not declared as `no_path_value`.
    FloorUndeclared,
    /// Values that no radio channel has, for the declared kind.
    ValueOutOfRange,
    /// The levels are those of another kind of values, or of another power.
    WrongValueKind,
    /// The rows or columns run the other way, or are swapped.
    WrongOrientation,
    /// The map lies some cells beside the buildings.
    Shifted,
    /// The map fits the buildings of another tile.
    WrongTile,
    /// The map fits the buildings of no tile nearby.
    BuildingsDisagree,
    /// Too few rays for the size of the cells.
    Undersampled,
    /// A warning, where `rsrp.strict` allows none.
    Warned,
    /// Not a single outdoor cell is reached.
    NothingReached,
    /// The transmitter lies outside of the map.
    TransmitterOutside,
    /// The transmitter lies inside of the building under it.
    TransmitterInsideBuilding,
    /// No such tile.
    UnknownLocation,
    /// The tile exists but was too empty to be kept.
    TileDropped,
    /// Several repeats, but no standard error.
    ErrorMissing,
    /// A standard error, but not of several repeats.
    ErrorWithoutRepeats,
    /// A standard error, or a half of the repeats, of another shape than the values.
    ErrorShape,
    /// A standard error that the mean of repeats cannot have.
    ErrorOutOfRange,
    /// A half of the repeats that cannot be one of them.
    HalfOutOfRange,
    /// Several files are maps of one tile.
    DuplicateLocation,
}

impl RejectionCode {
    /// The name used in files.
    #[must_use]
    pub fn name(self) -> String {
        match serde_json::to_value(self) {
            Ok(serde_json::Value::String(name)) => name,
            _ => format!("{self:?}"),
        }
    }
}

/// A map that is not taken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Rejection {
    /// The named reason.
    pub code: RejectionCode,
    /// What was expected.
    pub expected: String,
    /// What was found.
    pub found: String,
    /// What the producer of the map can do.
    pub mend: String,
}

impl Rejection {
    pub(super) fn new(
        code: RejectionCode,
        expected: impl Into<String>,
        found: impl Into<String>,
        mend: impl Into<String>,
    ) -> Self {
        Self { code, expected: expected.into(), found: found.into(), mend: mend.into() }
    }
}

impl fmt::Display for Rejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { code, expected, found, mend } = self;
        write!(f, "{}: found {found}, expected {expected}; {mend}", code.name())
    }
}

/// The first of some names, that a message stays short.
pub(super) fn some(names: &[impl AsRef<str>]) -> String {
    const FEW: usize = 8;
    let few: Vec<&str> = names.iter().take(FEW).map(AsRef::as_ref).collect();
    let more =
        if names.len() > FEW { format!(" and {} more", names.len() - FEW) } else { String::new() };
    format!("{few:?}{more}")
}

//! What can be wrong with a building in OSM, and what was done about it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::ObjectId;

/// What was done with an object that is not plain.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// The object does not appear.
    Skipped,
    /// The object appears, mended as its code says.
    Repaired,
    /// The object is sound but is not meant to appear.
    LeftOut,
}

impl Action {
    /// The name used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Skipped => "skipped",
            Self::Repaired => "repaired",
            Self::LeftOut => "left_out",
        }
    }
}

/// A reason to skip, repair or leave out an object.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Defect {
    /// A way with building tags whose ends do not meet.
    OpenWay,
    /// A way that uses nodes the extract lacks.
    MissingNodes,
    /// A ring with fewer than three different points.
    TooFewPoints,
    /// A ring whose points lie on a line.
    ZeroArea,
    /// More points than any building has (10,000): testing them for crossings would take long.
    TooManyPoints,
    /// Wider than any building is (10 km).
    TooLarge,
    /// A relation without any closed outer ring.
    NoOuterRing,
    /// A relation that uses ways the extract lacks; the other rings are kept.
    MissingMembers,
    /// A chain of member ways that does not close; the other rings are kept.
    UnclosedRing,
    /// An outline that crosses itself; filled by the even-odd rule.
    SelfIntersecting,
    /// Outer rings that overlap; their union is filled.
    OverlappingOuters,
    /// An inner ring that lies in no outer ring; dropped.
    OrphanInner,
    /// A ring whose role contradicts where it lies; the place decides.
    RoleMismatch,
    /// A way or ring that a relation lists twice; taken once.
    DuplicateMember,
    /// Consecutive points at the same place; taken once.
    DuplicatePoints,
    /// An object that an earlier extract of the same run already holds; the first is taken.
    DuplicateObject,
    /// Too far from the UTM zone for it to be projected.
    NotProjectable,
    /// A height that is not positive, too large or not finite; the next source is taken.
    HeightImplausible,
    /// A height that is no length; the next source is taken.
    HeightUnparsable,
    /// `building=no`, underground, planned or gone.
    NotABuilding,
    /// An outer way of a building relation, itself tagged as a building; the relation stands for it.
    CoveredByRelation,
    /// Begins above the flight height, or stands on posts: does not block by itself.
    Elevated,
    /// Building parts are switched off in the configuration.
    PartsDisabled,
}

impl Defect {
    /// The name used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::OpenWay => "open_way",
            Self::MissingNodes => "missing_nodes",
            Self::TooFewPoints => "too_few_points",
            Self::ZeroArea => "zero_area",
            Self::TooManyPoints => "too_many_points",
            Self::TooLarge => "too_large",
            Self::NoOuterRing => "no_outer_ring",
            Self::MissingMembers => "missing_members",
            Self::UnclosedRing => "unclosed_ring",
            Self::SelfIntersecting => "self_intersecting",
            Self::OverlappingOuters => "overlapping_outers",
            Self::OrphanInner => "orphan_inner",
            Self::RoleMismatch => "role_mismatch",
            Self::DuplicateMember => "duplicate_member",
            Self::DuplicatePoints => "duplicate_points",
            Self::DuplicateObject => "duplicate_object",
            Self::NotProjectable => "not_projectable",
            Self::HeightImplausible => "height_implausible",
            Self::HeightUnparsable => "height_unparsable",
            Self::NotABuilding => "not_a_building",
            Self::CoveredByRelation => "covered_by_relation",
            Self::Elevated => "elevated",
            Self::PartsDisabled => "parts_disabled",
        }
    }

    /// What is done about it. A relation that loses all rings to a repair is skipped with
    /// [`Defect::NoOuterRing`] in addition.
    #[must_use]
    pub fn action(self) -> Action {
        match self {
            Self::OpenWay
            | Self::MissingNodes
            | Self::TooFewPoints
            | Self::ZeroArea
            | Self::TooManyPoints
            | Self::TooLarge
            | Self::NoOuterRing
            | Self::NotProjectable => Action::Skipped,
            Self::MissingMembers
            | Self::UnclosedRing
            | Self::SelfIntersecting
            | Self::OverlappingOuters
            | Self::OrphanInner
            | Self::RoleMismatch
            | Self::DuplicateMember
            | Self::DuplicatePoints
            | Self::DuplicateObject
            | Self::HeightImplausible
            | Self::HeightUnparsable => Action::Repaired,
            Self::NotABuilding | Self::CoveredByRelation | Self::Elevated | Self::PartsDisabled => {
                Action::LeftOut
            }
        }
    }
}

/// One defect of one object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Problem {
    /// The object.
    pub object: ObjectId,
    /// What is wrong.
    pub defect: Defect,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_of_codes_are_their_serialised_names() {
        for defect in [Defect::OpenWay, Defect::NoOuterRing, Defect::NotABuilding] {
            let json = serde_json::to_string(&defect).expect("serialised");
            assert_eq!(json, format!("{:?}", defect.name()));
        }
    }
}

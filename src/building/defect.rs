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
    /// The object appears as it is; but not everywhere that one might look for it.
    Noted,
}

impl Action {
    /// The name used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Skipped => "skipped",
            Self::Repaired => "repaired",
            Self::LeftOut => "left_out",
            Self::Noted => "noted",
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
    /// Building tags on a node, which has no outline.
    Node,
    /// Building tags on a relation that is neither a multipolygon nor a building.
    NotAnArea,
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
    /// An inner ring that crosses an outer one; the outer ring less the inner one is filled.
    CrossingInner,
    /// A ring whose role contradicts where it lies; the place decides.
    RoleMismatch,
    /// Members whose role is neither outer nor inner nor empty; they are no part of the outline.
    ForeignRole,
    /// A way or ring that a relation lists twice; taken once.
    DuplicateMember,
    /// Consecutive points at the same place; taken once.
    DuplicatePoints,
    /// A way that goes round its ring more than once; taken once.
    RingWalkedTwice,
    /// An object that is there more than once; the whole copy is taken.
    DuplicateObject,
    /// Too far from the UTM zone for it to be projected.
    NotProjectable,
    /// A height that is not positive, too large or not finite; the next source is taken.
    HeightImplausible,
    /// A height that is no length, or may be two; the next source is taken.
    HeightUnparsable,
    /// A height below the object's own bottom; the next source is taken.
    TopBelowBottom,
    /// `building=no`, underground, planned or gone.
    NotABuilding,
    /// An outer way of a building relation, itself tagged as a building; the relation stands for it.
    CoveredByRelation,
    /// A building relation whose outline carries building tags itself; the outline stands for it.
    CoveredByOutline,
    /// Begins above the flight height, or stands on posts, outside of every outline: one can pass
    /// below, so its cells stay open where nothing else stands.
    Raised,
    /// So small or thin that it covers the centre of no cell.
    NoCell,
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
            Self::Node => "node",
            Self::NotAnArea => "not_an_area",
            Self::CrossingInner => "crossing_inner",
            Self::ForeignRole => "foreign_role",
            Self::RingWalkedTwice => "ring_walked_twice",
            Self::TopBelowBottom => "top_below_bottom",
            Self::CoveredByOutline => "covered_by_outline",
            Self::Raised => "raised",
            Self::NoCell => "no_cell",
            Self::PartsDisabled => "parts_disabled",
        }
    }

    /// What is done about an object for it. A ring of a relation is dropped and the relation repaired
    /// for what skips a way; without any ring left it is skipped for [`Defect::NoOuterRing`].
    #[must_use]
    pub fn action(self) -> Action {
        match self {
            Self::Node
            | Self::NotAnArea
            | Self::OpenWay
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
            | Self::CrossingInner
            | Self::RoleMismatch
            | Self::ForeignRole
            | Self::DuplicateMember
            | Self::DuplicatePoints
            | Self::RingWalkedTwice
            | Self::DuplicateObject
            | Self::HeightImplausible
            | Self::HeightUnparsable
            | Self::TopBelowBottom => Action::Repaired,
            Self::NotABuilding
            | Self::CoveredByRelation
            | Self::CoveredByOutline
            | Self::PartsDisabled => Action::LeftOut,
            Self::Raised | Self::NoCell => Action::Noted,
        }
    }
}

/// One defect of one object. An object that does not appear has exactly one whose action says so.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Problem {
    /// The object.
    pub object: ObjectId,
    /// What is wrong.
    pub defect: Defect,
    /// What was done about it.
    pub action: Action,
}

impl Problem {
    /// A defect that decides about its object, or is mended.
    #[must_use]
    pub fn new(object: ObjectId, defect: Defect) -> Self {
        Self { object, defect, action: defect.action() }
    }

    /// A defect of a piece of an object: the object does not stand or fall with it.
    #[must_use]
    pub fn of_piece(object: ObjectId, defect: Defect) -> Self {
        let action = match defect.action() {
            Action::Skipped => Action::Repaired,
            other => other,
        };
        Self { object, defect, action }
    }
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

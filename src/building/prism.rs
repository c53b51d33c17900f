//! What stands over a place: the one rule that the height grid and the scene both follow.
//!
//! Over a cell counts the highest *known* top of the buildings and parts there, a guess only where
//! nothing is known. An outline does not count where one of its own parts lies: it says where a
//! building is, its parts say how high. What is raised (begins above the flight height)
//!
//! - stands on the ground within its outline, for the outline says that a building is there;
//!   arcades and passages are therefore closed;
//! - raises what stands below it elsewhere;
//! - leaves the ground open where nothing stands: skyways, canopies.
//!
//! The rule is written as prisms over footprints, cut so that none needs to know the others: the
//! column over a cell is the highest of the prisms that stand there, if one does.

use super::groups::Grouped;
use super::{Attributes, Building, HeightSource, Kind};

/// Thickness of what is known to be raised but not from where on (`building=roof` without
/// `min_height`), in metres: that of a roof.
const SLAB_M: f32 = 0.3;

/// A piece of a building: a part of its footprint with a bottom and a top.
#[derive(Debug, Clone, PartialEq)]
pub struct Prism {
    /// The building in the city.
    pub building: u32,
    /// What of its footprint; all of it if there are no limits.
    pub limits: Option<Box<Limits>>,
    /// Height of the bottom over the ground, in metres.
    pub bottom_m: f32,
    /// Height of the top over the ground, in metres.
    pub top_m: f32,
    /// Where the top comes from.
    pub source: HeightSource,
    /// Does not stand on the ground: raises what stands below it, and leaves the rest open.
    pub floats: bool,
}

/// The region of a prism within its building's footprint, by other buildings of the city.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Limits {
    /// For each list, the region lies within one of its footprints.
    pub within: Vec<Vec<u32>>,
    /// And in none of these.
    pub without: Vec<u32>,
}

/// Appends the prisms of a building.
pub(super) fn prisms_of(city: &Grouped, building: usize, prisms: &mut Vec<Prism>) {
    let attributes = &city.buildings()[building].attributes;
    let known = attributes.source.is_known();
    // What is known hides what is guessed.
    let mut hidden = if known { vec![] } else { city.overlapping(building, is_known) };
    // Its parts say how high an outline is. They know at least as much, for they inherit from it.
    hidden.extend(city.parts_of(building));
    hidden.sort_unstable();
    hidden.dedup();
    if !attributes.raised {
        let bottom_m = attributes.min_height_m;
        prisms.push(prism(building, attributes, bottom_m, false, vec![], hidden));
        return;
    }

    let mut base: Vec<u32> = city.outlines_of(building).to_vec();
    base.retain(|&outline| !city.buildings()[outline as usize].attributes.raised);
    if known {
        // A guess below does not count here, so it cannot carry either.
        base.extend(
            city.overlapping(building, |other| !is_known(other) && !other.attributes.raised),
        );
    }
    base.sort_unstable();
    base.dedup();
    let bottom_m = underside(attributes, city.flight_height_m());
    if base.is_empty() {
        prisms.push(prism(building, attributes, bottom_m, true, vec![], hidden));
        return;
    }
    let below = city.overlapping(building, |other| {
        let Attributes { kind, raised, source, .. } = other.attributes;
        kind == Kind::Part && !raised && (source.is_known() || !known)
    });
    let and = |others: &[u32]| [&hidden, others].concat();
    prisms.push(prism(building, attributes, 0.0, false, vec![base.clone()], and(&below)));
    if !below.is_empty() {
        let within = vec![base.clone(), below];
        prisms.push(prism(building, attributes, bottom_m, true, within, hidden.clone()));
    }
    prisms.push(prism(building, attributes, bottom_m, true, vec![], and(&base)));
}

fn is_known(building: &Building) -> bool {
    building.attributes.source.is_known()
}

fn prism(
    building: usize,
    attributes: &Attributes,
    bottom_m: f32,
    floats: bool,
    within: Vec<Vec<u32>>,
    without: Vec<u32>,
) -> Prism {
    let limits = Limits { within, without };
    Prism {
        building: building as u32,
        limits: (limits != Limits::default()).then(|| Box::new(limits)),
        bottom_m,
        top_m: attributes.height_m,
        source: attributes.source,
        floats,
    }
}

/// Height of the bottom of what is raised, in metres over the ground.
fn underside(attributes: &Attributes, flight_height_m: f64) -> f32 {
    let Attributes { height_m, min_height_m, .. } = *attributes;
    let is_told = f64::from(min_height_m) > flight_height_m;
    if is_told { min_height_m } else { (height_m - SLAB_M).max(0.0) }
}

//! Parts of the maps: by share of holes, by density, height and size of buildings, by region.

use super::buildings::Buildings;
use super::report::GroupKind;
use crate::crs::Utm;
use crate::grid::TileId;

/// Tiles at most this far from another belong to its region, in metres.
const REGION_GAP_M: u64 = 10_000;

/// What a map is like.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Traits {
    /// Share of outdoor cells that are holes.
    pub(super) hole_share: f64,
    pub(super) buildings: Buildings,
}

/// Whether a value belongs to a stratum.
type Belongs = fn(f64) -> bool;

/// Maps that are judged together, by their positions in the list of maps.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct GroupMembers {
    pub(super) kind: GroupKind,
    pub(super) name: String,
    pub(super) maps: Vec<usize>,
}

const BY_HOLES: [(&str, Belongs); 5] = [
    ("no holes", |share| share == 0.0),
    ("below 10 %", |share| share > 0.0 && share < 0.1),
    ("10 to 20 %", |share| (0.1..0.2).contains(&share)),
    ("20 to 40 %", |share| (0.2..0.4).contains(&share)),
    ("40 % and more", |share| share >= 0.4),
];
const BY_BUILT_SHARE: [(&str, Belongs); 4] = [
    ("below 20 %", |share| share < 0.2),
    ("20 to 30 %", |share| (0.2..0.3).contains(&share)),
    ("30 to 40 %", |share| (0.3..0.4).contains(&share)),
    ("40 % and more", |share| share >= 0.4),
];
const BY_HEIGHT: [(&str, Belongs); 4] = [
    ("below 5 m", |metres| metres < 5.0),
    ("5 to 10 m", |metres| (5.0..10.0).contains(&metres)),
    ("10 to 20 m", |metres| (10.0..20.0).contains(&metres)),
    ("20 m and more", |metres| metres >= 20.0),
];
/// One-family houses cover 100 to 400 m², apartments and shops up to about 2,000 m².
const BY_FOOTPRINT: [(&str, Belongs); 4] = [
    ("below 500 m²", |area| area < 500.0),
    ("500 to 2,000 m²", |area| (500.0..2_000.0).contains(&area)),
    ("2,000 to 10,000 m²", |area| (2_000.0..10_000.0).contains(&area)),
    ("10,000 m² and more", |area| area >= 10_000.0),
];

/// All groups that have a map: by share of holes, density, height and size of buildings, region.
pub(super) fn groups(ids: &[TileId], traits: &[Traits]) -> Vec<GroupMembers> {
    let strata = |kind, strata: &[(&str, Belongs)], value: fn(&Traits) -> f64| {
        let members = |&(name, belongs): &(&str, Belongs)| GroupMembers {
            kind,
            name: name.to_owned(),
            maps: (0..ids.len()).filter(|&map| belongs(value(&traits[map]))).collect(),
        };
        strata.iter().map(members).collect::<Vec<_>>()
    };
    let by_trait = [
        strata(GroupKind::HoleShare, &BY_HOLES, |of| of.hole_share),
        strata(GroupKind::BuiltShare, &BY_BUILT_SHARE, |of| of.buildings.share),
        strata(GroupKind::Height, &BY_HEIGHT, |of| of.buildings.mean_height_m),
        strata(GroupKind::Footprint, &BY_FOOTPRINT, |of| of.buildings.mean_footprint_m2),
    ];
    let by_region = regions(ids).into_iter().map(|maps| GroupMembers {
        kind: GroupKind::Region,
        name: region_name(ids, &maps),
        maps,
    });
    let groups = by_trait.into_iter().flatten().chain(by_region);
    groups.filter(|group| !group.maps.is_empty()).collect()
}

/// Regions in the order of their first maps: single linkage of tile centres.
fn regions(ids: &[TileId]) -> Vec<Vec<usize>> {
    let near = |a: TileId, b: TileId| {
        a.utm == b.utm
            && a.easting.abs_diff(b.easting) <= REGION_GAP_M
            && a.northing.abs_diff(b.northing) <= REGION_GAP_M
    };
    let mut left: Vec<usize> = (0..ids.len()).collect();
    let mut regions = Vec::new();
    while let Some(first) = (!left.is_empty()).then(|| left.remove(0)) {
        let mut region = vec![first];
        let mut at = 0;
        while at < region.len() {
            let center = ids[region[at]];
            region.extend(left.extract_if(.., |&mut map| near(ids[map], center)));
            at += 1;
        }
        region.sort_unstable();
        regions.push(region);
    }
    regions
}

/// The middle of a region, in degrees.
fn region_name(ids: &[TileId], maps: &[usize]) -> String {
    let utm: Utm = ids[maps[0]].utm;
    let mean = |of: fn(&TileId) -> i64| {
        maps.iter().map(|&map| of(&ids[map])).sum::<i64>() as f64 / maps.len() as f64
    };
    let [lon, lat] = utm.inverse(mean(|id| id.easting), mean(|id| id.northing));
    let (north, east) = (if lat < 0.0 { 'S' } else { 'N' }, if lon < 0.0 { 'W' } else { 'E' });
    format!("{:.2}° {north}, {:.2}° {east}", lat.abs(), lon.abs())
}

/// Pairs of maps whose squares of a side in metres share cells.
pub(super) fn overlapping_pairs(ids: &[TileId], side_m: f64) -> u64 {
    let side = side_m.ceil() as u32;
    let pairs = ids.iter().enumerate().flat_map(|(at, &a)| ids[..at].iter().map(move |&b| (a, b)));
    pairs.filter(|(a, b)| a.overlaps(*b, side)).count() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(name: &str) -> TileId {
        name.parse().expect("an id")
    }

    #[test]
    fn regions_hang_together_over_many_tiles() {
        let ids = [
            id("utm10n_e590000_n4130000"),
            id("utm35n_e385000_n6671000"),
            id("utm10n_e605000_n4130000"),
            id("utm10n_e597000_n4131000"),
        ];
        assert_eq!(regions(&ids), [vec![0, 2, 3], vec![1]]);
        assert_eq!(region_name(&ids, &[1]), "60.16° N, 24.93° E");
    }

    #[test]
    fn every_map_has_one_stratum_and_one_region() {
        let ids = vec![id("utm10n_e590000_n4130000"); 6];
        let traits = [0.0, 0.05, 0.1, 0.2, 0.4, 1.0].map(|share| Traits {
            hole_share: share,
            buildings: Buildings {
                share: share / 2.0,
                mean_height_m: 30.0 * share,
                mean_footprint_m2: 20_000.0 * share,
            },
        });
        let groups = groups(&ids, &traits);
        let kinds = [
            GroupKind::HoleShare,
            GroupKind::BuiltShare,
            GroupKind::Height,
            GroupKind::Footprint,
            GroupKind::Region,
        ];
        for kind in kinds {
            let of_kind = groups.iter().filter(|group| group.kind == kind);
            let mut maps: Vec<usize> = of_kind.flat_map(|group| group.maps.clone()).collect();
            maps.sort_unstable();
            assert_eq!(maps, [0, 1, 2, 3, 4, 5]);
        }
    }

    #[test]
    fn pairs_that_share_cells_are_counted() {
        let ids = [id("utm10n_e0_n0"), id("utm10n_e512_n0"), id("utm10n_e483_n0")];
        assert_eq!(overlapping_pairs(&ids, 484.0), 2);
        assert_eq!(overlapping_pairs(&ids, 28.0), 0);
    }
}

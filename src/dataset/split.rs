//! Train, validation and test: by place, so that no ground is seen in two of them.

use std::collections::{BTreeMap, HashMap};

use crate::config::{GridConfig, Split, SplitConfig};
use crate::grid::TileId;
use crate::store::sha256_bytes;

/// Who is kept where two splits overlap: the test split first, for it is the smallest and
/// the one that figures are quoted of.
const PRIORITY: [Split; 3] = [Split::Test, Split::Val, Split::Train];

/// Which record goes where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SplitAssignment {
    /// Splits of the records that are kept.
    pub kept: BTreeMap<TileId, Split>,
    /// Records that overlap one of another split.
    pub dropped: Vec<TileId>,
    /// Pairs of kept records of different splits whose whole tiles overlap.
    pub overlapping_tile_pairs: u64,
}

/// Assigns each tile to a split by the area or the block that its centre lies in, and drops
/// those that share a cell with a record of a split before theirs (test, val, train).
/// With `strict`, whole tiles must not overlap either.
///
/// Whether a tile is dropped depends on the other tiles, its split does not.
#[must_use]
pub fn assign_splits(tiles: &[TileId], grid: &GridConfig, config: &SplitConfig) -> SplitAssignment {
    let apart_m = if config.strict { grid.side_m } else { grid.crop_m };
    let mut by_split: BTreeMap<Split, Vec<TileId>> = BTreeMap::new();
    for &tile in tiles {
        by_split.entry(split_of(tile, config)).or_default().push(tile);
    }
    let mut kept = BTreeMap::new();
    let mut dropped = Vec::new();
    let mut neighbours = NearTiles::new(apart_m.max(grid.side_m));
    let mut overlapping_tile_pairs = 0;
    for split in PRIORITY {
        let candidates = by_split.remove(&split).unwrap_or_default();
        let (apart, overlapping): (Vec<TileId>, Vec<TileId>) =
            candidates.into_iter().partition(|&tile| neighbours.count(tile, apart_m) == 0);
        dropped.extend(overlapping);
        overlapping_tile_pairs +=
            apart.iter().map(|&tile| neighbours.count(tile, grid.side_m)).sum::<u64>();
        for tile in apart {
            kept.insert(tile, split);
            neighbours.insert(tile);
        }
    }
    dropped.sort_unstable();
    SplitAssignment { kept, dropped, overlapping_tile_pairs }
}

/// The split of a place.
fn split_of(tile: TileId, config: &SplitConfig) -> Split {
    let [lon, lat] = tile.lon_lat();
    let named = config.areas.iter().find(|area| {
        let [west, south, east, north] = area.bbox;
        (west..east).contains(&lon) && (south..north).contains(&lat)
    });
    if let Some(area) = named {
        return area.split;
    }
    let side = i64::from(config.block_m);
    let block = [tile.easting.div_euclid(side), tile.northing.div_euclid(side)];
    let draw = draw(config.seed, tile.utm.epsg(), block);
    if draw < config.test {
        Split::Test
    } else if draw < config.test + config.val {
        Split::Val
    } else {
        Split::Train
    }
}

/// A number in [0, 1) that depends on seed and block only.
fn draw(seed: u64, epsg: u32, [column, row]: [i64; 2]) -> f64 {
    let digest = sha256_bytes(format!("{seed} {epsg} {column} {row}").as_bytes()).sha256;
    // 53 bits, as many as a float64 holds.
    let bits = u64::from_str_radix(&digest[..16], 16).expect("a digest is hexadecimal") >> 11;
    bits as f64 / (1_u64 << 53) as f64
}

/// Tiles in square buckets at least as wide as the largest window that is asked about.
struct NearTiles {
    side: i64,
    buckets: HashMap<[i64; 2], Vec<TileId>>,
}

impl NearTiles {
    fn new(side_m: u32) -> Self {
        Self { side: i64::from(side_m), buckets: HashMap::new() }
    }

    fn bucket(&self, tile: TileId) -> [i64; 2] {
        [tile.easting.div_euclid(self.side), tile.northing.div_euclid(self.side)]
    }

    fn insert(&mut self, tile: TileId) {
        self.buckets.entry(self.bucket(tile)).or_default().push(tile);
    }

    /// How many tiles' squares of a side overlap that of a tile.
    fn count(&self, tile: TileId, side_m: u32) -> u64 {
        let [column, row] = self.bucket(tile);
        let around =
            (column - 1..=column + 1).flat_map(|c| (row - 1..=row + 1).map(move |r| [c, r]));
        let near = around.filter_map(|bucket| self.buckets.get(&bucket)).flatten();
        near.filter(|&&other| other.overlaps(tile, side_m)).count() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::SplitArea;
    use crate::crs::Utm;
    use proptest::prelude::*;

    fn tile(easting: i64, northing: i64) -> TileId {
        TileId { utm: Utm::from_epsg(32610).expect("a UTM code"), easting, northing }
    }

    fn lattice(spacing: i64, count: i64) -> Vec<TileId> {
        let cell = move |i: i64| (i % count * spacing + 500_000, i / count * spacing + 4_000_000);
        (0..count * count).map(cell).map(|(easting, northing)| tile(easting, northing)).collect()
    }

    #[test]
    fn shares_are_about_what_was_asked_for() {
        let config = SplitConfig { block_m: 512, ..SplitConfig::default() };
        let assignment = assign_splits(&lattice(512, 60), &GridConfig::default(), &config);
        let count = |split| assignment.kept.values().filter(|&&s| s == split).count();
        assert_eq!(assignment.kept.len(), 3600, "windows of 484 m every 512 m never overlap");
        for split in [Split::Val, Split::Test] {
            assert!((300..420).contains(&count(split)), "{split}: {}", count(split));
        }
        assert!(assignment.overlapping_tile_pairs > 0);
    }

    #[test]
    fn areas_win_over_blocks_and_rows_between_are_dropped() {
        let tiles: Vec<TileId> = (0..9).map(|row| tile(500_000, 4_000_000 + row * 128)).collect();
        let [west, _] = tiles[0].lon_lat();
        let [_, south] = tiles[5].lon_lat();
        let bbox = [west - 1.0, south - 1e-6, west + 1.0, 90.0];
        let areas = vec![SplitArea { name: "north".into(), split: Split::Val, bbox }];
        let config = SplitConfig { val: 0.0, test: 0.0, areas, ..SplitConfig::default() };
        let assignment = assign_splits(&tiles, &GridConfig::default(), &config);
        let of = |row: usize| assignment.kept.get(&tiles[row]).copied();
        assert_eq!([of(0), of(1)], [Some(Split::Train); 2]);
        assert_eq!(assignment.dropped, tiles[2..5]);
        assert!((5..9).all(|row| of(row) == Some(Split::Val)));
    }

    proptest! {
        #[test]
        fn splits_never_share_a_cell(
            spacing in prop::sample::select(vec![64_i64, 128, 256, 512]),
            seed in any::<u64>(),
            strict in any::<bool>(),
        ) {
            let config = SplitConfig { block_m: 900, seed, strict, ..SplitConfig::default() };
            let grid = GridConfig::default();
            let tiles = lattice(spacing, 14);
            let assignment = assign_splits(&tiles, &grid, &config);
            prop_assert_eq!(assignment.kept.len() + assignment.dropped.len(), tiles.len());
            let apart = if strict { grid.side_m } else { grid.crop_m };
            let mut pairs = 0;
            for (a, split_a) in &assignment.kept {
                for (b, split_b) in &assignment.kept {
                    if split_a < split_b {
                        prop_assert!(!a.overlaps(*b, apart));
                        pairs += u64::from(a.overlaps(*b, grid.side_m));
                    }
                }
            }
            prop_assert_eq!(pairs, assignment.overlapping_tile_pairs);
        }
    }
}

//! Closed rings out of the member ways of a relation (OSM wiki, "Relation:multipolygon/Algorithm").
//!
//! Purely topological: node ids in, node ids out.

use std::collections::HashMap;

/// A ring, and the ways that it was assembled from, by their index.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ClosedRing {
    /// Its nodes; the last repeats the first.
    pub(super) nodes: Vec<i64>,
    pub(super) ways: Vec<usize>,
}

/// What could be assembled.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Rings {
    pub(super) closed: Vec<ClosedRing>,
    /// Whether some ways are part of no ring.
    pub(super) leftover: bool,
}

/// Joins ways at their ends to rings, in any order and direction.
///
/// Where more than two ends meet (rings that touch), the walk goes on with the first way
/// left; whenever it comes back to a node of its own path, the loop is cut off as a ring.
/// Every way thus ends up in exactly one ring, or in a dead end.
pub(super) fn assemble(ways: &[&[i64]]) -> Rings {
    let mut rings = Rings::default();
    let mut open = Vec::new();
    for (index, way) in ways.iter().enumerate() {
        match (way.first(), way.last()) {
            (Some(first), Some(last)) if first == last && way.len() > 1 => {
                rings.closed.push(ClosedRing { nodes: way.to_vec(), ways: vec![index] });
            }
            (Some(_), Some(_)) if way.len() > 1 => open.push((index, *way)),
            _ => rings.leftover = true,
        }
    }
    let mut ends: HashMap<i64, Vec<usize>> = HashMap::new();
    for (index, (_, way)) in open.iter().enumerate() {
        ends.entry(way[0]).or_default().push(index);
        ends.entry(way[way.len() - 1]).or_default().push(index);
    }
    let mut used = vec![false; open.len()];
    for start in 0..open.len() {
        if used[start] {
            continue;
        }
        // The path as (way, whether it is walked backwards), and the nodes between them.
        let mut path: Vec<(usize, bool)> = Vec::new();
        let mut junctions = vec![open[start].1[0]];
        while let Some(&here) = junctions.last() {
            let next = ends[&here].iter().copied().find(|&way| !used[way]);
            let Some(next) = next else {
                // A dead end: its last way belongs to no ring.
                junctions.pop();
                rings.leftover |= path.pop().is_some();
                continue;
            };
            used[next] = true;
            let (_, way) = open[next];
            let backwards = way[0] != here;
            let there = if backwards { way[0] } else { way[way.len() - 1] };
            path.push((next, backwards));
            match junctions.iter().position(|&node| node == there) {
                None => junctions.push(there),
                Some(position) => {
                    rings.closed.push(join(&open, &path[position..]));
                    path.truncate(position);
                    junctions.truncate(position + 1);
                }
            }
        }
    }
    rings
}

fn join(ways: &[(usize, &[i64])], path: &[(usize, bool)]) -> ClosedRing {
    let mut nodes: Vec<i64> = Vec::new();
    for &(way, backwards) in path {
        let (_, way) = ways[way];
        let skip = usize::from(!nodes.is_empty());
        if backwards {
            nodes.extend(way.iter().rev().skip(skip));
        } else {
            nodes.extend(way.iter().skip(skip));
        }
    }
    ClosedRing { nodes, ways: path.iter().map(|&(way, _)| ways[way].0).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn open_ways_in_any_order_and_direction_close() {
        let rings = assemble(&[&[1, 2, 3], &[5, 4, 3], &[1, 6, 5]]);
        let ring = ClosedRing { nodes: vec![1, 2, 3, 4, 5, 6, 1], ways: vec![0, 1, 2] };
        assert_eq!(rings, Rings { closed: vec![ring], leftover: false });
    }

    #[test]
    fn rings_that_touch_in_a_node_are_told_apart() {
        let rings = assemble(&[&[1, 2, 9], &[9, 3, 1], &[9, 4, 5], &[5, 6, 9]]);
        let mut lengths: Vec<_> = rings.closed.iter().map(|ring| ring.nodes.len()).collect();
        lengths.sort_unstable();
        assert_eq!((lengths, rings.leftover), (vec![5, 5], false));
    }

    #[test]
    fn a_dead_end_does_not_spoil_the_ring_beside_it() {
        let rings = assemble(&[&[1, 2], &[2, 7, 8], &[2, 3, 1], &[20, 21, 20]]);
        assert_eq!(rings.closed.len(), 2);
        assert!(rings.leftover);
        assert_eq!(assemble(&[&[1, 2], &[2, 3]]), Rings { closed: vec![], leftover: true });
        assert!(assemble(&[&[], &[4]]).leftover);
    }

    proptest! {
        /// A ring cut into ways at random, shuffled and reversed at random, is found again.
        #[test]
        fn a_cut_ring_is_found_again(
            size in 3_u8..40,
            cuts in prop::collection::btree_set(0_u8..40, 1..8),
            reversed in any::<u64>(),
            shuffle in any::<prop::sample::Index>(),
        ) {
            let cuts: Vec<u8> = cuts.into_iter().filter(|&cut| cut < size).collect();
            prop_assume!(cuts.len() > 1);
            let mut ways: Vec<Vec<i64>> = (0..cuts.len())
                .map(|part| {
                    let (from, to) = (cuts[part], cuts[(part + 1) % cuts.len()]);
                    let length = (to + size - from - 1) % size + 1;
                    let mut way: Vec<i64> =
                        (0..=length).map(|step| i64::from((from + step) % size)).collect();
                    if reversed >> part & 1 == 1 {
                        way.reverse();
                    }
                    way
                })
                .collect();
            let by = shuffle.index(ways.len());
            ways.rotate_left(by);
            let views: Vec<&[i64]> = ways.iter().map(Vec::as_slice).collect();
            let rings = assemble(&views);
            prop_assert!(!rings.leftover);
            prop_assert_eq!(rings.closed.len(), 1);
            let mut used = rings.closed[0].ways.clone();
            used.sort_unstable();
            prop_assert_eq!(used, (0..ways.len()).collect::<Vec<_>>());
            let mut nodes = rings.closed[0].nodes.clone();
            prop_assert_eq!(nodes.first(), nodes.last());
            nodes.pop();
            nodes.sort_unstable();
            prop_assert_eq!(nodes, (0..i64::from(size)).collect::<Vec<_>>());
        }
    }
}

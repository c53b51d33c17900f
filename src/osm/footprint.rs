//! Footprints out of rings of coordinates: cleaned, nested, judged.

use geo::kernels::{Kernel, Orientation, RobustKernel};
use geo::{
    Area, BoundingRect, Contains, Coord, InteriorPoint, LineString, MultiPolygon, Polygon, Rect,
};

use crate::building::Defect;

/// Rings smaller than this are taken for a mistake, in m².
const MIN_AREA_M2: f64 = 0.01;
/// Rings flatter than this are lines: area over squared diagonal of the bounding box. Points
/// along a parallel enclose about 10⁻⁶ of it in UTM, a 100 m wall of 0.1 m encloses 10⁻³.
const MIN_FLATNESS: f64 = 1e-5;

/// Crossings are searched for in pairs of segments: 50 million at the worst.
const MAX_POINTS: usize = 10_000;
/// The largest buildings are 1 to 3 km wide, in metres.
const MAX_WIDTH_M: f64 = 10_000.0;

/// What a member's role says about its ring.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    Outer,
    Inner,
    /// Empty or unknown: the ring may be either.
    Any,
}

/// A ring of a relation: closed coordinates in metres, and the role of its ways.
#[derive(Debug, Clone)]
pub(super) struct Ring {
    pub(super) line: LineString<f64>,
    pub(super) role: Role,
}

/// Whether an object with so many points is worth looking at.
pub(super) fn check_size(points: usize) -> Result<(), Defect> {
    if points > MAX_POINTS { Err(Defect::TooManyPoints) } else { Ok(()) }
}

/// A footprint that is no wider than buildings are.
pub(super) fn check_width(footprint: MultiPolygon<f64>) -> Result<MultiPolygon<f64>, Defect> {
    let fits = footprint
        .bounding_rect()
        .is_none_or(|bounds| bounds.width() <= MAX_WIDTH_M && bounds.height() <= MAX_WIDTH_M);
    if fits { Ok(footprint) } else { Err(Defect::TooLarge) }
}

/// Removes repeated points, and checks that a ring encloses something.
///
/// Returns the closed ring, or why it is none; mends are appended to `defects`.
pub(super) fn clean(
    mut points: Vec<Coord<f64>>,
    defects: &mut Vec<Defect>,
) -> Result<LineString<f64>, Defect> {
    let length = points.len();
    points.dedup();
    if points.len() < length {
        defects.push(Defect::DuplicatePoints);
    }
    if points.len() < 4 || distinct_is_below_three(&points) {
        return Err(Defect::TooFewPoints);
    }
    let ring = LineString(points);
    if crosses_itself(&ring) {
        defects.push(Defect::SelfIntersecting);
        return Ok(ring);
    }
    let polygon = Polygon::new(ring, vec![]);
    let area = polygon.unsigned_area();
    let diagonal = polygon
        .bounding_rect()
        .map_or(0.0, |rect| rect.width() * rect.width() + rect.height() * rect.height());
    if area < MIN_AREA_M2 || area < MIN_FLATNESS * diagonal {
        return Err(Defect::ZeroArea);
    }
    Ok(polygon.into_inner().0)
}

fn distinct_is_below_three(points: &[Coord<f64>]) -> bool {
    let first = points[0];
    let second = points.iter().find(|&&point| point != first);
    !points.iter().any(|&point| point != first && Some(&point) != second)
}

/// Nests the rings of a relation to polygons. Where a ring lies decides what it is; roles
/// only tell a hole that lies nowhere from a building.
///
/// Returns one polygon for each outer ring, which may overlap.
pub(super) fn nest(mut rings: Vec<Ring>, defects: &mut Vec<Defect>) -> MultiPolygon<f64> {
    drop_twins(&mut rings, defects);
    let polygons: Vec<Polygon<f64>> =
        rings.iter().map(|ring| Polygon::new(ring.line.clone(), vec![])).collect();
    let boxes: Vec<Option<Rect<f64>>> = polygons.iter().map(BoundingRect::bounding_rect).collect();
    let areas: Vec<f64> = polygons.iter().map(Area::unsigned_area).collect();
    let inside = |inner: usize, outer: usize| {
        let (Some(inner_box), Some(outer_box)) = (boxes[inner], boxes[outer]) else {
            return false;
        };
        inner != outer
            && areas[inner] < areas[outer]
            && box_within(inner_box, outer_box)
            && polygons[inner].interior_point().is_some_and(|at| polygons[outer].contains(&at))
            && !cross(&rings[inner].line, &rings[outer].line)
    };
    let containers: Vec<Vec<usize>> = (0..rings.len())
        .map(|inner| (0..rings.len()).filter(|&outer| inside(inner, outer)).collect())
        .collect();

    let is_hole = |ring: usize| containers[ring].len() % 2 == 1;
    let (mut outers, mut orphans) = (Vec::new(), 0);
    for (ring, Ring { role, .. }) in rings.iter().enumerate() {
        match (is_hole(ring), role) {
            (false, Role::Inner) if containers[ring].is_empty() => orphans += 1,
            (hole, Role::Inner) if !hole => {
                defects.push(Defect::RoleMismatch);
                outers.push(ring);
            }
            (true, Role::Outer) => defects.push(Defect::RoleMismatch),
            (true, _) => {}
            (false, _) => outers.push(ring),
        }
    }
    // Without any outer ring it is the relation that is broken, not its holes.
    if orphans > 0 && !outers.is_empty() {
        defects.push(Defect::OrphanInner);
    }
    // A hole belongs to the smallest ring around it.
    let mut holes: Vec<Vec<LineString<f64>>> = vec![Vec::new(); rings.len()];
    for ring in (0..rings.len()).filter(|&ring| is_hole(ring)) {
        let parent = containers[ring].iter().min_by(|&&a, &&b| areas[a].total_cmp(&areas[b]));
        if let Some(&parent) = parent {
            holes[parent].push(rings[ring].line.clone());
        }
    }
    let overlapping = outers.iter().enumerate().any(|(index, &a)| {
        outers[..index].iter().any(|&b| overlap(&polygons[a], &polygons[b], boxes[a], boxes[b]))
    });
    if overlapping {
        defects.push(Defect::OverlappingOuters);
    }
    let with_holes =
        |ring: usize| Polygon::new(rings[ring].line.clone(), std::mem::take(&mut holes[ring]));
    MultiPolygon(outers.into_iter().map(with_holes).collect())
}

/// Removes rings that repeat an earlier one.
fn drop_twins(rings: &mut Vec<Ring>, defects: &mut Vec<Defect>) {
    let sorted_points = |ring: &Ring| {
        let mut points: Vec<_> =
            ring.line.0[1..].iter().map(|p| (p.x.to_bits(), p.y.to_bits())).collect();
        points.sort_unstable();
        points
    };
    let mut seen = std::collections::HashSet::new();
    let before = rings.len();
    rings.retain(|ring| seen.insert(sorted_points(ring)));
    if rings.len() < before {
        defects.push(Defect::DuplicateMember);
    }
}

/// Whether two outer rings share area. Rings in one another are no overlap here: they are
/// islands in holes, which `nest` has sorted out.
fn overlap(
    a: &Polygon<f64>,
    b: &Polygon<f64>,
    box_a: Option<Rect<f64>>,
    box_b: Option<Rect<f64>>,
) -> bool {
    let (Some(box_a), Some(box_b)) = (box_a, box_b) else {
        return false;
    };
    let boxes_meet = box_a.min().x < box_b.max().x
        && box_b.min().x < box_a.max().x
        && box_a.min().y < box_b.max().y
        && box_b.min().y < box_a.max().y;
    boxes_meet && cross(a.exterior(), b.exterior())
}

fn box_within(inner: Rect<f64>, outer: Rect<f64>) -> bool {
    inner.min().x >= outer.min().x
        && inner.min().y >= outer.min().y
        && inner.max().x <= outer.max().x
        && inner.max().y <= outer.max().y
}

/// Whether a ring crosses itself: two of its segments share a point inside of both.
/// Touching and running back over itself are no crossings.
fn crosses_itself(ring: &LineString<f64>) -> bool {
    let segments = sorted_segments(ring);
    segments.iter().enumerate().any(|(index, &[a, b])| {
        let reach = a.x.max(b.x);
        segments[index + 1..]
            .iter()
            .take_while(|[c, d]| c.x.min(d.x) <= reach)
            .any(|&[c, d]| segments_cross(a, b, c, d))
    })
}

/// Whether two rings cross each other.
fn cross(one: &LineString<f64>, other: &LineString<f64>) -> bool {
    let others = sorted_segments(other);
    one.lines().any(|line| {
        let reach = line.start.x.max(line.end.x);
        others
            .iter()
            .take_while(|[c, d]| c.x.min(d.x) <= reach)
            .any(|&[c, d]| segments_cross(line.start, line.end, c, d))
    })
}

/// Segments in the order of their western ends, for sweeping.
fn sorted_segments(ring: &LineString<f64>) -> Vec<[Coord<f64>; 2]> {
    let mut segments: Vec<_> = ring.lines().map(|line| [line.start, line.end]).collect();
    segments.sort_by(|[a, b], [c, d]| a.x.min(b.x).total_cmp(&c.x.min(d.x)));
    segments
}

/// Whether the open segments ab and cd cross in one point; exact predicates.
fn segments_cross(a: Coord<f64>, b: Coord<f64>, c: Coord<f64>, d: Coord<f64>) -> bool {
    if a.y.max(b.y) < c.y.min(d.y) || c.y.max(d.y) < a.y.min(b.y) {
        return false;
    }
    let opposite = |first: Orientation, second: Orientation| {
        first != Orientation::Collinear && second != Orientation::Collinear && first != second
    };
    let side = |p, q, r| RobustKernel::orient2d(p, q, r);
    opposite(side(a, b, c), side(a, b, d)) && opposite(side(c, d, a), side(c, d, b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geo::coord;

    fn square(x: f64, y: f64, side: f64) -> LineString<f64> {
        let corners = [(x, y), (x + side, y), (x + side, y + side), (x, y + side), (x, y)];
        LineString(corners.iter().map(|&(x, y)| coord! { x: x, y: y }).collect())
    }

    fn nested(rings: &[(LineString<f64>, Role)]) -> (f64, usize, Vec<Defect>) {
        let mut defects = Vec::new();
        let rings = rings.iter().cloned().map(|(line, role)| Ring { line, role }).collect();
        let footprint = nest(rings, &mut defects);
        (footprint.unsigned_area(), footprint.0.len(), defects)
    }

    #[test]
    fn holes_islands_and_roles() {
        use Role::{Any, Inner, Outer};
        let (outer, hole, island) =
            (square(0.0, 0.0, 10.0), square(2.0, 2.0, 6.0), square(4.0, 4.0, 2.0));
        let area = 100.0 - 36.0 + 4.0;
        for roles in [[Outer, Inner, Outer], [Any, Any, Any]] {
            let rings =
                [(outer.clone(), roles[0]), (hole.clone(), roles[1]), (island.clone(), roles[2])];
            assert_eq!(nested(&rings), (area, 2, vec![]));
        }
        let wrong = [(outer.clone(), Outer), (hole.clone(), Outer), (island, Inner)];
        assert_eq!(nested(&wrong), (area, 2, vec![Defect::RoleMismatch; 2]));
        let orphan = [(outer.clone(), Outer), (square(20.0, 0.0, 5.0), Inner)];
        assert_eq!(nested(&orphan), (100.0, 1, vec![Defect::OrphanInner]));
        let twice = [(outer.clone(), Outer), (outer.clone(), Outer)];
        assert_eq!(nested(&twice), (100.0, 1, vec![Defect::DuplicateMember]));
    }

    #[test]
    fn touching_inner_rings_are_two_holes() {
        let rings = [
            (square(0.0, 0.0, 10.0), Role::Outer),
            (square(2.0, 2.0, 3.0), Role::Inner),
            (square(5.0, 2.0, 3.0), Role::Inner),
        ];
        assert_eq!(nested(&rings), (82.0, 1, vec![]));
    }

    #[test]
    fn overlapping_outers_stay_two_polygons() {
        let rings = [(square(0.0, 0.0, 10.0), Role::Outer), (square(5.0, 5.0, 10.0), Role::Outer)];
        assert_eq!(nested(&rings), (200.0, 2, vec![Defect::OverlappingOuters]));
    }

    #[test]
    fn cleaning() {
        let ring = |points: &[(f64, f64)]| {
            let mut defects = Vec::new();
            let points = points.iter().map(|&(x, y)| coord! { x: x, y: y }).collect();
            (clean(points, &mut defects).map(|line| line.0.len()), defects)
        };
        let closed = ring(&[(0.0, 0.0), (5.0, 0.0), (5.0, 0.0), (5.0, 5.0), (0.0, 0.0)]);
        assert_eq!(closed, (Ok(4), vec![Defect::DuplicatePoints]));
        let line = ring(&[(0.0, 0.0), (5.0, 0.0), (9.0, 0.0), (0.0, 0.0)]);
        assert_eq!(line.0, Err(Defect::ZeroArea));
        let back = ring(&[(0.0, 0.0), (5.0, 0.0), (0.0, 0.0), (5.0, 0.0), (0.0, 0.0)]);
        assert_eq!(back.0, Err(Defect::TooFewPoints));
        let bow_tie = ring(&[(0.0, 0.0), (5.0, 5.0), (5.0, 0.0), (0.0, 5.0), (0.0, 0.0)]);
        assert_eq!(bow_tie, (Ok(5), vec![Defect::SelfIntersecting]));
        let spike = ring(&[(0.0, 0.0), (9.0, 0.0), (5.0, 0.0), (5.0, 5.0), (0.0, 0.0)]);
        assert_eq!(spike, (Ok(5), vec![]));
    }
}

//! Footprints out of rings of coordinates: cleaned, nested, judged.

use std::collections::{HashMap, HashSet};

use geo::kernels::{Kernel, Orientation, RobustKernel};
use geo::{
    Area, BooleanOps, BoundingRect, Contains, Coord, InteriorPoint, LineString, MultiPolygon,
    Polygon, Rect,
};

use crate::building::{Defect, Told};

/// Rings smaller than this are taken for a mistake, in m².
const MIN_AREA_M2: f64 = 0.01;
/// Rings flatter than this are lines: area over squared diagonal of the bounding box. Points
/// along a parallel enclose about 10⁻⁶ of it in UTM, a 100 m wall of 0.1 m encloses 10⁻³.
const MIN_FLATNESS: f64 = 1e-5;

/// Crossings are searched for in pairs of segments: 50 million at the worst.
const MAX_POINTS: usize = 10_000;
/// Rings of so few points are searched for crossings pair by pair: sorting would take longer.
const FEW_POINTS: usize = 32;
/// The largest buildings are 1 to 3 km wide, in metres.
const MAX_WIDTH_M: f64 = 10_000.0;

/// What a member's role says about its ring.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    Outer,
    Inner,
    /// Empty: the ring may be either.
    Any,
}

impl Role {
    /// What a role says of multipolygons; `None` if members of that role are no part of the outline.
    pub(super) fn of(text: &str) -> Option<Self> {
        match text {
            "outer" => Some(Self::Outer),
            "inner" => Some(Self::Inner),
            "" => Some(Self::Any),
            _ => None,
        }
    }
}

/// A ring of a relation: closed coordinates in metres, the role of its ways, and the height that they
/// tell.
#[derive(Debug, Clone)]
pub(super) struct Ring {
    pub(super) line: LineString<f64>,
    pub(super) role: Role,
    pub(super) told: Option<Told>,
}

/// A polygon of a relation, and the height that the ways around it tell.
#[derive(Debug, Clone)]
pub(super) struct Piece {
    pub(super) polygon: Polygon<f64>,
    pub(super) told: Option<Told>,
}

/// What the rings of a relation make.
#[derive(Debug, Default)]
pub(super) struct Nested {
    pub(super) pieces: Vec<Piece>,
    /// The outer rings, as they were drawn.
    pub(super) outers: Vec<LineString<f64>>,
}

/// Whether an object with so many points is worth looking at.
pub(super) fn check_size(points: usize) -> Result<(), Defect> {
    if points > MAX_POINTS { Err(Defect::TooManyPoints) } else { Ok(()) }
}

/// Whether a footprint is no wider than buildings are.
pub(super) fn check_width<'a>(
    polygons: impl IntoIterator<Item = &'a Polygon<f64>>,
) -> Result<(), Defect> {
    let points = polygons.into_iter().flat_map(|polygon| &polygon.exterior().0);
    let bounds =
        points.fold([f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY], {
            |[west, south, east, north], point| {
                [west.min(point.x), south.min(point.y), east.max(point.x), north.max(point.y)]
            }
        });
    let [west, south, east, north] = bounds;
    let fits = east - west <= MAX_WIDTH_M && north - south <= MAX_WIDTH_M;
    if fits { Ok(()) } else { Err(Defect::TooLarge) }
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
    if let Some(once) = walked_once(&points) {
        defects.push(Defect::RingWalkedTwice);
        points = once;
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

/// A closed walk without the rounds that it makes a second time; `None` if it makes none. Counted
/// even-odd, two rounds would enclose nothing.
fn walked_once(points: &[Coord<f64>]) -> Option<Vec<Coord<f64>>> {
    if !repeats(&points[1..]) {
        return None;
    }
    // Whenever the walk comes back to a point of its path, a loop is cut off.
    let mut path: Vec<Coord<f64>> = Vec::new();
    let mut at: HashMap<(u64, u64), usize> = HashMap::new();
    let (mut loops, mut known, mut again) = (Vec::new(), HashSet::new(), false);
    for &point in points {
        if let Some(&start) = at.get(&key(&point)) {
            let round: Vec<Coord<f64>> = path.drain(start..).collect();
            for point in &round {
                at.remove(&key(point));
            }
            // A bit of wall walked back and forth encloses nothing.
            if round.len() > 2 {
                if known.insert(corners(&round)) {
                    loops.push(round);
                } else {
                    again = true;
                }
            }
        }
        at.insert(key(&point), path.len());
        path.push(point);
    }
    if !again {
        return None;
    }
    // One walk again: ways between loops are walked there and back, which encloses nothing.
    let start = loops[0][0];
    let closed = |round: &Vec<Coord<f64>>| [&round[..], &round[..1]].concat();
    let mut once: Vec<Coord<f64>> = loops.iter().flat_map(closed).collect();
    once.push(start);
    once.dedup();
    Some(once)
}

/// Whether some point is there twice. Most rings are short: looking at all pairs beats a table.
fn repeats(points: &[Coord<f64>]) -> bool {
    const SHORT: usize = 32;
    if points.len() <= SHORT {
        return points.iter().enumerate().any(|(at, point)| points[..at].contains(point));
    }
    let mut seen = HashSet::with_capacity(points.len());
    points.iter().any(|point| !seen.insert(key(point)))
}

/// A point as something that can be looked up.
fn key(point: &Coord<f64>) -> (u64, u64) {
    (point.x.to_bits(), point.y.to_bits())
}

/// The corners of a ring, wherever it begins and whichever way it goes.
fn corners(points: &[Coord<f64>]) -> Vec<(u64, u64)> {
    let mut corners: Vec<_> = points.iter().map(key).collect();
    corners.sort_unstable();
    corners
}

/// Nests the rings of a relation to polygons. Where a ring lies decides what it is; roles
/// only tell a hole that lies nowhere from a building.
///
/// Returns a polygon for each outer ring, which may overlap, less the inner rings. Where outer rings
/// share area and meet in their nodes only, nobody can tell which way belongs to which: the even-odd
/// rule over all of them decides.
pub(super) fn nest(mut rings: Vec<Ring>, defects: &mut Vec<Defect>) -> Nested {
    drop_twins(&mut rings, defects);
    let shapes = Shapes::new(&rings);
    let containers: Vec<Vec<usize>> = (0..rings.len())
        .map(|inner| (0..rings.len()).filter(|&outer| shapes.inside(inner, outer)).collect())
        .collect();
    let is_hole = |ring: usize| containers[ring].len() % 2 == 1;
    let (mut outers, mut cutting, mut orphans) = (Vec::new(), Vec::new(), 0);
    for (ring, Ring { role, .. }) in rings.iter().enumerate() {
        let cuts = !is_hole(ring) && shapes.cuts(ring, *role, &rings);
        match (is_hole(ring), role) {
            _ if cuts => cutting.push(ring),
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
        let area = |ring: usize| shapes.areas[ring];
        let parent = containers[ring].iter().min_by(|&&a, &&b| area(a).total_cmp(&area(b)));
        if let Some(&parent) = parent {
            holes[parent].push(rings[ring].line.clone());
        }
    }
    let mut pieces: Vec<Piece> = outers
        .iter()
        .map(|&ring| {
            let holes = std::mem::take(&mut holes[ring]);
            let polygon = Polygon::new(rings[ring].line.clone(), holes);
            Piece { polygon, told: rings[ring].told }
        })
        .collect();
    if outers.len() > 1 && shapes.any_crossing(&outers) {
        defects.push(Defect::OverlappingOuters);
    }
    if outers.len() > 1 {
        pieces = even_odd(pieces, &outers, &shapes);
    }
    if !cutting.is_empty() && !outers.is_empty() {
        defects.push(Defect::CrossingInner);
        pieces = without(pieces, cutting.iter().map(|&ring| &shapes.polygons[ring]));
    }
    Nested { pieces, outers: outers.iter().map(|&ring| rings[ring].line.clone()).collect() }
}

/// Rings as areas, and how they lie to each other.
struct Shapes {
    polygons: Vec<Polygon<f64>>,
    boxes: Vec<Option<Rect<f64>>>,
    areas: Vec<f64>,
}

impl Shapes {
    fn new(rings: &[Ring]) -> Self {
        let polygons: Vec<Polygon<f64>> =
            rings.iter().map(|ring| Polygon::new(ring.line.clone(), vec![])).collect();
        let boxes = polygons.iter().map(BoundingRect::bounding_rect).collect();
        let areas = polygons.iter().map(Area::unsigned_area).collect();
        Self { polygons, boxes, areas }
    }

    /// Whether a ring lies in another.
    fn inside(&self, inner: usize, outer: usize) -> bool {
        let (Some(inner_box), Some(outer_box)) = (self.boxes[inner], self.boxes[outer]) else {
            return false;
        };
        let [one, other] = [&self.polygons[inner], &self.polygons[outer]];
        inner != outer
            && self.areas[inner] < self.areas[outer]
            && box_within(inner_box, outer_box)
            && one.interior_point().is_some_and(|at| other.contains(&at))
            && !cross(one.exterior(), other.exterior())
            // Rings may also cross in their nodes.
            && (!share_nodes(one, other) || self.shared_m2(inner, outer) > self.areas[inner] - MIN_AREA_M2)
    }

    /// Area that two rings share, in m².
    fn shared_m2(&self, one: usize, other: usize) -> f64 {
        self.polygons[one].intersection(&self.polygons[other]).unsigned_area()
    }

    fn boxes_meet(&self, one: usize, other: usize) -> bool {
        let (Some(a), Some(b)) = (self.boxes[one], self.boxes[other]) else { return false };
        a.min().x < b.max().x
            && b.min().x < a.max().x
            && a.min().y < b.max().y
            && b.min().y < a.max().y
    }

    /// Whether a ring that lies in no other is a hole that reaches beyond its outline: one with the
    /// role of a hole, or one without role that lies mostly within.
    fn cuts(&self, ring: usize, role: Role, rings: &[Ring]) -> bool {
        role != Role::Outer
            && (0..rings.len()).any(|outer| {
                let may_be_outer = outer != ring && rings[outer].role != Role::Inner;
                let least = if role == Role::Inner { MIN_AREA_M2 } else { self.areas[ring] / 2.0 };
                may_be_outer
                    && self.boxes_meet(ring, outer)
                    && (role == Role::Inner || self.areas[ring] < self.areas[outer])
                    && !self.inside(ring, outer)
                    && !self.inside(outer, ring)
                    && self.shared_m2(ring, outer) > least
            })
    }

    /// Whether some of these rings cross each other.
    fn any_crossing(&self, rings: &[usize]) -> bool {
        let crosses = |a: usize, b: usize| {
            self.boxes_meet(a, b) && cross(self.polygons[a].exterior(), self.polygons[b].exterior())
        };
        rings.iter().enumerate().any(|(at, &a)| rings[..at].iter().any(|&b| crosses(a, b)))
    }

    /// Whether two outer rings share area, though they meet in their nodes only.
    fn overlap_in_nodes(&self, a: usize, b: usize) -> bool {
        let [one, other] = [&self.polygons[a], &self.polygons[b]];
        self.boxes_meet(a, b)
            && share_nodes(one, other)
            && !cross(one.exterior(), other.exterior())
            && !self.inside(a, b)
            && !self.inside(b, a)
            && self.shared_m2(a, b) > MIN_AREA_M2
    }
}

/// Whether two rings have two or more points in common.
fn share_nodes(one: &Polygon<f64>, other: &Polygon<f64>) -> bool {
    let points: HashSet<_> = one.exterior().0[1..].iter().map(key).collect();
    other.exterior().0[1..].iter().filter(|point| points.contains(&key(point))).count() > 1
}

/// Pieces that share area and meet in nodes only become one by the even-odd rule.
fn even_odd(pieces: Vec<Piece>, outers: &[usize], shapes: &Shapes) -> Vec<Piece> {
    let mut left: Vec<(usize, Piece)> = outers.iter().copied().zip(pieces).collect();
    let mut done = Vec::new();
    while !left.is_empty() {
        let (ring, piece) = left.remove(0);
        let (mut group, mut merged) = (vec![ring], MultiPolygon(vec![piece.polygon.clone()]));
        let mut told = vec![piece.told];
        while let Some(next) = left.iter().position(|(other, _)| {
            group.iter().any(|&member| shapes.overlap_in_nodes(member, *other))
        }) {
            let (other, piece) = left.remove(next);
            merged = merged.xor(&piece.polygon);
            group.push(other);
            told.push(piece.told);
        }
        if group.len() == 1 {
            done.push(piece);
        } else {
            let told = Told::best(told.into_iter().flatten());
            done.extend(merged.into_iter().map(|polygon| Piece { polygon, told }));
        }
    }
    done
}

/// Pieces less what is cut out of them.
fn without<'a>(
    mut pieces: Vec<Piece>,
    cutting: impl Iterator<Item = &'a Polygon<f64>>,
) -> Vec<Piece> {
    for hole in cutting {
        let cut = |Piece { polygon, told }: Piece| {
            polygon.difference(hole).into_iter().map(move |polygon| Piece { polygon, told })
        };
        pieces = pieces.into_iter().flat_map(cut).collect();
    }
    pieces
}

/// Removes rings that repeat an earlier one.
fn drop_twins(rings: &mut Vec<Ring>, defects: &mut Vec<Defect>) {
    let mut seen = HashSet::new();
    let before = rings.len();
    rings.retain(|ring| seen.insert(corners(&ring.line.0[1..])));
    if rings.len() < before {
        defects.push(Defect::DuplicateMember);
    }
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
    if ring.0.len() <= FEW_POINTS {
        let mut segments = ring.0.windows(2).enumerate();
        return segments.any(|(index, one)| {
            let mut later = ring.0[index + 1..].windows(2);
            later.any(|other| segments_cross(one[0], one[1], other[0], other[1]))
        });
    }
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
    let apart = |a: f64, b: f64, c: f64, d: f64| a.max(b) < c.min(d) || c.max(d) < a.min(b);
    if apart(a.x, b.x, c.x, d.x) || apart(a.y, b.y, c.y, d.y) {
        return false;
    }
    // Of lines that meet at an end, nothing else can be common but a stretch of both.
    if a == c || a == d || b == c || b == d {
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
        let ring = |(line, role)| Ring { line, role, told: None };
        let Nested { pieces, .. } = nest(rings.iter().cloned().map(ring).collect(), &mut defects);
        (pieces.iter().map(|piece| piece.polygon.unsigned_area()).sum(), pieces.len(), defects)
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
    fn a_hole_that_reaches_beyond_its_outline_is_cut_out() {
        use Role::{Any, Inner, Outer};
        let (outer, hole) = (square(0.0, 0.0, 10.0), square(4.0, 2.0, 6.5));
        let cut = |one: Role, other: Role| {
            let (area, pieces, defects) = nested(&[(outer.clone(), one), (hole.clone(), other)]);
            assert_eq!((pieces, defects), (1, vec![Defect::CrossingInner]), "{one:?} {other:?}");
            assert!((area - (100.0 - 6.0 * 6.5)).abs() < 1e-6, "{one:?} {other:?}: {area}");
        };
        cut(Outer, Inner);
        cut(Outer, Any);
        cut(Any, Any);
        // All of it cut away.
        let rings = [(square(2.0, 2.0, 1.0), Outer), (square(0.0, 0.0, 10.0), Inner)];
        assert_eq!(nested(&rings).1, 0);
    }

    #[test]
    fn outers_that_meet_in_nodes_follow_the_even_odd_rule() {
        let ring = |points: &[(f64, f64)]| {
            let mut line: LineString<f64> = points.iter().copied().collect();
            line.close();
            line
        };
        // They meet in (46, 50) and (46, 20) only; what lies east of that line is in both.
        let west = ring(&[
            (46.0, 50.0),
            (16.0, 45.0),
            (16.0, 25.0),
            (46.0, 20.0),
            (61.0, 30.0),
            (61.0, 40.0),
        ]);
        let east = ring(&[
            (46.0, 50.0),
            (46.0, 70.0),
            (96.0, 70.0),
            (96.0, 0.0),
            (46.0, 0.0),
            (46.0, 20.0),
        ]);
        let (area, _, defects) = nested(&[(west, Role::Outer), (east, Role::Outer)]);
        assert!(defects.is_empty(), "{defects:?}");
        assert!((area - (750.0 + 3500.0 - 300.0)).abs() < 1e-3, "{area}");
    }

    #[test]
    fn a_ring_walked_more_than_once_is_taken_once() {
        let points = |ids: &[u8]| -> Vec<Coord<f64>> {
            let corner = |id: &u8| match id {
                1 => (0.0, 0.0),
                2 => (5.0, 0.0),
                3 => (5.0, 5.0),
                4 => (0.0, 5.0),
                5 => (9.0, 5.0),
                _ => (9.0, 9.0),
            };
            ids.iter().map(|id| corner(id).into()).collect()
        };
        for walk in [
            &[1, 2, 3, 4, 1, 2, 3, 4, 1][..],
            &[1, 2, 3, 4, 1, 4, 3, 2, 1],
            &[1, 2, 3, 4, 1, 2, 3, 4, 1, 2, 3, 4, 1],
            &[1, 2, 3, 4, 1, 2, 3, 5, 3, 4, 1],
        ] {
            let mut defects = Vec::new();
            let ring = clean(points(walk), &mut defects).expect("a ring");
            assert_eq!(defects, [Defect::RingWalkedTwice], "{walk:?}");
            assert_eq!(Polygon::new(ring, vec![]).unsigned_area(), 25.0, "{walk:?}");
        }
        for walk in [&[1, 2, 3, 4, 1][..], &[1, 2, 3, 5, 3, 4, 1], &[1, 2, 3, 5, 6, 3, 4, 1]] {
            assert_eq!(walked_once(&points(walk)), None, "{walk:?}");
        }
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

//! From a region to the triangles of a roof and the edges that walls stand on.
//!
//! The boundary is read off the triangles: what has no opposite. So the walls fit them whatever a
//! triangulator does. Corners where the boundary touches itself (a hole at the outer ring) are
//! split, one copy for each fan of triangles: every vertex then has one edge of the boundary
//! coming in and one going out, and the walls of a corner meet in pairs.

use i_overlay::i_float::int::point::IntPoint;
use i_overlay::i_shape::int::shape::IntShape;
use i_triangle::int::unchecked::IntUncheckedTriangulatable;

use super::region::{double_area, edges};

/// A triangulated region.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Cap {
    /// Vertices in steps of the lattice; corners where the boundary touches itself are there more
    /// than once.
    pub(super) points: Vec<IntPoint>,
    /// Triangles of indices into `points`, counter-clockwise seen from above.
    pub(super) triangles: Vec<[u32; 3]>,
    /// Edges of the boundary, the region on their left.
    pub(super) boundary: Vec<[u32; 2]>,
}

/// A triangulation that is none: a bug of the triangulator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct NotConforming;

impl Cap {
    /// Triangulates shapes that share points at most, and checks the result: area and boundary
    /// must be those of the shapes, exactly.
    pub(super) fn new(shapes: &[IntShape]) -> Result<Self, NotConforming> {
        let mut cap = Self::default();
        for shape in shapes {
            cap.add(shape)?;
        }
        Ok(cap)
    }

    /// Whether a point lies in the region: a ray to the east crosses its boundary an odd number
    /// of times. Of two regions that share an edge exactly one holds a point on it.
    pub(super) fn covers(&self, at: IntPoint) -> bool {
        let crosses = |&[a, b]: &[u32; 2]| {
            let [a, b] = [a, b].map(|end| self.points[end as usize]);
            let (low, high) = if a.y < b.y { (a, b) } else { (b, a) };
            // Lower end included, upper end not: a corner counts once.
            low.y <= at.y && at.y < high.y && (high - low).cross_product(at - low) > 0
        };
        self.boundary.iter().filter(|edge| crosses(edge)).count() % 2 == 1
    }

    fn add(&mut self, shape: &IntShape) -> Result<(), NotConforming> {
        let mut points: Vec<IntPoint> = shape.iter().flatten().copied().collect();
        points.sort_unstable();
        points.dedup();
        let index = |point: IntPoint| -> Result<u32, NotConforming> {
            points.binary_search(&point).map(|at| at as u32).map_err(|_| NotConforming)
        };
        let raw = shape.uncheck_triangulate().into_delaunay();
        // By place: a triangulator may list a point that contours share twice.
        let indices = raw.points().iter().map(|&point| index(point));
        let indices = indices.collect::<Result<Vec<u32>, _>>()?;
        let corners: Vec<u32> =
            raw.triangle_indices::<u32>().iter().map(|&at| indices[at as usize]).collect();

        let area = |[a, b, c]: [u32; 3]| {
            let [a, b, c] = [a, b, c].map(|at| points[at as usize]);
            i128::from((b - a).cross_product(c - a))
        };
        let triangles =
            || corners.chunks_exact(3).map(|corners| [corners[0], corners[1], corners[2]]);
        if triangles().any(|triangle| area(triangle) <= 0)
            || triangles().map(area).sum::<i128>() != double_area(shape)
        {
            return Err(NotConforming);
        }
        let half_edges = HalfEdges::new(&corners)?;
        let mut found: Vec<[u32; 2]> = half_edges.boundary().map(|edge| edge.ends).collect();
        let wanted = shape.iter().flat_map(|contour| edges(contour));
        let wanted = wanted.map(|(a, b)| Ok([index(a)?, index(b)?]));
        let mut wanted = wanted.collect::<Result<Vec<[u32; 2]>, _>>()?;
        found.sort_unstable();
        wanted.sort_unstable();
        if found != wanted {
            return Err(NotConforming);
        }
        self.append(points, corners, &half_edges);
        Ok(())
    }

    /// Appends a checked triangulation, splitting the points where its boundary touches itself.
    fn append(&mut self, mut points: Vec<IntPoint>, mut corners: Vec<u32>, edges: &HalfEdges) {
        let mut is_taken = vec![false; points.len()];
        for edge in edges.boundary() {
            let from = edge.ends[0];
            if !std::mem::replace(&mut is_taken[from as usize], true) {
                continue;
            }
            let copy = points.len() as u32;
            points.push(points[from as usize]);
            // Around the point, from the edge of the boundary that leaves it to the one that arrives.
            let mut corner = Some(edge.corner);
            while let Some(at) = corner {
                corners[at as usize] = copy;
                corner = edges.corner_of([from, edges.ends_of(previous(at))[0]]);
            }
        }
        let offset = self.points.len() as u32;
        let at = |corner: u32| offset + corners[corner as usize];
        let boundary = edges.boundary().map(|edge| [at(edge.corner), at(next(edge.corner))]);
        self.boundary.extend(boundary);
        let triangles = corners.chunks_exact(3);
        self.triangles.extend(triangles.map(|c| [offset + c[0], offset + c[1], offset + c[2]]));
        self.points.extend(points);
    }
}

/// The next corner of the same triangle.
fn next(corner: u32) -> u32 {
    if corner % 3 == 2 { corner - 2 } else { corner + 1 }
}

/// The previous corner of the same triangle.
fn previous(corner: u32) -> u32 {
    if corner.is_multiple_of(3) { corner + 2 } else { corner - 1 }
}

/// An edge of a triangle, from its corner to the next one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct HalfEdge {
    ends: [u32; 2],
    corner: u32,
}

/// The directed edges of all triangles, sorted by their ends.
struct HalfEdges {
    sorted: Vec<HalfEdge>,
    by_corner: Vec<[u32; 2]>,
}

impl HalfEdges {
    /// Of triangles as three corners each; no two may have an edge in the same direction.
    fn new(corners: &[u32]) -> Result<Self, NotConforming> {
        let ends = |corner: u32| [corners[corner as usize], corners[next(corner) as usize]];
        let by_corner: Vec<[u32; 2]> = (0..corners.len() as u32).map(ends).collect();
        let mut sorted: Vec<HalfEdge> =
            (0..).zip(&by_corner).map(|(corner, &ends)| HalfEdge { ends, corner }).collect();
        sorted.sort_unstable();
        if sorted.windows(2).any(|pair| pair[0].ends == pair[1].ends) {
            return Err(NotConforming);
        }
        Ok(Self { sorted, by_corner })
    }

    fn ends_of(&self, corner: u32) -> [u32; 2] {
        self.by_corner[corner as usize]
    }

    fn corner_of(&self, ends: [u32; 2]) -> Option<u32> {
        let at = self.sorted.binary_search_by_key(&ends, |edge| edge.ends).ok()?;
        Some(self.sorted[at].corner)
    }

    /// The edges without an opposite.
    fn boundary(&self) -> impl Iterator<Item = HalfEdge> + '_ {
        let is_single = |edge: &&HalfEdge| {
            let [from, to] = edge.ends;
            self.corner_of([to, from]).is_none()
        };
        self.sorted.iter().filter(is_single).copied()
    }
}

//! Footprints in integers: snapping, cleaning, union and difference.
//!
//! Coordinates are multiples of 2⁻¹³ m (0.12 mm) from a place in whole metres. That is below the
//! 1 cm of OpenStreetMap, exact in float32 up to 2,048 m from a tile's centre, and independent of
//! the place that is chosen: a building has the same corners in all tiles that hold it, and
//! Boolean operations decide by exact predicates.

use geo::{BoundingRect, LineString, MultiPolygon, Polygon, Rect};
use i_overlay::core::fill_rule::FillRule;
use i_overlay::core::overlay::{IntOverlayOptions, Overlay, ShapeType};
use i_overlay::core::overlay_rule::OverlayRule;
use i_overlay::core::solver::Solver;
use i_overlay::i_float::int::point::IntPoint;
use i_overlay::i_shape::int::shape::{IntContour, IntShape, IntShapes};

/// Steps of the lattice in a metre.
pub(super) const STEPS_PER_M: f64 = 8192.0;

/// An area on the ground: shapes without self-intersections that share points at most, each an
/// outer contour counter-clockwise and its holes clockwise.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Region {
    /// The place that coordinates count from: easting and northing in whole metres.
    pub(super) origin: [i64; 2],
    /// The shapes, in steps of the lattice.
    pub(super) shapes: IntShapes,
}

impl Region {
    /// What of a footprint (metres of a projection) lies within one of the footprints of each list
    /// and in none of some others.
    ///
    /// Each polygon is taken with the even-odd rule over all its rings, and polygons are united.
    pub(super) fn new(
        footprint: &MultiPolygon<f64>,
        within: &[Vec<&MultiPolygon<f64>>],
        without: &[&MultiPolygon<f64>],
    ) -> Self {
        let origin = footprint.bounding_rect().map_or([0; 2], |bounds| {
            let center = bounds.center();
            [center.x.round() as i64, center.y.round() as i64]
        });
        let cut = |footprints: &[&MultiPolygon<f64>]| -> Vec<IntShapes> {
            let polygons = footprints.iter().flat_map(|footprint| &footprint.0);
            polygons.map(|polygon| clean(&rings(polygon, origin))).collect()
        };
        let mut shapes = match &footprint.0[..] {
            [polygon] => {
                let mut overlay = overlay();
                overlay.add_contours(&rings(polygon, origin), ShapeType::Subject);
                overlay.overlay(OverlayRule::Subject, FillRule::EvenOdd)
            }
            _ => combine(&cut(&[footprint]), &[], OverlayRule::Subject),
        };
        for footprints in within {
            shapes = combine(&[shapes], &cut(footprints), OverlayRule::Intersect);
        }
        if !without.is_empty() {
            shapes = combine(&[shapes], &cut(without), OverlayRule::Difference);
        }
        Self { origin, shapes }
    }

    /// The bounding box, in metres of the projection; `None` for an empty region.
    pub(super) fn bounds(&self) -> Option<Rect<f64>> {
        let outer = self.shapes.iter().filter_map(|shape| shape.first());
        let points = outer.flatten().map(|point| self.place(*point));
        points.map(|at| Rect::new(at, at)).reduce(|a, b| {
            let (low, high) = (a.min(), b.max());
            Rect::new(
                [low.x.min(b.min().x), low.y.min(b.min().y)],
                [high.x.max(a.max().x), high.y.max(a.max().y)],
            )
        })
    }

    /// Easting and northing of a point, in metres.
    fn place(&self, point: IntPoint) -> [f64; 2] {
        let [x, y] = self.origin;
        [x as f64 + f64::from(point.x) / STEPS_PER_M, y as f64 + f64::from(point.y) / STEPS_PER_M]
    }
}

/// Twice the area of a shape, in square steps, holes taken off.
pub(super) fn double_area(shape: &IntShape) -> i128 {
    shape.iter().map(|contour| double_contour_area(contour)).sum()
}

fn double_contour_area(contour: &[IntPoint]) -> i128 {
    edges(contour).map(|(a, b)| i128::from(a.cross_product(b))).sum()
}

/// The edges of a closed contour, the last one back to its first point.
pub(super) fn edges(contour: &[IntPoint]) -> impl Iterator<Item = (IntPoint, IntPoint)> + '_ {
    contour.iter().copied().zip(contour.iter().copied().cycle().skip(1))
}

/// The rings of a polygon on the lattice.
fn rings(polygon: &Polygon<f64>, origin: [i64; 2]) -> Vec<IntContour> {
    let ring = |line: &LineString<f64>| -> IntContour {
        // A closed ring repeats its first point.
        let points = &line.0[..line.0.len().saturating_sub(1)];
        points.iter().map(|point| snap([point.x, point.y], origin)).collect()
    };
    std::iter::once(polygon.exterior()).chain(polygon.interiors()).map(ring).collect()
}

/// A place in metres as steps of the lattice from an origin. Half steps are rounded up wherever
/// the origin lies; the difference is exact, both being near each other.
pub(super) fn snap([x, y]: [f64; 2], [easting, northing]: [i64; 2]) -> IntPoint {
    let step = |value: f64, origin: i64| ((value - origin as f64) * STEPS_PER_M + 0.5).floor();
    IntPoint::new(step(x, easting) as i32, step(y, northing) as i32)
}

/// An operation on shapes that the even-odd rule has cleaned.
fn combine(subjects: &[IntShapes], clips: &[IntShapes], rule: OverlayRule) -> IntShapes {
    let mut overlay = overlay();
    for shapes in subjects {
        overlay.add_shapes(shapes, ShapeType::Subject);
    }
    for shapes in clips {
        overlay.add_shapes(shapes, ShapeType::Clip);
    }
    overlay.overlay(rule, FillRule::NonZero)
}

/// Points where contours touch stay corners of both, or faces would meet at half an edge.
fn overlay() -> Overlay {
    Overlay::new_custom(0, IntOverlayOptions::keep_output_points(), Solver::default())
}

/// What the even-odd rule makes of rings: shapes that may be united and taken off.
fn clean(rings: &[IntContour]) -> IntShapes {
    let mut overlay = Overlay::with_contours(rings, &[]);
    overlay.overlay(OverlayRule::Subject, FillRule::EvenOdd)
}

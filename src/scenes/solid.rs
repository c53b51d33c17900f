//! The prisms of buildings (`building::Prism`) as closed meshes.

use geo::{MultiPolygon, Rect};
use rayon::prelude::*;

use super::cap::{Cap, NotConforming};
use super::region::{Region, STEPS_PER_M, snap};
use crate::building::{City, Prism};
use crate::manifest::LeftOutSolids;

/// A closed prism over a footprint.
#[derive(Debug, Clone, PartialEq)]
pub struct Solid {
    /// The place that the cap counts from: easting and northing in whole metres.
    origin: [i64; 2],
    cap: Cap,
    bounds: Rect<f64>,
    bottom_m: f32,
    top_m: f32,
}

/// Why a building became no solid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum NoSolid {
    NoHeight,
    CoveredByParts,
    NoArea,
    NotConforming,
}

impl From<NotConforming> for NoSolid {
    fn from(_: NotConforming) -> Self {
        Self::NotConforming
    }
}

impl Solid {
    /// A prism over a region of a footprint.
    fn new(
        footprint: &MultiPolygon<f64>,
        within: &[Vec<&MultiPolygon<f64>>],
        without: &[&MultiPolygon<f64>],
        [bottom_m, top_m]: [f32; 2],
    ) -> Result<Self, NoSolid> {
        if bottom_m >= top_m {
            return Err(NoSolid::NoHeight);
        }
        let region = Region::new(footprint, within, without);
        let is_cut = !(within.is_empty() && without.is_empty());
        let empty = if is_cut { NoSolid::CoveredByParts } else { NoSolid::NoArea };
        let bounds = region.bounds().ok_or(empty)?;
        let cap = Cap::new(&region.shapes)?;
        Ok(Self { origin: region.origin, cap, bounds, bottom_m, top_m })
    }

    fn of_prism(city: &City, prism: &Prism) -> Result<Self, NoSolid> {
        let footprint = |at: &u32| &city.buildings()[*at as usize].footprint;
        let limits = prism.limits.as_deref();
        let within = limits.iter().flat_map(|limits| &limits.within);
        let within: Vec<Vec<_>> = within.map(|list| list.iter().map(footprint).collect()).collect();
        let without = limits.iter().flat_map(|limits| &limits.without);
        let without: Vec<_> = without.map(footprint).collect();
        Self::new(footprint(&prism.building), &within, &without, [prism.bottom_m, prism.top_m])
    }

    /// Bounding box, in metres of the projection.
    #[must_use]
    pub fn bounds(&self) -> Rect<f64> {
        self.bounds
    }

    /// Height of the bottom and of the top over the ground, in metres.
    #[must_use]
    pub fn heights_m(&self) -> [f32; 2] {
        [self.bottom_m, self.top_m]
    }

    /// Whether a place on the ground (easting and northing in metres) lies in its footprint.
    #[must_use]
    pub fn covers(&self, place: [f64; 2]) -> bool {
        self.cap.covers(snap(place, self.origin))
    }

    /// Number of triangles of its surface.
    #[must_use]
    pub fn triangles(&self) -> usize {
        2 * (self.cap.triangles.len() + self.cap.boundary.len())
    }

    /// Its vertices relative to a place (easting and northing in whole metres): those of the
    /// bottom, then those of the top in the same order.
    pub(super) fn vertices(&self, [easting, northing]: [i64; 2]) -> impl Iterator<Item = [f32; 3]> {
        let [x, y] = self.origin;
        let (dx, dy) = ((x - easting) as f64, (y - northing) as f64);
        [self.bottom_m, self.top_m].into_iter().flat_map(move |z| {
            self.cap.points.iter().map(move |point| {
                let east = dx + f64::from(point.x) / STEPS_PER_M;
                let north = dy + f64::from(point.y) / STEPS_PER_M;
                [east as f32, north as f32, z]
            })
        })
    }

    /// Its triangles as indices of [`Self::vertices`], counter-clockwise seen from outside.
    pub(super) fn faces(&self) -> impl Iterator<Item = [u32; 3]> {
        let up = self.cap.points.len() as u32;
        let Cap { triangles, boundary, .. } = &self.cap;
        let bottom = triangles.iter().map(|&[a, b, c]| [a, c, b]);
        let top = triangles.iter().map(move |triangle| triangle.map(|at| at + up));
        let walls = boundary.iter().flat_map(move |&[a, b]| [[a, b, b + up], [a, b + up, a + up]]);
        bottom.chain(top).chain(walls)
    }
}

/// What buildings become.
#[derive(Debug)]
pub struct Solids {
    /// The solids, in the order of their buildings.
    pub solids: Vec<Solid>,
    /// Buildings that became none, by reason.
    pub left_out: LeftOutSolids,
}

/// Makes solids of the prisms of a city. Their order is that of the buildings, with any number of
/// threads.
#[must_use]
pub fn extrude(city: &City) -> Solids {
    let made: Vec<Vec<Result<Solid, NoSolid>>> = (0..city.buildings().len())
        .into_par_iter()
        .map(|at| {
            let prisms = city.prisms_of(at).iter();
            prisms.map(|prism| Solid::of_prism(city, prism)).collect()
        })
        .collect();
    let mut left_out = LeftOutSolids::default();
    let mut solids = Vec::with_capacity(made.len());
    for of_one in made {
        // That a piece of a building is empty matters only if all are.
        let is_there = of_one.iter().any(Result::is_ok);
        let mut reasons = Vec::new();
        for solid in of_one {
            match solid {
                Ok(solid) => solids.push(solid),
                Err(NoSolid::NotConforming) => left_out.not_closed += 1,
                Err(reason) => reasons.push(reason),
            }
        }
        match reasons.first() {
            Some(_) if is_there => {}
            Some(NoSolid::NoHeight) => left_out.no_height += 1,
            Some(NoSolid::CoveredByParts) => left_out.covered_by_parts += 1,
            Some(NoSolid::NoArea) => left_out.no_area += 1,
            Some(NoSolid::NotConforming) | None => {}
        }
    }
    Solids { solids, left_out }
}

#[cfg(test)]
mod tests {
    use super::super::mesh::Mesh;
    use super::*;
    use crate::building::{Attributes, Building, HeightSource, Kind, ObjectId};
    use crate::config::BuildingsConfig;
    use crate::grid::TileId;
    use geo::{Coord, Line, LineString, LinesIter, Polygon};
    use proptest::prelude::*;

    /// Where the test buildings stand, away from zero as real ones do.
    const PLACE: [f64; 2] = [598_016.0, 4_128_768.0];

    fn tile() -> TileId {
        "utm10n_e598016_n4128768".parse().expect("an id")
    }

    fn ring(points: &[[f64; 2]]) -> LineString<f64> {
        let place = |[x, y]: &[f64; 2]| Coord { x: PLACE[0] + x, y: PLACE[1] + y };
        let mut line: LineString<f64> = points.iter().map(place).collect();
        line.close();
        line
    }

    fn square(x: f64, y: f64, side: f64) -> LineString<f64> {
        ring(&[[x, y], [x + side, y], [x + side, y + side], [x, y + side]])
    }

    fn footprint(polygons: &[&[LineString<f64>]]) -> MultiPolygon<f64> {
        let polygon =
            |rings: &&[LineString<f64>]| Polygon::new(rings[0].clone(), rings[1..].to_vec());
        MultiPolygon(polygons.iter().map(polygon).collect())
    }

    fn mesh(solid: &Solid) -> Mesh {
        Mesh::of_solids([solid], tile())
    }

    /// Area of what a solid stands on, by the volume of its mesh, which must be closed.
    fn area(footprint: &MultiPolygon<f64>, without: &[&MultiPolygon<f64>]) -> f64 {
        let solid = Solid::new(footprint, &[], without, [1.0, 4.0]).expect("a solid");
        let mesh = mesh(&solid);
        assert!(mesh.is_closed(), "{footprint:?}");
        assert_eq!(mesh.triangles.len(), solid.triangles());
        mesh.volume_m3() / 3.0
    }

    fn assert_area(found: f64, wanted: f64) {
        assert!((found - wanted).abs() < 1e-3, "{found} m², expected {wanted}");
    }

    #[test]
    fn a_box_has_twelve_triangles_and_exact_corners() {
        let footprint = footprint(&[&[square(0.25, -7.5, 10.0)]]);
        let solid = Solid::new(&footprint, &[], &[], [0.0, 2.5]).expect("a solid");
        let mesh = mesh(&solid);
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (8, 12));
        assert_eq!(mesh.volume_m3(), 250.0);
        assert!(mesh.vertices.contains(&[10.25, 2.5, 2.5]), "{:?}", mesh.vertices);
        // The same corners, whichever tile they are seen from.
        let east = TileId { easting: tile().easting + 512, ..tile() };
        let there = Mesh::of_solids([&solid], east);
        let moved = there.vertices.iter().map(|&[x, y, z]| [x + 512.0, y, z]);
        assert_eq!(moved.collect::<Vec<_>>(), mesh.vertices);
    }

    #[test]
    fn contours_that_touch_are_split_at_their_points() {
        let outer = square(0.0, 0.0, 10.0);
        // A hole with a corner on a corner of the outline, and one in the middle of an edge.
        let at_corner = ring(&[[0.0, 0.0], [6.0, 3.0], [3.0, 6.0]]);
        assert_area(area(&footprint(&[&[outer.clone(), at_corner]]), &[]), 100.0 - 13.5);
        let at_edge = ring(&[[10.0, 5.0], [7.0, 8.0], [7.0, 2.0]]);
        assert_area(area(&footprint(&[&[outer.clone(), at_edge]]), &[]), 100.0 - 9.0);
        // Two holes that touch in one point, and two that share an edge.
        let (one, other) = (square(2.0, 2.0, 3.0), square(5.0, 5.0, 3.0));
        assert_area(area(&footprint(&[&[outer.clone(), one.clone(), other.clone()]]), &[]), 82.0);
        let beside = square(5.0, 2.0, 3.0);
        assert_area(area(&footprint(&[&[outer, one.clone(), beside]]), &[]), 82.0);
        // Two outlines that touch in one point.
        assert_area(area(&footprint(&[&[one], &[other]]), &[]), 18.0);
    }

    #[test]
    fn crossings_and_overlaps_follow_the_rule_of_footprints() {
        let bow_tie = ring(&[[0.0, 0.0], [4.0, 4.0], [4.0, 0.0], [0.0, 4.0]]);
        assert_area(area(&footprint(&[&[bow_tie]]), &[]), 8.0);
        let overlapping = footprint(&[&[square(0.0, 0.0, 10.0)], &[square(5.0, 5.0, 10.0)]]);
        assert_area(area(&overlapping, &[]), 175.0);
        // Even-odd within a polygon: a ring that runs over half of another.
        let twice = footprint(&[&[square(0.0, 0.0, 10.0), square(5.0, 0.0, 10.0)]]);
        assert_area(area(&twice, &[]), 100.0);
        let spike = ring(&[[0.0, 0.0], [9.0, 0.0], [5.0, 0.0], [5.0, 5.0], [0.0, 5.0]]);
        assert_area(area(&footprint(&[&[spike]]), &[]), 25.0);
    }

    fn building(
        footprint: MultiPolygon<f64>,
        kind: Kind,
        [bottom, top]: [f32; 2],
        raised: bool,
    ) -> Building {
        let attributes = Attributes {
            kind,
            height_m: top,
            source: HeightSource::Height,
            min_height_m: bottom,
            raised,
        };
        Building { object: ObjectId::Way(1), footprint, attributes }
    }

    #[test]
    fn buildings_become_what_the_height_grid_makes_of_them() {
        use Kind::{Outline, Part};
        let at = |x: f64, side: f64| footprint(&[&[square(x, 0.0, side)]]);
        let buildings = [
            building(at(0.0, 10.0), Outline, [0.0, 20.0], false),
            building(at(0.0, 4.0), Part, [0.0, 5.0], false),
            building(at(2.0, 4.0), Part, [1.0, 30.0], false),
            building(at(1.0, 2.0), Part, [40.0, 50.0], true),
            building(at(20.0, 4.0), Outline, [0.0, 6.0], true),
            building(at(30.0, 4.0), Outline, [0.0, 0.2], true),
            building(at(40.0, 4.0), Outline, [2.0, 2.0], false),
            building(at(50.0, 4.0), Outline, [0.0, 9.0], false),
            building(at(50.0, 5.0), Part, [0.0, 9.0], false),
            building(at(70.0, 10.0), Outline, [0.0, 20.0], false),
            building(at(75.0, 10.0), Part, [8.0, 12.0], true),
        ];
        let city = City::new(buildings.to_vec(), &[], &BuildingsConfig::default());
        let Solids { solids, left_out } = extrude(&city);
        let found: Vec<_> = solids
            .iter()
            .map(|solid| (solid.heights_m(), mesh(solid).volume_m3().round()))
            .collect();
        let wanted = [
            ([0.0, 20.0], (100.0 - 24.0) * 20.0),
            ([0.0, 5.0], 80.0),
            ([1.0, 30.0], 16.0 * 29.0),
            ([40.0, 50.0], 40.0),
            ([5.7, 6.0], 5.0),
            ([0.0, 0.2], 3.0),
            ([0.0, 9.0], 225.0),
            ([0.0, 20.0], 50.0 * 20.0),
            // On the ground within the outline, floating beyond.
            ([0.0, 12.0], 50.0 * 12.0),
            ([8.0, 12.0], 50.0 * 4.0),
        ];
        assert_eq!(found, wanted);
        let counts = LeftOutSolids { no_height: 1, covered_by_parts: 1, ..Default::default() };
        assert_eq!(left_out, counts);
        assert!(solids[0].covers([PLACE[0] + 8.0, PLACE[1] + 8.0]));
        assert!(!solids[0].covers([PLACE[0] + 1.0, PLACE[1] + 1.0]), "a part stands there");
    }

    /// Whether a place lies in a footprint, by its definition.
    fn inside(footprint: &MultiPolygon<f64>, at: Coord<f64>) -> bool {
        footprint.iter().any(|polygon| {
            let crossings = polygon.lines_iter().filter(|line| {
                (line.start.y <= at.y) != (line.end.y <= at.y) && crossing(line, at.y) > at.x
            });
            crossings.count() % 2 == 1
        })
    }

    /// Where a line crosses a northing.
    fn crossing(line: &Line<f64>, y: f64) -> f64 {
        line.start.x + (y - line.start.y) * line.dx() / line.dy()
    }

    /// Area of the places that a predicate takes, which may change at lines only: between the
    /// northings of all ends and crossings the width is linear, so that its value in the middle
    /// gives the area exactly.
    fn area_by_strips(lines: &[Line<f64>], takes: impl Fn(Coord<f64>) -> bool) -> f64 {
        let mut northings: Vec<f64> =
            lines.iter().flat_map(|line| [line.start.y, line.end.y]).collect();
        for (index, a) in lines.iter().enumerate() {
            for b in &lines[index + 1..] {
                let determinant = a.dx() * b.dy() - a.dy() * b.dx();
                let t = ((b.start.x - a.start.x) * b.dy() - (b.start.y - a.start.y) * b.dx())
                    / determinant;
                if (0.0..=1.0).contains(&t) {
                    northings.push(a.start.y + t * a.dy());
                }
            }
        }
        northings.sort_by(f64::total_cmp);
        let strip = |pair: &[f64]| {
            let y = f64::midpoint(pair[0], pair[1]);
            let crossed = lines.iter().filter(|line| (line.start.y <= y) != (line.end.y <= y));
            let mut eastings: Vec<f64> = crossed.map(|line| crossing(line, y)).collect();
            eastings.sort_by(f64::total_cmp);
            let runs = eastings
                .windows(2)
                .filter(|run| takes(Coord { x: f64::midpoint(run[0], run[1]), y }));
            runs.map(|run| run[1] - run[0]).sum::<f64>() * (pair[1] - pair[0])
        };
        northings.windows(2).map(strip).sum()
    }

    /// Rings whose corners often coincide, lie on edges of others or cross them.
    fn any_footprint() -> impl Strategy<Value = MultiPolygon<f64>> {
        let coarse = (0_i32..9, 0_i32..9).prop_map(|(x, y)| [f64::from(x), f64::from(y)]);
        let fine = (0_i32..800, 0_i32..800)
            .prop_map(|(x, y)| [f64::from(x) / 100.0, f64::from(y) / 100.0]);
        let point = prop_oneof![4 => coarse, 1 => fine];
        let ring_of = |points: Vec<[f64; 2]>| ring(&points);
        let ring = prop::collection::vec(point, 3..8).prop_map(ring_of);
        let rings = prop::collection::vec(ring, 1..4);
        let polygon = rings.prop_map(|rings| Polygon::new(rings[0].clone(), rings[1..].to_vec()));
        prop::collection::vec(polygon, 1..4).prop_map(MultiPolygon)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        /// Holes, touching rings, self-intersections, overlapping outers, parts: the mesh is
        /// closed, and its volume is area times height.
        #[test]
        fn any_footprint_becomes_a_closed_solid_of_its_area(
            footprint in any_footprint(),
            others in prop::collection::vec(any_footprint(), 0..3),
        ) {
            let others: Vec<&MultiPolygon<f64>> = others.iter().collect();
            let takes = |at| inside(&footprint, at) && !others.iter().any(|other| inside(other, at));
            let all = || std::iter::once(&footprint).chain(others.iter().copied());
            let lines: Vec<Line<f64>> = all().flat_map(LinesIter::lines_iter).collect();
            let wanted = area_by_strips(&lines, takes);
            // Corners are moved by half a step of 0.12 mm, crossings by a few.
            let length: f64 = lines.iter().map(|line| line.dx().hypot(line.dy())).sum();
            let tolerance = 3e-4 * length + 1e-6;
            let solid = match Solid::new(&footprint, &[], &others, [1.0, 4.0]) {
                Ok(solid) => solid,
                Err(reason) => {
                    let empty = matches!(reason, NoSolid::NoArea | NoSolid::CoveredByParts);
                    prop_assert!(empty && wanted <= tolerance, "{reason:?}, {wanted} m²");
                    return Ok(());
                }
            };
            let mesh = mesh(&solid);
            prop_assert!(mesh.is_closed());
            let found = mesh.volume_m3() / 3.0;
            prop_assert!((found - wanted).abs() < tolerance, "{found} m², expected {wanted}");
            let bounds = solid.bounds();
            for step in 0..40 {
                let (x, y) = (f64::from(step % 8) + 0.387, f64::from(step / 8 * 2) + 0.271);
                let at = Coord { x: PLACE[0] + x, y: PLACE[1] + y };
                let is_near = |line: &Line<f64>| distance(line, at) < 0.002;
                if !lines.iter().any(is_near) {
                    prop_assert_eq!(solid.covers([at.x, at.y]), takes(at), "{:?}", (x, y));
                    let within = (bounds.min().x..=bounds.max().x).contains(&at.x)
                        && (bounds.min().y..=bounds.max().y).contains(&at.y);
                    prop_assert!(within || !takes(at), "the bounding box is too small");
                }
            }
        }
    }

    fn distance(line: &Line<f64>, at: Coord<f64>) -> f64 {
        let squared = line.dx().powi(2) + line.dy().powi(2);
        let along = (at.x - line.start.x) * line.dx() + (at.y - line.start.y) * line.dy();
        let t = if squared > 0.0 { (along / squared).clamp(0.0, 1.0) } else { 0.0 };
        (line.start.x + t * line.dx() - at.x).hypot(line.start.y + t * line.dy() - at.y)
    }
}

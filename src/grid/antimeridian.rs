//! Polygons of longitudes and latitudes that cross the 180th meridian (RFC 7946, section 3.1.9).

use geo::{BooleanOps, BoundingRect, LineString, MapCoords, MultiPolygon, Polygon, Rect, coord};

/// The polygon within ±180 degrees, in pieces if it crosses the antimeridian. A ring crosses where
/// its longitude jumps by more than half a turn, or goes on beyond 180; a jump of a whole turn is
/// the border of the world.
pub(super) fn cut(polygon: Polygon<f64>) -> MultiPolygon<f64> {
    let (exterior, interiors) = polygon.into_inner();
    let exterior = unrolled(exterior, None);
    let first = exterior.0.first().map(|point| point.x);
    let interiors = interiors.into_iter().map(|ring| unrolled(ring, first)).collect();
    let polygon = Polygon::new(exterior, interiors);
    let Some(bounds) = polygon.bounding_rect() else { return MultiPolygon(vec![]) };
    if bounds.min().x >= -180.0 && bounds.max().x <= 180.0 {
        return MultiPolygon(vec![polygon]);
    }
    let turns = ((bounds.min().x + 180.0) / 360.0).floor() as i32
        ..=((bounds.max().x + 180.0) / 360.0).floor() as i32;
    let piece = |turn: i32| {
        let shift = f64::from(turn) * 360.0;
        let strip =
            Rect::new(coord! { x: shift - 180.0, y: -90.0 }, coord! { x: shift + 180.0, y: 90.0 });
        let within = polygon.intersection(&strip.to_polygon());
        within.map_coords(|at| coord! { x: (at.x - shift).clamp(-180.0, 180.0), y: at.y })
    };
    turns.flat_map(piece).collect()
}

/// A ring whose longitudes go on over the antimeridian instead of jumping.
fn unrolled(mut ring: LineString<f64>, near: Option<f64>) -> LineString<f64> {
    let mut last = near;
    let mut turn = 0.0;
    for point in &mut ring.0 {
        if let Some(last) = last {
            let jump = point.x + turn - last;
            if jump.abs() > 180.0 && jump.abs() < 360.0 {
                turn -= 360.0_f64.copysign(jump);
            }
        }
        point.x += turn;
        last = Some(point.x);
    }
    ring
}

/// The middle of intervals of longitude: that of all the globe without the widest gap between them.
pub(super) fn middle(mut intervals: Vec<[f64; 2]>) -> f64 {
    intervals.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut merged: Vec<[f64; 2]> = Vec::new();
    for [west, east] in intervals {
        match merged.last_mut() {
            Some(last) if west <= last[1] => last[1] = last[1].max(east),
            _ => merged.push([west, east]),
        }
    }
    let (Some(first), Some(last)) = (merged.first(), merged.last()) else { return f64::NAN };
    // The gap at the antimeridian is the first: of equal ones it counts.
    let (mut widest, mut west, mut east) = (first[0] + 360.0 - last[1], first[0], last[1]);
    for pair in merged.windows(2) {
        let gap = pair[1][0] - pair[0][1];
        if gap > widest {
            (widest, west, east) = (gap, pair[1][0], pair[0][1] + 360.0);
        }
    }
    let middle = f64::midpoint(west, east);
    if middle > 180.0 { middle - 360.0 } else { middle }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_lies_away_from_the_widest_gap() {
        assert_eq!(middle(vec![[24.0, 25.0]]), 24.5);
        assert_eq!(middle(vec![[10.0, 20.0], [15.0, 40.0]]), 25.0);
        assert_eq!(middle(vec![[-180.0, -177.0], [179.0, 180.0]]), -179.0);
        assert_eq!(middle(vec![[-180.0, -179.0], [177.0, 180.0]]), 179.0);
        assert_eq!(middle(vec![[-180.0, 180.0]]), 0.0);
        assert!(middle(vec![]).is_nan());
    }

    #[test]
    fn the_world_and_what_lies_on_one_side_stay_as_they_are() {
        for (west, east) in [(-180.0, 180.0), (24.0, 25.0), (-180.0, -179.0)] {
            let corner = coord! { x: west, y: -10.0 };
            let polygon = Rect::new(corner, coord! { x: east, y: 10.0 }).to_polygon();
            assert_eq!(cut(polygon.clone()), MultiPolygon(vec![polygon]));
        }
    }
}

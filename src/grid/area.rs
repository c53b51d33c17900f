//! The part of the world that a run covers.

use std::path::{Path, PathBuf};

use geo::{BoundingRect, Contains, Coord, LineString, MultiPolygon, Point, Polygon, Rect, coord};

use super::antimeridian;
use crate::error::{Fault, FileError, HasFault};

/// An area in longitude and latitude, or everything the extract holds.
#[derive(Debug, Clone, PartialEq)]
pub enum Area {
    /// Whatever the extract covers.
    Whole,
    /// Inside polygons, in degrees (WGS 84).
    Inside(MultiPolygon<f64>),
}

/// Why an area cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AreaError {
    /// The bounding box is empty or not on the globe.
    #[error(
        "bounding box {0:?} is no area: expected west,south,east,north in degrees, \
         west < east within ±180 (west > east reaches across the antimeridian, less than 180° wide) \
         and south < north within ±90"
    )]
    Bbox([f64; 4]),
    /// The file could not be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The file is no GeoJSON.
    #[error("{}: not GeoJSON: {reason}", path.display())]
    NotGeoJson {
        /// The file.
        path: PathBuf,
        /// The parser's reason.
        reason: String,
    },
    /// The GeoJSON holds no polygon.
    #[error("{}: no Polygon or MultiPolygon in it, nothing would be covered", path.display())]
    NoPolygon {
        /// The file.
        path: PathBuf,
    },
}

impl HasFault for AreaError {
    fn fault(&self) -> Fault {
        match self {
            Self::File(error) => error.fault(),
            _ => Fault::Input,
        }
    }
}

impl Area {
    /// From west, south, east, north in degrees. A box whose west is larger than its east reaches
    /// across the antimeridian (RFC 7946, section 5.2); over half the globe it is taken for a slip.
    ///
    /// # Errors
    /// [`AreaError::Bbox`] for an empty box or one that is not on the globe.
    pub fn from_bbox(bbox: [f64; 4]) -> Result<Self, AreaError> {
        let [west, south, east, north] = bbox;
        let on_globe = [west, east].iter().all(|lon| lon.abs() <= 180.0)
            && [south, north].iter().all(|lat| lat.abs() <= 90.0);
        let across = west > east && west - east >= 180.0;
        if !(on_globe && (west < east || across) && south < north) {
            return Err(AreaError::Bbox(bbox));
        }
        let rect = |west: f64, east: f64| {
            Rect::new(coord! { x: west, y: south }, coord! { x: east, y: north }).to_polygon()
        };
        let polygons = if west < east {
            vec![rect(west, east)]
        } else {
            // A side of no width is none.
            let halves = [(west, 180.0), (-180.0, east)];
            halves.into_iter().filter(|(west, east)| west < east).map(|(w, e)| rect(w, e)).collect()
        };
        if polygons.is_empty() {
            return Err(AreaError::Bbox(bbox));
        }
        Ok(Self::Inside(MultiPolygon(polygons)))
    }

    /// All polygons of a GeoJSON file (RFC 7946: degrees, WGS 84). What crosses the antimeridian is
    /// cut there, whether its longitudes go on beyond ±180 or jump from one side to the other.
    ///
    /// # Errors
    /// When the file cannot be read, is no GeoJSON or holds no polygon.
    pub fn from_geojson(path: &Path) -> Result<Self, AreaError> {
        let text = std::fs::read_to_string(path).map_err(FileError::new("read", path))?;
        let not_geojson = |reason: String| AreaError::NotGeoJson { path: path.to_owned(), reason };
        let parsed: geojson::GeoJson =
            text.parse().map_err(|error: geojson::Error| not_geojson(error.to_string()))?;
        let collection: geo::GeometryCollection<f64> =
            geo::GeometryCollection::try_from(&parsed)
                .map_err(|error| not_geojson(error.to_string()))?;
        let mut polygons = Vec::new();
        collection.into_iter().for_each(|geometry| collect_polygons(geometry, &mut polygons));
        if polygons.is_empty() {
            return Err(AreaError::NoPolygon { path: path.to_owned() });
        }
        Ok(Self::Inside(polygons.into_iter().flat_map(antimeridian::cut).collect()))
    }

    /// From the coordinates of GeoJSON polygons, as manifests record them.
    #[must_use]
    pub fn from_coordinates(polygons: &[Vec<Vec<[f64; 2]>>]) -> Self {
        let ring = |ring: &Vec<[f64; 2]>| ring.iter().copied().map(Coord::from).collect();
        let polygon = |rings: &Vec<Vec<[f64; 2]>>| {
            let mut rings = rings.iter().map(ring);
            let exterior = rings.next().unwrap_or_else(|| LineString::new(Vec::new()));
            Polygon::new(exterior, rings.collect())
        };
        Self::Inside(polygons.iter().map(polygon).collect())
    }

    /// The polygons as GeoJSON coordinates; `None` for the whole extract.
    #[must_use]
    pub fn coordinates(&self) -> Option<Vec<Vec<Vec<[f64; 2]>>>> {
        let Self::Inside(MultiPolygon(polygons)) = self else {
            return None;
        };
        let ring = |line: &LineString<f64>| line.coords().map(|p| [p.x, p.y]).collect();
        let rings = |polygon: &Polygon<f64>| {
            std::iter::once(polygon.exterior()).chain(polygon.interiors()).map(ring).collect()
        };
        Some(polygons.iter().map(rings).collect())
    }

    /// Whether a place lies inside.
    #[must_use]
    pub fn contains(&self, lon: f64, lat: f64) -> bool {
        match self {
            Self::Whole => true,
            Self::Inside(polygons) => polygons.contains(&Point::new(lon, lat)),
        }
    }

    /// Longitude and latitude of the middle of the bounding box, which may reach across the
    /// antimeridian; `None` for the whole extract.
    #[must_use]
    pub fn middle(&self) -> Option<[f64; 2]> {
        let Self::Inside(polygons) = self else { return None };
        let lat = polygons.bounding_rect()?.center().y;
        let longitudes = polygons.iter().filter_map(BoundingRect::bounding_rect);
        let longitudes = longitudes.map(|rect| [rect.min().x, rect.max().x]).collect();
        Some([antimeridian::middle(longitudes), lat])
    }
}

fn collect_polygons(geometry: geo::Geometry<f64>, polygons: &mut Vec<Polygon<f64>>) {
    match geometry {
        geo::Geometry::Polygon(polygon) => polygons.push(polygon),
        geo::Geometry::MultiPolygon(several) => polygons.extend(several),
        geo::Geometry::GeometryCollection(collection) => {
            collection.into_iter().for_each(|member| collect_polygons(member, polygons));
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bbox_contains_its_inside_only() {
        let area = Area::from_bbox([24.0, 60.0, 25.0, 61.0]).expect("a box");
        assert!(area.contains(24.5, 60.5) && !area.contains(23.9, 60.5));
        assert_eq!(area.middle(), Some([24.5, 60.5]));
        assert!(matches!(Area::from_bbox([1.0, 0.0, 0.0, 1.0]), Err(AreaError::Bbox(_))));
        assert!(matches!(Area::from_bbox([1.0, 0.0, 1.0, 1.0]), Err(AreaError::Bbox(_))));
        assert!(matches!(Area::from_bbox([0.0, 1.0, 1.0, 0.0]), Err(AreaError::Bbox(_))));
        assert!(matches!(Area::from_bbox([170.0, 0.0, 181.0, 1.0]), Err(AreaError::Bbox(_))));
        assert!(matches!(Area::from_bbox([f64::NAN, 0.0, 1.0, 1.0]), Err(AreaError::Bbox(_))));
    }

    #[test]
    fn a_bbox_may_reach_across_the_antimeridian() {
        let area = Area::from_bbox([179.0, -17.0, -177.0, -16.0]).expect("a box");
        assert!(area.contains(179.5, -16.5) && area.contains(-177.5, -16.5));
        assert!(!area.contains(0.0, -16.5) && !area.contains(178.5, -16.5));
        assert_eq!(area.middle(), Some([-179.0, -16.5]));
        let up_to = Area::from_bbox([179.0, -17.0, -180.0, -16.0]).expect("a box");
        assert_eq!(up_to.middle(), Some([179.5, -16.5]));
    }

    #[test]
    fn geojson_may_cross_the_antimeridian() {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("area.geojson");
        for ring in [
            "[[179,-17],[181,-17],[181,-16],[179,-16],[179,-17]]",
            "[[179,-17],[-179,-17],[-179,-16],[179,-16],[179,-17]]",
            "[[-179,-17],[-179,-16],[-181,-16],[-181,-17],[-179,-17]]",
        ] {
            let text = format!(r#"{{"type":"Polygon","coordinates":[{ring}]}}"#);
            std::fs::write(&path, text).expect("written");
            let area = Area::from_geojson(&path).expect("a polygon");
            assert!(area.contains(179.5, -16.5) && area.contains(-179.5, -16.5), "{ring}");
            assert!(!area.contains(0.0, -16.5) && !area.contains(178.9, -16.5), "{ring}");
            let middle = area.middle().expect("it has one");
            assert_eq!((middle[0].abs(), middle[1]), (180.0, -16.5), "{ring}");
            let all = area.coordinates().expect("polygons").into_iter().flatten().flatten();
            assert!(all.into_iter().all(|[lon, _]| lon.abs() <= 180.0), "{ring}");
        }
    }

    #[test]
    fn geojson_polygons_are_read_and_other_things_refused() {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("area.geojson");
        let write = |text: &str| std::fs::write(&path, text).expect("written");
        write(
            r#"{"type":"Feature","properties":{},"geometry":{"type":"Polygon",
               "coordinates":[[[0,0],[2,0],[2,2],[0,2],[0,0]],[[0.5,0.5],[1,0.5],[1,1],[0.5,0.5]]]}}"#,
        );
        let area = Area::from_geojson(&path).expect("a polygon");
        assert!(area.contains(1.5, 1.5) && !area.contains(0.9, 0.7));
        let again = Area::from_coordinates(&area.coordinates().expect("polygons"));
        assert_eq!(again, area, "recorded and read again");
        write(r#"{"type":"Point","coordinates":[0,0]}"#);
        assert!(matches!(Area::from_geojson(&path), Err(AreaError::NoPolygon { .. })));
        write("roads");
        assert!(matches!(Area::from_geojson(&path), Err(AreaError::NotGeoJson { .. })));
        let missing = dir.path().join("missing");
        assert!(matches!(Area::from_geojson(&missing), Err(AreaError::File(_))));
    }
}

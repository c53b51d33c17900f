//! One record: a MessagePack map with named fields; its arrays are `.npy` files as byte
//! strings, so that element type and shape travel along.
//!
//! A record of a map that was traced once has schema `record.v1`. One of a map of several repeats has
//! schema `record.v2`: errors beside the levels, both as integers (`packed`). Both are read alike.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;

use super::grids::{Grids, RecordError, matrix};
#[cfg(feature = "build")]
use super::packed::Packed;
use super::packed::{self, PackedRef};
use crate::config::Split;
use crate::grid::TileId;
use crate::manifest::{BaseStation, BuiltBySource, Radio, SourceMap};
use crate::manifest::{MASK_BUILDING, MASK_REACHED, MASK_UNREACHED};
#[cfg(feature = "build")]
use crate::store::npy_bytes;
use crate::units::Dbm;

/// Where a record comes from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// The radio map's file.
    pub radio_map: SourceMap,
    /// SHA-256 of the tile's file.
    pub tile_sha256: String,
    /// SHA-256 of the imported map's file.
    pub rsrp_sha256: String,
    /// Built-up cells of the height grid (before downsampling) by source of height.
    pub built_cells: BuiltBySource,
    /// Licence, as an SPDX identifier.
    pub licence: String,
    /// Attribution that must stay with the record.
    pub attribution: String,
}

/// A record, as it lies in a shard.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// `record.v1`, or `record.v2` where there are errors.
    pub schema: String,
    /// The tile.
    pub id: TileId,
    /// The split.
    pub split: Split,
    /// EPSG code of the projection.
    pub epsg: u32,
    /// Easting and northing of the centre, in metres.
    pub center_m: [f64; 2],
    /// Longitude and latitude of the centre, in degrees.
    pub center_lon_lat: [f64; 2],
    /// Side of a cell, in metres.
    pub cell_m: f64,
    /// Always `north_first`: row 0 is the northernmost, column 0 the westernmost.
    #[schemars(extend("const" = "north_first"))]
    pub row_order: String,
    /// `.npy`, float32 `[n, n]`: height of the highest building in metres, 0 where there is none.
    #[schemars(with = "Vec<u8>")]
    pub height_m: ByteBuf,
    /// `.npy`, float32 `[n, n]`: RSRP in dBm per resource element. A building cell that is partly
    /// outdoors holds the level there, a wholly covered one the floor. In `record.v2` int16, in
    /// hundredths of dBm, with -32768 for the floor; levels below -327.67 dBm are raised to that.
    #[schemars(with = "Vec<u8>")]
    pub rsrp_dbm: ByteBuf,
    /// `.npy`, uint8 `[n, n]`: 0 outdoor reached, 1 building, 2 outdoor unreached.
    #[schemars(with = "Vec<u8>")]
    pub mask: ByteBuf,
    /// Independent repeats that levels are the mean of, two at least (`record.v2`);
    /// `radio.samples_per_tx` counts the rays of one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats: Option<u32>,
    /// `.npy`, uint16 `[n, n]`: standard error of each level in hundredths of dB, 0 to 434
    /// (`record.v2`). See `ErrorGrids`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<Vec<u8>>")]
    pub std_error_db: Option<ByteBuf>,
    /// `.npy`, uint8 `[n, n]`: share of the summed power that the first half of the repeats received,
    /// in 250ths (`record.v2`, where the map tells it). See `ErrorGrids`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<Vec<u8>>")]
    pub first_half_share: Option<ByteBuf>,
    /// What cells without a path hold, in dBm.
    pub floor_dbm: Dbm,
    /// Cells at least this high are buildings in the mask, in metres.
    pub flight_height_m: f64,
    /// The transmitter.
    pub base_station: BaseStation,
    /// How the map was computed.
    pub radio: Radio,
    /// Where it comes from.
    pub provenance: Provenance,
}

impl Record {
    /// The value of `schema` without errors.
    pub const SCHEMA: &'static str = "record.v1";
    /// The value of `schema` with errors.
    pub const SCHEMA_WITH_ERRORS: &'static str = "record.v2";
    /// The value of `row_order`.
    pub const ROW_ORDER: &'static str = "north_first";

    #[cfg(feature = "build")]
    /// Puts arrays into the byte strings of a record, and sets the schema after them. Levels with
    /// errors are rounded to hundredths; [`Record::repeats`] must be set then.
    #[must_use]
    pub fn with_grids(mut self, grids: &Grids) -> Self {
        self.height_m = ByteBuf::from(npy_bytes(&grids.height_m));
        self.mask = ByteBuf::from(npy_bytes(&grids.mask));
        (self.std_error_db, self.first_half_share) = (None, None);
        if let Some(errors) = &grids.errors {
            let packed = packed::pack(self.floor_dbm, grids, errors);
            let Packed { rsrp_dbm, std_error_db, first_half_share } = packed;
            Self::SCHEMA_WITH_ERRORS.clone_into(&mut self.schema);
            self.rsrp_dbm = rsrp_dbm;
            (self.std_error_db, self.first_half_share) = (Some(std_error_db), first_half_share);
        } else {
            Self::SCHEMA.clone_into(&mut self.schema);
            self.rsrp_dbm = ByteBuf::from(npy_bytes(&grids.rsrp_dbm));
            self.repeats = None;
        }
        self
    }

    /// The MessagePack bytes, a map with the fields' names in the order of declaration.
    ///
    /// # Panics
    /// Never: writing to memory cannot fail.
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        rmp_serde::to_vec_named(self).expect("writing to memory cannot fail")
    }

    /// Reads a record; the arrays are not looked at yet.
    ///
    /// # Errors
    /// [`RecordError::Encoding`], also for bytes after the record, and [`RecordError::Value`] for
    /// another order of rows, in which the arrays would mean another place.
    pub fn decode(bytes: &[u8]) -> Result<Self, RecordError> {
        let mut rest = bytes;
        let record: Self = rmp_serde::from_read(&mut rest)
            .map_err(|error| RecordError::Encoding(error.to_string()))?;
        record.check_schema()?;
        if !rest.is_empty() {
            let found = format!("{} bytes after the record", rest.len());
            return Err(RecordError::Encoding(found));
        }
        if record.row_order != Self::ROW_ORDER {
            return Err(RecordError::Value {
                field: "row_order",
                found: record.row_order,
                expected: Self::ROW_ORDER.to_owned(),
            });
        }
        Ok(record)
    }

    /// Which schema it is, and whether it has the fields that belong to it.
    fn check_schema(&self) -> Result<(), RecordError> {
        let of_errors = [
            ("repeats", self.repeats.is_some()),
            ("std_error_db", self.std_error_db.is_some()),
            ("first_half_share", self.first_half_share.is_some()),
        ];
        let fields: Vec<&str> =
            of_errors.iter().filter_map(|(name, given)| given.then_some(*name)).collect();
        let (is_whole, expected) = match self.schema.as_str() {
            Self::SCHEMA => (fields.is_empty(), "none of them"),
            Self::SCHEMA_WITH_ERRORS => (
                self.repeats.is_some_and(|repeats| repeats > 1) && self.std_error_db.is_some(),
                "two repeats or more and the field std_error_db",
            ),
            _ => return Err(RecordError::Encoding(format!("schema is {:?}", self.schema))),
        };
        if is_whole {
            return Ok(());
        }
        let (schema, repeats) = (&self.schema, self.repeats.unwrap_or(1));
        Err(RecordError::Encoding(format!(
            "{schema} with {repeats} repeats and the fields {fields:?}, expected {expected}"
        )))
    }

    /// The arrays, each a square matrix of `cells` × `cells`.
    ///
    /// # Errors
    /// [`RecordError::Array`] and [`RecordError::Value`].
    pub fn grids(&self, cells: usize) -> Result<Grids, RecordError> {
        let height_m = matrix("height_m", &self.height_m, cells)?;
        if self.schema == Self::SCHEMA_WITH_ERRORS {
            let mask = matrix("mask", &self.mask, cells)?;
            let (rsrp_dbm, errors) = packed::unpack(self.packed(), &mask)?;
            return Ok(Grids { height_m, rsrp_dbm, mask, errors: Some(errors) });
        }
        let rsrp_dbm = matrix("rsrp_dbm", &self.rsrp_dbm, cells)?;
        let mask = matrix("mask", &self.mask, cells)?;
        Ok(Grids { height_m, rsrp_dbm, mask, errors: None })
    }

    /// The arrays, after checking that their values mean what the schema says.
    ///
    /// # Errors
    /// As [`Record::grids`]; the first value that is wrong is named with its cell.
    pub fn sound_grids(&self, cells: usize) -> Result<Grids, RecordError> {
        let grids = self.grids(cells)?;
        let sound = Soundness::of(self);
        let rows = grids.height_m.rows().into_iter().zip(grids.rsrp_dbm.rows());
        let rows = rows.zip(grids.mask.rows()).map(|((heights, rsrp), mask)| (heights, rsrp, mask));
        for (row, (heights, rsrp, mask)) in rows.enumerate() {
            let all = match (heights.as_slice(), rsrp.as_slice(), mask.as_slice()) {
                (Some(heights), Some(rsrp), Some(mask)) => sound.all(heights, rsrp, mask),
                // Columns that lie together, as no array of ours has them.
                _ => sound.all(&heights.to_vec(), &rsrp.to_vec(), &mask.to_vec()),
            };
            if !all {
                let mut cells = heights.iter().zip(rsrp).zip(mask).enumerate();
                let first = cells.find(|&(_, ((&h, &rsrp), &kind))| !sound.cell(h, rsrp, kind));
                let (column, ((&height, &rsrp), &kind)) = first.expect("one of them is unsound");
                return Err(self.unsound(((row, column), height, rsrp, kind)));
            }
        }
        packed::check(&grids)?;
        Ok(grids)
    }

    /// The arrays of a record with errors.
    fn packed(&self) -> PackedRef<'_> {
        PackedRef {
            rsrp_dbm: &self.rsrp_dbm,
            std_error_db: self.std_error_db.as_ref().map_or(&[][..], |bytes| bytes),
            first_half_share: self.first_half_share.as_ref().map(|bytes| &bytes[..]),
            floor_dbm: self.floor_dbm,
        }
    }

    /// What is wrong with a cell: its place, height, RSRP and mask.
    fn unsound(&self, (at, height, rsrp, kind): ((usize, usize), f32, f32, u8)) -> RecordError {
        let wrong = |field, found: String, expected: &str| {
            let found = format!("{found} at row {}, column {}", at.0, at.1);
            RecordError::Value { field, found, expected: expected.to_owned() }
        };
        if !(height >= 0.0 && height.is_finite()) {
            return wrong("height_m", height.to_string(), "0 m or more");
        }
        if !rsrp.is_finite() {
            return wrong("rsrp_dbm", rsrp.to_string(), "a finite level");
        }
        if kind == MASK_UNREACHED && f64::from(height) < self.flight_height_m {
            return wrong("rsrp_dbm", rsrp.to_string(), "the floor where mask is 2");
        }
        let found = format!("{kind} under a height of {height} m");
        let expected = "1 exactly where a building reaches the flight height, else 0 or 2";
        wrong("mask", found, expected)
    }
}

/// What the values of a cell must be to each other.
#[derive(Clone, Copy)]
struct Soundness {
    /// The least height that is at least the flight height.
    building_m: f32,
    floor_dbm: f32,
}

impl Soundness {
    fn of(record: &Record) -> Self {
        let nearest = record.flight_height_m as f32;
        let is_below = f64::from(nearest) < record.flight_height_m;
        let building_m = if is_below { nearest.next_up() } else { nearest };
        Self { building_m, floor_dbm: record.floor_dbm.0 as f32 }
    }

    /// Whether all cells are sound. Every record that is read comes through here: without branches
    /// it takes a tenth of the time.
    fn all(self, heights: &[f32], rsrp: &[f32], mask: &[u8]) -> bool {
        let cells = heights.iter().zip(rsrp).zip(mask);
        cells.fold(true, |sound, ((&height, &rsrp), &kind)| sound & self.cell(height, rsrp, kind))
    }

    #[expect(
        clippy::needless_bitwise_bool,
        clippy::manual_range_contains,
        reason = "a branch for each costs more than all of them"
    )]
    #[inline]
    fn cell(self, height: f32, rsrp: f32, kind: u8) -> bool {
        let is_building = height >= self.building_m;
        let is_at_floor = rsrp == self.floor_dbm;
        let is_outdoor = (kind == MASK_REACHED) | ((kind == MASK_UNREACHED) & is_at_floor);
        let is_kind = (is_building & (kind == MASK_BUILDING)) | (!is_building & is_outdoor);
        (height >= 0.0) & (height < f32::INFINITY) & (rsrp.abs() < f32::INFINITY) & is_kind
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::manifest::ValueKind;
    use crate::store::sha256_bytes;
    use ndarray::array;

    pub(crate) fn example() -> (Record, Grids) {
        let grids = Grids {
            height_m: array![[0.0, 9.0], [0.0, 1.5]],
            rsrp_dbm: array![[-90.0, -160.0], [-160.0, -101.5]],
            mask: array![[0, 1], [2, 0]],
            errors: None,
        };
        let id: TileId = "utm10n_e598016_n4128768".parse().expect("an id");
        let digest = sha256_bytes(b"map");
        let record = Record {
            schema: Record::SCHEMA.to_owned(),
            id,
            split: Split::Train,
            epsg: 32610,
            center_m: id.center(),
            center_lon_lat: id.lon_lat(),
            cell_m: 4.0,
            row_order: Record::ROW_ORDER.to_owned(),
            height_m: ByteBuf::new(),
            rsrp_dbm: ByteBuf::new(),
            mask: ByteBuf::new(),
            repeats: None,
            std_error_db: None,
            first_half_share: None,
            floor_dbm: Dbm(-160.0),
            flight_height_m: 2.0,
            base_station: BaseStation {
                position_m: [1.0, 2.0, 12.0],
                power_per_re_dbm: Dbm(15.0),
                pattern: "iso".to_owned(),
            },
            radio: Radio {
                frequency_hz: 3.5e9,
                rx_height_m: 2.0,
                sionna_version: "sionna-rt 2.2.0".to_owned(),
                samples_per_tx: 15_000_000,
                max_depth: 5,
                refraction: false,
                diffraction: true,
            },
            provenance: Provenance {
                radio_map: SourceMap {
                    file: "map.npz".to_owned(),
                    digest: digest.clone(),
                    value_kind: ValueKind::PathGainDb,
                },
                tile_sha256: digest.sha256.clone(),
                rsrp_sha256: digest.sha256,
                built_cells: BuiltBySource::default(),
                licence: "ODbL-1.0".to_owned(),
                attribution: "© OpenStreetMap contributors".to_owned(),
            },
        };
        (record.with_grids(&grids), grids)
    }

    #[test]
    fn records_round_trip() {
        let (record, grids) = example();
        let decoded = Record::decode(&record.encode()).expect("a record");
        assert_eq!(decoded, record);
        assert_eq!(decoded.sound_grids(2).expect("sound"), grids);
    }

    #[test]
    fn unsound_records_are_named() {
        let (record, grids) = example();
        let error = |change: &dyn Fn(&mut Grids)| {
            let mut grids = grids.clone();
            change(&mut grids);
            let unsound = record.clone().with_grids(&grids).sound_grids(2);
            unsound.expect_err("unsound").to_string()
        };
        assert!(error(&|grids| grids.height_m[[0, 0]] = f32::NAN).contains("height_m"));
        assert!(error(&|grids| grids.rsrp_dbm[[0, 0]] = f32::INFINITY).contains("rsrp_dbm"));
        assert!(error(&|grids| grids.rsrp_dbm[[1, 0]] = -99.0).contains("floor"));
        assert!(error(&|grids| grids.mask[[0, 0]] = 1).contains("mask"));
        assert!(error(&|grids| grids.mask[[0, 1]] = 0).contains("mask"));
        assert!(error(&|grids| grids.mask[[0, 0]] = 3).contains("row 0, column 0"));
        assert!(matches!(record.grids(3), Err(RecordError::Value { .. })));
        assert!(matches!(Record::decode(b"\x80"), Err(RecordError::Encoding(_))));
        let mut damaged = record.clone();
        damaged.mask = ByteBuf::from(vec![1, 2, 3]);
        assert!(matches!(damaged.grids(2), Err(RecordError::Array { field: "mask", .. })));
        let mut future = record.clone();
        future.schema = "record.v3".to_owned();
        assert!(Record::decode(&future.encode()).is_err());
        let mut turned = record.clone();
        turned.row_order = "south_first".to_owned();
        let turned = Record::decode(&turned.encode());
        assert!(matches!(turned, Err(RecordError::Value { field: "row_order", .. })));
        let longer = [record.encode(), vec![0xc0]].concat();
        assert!(matches!(Record::decode(&longer), Err(RecordError::Encoding(_))));
    }
}

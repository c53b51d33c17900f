//! The columns of a table of records: one value of a record each, arrays as lists of fixed size.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::types::{
    ArrowPrimitiveType, Float32Type, Float64Type, Int32Type, UInt8Type, UInt32Type, UInt64Type,
};
use arrow_array::{ArrayRef, BooleanArray, FixedSizeListArray, PrimitiveArray, StringArray};
use arrow_schema::{DataType, Field};
use ndarray::Array2;

use crate::dataset::{Grids, Record};
use crate::manifest::ExportColumn;

/// A record with its arrays: what becomes a row.
pub(super) type Row = (Record, Grids);

/// A column, and how it is filled.
pub(super) struct Column {
    /// What is said of it.
    pub(super) entry: ExportColumn,
    values: Values,
    element: DataType,
}

type Values = Box<dyn Fn(&[Row]) -> ArrayRef + Send + Sync>;

impl Column {
    /// As Arrow and Parquet have it; shape, unit and meaning are metadata of the field.
    pub(super) fn field(&self) -> Field {
        let ExportColumn { name, shape, unit, meaning, nullable, .. } = &self.entry;
        let data_type = match shape.iter().product::<u32>() {
            _ if shape.is_empty() => self.element.clone(),
            size => list_type(&self.element, size as i32),
        };
        let mut metadata = HashMap::from([("description".to_owned(), meaning.clone())]);
        if !shape.is_empty() {
            metadata.insert("shape".to_owned(), serde_json::json!(shape).to_string());
        }
        metadata.extend(unit.iter().map(|unit| ("unit".to_owned(), unit.clone())));
        Field::new(name, data_type, *nullable).with_metadata(metadata)
    }

    /// Its values in these rows.
    pub(super) fn values(&self, rows: &[Row]) -> ArrayRef {
        (self.values)(rows)
    }

    fn unit(mut self, unit: &str) -> Self {
        self.entry.unit = Some(unit.to_owned());
        self
    }

    fn of(name: &str, element: DataType, shape: &[u32], meaning: &str, values: Values) -> Self {
        let dtype = match &element {
            DataType::Utf8 => "str".to_owned(),
            DataType::Boolean => "bool".to_owned(),
            number => number.to_string().to_lowercase(),
        };
        let (name, meaning) = (name.to_owned(), meaning.to_owned());
        let shape = shape.to_vec();
        let entry = ExportColumn { name, dtype, shape, unit: None, meaning, nullable: false };
        Self { entry, values, element }
    }
}

fn list_type(element: &DataType, size: i32) -> DataType {
    DataType::FixedSizeList(Arc::new(Field::new_list_field(element.clone(), false)), size)
}

fn text(name: &str, meaning: &str, of: fn(&Record) -> String) -> Column {
    let values = move |rows: &[Row]| -> ArrayRef {
        Arc::new(StringArray::from_iter_values(rows.iter().map(|(record, _)| of(record))))
    };
    Column::of(name, DataType::Utf8, &[], meaning, Box::new(values))
}

fn flag(name: &str, meaning: &str, of: fn(&Record) -> bool) -> Column {
    let values = move |rows: &[Row]| -> ArrayRef {
        let flags: Vec<bool> = rows.iter().map(|(record, _)| of(record)).collect();
        Arc::new(BooleanArray::from(flags))
    };
    Column::of(name, DataType::Boolean, &[], meaning, Box::new(values))
}

fn number<T: ArrowPrimitiveType>(
    name: &str,
    meaning: &str,
    of: fn(&Record) -> T::Native,
) -> Column {
    let values = move |rows: &[Row]| -> ArrayRef {
        let numbers = rows.iter().map(|(record, _)| of(record));
        Arc::new(PrimitiveArray::<T>::from_iter_values(numbers))
    };
    Column::of(name, T::DATA_TYPE, &[], meaning, Box::new(values))
}

fn vector<const N: usize>(name: &str, meaning: &str, of: fn(&Record) -> [f64; N]) -> Column {
    let values = move |rows: &[Row]| {
        let vectors = rows.iter().map(|(record, _)| Some(of(record)));
        list::<Float64Type>(N, rows.len(), vectors)
    };
    Column::of(name, DataType::Float64, &[N as u32], meaning, Box::new(values))
}

/// An array of a record, where it has one.
type GridOf<N> = fn(&Grids) -> Option<&Array2<N>>;

fn grid<T: ArrowPrimitiveType>(
    name: &str,
    cells: u32,
    meaning: &str,
    of: GridOf<T::Native>,
) -> Column {
    let size = (cells * cells) as usize;
    let values = move |rows: &[Row]| {
        let grids = rows.iter().map(|(_, grids)| Some(of(grids)?.iter().copied()));
        list::<T>(size, rows.len(), grids)
    };
    Column::of(name, T::DATA_TYPE, &[cells, cells], meaning, Box::new(values))
}

/// Lists of `size` values; one that is absent is null.
fn list<T: ArrowPrimitiveType>(
    size: usize,
    length: usize,
    lists: impl Iterator<Item = Option<impl IntoIterator<Item = T::Native>>>,
) -> ArrayRef {
    let mut values: Vec<T::Native> = Vec::with_capacity(size * length);
    let mut present = Vec::with_capacity(length);
    for list in lists {
        present.push(list.is_some());
        values.extend(list.into_iter().flatten());
        values.resize(size * present.len(), T::Native::default());
    }
    let element = Arc::new(Field::new_list_field(T::DATA_TYPE, false));
    let nulls = present.contains(&false).then(|| present.into());
    let values = PrimitiveArray::<T>::from_iter_values(values);
    Arc::new(FixedSizeListArray::new(element, size as i32, Arc::new(values), nulls))
}

/// The columns of a dataset whose records have `cells` × `cells` cells; with those of errors if some
/// record has any.
pub(super) fn columns(cells: u32, has_errors: bool) -> Vec<Column> {
    let mut columns = places();
    columns.extend(arrays(cells));
    if has_errors {
        columns.extend(errors(cells));
    }
    columns.extend(radio());
    columns.extend(sources());
    columns
}

fn places() -> Vec<Column> {
    vec![
        text(
            "id",
            "Name of the place: UTM zone, easting and northing of its centre in metres.",
            |record| record.id.to_string(),
        ),
        number::<UInt32Type>("epsg", "EPSG code of the projection.", |record| record.epsg),
        vector("center_m", "Easting and northing of the centre.", |record| record.center_m)
            .unit("m"),
        vector("center_lon_lat", "Longitude and latitude of the centre (WGS 84).", |record| {
            record.center_lon_lat
        })
        .unit("degree"),
        number::<Float64Type>("cell_m", "Side of a cell.", |record| record.cell_m).unit("m"),
    ]
}

/// Row 0 is the northernmost, column 0 the westernmost.
fn arrays(cells: u32) -> Vec<Column> {
    let height = "Height of the highest building, 0 where there is none.";
    let rsrp = "RSRP per resource element; floor_dbm where there is no path.";
    let mask = "0 outdoor and reached, 1 building, 2 outdoor and unreached.";
    vec![
        grid::<Float32Type>("height_m", cells, height, |grids| Some(&grids.height_m)).unit("m"),
        grid::<Float32Type>("rsrp_dbm", cells, rsrp, |grids| Some(&grids.rsrp_dbm)).unit("dBm"),
        grid::<UInt8Type>("mask", cells, mask, |grids| Some(&grids.mask)),
    ]
}

fn errors(cells: u32) -> Vec<Column> {
    let error = "Standard error of rsrp_dbm from the repeats; null in a record of a single trace.";
    let share = "Share of the summed power that the first half of the repeats received, 0 to 1.";
    let error = grid::<Float32Type>("std_error_db", cells, error, |grids| {
        Some(&grids.errors.as_ref()?.std_error_db)
    });
    let share = grid::<Float32Type>("first_half_share", cells, share, |grids| {
        grids.errors.as_ref()?.first_half_share.as_ref()
    });
    let mut columns = vec![error.unit("dB"), share];
    for column in &mut columns {
        column.entry.nullable = true;
    }
    columns
}

fn radio() -> Vec<Column> {
    let at = "East, north and up from the centre on the ground to the base station.";
    let power = "Transmit power per resource element.";
    vec![
        vector("base_station_m", at, |record| record.base_station.position_m).unit("m"),
        number::<Float64Type>("power_per_re_dbm", power, |record| {
            record.base_station.power_per_re_dbm.0
        })
        .unit("dBm"),
        text("pattern", "Antenna pattern, in the producer's words.", |record| {
            record.base_station.pattern.clone()
        }),
        number::<Float64Type>("floor_dbm", "What cells without a path hold.", |record| {
            record.floor_dbm.0
        })
        .unit("dBm"),
        number::<Float64Type>(
            "flight_height_m",
            "Cells at least this high are buildings.",
            |record| record.flight_height_m,
        )
        .unit("m"),
        number::<Float64Type>("frequency_hz", "Carrier frequency.", |record| {
            record.radio.frequency_hz
        })
        .unit("Hz"),
        number::<Float64Type>(
            "rx_height_m",
            "Height of the receivers over the ground.",
            |record| record.radio.rx_height_m,
        )
        .unit("m"),
        number::<Int32Type>(
            "repeats",
            "Independent traces that levels are the mean of.",
            |record| record.repeats.unwrap_or(1).try_into().unwrap_or(i32::MAX),
        ),
        number::<UInt64Type>("samples_per_tx", "Rays of one trace.", |record| {
            record.radio.samples_per_tx
        }),
        number::<UInt32Type>("max_depth", "Most interactions of a path.", |record| {
            record.radio.max_depth
        }),
        flag("refraction", "Whether paths go through walls.", |record| record.radio.refraction),
        flag("diffraction", "Whether paths bend around edges.", |record| record.radio.diffraction),
        text("sionna_version", "The solver and its version.", |record| {
            record.radio.sionna_version.clone()
        }),
    ]
}

fn sources() -> Vec<Column> {
    let provenance = "Files that the record was made of and their SHA-256; built cells by source of height (JSON).";
    vec![
        text("provenance", provenance, |record| serde_json::json!(record.provenance).to_string()),
        text("licence", "Licence, as an SPDX identifier.", |record| {
            record.provenance.licence.clone()
        }),
        text("attribution", "Attribution that must stay with the record.", |record| {
            record.provenance.attribution.clone()
        }),
    ]
}

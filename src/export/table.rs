//! Records to the bytes of a Parquet file, and what such a file says of itself.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_schema::Schema;
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};

use super::columns::{Column, Row, columns};
use crate::dataset::{Dataset, ReadError};
use crate::grid::TileId;
use crate::manifest::ExportColumn;

/// Rows that a reader takes at a time: 16 MB of 121 × 121 cells.
const ROWS_PER_GROUP: usize = 64;
const ZSTD_LEVEL: i32 = 9;

/// The table that records become.
pub(super) struct Table {
    columns: Vec<Column>,
    schema: Arc<Schema>,
}

impl Table {
    /// Of records with `cells` × `cells` cells; with columns of errors, or without.
    pub(super) fn new(cells: u32, has_errors: bool) -> Self {
        let columns = columns(cells, has_errors);
        let schema = Schema::new(columns.iter().map(Column::field).collect::<Vec<_>>());
        Self { columns, schema: Arc::new(schema) }
    }

    /// What is said of its columns.
    pub(super) fn entries(&self) -> Vec<ExportColumn> {
        self.columns.iter().map(|column| column.entry.clone()).collect()
    }

    /// A file of these records.
    pub(super) fn write(&self, dataset: &Dataset, ids: &[TileId]) -> Result<Vec<u8>, ReadError> {
        let level = ZstdLevel::try_new(ZSTD_LEVEL).expect("Zstandard has this level");
        let properties =
            WriterProperties::builder().set_compression(Compression::ZSTD(level)).build();
        let mut writer = ArrowWriter::try_new(Vec::new(), self.schema.clone(), Some(properties))
            .expect("the schema is one that Parquet has");
        for ids in ids.chunks(ROWS_PER_GROUP) {
            let rows = ids.iter().map(|&id| dataset.record_with_grids(id));
            let rows = rows.collect::<Result<Vec<Row>, ReadError>>()?;
            let values = self.columns.iter().map(|column| column.values(&rows)).collect();
            let batch = RecordBatch::try_new(self.schema.clone(), values)
                .expect("columns are filled as they are declared");
            writer.write(&batch).expect("writing to memory cannot fail");
            writer.flush().expect("writing to memory cannot fail");
        }
        Ok(writer.into_inner().expect("writing to memory cannot fail"))
    }
}

/// What a Parquet file says of itself.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Shape {
    /// Number of its rows.
    pub(crate) rows: i64,
    /// Names of its columns.
    pub(crate) columns: Vec<String>,
}

/// Reads the end of a Parquet file.
///
/// # Errors
/// What is wrong, in words.
pub(crate) fn read_shape(path: &Path) -> Result<Shape, String> {
    let file = File::open(path).map_err(|error| error.to_string())?;
    let reader = SerializedFileReader::new(file).map_err(|error| error.to_string())?;
    let metadata = reader.metadata().file_metadata();
    let fields = metadata.schema().get_fields();
    let columns = fields.iter().map(|field| field.name().to_owned()).collect();
    Ok(Shape { rows: metadata.num_rows(), columns })
}

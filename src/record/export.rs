//! A run as a table for other programs: every record a row, every column of `samples.arrows`, codes in words.

use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::Arc;

use arrow::array::{ArrayRef, AsArray, RecordBatch, StringArray};
use arrow::compute::cast;
use arrow::datatypes::{DataType, Field, Schema, SchemaRef, UInt32Type};
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;

use super::columns::{limit_names, state_of};
use super::run::{Run, permissions};
use super::samples::Batches;
use super::{RecordError, Result};
use crate::signal::FaultSet;

/// What the columns of time count, for whoever reads an export.
pub const TIME_BASE: &str = "one row a tick; t_s: since the run's first record; program_time_s: since the program's \
     start, NaN while none runs; *_ns: the recording machine's monotonic clock, which has no date; the run's \
     start document (run.toml) says when it began";

/// A file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Comma-separated values with a header; floating point in as many digits as bring it back exactly, `NaN` where
    /// there is no value.
    Csv,
    /// Apache Parquet; the documents and the time base are in the file's metadata (`freerig.run`,
    /// `freerig.time_base`).
    Parquet,
}

impl Format {
    /// Name of the file in the run's folder.
    pub const fn file_name(self) -> &'static str {
        match self {
            Format::Csv => "samples.csv",
            Format::Parquet => "samples.parquet",
        }
    }
}

/// What was exported.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Exported {
    /// Rows.
    pub rows: usize,
    /// Names of the columns, with their units.
    pub columns: Vec<String>,
}

/// Writes the records of `run` to `path`, which is replaced when everything is written.
///
/// # Errors
/// Where the samples cannot be read or the file cannot be written.
pub fn export(run: &Run, format: Format, path: &Path) -> Result<Exported> {
    let failed = |reason: String| RecordError::Export { path: path.into(), reason };
    let batches = Batches::open(&run.folder, None)?;
    let schema = schema_in_words(batches.schema());
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut file = tempfile::Builder::new()
        .prefix(".tmp-")
        .permissions(permissions())
        .tempfile_in(folder)
        .map_err(RecordError::io(folder))?;
    let mut out = BufWriter::with_capacity(1 << 18, file.as_file_mut());
    let mut rows = 0;
    match format {
        Format::Csv => {
            let mut header = true;
            for batch in batches {
                let batch = in_words(&batch, &schema).map_err(|e| failed(e.to_string()))?;
                rows += batch.num_rows();
                let mut writer = arrow::csv::WriterBuilder::new().with_header(header).build(&mut out);
                writer.write(&batch).map_err(|e| failed(e.to_string()))?;
                header = false;
            }
        }
        Format::Parquet => {
            let document = toml::to_string(&run.document).map_err(|e| failed(e.to_string()))?;
            let metadata = [("freerig.run", document), ("freerig.time_base", TIME_BASE.into())];
            let properties = WriterProperties::builder()
                .set_compression(Compression::SNAPPY)
                .set_key_value_metadata(Some(metadata.map(|(k, v)| KeyValue::new(k.into(), v)).into()))
                .build();
            let mut writer =
                ArrowWriter::try_new(&mut out, schema.clone(), Some(properties)).map_err(|e| failed(e.to_string()))?;
            for batch in batches {
                let batch = in_words(&batch, &schema).map_err(|e| failed(e.to_string()))?;
                rows += batch.num_rows();
                writer.write(&batch).map_err(|e| failed(e.to_string()))?;
            }
            writer.close().map_err(|e| failed(e.to_string()))?;
        }
    }
    out.flush().map_err(RecordError::io(path))?;
    drop(out);
    file.as_file().sync_all().map_err(RecordError::io(path))?;
    file.persist(path).map_err(|e| RecordError::Io { path: path.into(), source: e.error })?;
    Ok(Exported { rows, columns: schema.fields().iter().map(|f| f.name().clone()).collect() })
}

/// How the codes of the column `name` read in words; `None` where they are numbers.
fn words(name: &str) -> Option<fn(u32) -> String> {
    fn faults(set: u32) -> String {
        FaultSet(set).iter().map(|c| c.name()).collect::<Vec<_>>().join("|")
    }
    match name.rsplit_once('.').map_or(name, |(_, own)| own) {
        "state" => Some(|code| state_of(code as u8).name().into()),
        "faults" | "rig_faults" | "latched_faults" => Some(faults),
        "limits" => Some(|set| limit_names(set as u8).collect::<Vec<_>>().join("|")),
        _ => None,
    }
}

fn schema_in_words(schema: &Schema) -> SchemaRef {
    let fields = schema.fields().iter().map(|field| match words(field.name()) {
        Some(_) => Field::new(field.name(), DataType::Utf8, false),
        None => field.as_ref().clone(),
    });
    Arc::new(Schema::new(fields.collect::<Vec<_>>()))
}

fn in_words(batch: &RecordBatch, schema: &SchemaRef) -> std::result::Result<RecordBatch, arrow::error::ArrowError> {
    let columns = schema.fields().iter().zip(batch.columns()).map(|(field, column)| match words(field.name()) {
        Some(word) => {
            let codes = cast(column, &DataType::UInt32)?;
            let texts = codes.as_primitive::<UInt32Type>().values().iter().map(|&code| word(code));
            Ok(Arc::new(StringArray::from_iter_values(texts)) as ArrayRef)
        }
        None => Ok(column.clone()),
    });
    RecordBatch::try_new(schema.clone(), columns.collect::<std::result::Result<_, arrow::error::ArrowError>>()?)
}

//! `samples.arrows`: every record of a run as an Arrow IPC stream.
//!
//! A stream, not a file: it is readable up to its last whole batch after a kill, because nothing at its end is
//! needed. A batch is handed to the operating system as soon as it is complete.

use std::fs::File;
use std::io::{BufReader, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

use arrow::array::{Array, AsArray, Float64Array, RecordBatch};
use arrow::compute::cast;
use arrow::datatypes::{DataType, Float64Type, SchemaRef};
use arrow::error::ArrowError;
use arrow::ipc::reader::StreamReader;
use arrow::ipc::writer::StreamWriter;

use super::columns::{record_at, schema};
use super::{RecordError, Result};
use crate::signal::{TickRecord, Truth};

/// Name of the file in the run's folder.
pub const FILE_NAME: &str = "samples.arrows";

/// The file while it is written.
pub struct SampleWriter {
    path: PathBuf,
    writer: StreamWriter<BufWriter<File>>,
}

impl SampleWriter {
    /// Creates the file with the schema in it.
    ///
    /// # Errors
    /// Where the file cannot be created or written.
    pub fn create(folder: &Path, schema: &SchemaRef) -> Result<Self> {
        let path = folder.join(FILE_NAME);
        let file = File::create_new(&path).map_err(RecordError::io(&path))?;
        let mut writer = StreamWriter::try_new(BufWriter::with_capacity(1 << 18, file), schema)
            .map_err(RecordError::samples(&path))?;
        writer.get_mut().flush().map_err(RecordError::io(&path))?;
        Ok(Self { path, writer })
    }

    /// Appends `batch` and hands it to the operating system.
    ///
    /// # Errors
    /// Where it cannot be written: the disk is full.
    pub fn write(&mut self, batch: &RecordBatch) -> Result<()> {
        self.writer.write(batch).map_err(RecordError::samples(&self.path))?;
        self.writer.get_mut().flush().map_err(RecordError::io(&self.path))
    }

    /// From here on the disk has no room.
    #[cfg(test)]
    pub(super) fn fill_the_disk(&mut self) {
        let full = File::options().write(true).open("/dev/full").unwrap();
        *self.writer.get_mut() = BufWriter::new(full);
    }

    /// Writes the end of the stream and waits until the disk has everything.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn finish(mut self) -> Result<()> {
        self.writer.finish().map_err(RecordError::samples(&self.path))?;
        self.writer.get_mut().flush().map_err(RecordError::io(&self.path))?;
        self.writer.get_ref().get_ref().sync_all().map_err(RecordError::io(&self.path))
    }
}

/// The batches of a file, up to the last whole one.
pub struct Batches {
    reader: Option<StreamReader<BufReader<File>>>,
    schema: SchemaRef,
    size: u64,
    truncated: bool,
}

impl Batches {
    /// Opens the file in `folder`; of its columns only those of the indices `projection`, where given.
    ///
    /// # Errors
    /// Where it cannot be opened, or was cut before its schema was complete.
    pub fn open(folder: &Path, projection: Option<Vec<usize>>) -> Result<Self> {
        let path = folder.join(FILE_NAME);
        let file = File::open(&path).map_err(RecordError::io(&path))?;
        let size = file.metadata().map_err(RecordError::io(&path))?.len();
        let reader = StreamReader::try_new(BufReader::with_capacity(1 << 18, file), projection).map_err(|source| {
            // An empty or cut schema: the run was killed before its first sample.
            RecordError::NoSamples { path: path.clone(), reason: source.to_string() }
        })?;
        Ok(Self { schema: reader.schema(), reader: Some(reader), size, truncated: false })
    }

    /// The (projected) schema.
    pub fn schema(&self) -> &SchemaRef {
        &self.schema
    }

    /// How much of the file has been read, 0 to 1.
    pub fn share(&self) -> f64 {
        let Some(reader) = &self.reader else { return 1.0 };
        let mut file: &File = reader.get_ref().get_ref();
        file.stream_position().map_or(0.0, |at| at as f64 / self.size.max(1) as f64)
    }

    /// Whether the file ended within a batch; known when the iterator has ended.
    pub fn truncated(&self) -> bool {
        self.truncated
    }
}

impl Iterator for Batches {
    type Item = RecordBatch;

    fn next(&mut self) -> Option<RecordBatch> {
        match self.reader.as_mut()?.next() {
            Some(Ok(batch)) => Some(batch),
            Some(Err(_)) => {
                // Cut off by a kill or a full disk: what came before is whole.
                self.truncated = true;
                self.reader = None;
                None
            }
            None => {
                self.reader = None;
                None
            }
        }
    }
}

/// Some columns of a run as numbers, all of one length.
#[derive(Clone, Debug, Default)]
pub struct Table {
    names: Vec<String>,
    columns: Vec<Vec<f64>>,
}

impl Table {
    /// The column `name`; empty where there is none.
    pub fn get(&self, name: &str) -> &[f64] {
        self.names.iter().position(|n| n == name).map_or(&[], |i| &self.columns[i])
    }

    /// Rows.
    pub fn len(&self) -> usize {
        self.columns.first().map_or(0, Vec::len)
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Some columns of a run as numbers, piece by piece: a run of a day does not fit into memory as a whole.
pub struct Tables {
    batches: Batches,
    names: Vec<String>,
    path: PathBuf,
}

impl Tables {
    /// Opens the columns `names` of the file in `folder`, as `f64` whatever they are stored as; a column that the file
    /// lacks is left out.
    ///
    /// # Errors
    /// Where the file cannot be read at all.
    pub fn open(folder: &Path, names: &[String]) -> Result<Self> {
        let all = Batches::open(folder, None)?.schema().clone();
        let mut found: Vec<(usize, &String)> =
            names.iter().filter_map(|n| all.index_of(n).ok().map(|i| (i, n))).collect();
        // A projection keeps the file's order.
        found.sort_unstable();
        found.dedup();
        let batches = Batches::open(folder, Some(found.iter().map(|(i, _)| *i).collect()))?;
        let names = found.into_iter().map(|(_, name)| name.clone()).collect();
        Ok(Self { batches, names, path: folder.join(FILE_NAME) })
    }

    /// All of them together.
    ///
    /// # Errors
    /// Where a column does not hold numbers.
    pub fn whole(self) -> Result<Table> {
        let mut whole = Table { columns: vec![Vec::new(); self.names.len()], names: self.names.clone() };
        for table in self {
            whole.columns.iter_mut().zip(table?.columns).for_each(|(all, mut new)| all.append(&mut new));
        }
        Ok(whole)
    }

    /// How much of the file has been read, 0 to 1.
    pub fn share(&self) -> f64 {
        self.batches.share()
    }
}

impl Iterator for Tables {
    type Item = Result<Table>;

    fn next(&mut self) -> Option<Self::Item> {
        let batch = self.batches.next()?;
        let columns = batch.columns().iter().map(|array| as_f64(array)).collect::<std::result::Result<_, _>>();
        let columns = columns.map_err(RecordError::samples(&self.path));
        Some(columns.map(|columns| Table { names: self.names.clone(), columns }))
    }
}

fn as_f64(array: &dyn Array) -> std::result::Result<Vec<f64>, ArrowError> {
    if let Some(floats) = array.as_primitive_opt::<Float64Type>() {
        return Ok(floats.values().to_vec());
    }
    Ok(cast(array, &DataType::Float64)?.as_primitive::<Float64Type>().values().to_vec())
}

/// The column `name` of `batch`; `None` where there is none or it is not of floating point.
pub fn floats<'a>(batch: &'a RecordBatch, name: &str) -> Option<&'a Float64Array> {
    batch.column_by_name(name)?.as_primitive_opt()
}

/// The records of a run, bit for bit as they were pushed, with the simulated rig's truth (empty without).
pub struct Records {
    batches: Batches,
    names: Vec<String>,
    truth: bool,
    current: Option<(RecordBatch, usize)>,
}

impl Records {
    /// Opens the file in `folder` of a run of the FREEs `names`.
    ///
    /// # Errors
    /// Where it cannot be read, or its columns are not those of this program.
    pub fn open(folder: &Path, names: &[String]) -> Result<Self> {
        let batches = Batches::open(folder, None)?;
        let truth = match batches.schema() {
            s if *s == schema(names, false) => false,
            s if *s == schema(names, true) => true,
            _ => return Err(RecordError::OtherColumns { path: folder.join(FILE_NAME) }),
        };
        Ok(Self { batches, names: names.to_vec(), truth, current: None })
    }
}

impl Iterator for Records {
    type Item = (TickRecord, Vec<Truth>);

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some((batch, row)) = &mut self.current
                && *row < batch.num_rows()
            {
                let item = record_at(batch, *row, &self.names, self.truth);
                *row += 1;
                return Some(item);
            }
            self.current = Some((self.batches.next()?, 0));
        }
    }
}

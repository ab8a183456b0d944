//! A study of many designs in a folder, computed in pieces by as many processes and machines as there are.
//!
//! | file | what |
//! | --- | --- |
//! | `study.toml` | what is asked; the same for everybody who computes |
//! | `piece-00012.parquet` | the designs of one piece at every pressure, written whole or not at all |
//! | `designs.parquet` | all of them, once every piece is there |
//!
//! What was computed when a process is killed stays: whoever comes next computes the pieces that are missing. Two who
//! compute the same piece write the same.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, Float64Array, RecordBatch, StringArray, UInt32Array};
use arrow::datatypes::{Float64Type, UInt32Type};
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::basic::Compression;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use serde::{Deserialize, Serialize};

use super::palette;
use super::plot::{Line, Plot};
use super::run::write_atomically;
use super::sheet::Sheet;
use super::{RecordError, Result};
use crate::fem::material::Law;
use crate::fem::tube::Tube;
use crate::plan::study::{Candidate, Row};

/// Most designs of a piece: some seconds of one core.
const PIECE: usize = 16;
/// Pieces that a small study has at least, as far as it has designs: shares are made of whole ones.
const PIECES: usize = 64;

/// What is asked, as study.toml has it. SI units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StudyDocument {
    /// Version of freerig that computes it.
    pub version: String,
    /// What is varied, in the words of the command line, the last running fastest.
    pub sweeps: Vec<String>,
    /// Number of designs.
    pub designs: usize,
    /// m.
    pub length_m: f64,
    /// Pa.
    pub pressures_pa: Vec<f64>,
    /// Relative discretisation error.
    pub tolerance: f64,
    /// What is not varied.
    pub tube: TubeInWords,
}

/// A tube in study.toml.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TubeInWords {
    gamma_rad: f64,
    inner_diameter_m: f64,
    wall_m: f64,
    fibers: usize,
    fiber_ea_n: f64,
    fiber_width_m: f64,
    mu_pa: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    alpha: Option<f64>,
}

impl From<&Tube> for TubeInWords {
    fn from(tube: &Tube) -> Self {
        TubeInWords {
            gamma_rad: tube.gamma,
            inner_diameter_m: 2.0 * tube.inner_radius,
            wall_m: tube.wall,
            fibers: tube.fibers,
            fiber_ea_n: tube.fiber_ea,
            fiber_width_m: tube.fiber_width,
            mu_pa: tube.law.shear_modulus(),
            alpha: tube.law.exponent(),
        }
    }
}

impl StudyDocument {
    /// What `other` asks differently; none where nothing.
    fn differs(&self, other: &StudyDocument) -> Option<String> {
        let pairs = [
            ("version", format!("{:?}", self.version), format!("{:?}", other.version)),
            ("sweeps", format!("{:?}", self.sweeps), format!("{:?}", other.sweeps)),
            ("designs", self.designs.to_string(), other.designs.to_string()),
            ("length_m", self.length_m.to_string(), other.length_m.to_string()),
            ("pressures_pa", format!("{:?}", self.pressures_pa), format!("{:?}", other.pressures_pa)),
            ("tolerance", self.tolerance.to_string(), other.tolerance.to_string()),
            ("tube", format!("{:?}", self.tube), format!("{:?}", other.tube)),
        ];
        pairs.into_iter().find(|(_, a, b)| a != b).map(|(key, a, b)| format!("{key}: {a} there, {b} here"))
    }
}

/// A study's folder.
#[derive(Clone, Debug)]
pub struct Study {
    folder: PathBuf,
    document: StudyDocument,
}

impl Study {
    /// Opens the study in `folder`, or begins it.
    ///
    /// # Errors
    /// A folder that cannot be written, or that holds another study.
    pub fn open(folder: &Path, document: StudyDocument) -> Result<Study> {
        fs::create_dir_all(folder).map_err(RecordError::io(folder))?;
        let path = folder.join("study.toml");
        let reason = |path: &Path, reason: String| RecordError::Document { path: path.into(), reason };
        match fs::read_to_string(&path) {
            Ok(text) => {
                let there: StudyDocument = toml::from_str(&text).map_err(|e| reason(&path, e.to_string()))?;
                if let Some(differs) = there.differs(&document) {
                    return Err(RecordError::OtherStudy { path, differs });
                }
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                let text = toml::to_string(&document).map_err(|e| reason(&path, e.to_string()))?;
                write_atomically(&path, text.as_bytes())?;
            }
            Err(error) => return Err(RecordError::io(&path)(error)),
        }
        Ok(Study { folder: folder.into(), document })
    }

    /// Number of pieces.
    pub fn pieces(&self) -> usize {
        self.document.designs.div_ceil(self.piece())
    }

    /// Designs of a piece.
    fn piece(&self) -> usize {
        (self.document.designs / PIECES).clamp(1, PIECE)
    }

    /// The designs of `piece`.
    pub fn designs(&self, piece: usize) -> std::ops::Range<usize> {
        let all = self.document.designs;
        (piece * self.piece()).min(all)..((piece + 1) * self.piece()).min(all)
    }

    /// Whether `piece` is there.
    pub fn done(&self, piece: usize) -> bool {
        self.path(piece).exists()
    }

    fn path(&self, piece: usize) -> PathBuf {
        self.folder.join(format!("piece-{piece:05}.parquet"))
    }

    /// Writes `piece`, whole or not at all.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn keep(&self, piece: usize, rows: &[Row]) -> Result<()> {
        let path = self.path(piece);
        let bytes = self.parquet(&path, rows)?;
        write_atomically(&path, &bytes)
    }

    /// Every piece's rows in order, written into `designs.parquet`, whose path is returned with them.
    ///
    /// # Errors
    /// A piece that is missing or damaged, by its file; where the whole cannot be written.
    pub fn merge(&self) -> Result<(PathBuf, Vec<Row>)> {
        let mut rows = Vec::new();
        for piece in 0..self.pieces() {
            let path = self.path(piece);
            let found = read(&path)?;
            let wanted = self.designs(piece).len() * self.document.pressures_pa.len();
            if found.len() != wanted {
                let reason = format!("{} rows where {wanted} belong", found.len());
                return Err(RecordError::Piece { path, reason });
            }
            rows.extend(found);
        }
        let path = self.folder.join("designs.parquet");
        let bytes = self.parquet(&path, &rows)?;
        write_atomically(&path, &bytes)?;
        Ok((path, rows))
    }

    fn parquet(&self, path: &Path, rows: &[Row]) -> Result<Vec<u8>> {
        let failed = |reason: String| RecordError::Export { path: path.into(), reason };
        let batch = batch(rows).map_err(|e| failed(e.to_string()))?;
        let question = toml::to_string(&self.document).map_err(|e| failed(e.to_string()))?;
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_key_value_metadata(Some(vec![KeyValue::new("freerig.study".into(), question)]))
            .build();
        let mut bytes = Vec::new();
        let mut writer =
            ArrowWriter::try_new(&mut bytes, batch.schema(), Some(properties)).map_err(|e| failed(e.to_string()))?;
        writer.write(&batch).map_err(|e| failed(e.to_string()))?;
        writer.close().map_err(|e| failed(e.to_string()))?;
        Ok(bytes)
    }
}

type Known = fn(&Row) -> f64;
type Perhaps = fn(&Row) -> Option<f64>;

/// Columns of a candidate.
const GIVEN: [(&str, Known); 8] = [
    ("gamma_rad", |r| r.candidate.tube.gamma),
    ("inner_diameter_m", |r| 2.0 * r.candidate.tube.inner_radius),
    ("wall_m", |r| r.candidate.tube.wall),
    ("fiber_ea_n", |r| r.candidate.tube.fiber_ea),
    ("fiber_width_m", |r| r.candidate.tube.fiber_width),
    ("mu_pa", |r| r.candidate.tube.law.shear_modulus()),
    ("alpha", |r| r.candidate.tube.law.exponent().unwrap_or(0.0)),
    ("pressure_pa", |r| r.pressure),
];
/// Columns that may be empty.
const FOUND: [(&str, Perhaps); 8] = [
    ("spacing_m", |r| r.candidate.spacing),
    ("twist_rad_per_m", |r| r.twist),
    ("axial_stretch", |r| r.stretch),
    ("force_n", |r| r.force),
    ("moment_nm", |r| r.moment),
    ("module_sideways_m", |r| r.sideways),
    ("module_lift_m", |r| r.lift),
    ("discretisation_error_estimate", |r| r.error),
];

fn batch(rows: &[Row]) -> std::result::Result<RecordBatch, arrow::error::ArrowError> {
    let mut columns: Vec<(&str, ArrayRef, bool)> = Vec::new();
    for (name, of) in GIVEN {
        columns.push((name, Arc::new(Float64Array::from_iter_values(rows.iter().map(of))), false));
    }
    let fibers = rows.iter().map(|r| r.candidate.tube.fibers as u32);
    columns.push(("fibers", Arc::new(UInt32Array::from_iter_values(fibers)), false));
    for (name, of) in FOUND {
        columns.push((name, Arc::new(Float64Array::from_iter(rows.iter().map(of))), true));
    }
    let remarks = StringArray::from_iter_values(rows.iter().map(|r| r.remark.as_str()));
    columns.push(("remark", Arc::new(remarks), false));
    RecordBatch::try_from_iter_with_nullable(columns)
}

fn read(path: &Path) -> Result<Vec<Row>> {
    let file = fs::File::open(path).map_err(RecordError::io(path))?;
    let damaged = |reason: String| RecordError::Piece { path: path.into(), reason };
    let reader = ParquetRecordBatchReaderBuilder::try_new(file)
        .and_then(ParquetRecordBatchReaderBuilder::build)
        .map_err(|e| damaged(e.to_string()))?;
    let mut rows = Vec::new();
    for batch in reader {
        let batch = batch.map_err(|e| damaged(e.to_string()))?;
        let column = |name: &str| batch.column_by_name(name).ok_or_else(|| damaged(format!("no column `{name}`")));
        let floats = |name: &str| {
            let column = column(name)?.as_primitive_opt::<Float64Type>();
            column.ok_or_else(|| damaged(format!("column `{name}` holds no numbers")))
        };
        let given = GIVEN.map(|(name, _)| floats(name)).into_iter().collect::<Result<Vec<_>>>()?;
        let found = FOUND.map(|(name, _)| floats(name)).into_iter().collect::<Result<Vec<_>>>()?;
        let fibers = column("fibers")?.as_primitive_opt::<UInt32Type>();
        let fibers = fibers.ok_or_else(|| damaged("column `fibers` holds no numbers".into()))?;
        let remarks = column("remark")?.as_string_opt::<i32>();
        let remarks = remarks.ok_or_else(|| damaged("column `remark` holds no text".into()))?;
        for i in 0..batch.num_rows() {
            let [gamma, diameter, wall, fiber_ea, fiber_width, mu, alpha, pressure] =
                std::array::from_fn(|c| given[c].value(i));
            let [spacing, twist, stretch, force, moment, sideways, lift, error] =
                std::array::from_fn(|c| found[c].is_valid(i).then(|| found[c].value(i)));
            let fibers = fibers.value(i) as usize;
            let law = Law::Ogden { mu, alpha };
            let tube = Tube { inner_radius: 0.5 * diameter, wall, gamma, fibers, fiber_ea, fiber_width, law };
            let candidate = Candidate { tube, spacing };
            let remark = remarks.value(i).to_owned();
            rows.push(Row { candidate, pressure, twist, stretch, force, moment, sideways, lift, error, remark });
        }
    }
    Ok(rows)
}

/// Height of a drawing, pixels.
const HEIGHT: u32 = 300;

/// A label, and what it says of a row, in its unit.
pub type Labelled<'a, T> = (String, &'a dyn Fn(&Row) -> T);

/// A page with, for every parameter (its label, its value in the label's unit) and every aim, the farthest that any
/// design with that value gets.
pub fn study_sheet(
    title: &str,
    facts: Vec<(String, String)>,
    rows: &[&Row],
    parameters: &[Labelled<'_, f64>],
    aims: &[Labelled<'_, Option<f64>>],
) -> Sheet {
    let mut figures = Vec::new();
    for (axis, value) in parameters {
        let mut values: Vec<f64> = rows.iter().map(|row| value(row)).collect();
        values.sort_by(f64::total_cmp);
        values.dedup();
        for (aim, of) in aims {
            let farthest = |x: &f64| {
                let those = rows.iter().filter(|row| value(row) == *x).filter_map(|row| of(row));
                those.fold(f64::NAN, f64::max)
            };
            let y = values.iter().map(farthest).collect();
            let plot = Plot {
                x_label: axis.clone(),
                y_label: aim.clone(),
                height: HEIGHT,
                lines: vec![Line::new(aim, palette::BLUE, &values, y)],
                ..Plot::default()
            };
            figures.push((format!("Most {aim}, whatever the rest, by {axis}"), plot));
        }
    }
    Sheet { title: title.into(), facts, figures, ..Sheet::default() }
}

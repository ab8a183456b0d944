//! `tip.csv` of a run that followed a path: where the plate was held to be while it ran, what was learned of the
//! module, and what a tracker saw. A line is handed to the operating system as soon as it is written: what a killed run
//! leaves behind can be read.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;

use super::{RecordError, Result};

/// Name of the file in the run's folder.
pub const FILE_NAME: &str = "tip.csv";

/// Its columns: the time of the program that the line is about; the plate's centre and the standard deviation of its
/// coordinates; what a tracker saw since the line before, and whether it was believed (1) or not (0); the unknowns.
const COLUMNS: [&str; 24] = [
    "program_time_s",
    "x_m",
    "y_m",
    "z_m",
    "deviation_x_m",
    "deviation_y_m",
    "deviation_z_m",
    "tracker_x_m",
    "tracker_y_m",
    "tracker_z_m",
    "tracker_believed",
    "a_angle_rad",
    "b_angle_rad",
    "c_angle_rad",
    "d_angle_rad",
    "a_rubber",
    "b_rubber",
    "c_rubber",
    "d_rubber",
    "a_wall",
    "b_wall",
    "c_wall",
    "d_wall",
    "payload_kg",
];

/// One line. What is not known is not a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipLine {
    /// Time of the program, s.
    pub time: f64,
    /// The plate's centre, m.
    pub position: Vector3<f64>,
    /// Standard deviation of its coordinates, m.
    pub deviation: Vector3<f64>,
    /// What a tracker saw of it, m, and whether that was believed.
    pub tracker: Option<(Vector3<f64>, bool)>,
    /// Winding angles (rad, of their magnitude), stiffnesses of the rubber and thicknesses of the wall (relative) of A,
    /// B, C, D by which they differ from their calibrations, and a payload, kg.
    pub unknowns: [f64; 13],
}

/// The file while it is written.
#[derive(Debug)]
pub struct TipWriter {
    path: PathBuf,
    file: File,
}

impl TipWriter {
    /// Creates the file in `folder`.
    ///
    /// # Errors
    /// Where it cannot be created or written.
    pub fn create(folder: &Path) -> Result<TipWriter> {
        let path = folder.join(FILE_NAME);
        let mut file = File::create_new(&path).map_err(RecordError::io(&path))?;
        writeln!(file, "{}", COLUMNS.join(",")).map_err(RecordError::io(&path))?;
        Ok(TipWriter { path, file })
    }

    /// Appends `line`.
    ///
    /// # Errors
    /// Where it cannot be written: the disk is full.
    pub fn write(&mut self, line: &TipLine) -> Result<()> {
        let (seen, believed) = match line.tracker {
            Some((seen, believed)) => (seen, f64::from(u8::from(believed))),
            None => (Vector3::repeat(f64::NAN), f64::NAN),
        };
        let values = [line.time].into_iter().chain(line.position.iter().copied()).chain(line.deviation.iter().copied());
        let values = values.chain(seen.iter().copied()).chain([believed]).chain(line.unknowns);
        let text = values.map(|x| if x.is_finite() { x.to_string() } else { String::new() }).collect::<Vec<_>>();
        self.file.write_all((text.join(",") + "\n").as_bytes()).map_err(RecordError::io(&self.path))
    }
}

/// The lines of the run in `folder`, up to the last whole one; none where it followed no path.
///
/// # Errors
/// Where the file cannot be read.
pub fn read(folder: &Path) -> Result<Option<Vec<TipLine>>> {
    let path = folder.join(FILE_NAME);
    match std::fs::read_to_string(&path) {
        Ok(text) => Ok(Some(text.lines().skip(1).map_while(line).collect())),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(RecordError::io(&path)(error)),
    }
}

fn line(text: &str) -> Option<TipLine> {
    let value = |text: &str| if text.is_empty() { Some(f64::NAN) } else { text.parse().ok() };
    let values: Vec<f64> = text.split(',').map(value).collect::<Option<_>>()?;
    let values: [f64; COLUMNS.len()] = values.try_into().ok()?;
    let vector = |at: usize| Vector3::new(values[at], values[at + 1], values[at + 2]);
    let tracker = (!values[10].is_nan()).then(|| (vector(7), values[10] == 1.0));
    let unknowns = std::array::from_fn(|i| values[11 + i]);
    Some(TipLine { time: values[0], position: vector(1), deviation: vector(4), tracker, unknowns })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_written_is_read_up_to_the_last_whole_line() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(read(folder.path()).unwrap(), None);
        let line = |time: f64, tracker| TipLine {
            time,
            position: Vector3::new(0.1 + time, -2e-3, 0.13),
            deviation: Vector3::repeat(1e-4),
            tracker,
            unknowns: std::array::from_fn(|i| 0.01 * i as f64),
        };
        let lines = [line(0.0, None), line(0.02, Some((Vector3::x(), true))), line(0.04, Some((Vector3::y(), false)))];
        let mut file = TipWriter::create(folder.path()).unwrap();
        lines.iter().for_each(|line| file.write(line).unwrap());
        assert_eq!(read(folder.path()).unwrap().unwrap(), lines);
        let path = folder.path().join(FILE_NAME);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, &text[..text.len() - 20]).unwrap();
        assert_eq!(read(folder.path()).unwrap().unwrap(), lines[..2]);
    }
}

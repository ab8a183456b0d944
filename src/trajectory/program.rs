//! What an experiment asks of every FREE.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{Sequence, SequenceError};
use crate::signal::{MAX_FREES, Quantity, Reference};

/// The reference of one FREE.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// Angle (rad, closed loop) or pressure (Pa, open loop).
    pub quantity: Quantity,
    /// Course over time.
    #[serde(rename = "segments")]
    pub sequence: Sequence,
}

/// Why axes do not make a program.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ProgramError {
    /// No FREE takes part.
    #[error("a program needs at least one FREE")]
    Empty,
    /// A FREE beyond those that a rig can hold.
    #[error("FREE {0} does not exist: a rig holds at most {MAX_FREES}, counted from 0")]
    NoSuchFree(usize),
    /// A FREE is asked twice.
    #[error("FREE {0} (counted from 0) is given two references")]
    Twice(usize),
    /// An axis that asks for nothing.
    #[error("the reference of FREE {0} (counted from 0) must be an angle or a pressure")]
    NoQuantity(usize),
    /// A FREE cannot be driven by suction.
    #[error(
        "the reference of FREE {free} (counted from 0) goes down to {pressure} Pa; a pressure must not be negative"
    )]
    Suction {
        /// Index of the FREE.
        free: usize,
        /// Its lowest pressure, Pa.
        pressure: f64,
    },
    /// A sequence that is none.
    #[error(transparent)]
    Sequence(#[from] SequenceError),
}

/// The references of all FREEs of the rig.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<Entry>", into = "Vec<Entry>")]
pub struct Program {
    /// By FREE, in the order of rig.toml; `None` holds the FREE at zero pressure.
    pub axes: [Option<Axis>; MAX_FREES],
    /// Total duration, s: the longest axis.
    pub duration: f64,
}

impl Program {
    /// A program of `axes`, each with the index of its FREE; it lasts as long as the longest.
    pub fn new(axes: impl IntoIterator<Item = (usize, Axis)>) -> Result<Self, ProgramError> {
        let mut program = Self::default();
        for (free, axis) in axes {
            match axis.quantity {
                Quantity::None => return Err(ProgramError::NoQuantity(free)),
                Quantity::Pressure if axis.sequence.range().0 < 0.0 => {
                    return Err(ProgramError::Suction { free, pressure: axis.sequence.range().0 });
                }
                Quantity::Pressure | Quantity::Angle => {}
            }
            let duration = axis.sequence.duration();
            let slot = program.axes.get_mut(free).ok_or(ProgramError::NoSuchFree(free))?;
            if slot.replace(axis).is_some() {
                return Err(ProgramError::Twice(free));
            }
            program.duration = program.duration.max(duration);
        }
        if program.axes.iter().all(Option::is_none) { Err(ProgramError::Empty) } else { Ok(program) }
    }

    /// An angle program for one FREE.
    pub fn angle(free: usize, sequence: Sequence) -> Result<Self, ProgramError> {
        Self::new([(free, Axis { quantity: Quantity::Angle, sequence })])
    }

    /// A pressure program for one FREE.
    pub fn pressure(free: usize, sequence: Sequence) -> Result<Self, ProgramError> {
        Self::new([(free, Axis { quantity: Quantity::Pressure, sequence })])
    }

    /// What is asked of FREE number `free` at time `t`, s since the start; nothing of one without an axis. Holds
    /// before the start and after the end. Allocates nothing.
    pub fn reference(&self, free: usize, t: f64) -> Reference {
        match self.axes.get(free) {
            Some(Some(axis)) => {
                let (position, rate, acceleration) = axis.sequence.at(t);
                Reference { quantity: axis.quantity, position, rate, acceleration }
            }
            _ => Reference::default(),
        }
    }

    /// The program `times` times, one after the other; shorter axes wait for the longest at their last value.
    pub fn repeated(&self, times: usize) -> Result<Self, ProgramError> {
        let axes = self.axes.iter().enumerate().filter_map(|(free, axis)| Some((free, axis.as_ref()?)));
        let axes: Vec<_> = axes
            .map(|(free, axis)| {
                let sequence = axis.sequence.extended_to(self.duration)?.repeated(times)?;
                Ok((free, Axis { quantity: axis.quantity, sequence }))
            })
            .collect::<Result<_, SequenceError>>()?;
        Self::new(axes)
    }
}

/// A program in a file: only the FREEs that take part.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Entry {
    free: usize,
    #[serde(flatten)]
    axis: Axis,
}

impl TryFrom<Vec<Entry>> for Program {
    type Error = ProgramError;

    fn try_from(entries: Vec<Entry>) -> Result<Self, ProgramError> {
        Self::new(entries.into_iter().map(|e| (e.free, e.axis)))
    }
}

impl From<Program> for Vec<Entry> {
    fn from(program: Program) -> Self {
        let axes = program.axes.into_iter().enumerate();
        axes.filter_map(|(free, axis)| Some(Entry { free, axis: axis? })).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Shape, paper_trajectory};
    use super::*;

    fn program() -> Program {
        let ramp = Sequence::starting_at(0.0).then(Shape::Linear, 4e4, 2.0).build().unwrap();
        Program::new([
            (3, Axis { quantity: Quantity::Angle, sequence: paper_trajectory().unwrap() }),
            (1, Axis { quantity: Quantity::Pressure, sequence: ramp }),
        ])
        .unwrap()
    }

    #[test]
    fn each_free_gets_its_own_reference() {
        let program = program();
        assert_eq!(program.duration, 9.0);
        let pressure = program.reference(1, 1.0);
        assert_eq!((pressure.quantity, pressure.position, pressure.rate), (Quantity::Pressure, 2e4, 2e4));
        assert_eq!(program.reference(1, 5.0).position, 4e4);
        assert_eq!(program.reference(3, 8.0).position, 70f64.to_radians());
        assert_eq!(program.reference(0, 1.0), Reference::default());
        assert_eq!(program.reference(99, 1.0), Reference::default());
    }

    #[test]
    fn repeats_keep_the_axes_together() {
        let twice = program().repeated(2).unwrap();
        assert_eq!(twice.duration, 18.0);
        assert_eq!(twice.reference(1, 10.0).position, 2e4);
        assert_eq!(twice.reference(3, 9.0 + 0.75).position, 20f64.to_radians());
    }

    #[test]
    fn what_is_no_program_is_refused_by_name() {
        let axis = |quantity, value| Axis { quantity, sequence: Sequence::constant(value, 1.0).unwrap() };
        assert_eq!(Program::new([]).unwrap_err(), ProgramError::Empty);
        assert_eq!(Program::new([(6, axis(Quantity::Angle, 1.0))]).unwrap_err(), ProgramError::NoSuchFree(6));
        assert_eq!(Program::new([(0, axis(Quantity::None, 1.0))]).unwrap_err(), ProgramError::NoQuantity(0));
        let twice = [(0, axis(Quantity::Angle, 1.0)), (0, axis(Quantity::Angle, 2.0))];
        assert_eq!(Program::new(twice).unwrap_err(), ProgramError::Twice(0));
        let suction = Program::new([(0, axis(Quantity::Pressure, -1.0))]).unwrap_err();
        assert_eq!(suction, ProgramError::Suction { free: 0, pressure: -1.0 });
    }

    #[test]
    fn a_file_gives_back_the_same_program() {
        #[derive(Debug, PartialEq, Serialize, Deserialize)]
        struct Document {
            program: Program,
        }
        let document = Document { program: program() };
        let text = toml::to_string(&document).unwrap();
        assert!(text.contains("[[program]]") && text.contains(r#"quantity = "angle""#), "{text}");
        assert_eq!(toml::from_str::<Document>(&text).unwrap(), document);
        let json = serde_json::to_string(&document).unwrap();
        assert_eq!(serde_json::from_str::<Document>(&json).unwrap(), document);
    }
}

//! The text that Alicat pressure controllers send: data frames, the description of their columns, registers.
//!
//! A data frame is one line: the unit's id, then columns, then status tokens, `A +050.42 +050.42 HLD`. Which
//! columns there are is the unit's own setting and can be asked for (`A??D*`). Columns are counted: a frame of
//! another length is an error, not a guess.

use thiserror::Error;

use super::serial_line::Escaped;
use crate::signal::RegulatorStatus;

/// What stands in a column, behind the id.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Column {
    /// The controlled pressure.
    Pressure,
    /// The set-point that the unit has accepted.
    Setpoint,
    /// Another number.
    Number,
    /// A word.
    Text,
}

/// The columns of a unit's data frames, without the id and without the status tokens.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Columns {
    columns: Vec<Column>,
    /// Unit of the pressure, as the device writes it (`PSIG`); empty where it was not asked.
    unit: String,
}

/// Why a line is not the data frame that was expected.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum FrameError {
    /// Bytes that do not occur in a frame.
    #[error("bytes that are no text: {0}")]
    NotText(Escaped),
    /// Another unit's id, or none.
    #[error("the reply {line} does not begin with the unit's id {id}")]
    WrongId {
        /// The unit asked.
        id: char,
        /// What arrived.
        line: Escaped,
    },
    /// The unit rejects the command.
    #[error("the unit rejects the command (`?`)")]
    Rejected,
    /// Too few or too many columns.
    #[error("the reply {line} has {found} columns behind the id, expected {expected}")]
    ColumnCount {
        /// How many there should be.
        expected: usize,
        /// How many there are.
        found: usize,
        /// What arrived.
        line: Escaped,
    },
    /// A column that should hold a number does not.
    #[error("`{token}` in the reply {line} is not a number")]
    NotANumber {
        /// The token.
        token: String,
        /// What arrived.
        line: Escaped,
    },
}

/// One data frame, in the units of the device.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Controlled pressure.
    pub pressure: f64,
    /// Accepted set-point; NaN of a gauge, which has none.
    pub setpoint: f64,
    /// Value of the set-point's last decimal place: the unit cannot say it more finely; 0 of a gauge.
    pub resolution: f64,
    /// Status tokens.
    pub status: RegulatorStatus,
    /// Tokens that this program does not know, verbatim; empty almost always.
    pub unknown: String,
}

/// Why a description of columns cannot be used.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ManifestError {
    /// No pressure or no set-point among the columns.
    #[error("the frames carry no {0}; add it to the data frame in the unit's menu")]
    Missing(&'static str),
    /// The first pressure is an absolute one.
    #[error("the frames carry an absolute pressure ({0}), freerig needs gauge pressure; change it in the unit's menu")]
    Absolute(String),
}

impl Default for Columns {
    /// A pressure controller from the factory: pressure and set-point.
    fn default() -> Self {
        Self { columns: vec![Column::Pressure, Column::Setpoint], unit: String::new() }
    }
}

impl Columns {
    /// The columns as the unit lists them in answer to `A??D*`, one line a column:
    /// `A D02 006 Gauge Press                s decimal     7/2 010 02 PSIG`. `Ok(None)` where the lines are no
    /// such list (older firmware answers `?`, or in another form).
    pub fn from_manifest<L: AsRef<[u8]>>(lines: &[L], id: u8) -> Result<Option<Self>, ManifestError> {
        let mut columns = Vec::new();
        let mut unit = None;
        for line in lines {
            let Ok(line) = std::str::from_utf8(line.as_ref()) else { continue };
            let mut tokens = line.split_ascii_whitespace();
            let is_row = |t: &str| t.len() > 1 && t.starts_with('D') && t[1..].bytes().all(|c| c.is_ascii_digit());
            if tokens.next().map(str::as_bytes) != Some(&[id]) || !tokens.next().is_some_and(is_row) {
                continue;
            }
            // The number of the statistic; the heading has `ID_`, older firmware has neither.
            match tokens.next() {
                Some("ID_") => continue,
                Some(number) if number.bytes().all(|c| c.is_ascii_digit()) => {}
                _ => return Ok(None),
            }
            let tokens: Vec<&str> = tokens.collect();
            let name = tokens.join(" ");
            // A star marks what is shown only when it is raised: status tokens. The id comes before the columns.
            if name.starts_with('*') || name.starts_with("Unit ID") {
                continue;
            }
            let number = tokens.contains(&"decimal") || tokens.contains(&"signed");
            columns.push(match (number, name.contains("Setpt"), name.contains("Press")) {
                (false, ..) => Column::Text,
                (true, true, _) if !columns.contains(&Column::Setpoint) => Column::Setpoint,
                (true, false, true) if !columns.contains(&Column::Pressure) => {
                    let label = tokens.last().copied().unwrap_or_default();
                    if name.starts_with("Abs") || label.ends_with('A') && !label.ends_with("PA") {
                        return Err(ManifestError::Absolute(label.to_owned()));
                    }
                    unit = Some(label.to_owned());
                    Column::Pressure
                }
                _ => Column::Number,
            });
        }
        match unit {
            _ if columns.is_empty() => Ok(None),
            None => Err(ManifestError::Missing("pressure")),
            Some(unit) => Ok(Some(Self { columns, unit })),
        }
    }

    /// A gauge from the factory: the pressure alone.
    pub fn gauge() -> Self {
        Self { columns: vec![Column::Pressure], unit: String::new() }
    }

    /// Whether the unit says which set-point it has accepted.
    pub fn has_setpoint(&self) -> bool {
        self.columns.contains(&Column::Setpoint)
    }

    /// Unit of the pressure as the device writes it; empty where it was not asked.
    pub fn unit(&self) -> &str {
        &self.unit
    }

    /// Size of the pressure's unit, Pa, where this program knows it.
    pub fn pascals_per_unit(&self) -> Option<f64> {
        let unit = self.unit.to_ascii_uppercase();
        let unit = unit.strip_suffix('G').unwrap_or(&unit);
        let known = [
            ("PA", 1.0),
            ("HPA", 1e2),
            ("KPA", 1e3),
            ("MBAR", 1e2),
            ("BAR", 1e5),
            ("PSI", crate::units::PASCAL_PER_PSI),
        ];
        // `MPA` is left out: without its case it could be either prefix.
        known.iter().find(|k| k.0 == unit).map(|k| k.1)
    }

    /// Reads one line (without its CR) as a data frame of unit `id`.
    pub fn parse(&self, line: &[u8], id: u8) -> Result<Frame, FrameError> {
        let escaped = || Escaped::from(line);
        let text = match std::str::from_utf8(line) {
            Ok(text) if text.bytes().all(|c| (0x20..0x7f).contains(&c)) => text.trim_ascii(),
            _ => return Err(FrameError::NotText(escaped())),
        };
        let mut tokens = text.split_ascii_whitespace();
        let first = tokens.next().unwrap_or_default();
        if first == "?" {
            return Err(FrameError::Rejected);
        }
        if first.as_bytes() != [id] {
            return Err(FrameError::WrongId { id: id.into(), line: escaped() });
        }
        let tokens: Vec<&str> = tokens.collect();
        if tokens.first() == Some(&"?") {
            return Err(FrameError::Rejected);
        }
        // Behind the last number there are words: status tokens. More numbers than columns is another frame.
        let numbers = tokens.iter().rposition(|t| number(t).is_some()).map_or(0, |i| i + 1);
        let expected = self.columns.len();
        let trailing_text = self.columns.iter().rev().take_while(|&&c| c == Column::Text).count();
        if tokens.len() < expected || numbers + trailing_text > expected {
            let found = numbers.max(tokens.len().min(expected));
            return Err(FrameError::ColumnCount { expected, found, line: escaped() });
        }
        let mut frame = Frame {
            pressure: f64::NAN,
            setpoint: f64::NAN,
            resolution: 0.0,
            status: RegulatorStatus::default(),
            unknown: String::new(),
        };
        for (&column, &token) in self.columns.iter().zip(&tokens) {
            let value = match column {
                Column::Text => continue,
                _ => {
                    number(token).ok_or_else(|| FrameError::NotANumber { token: token.to_owned(), line: escaped() })?
                }
            };
            match column {
                Column::Pressure => frame.pressure = value,
                Column::Setpoint => (frame.setpoint, frame.resolution) = (value, last_place(token)),
                _ => {}
            }
        }
        for &token in &tokens[expected..] {
            match status(token) {
                Some(bits) => frame.status = frame.status.with(bits),
                None => {
                    frame.status = frame.status.with(RegulatorStatus::UNKNOWN_TOKEN);
                    if !frame.unknown.is_empty() {
                        frame.unknown.push(' ');
                    }
                    frame.unknown.push_str(token);
                }
            }
        }
        Ok(frame)
    }
}

/// The bits of a status token, none for one that is not known. Flow (MOV, VOV), temperature (TOV) and totaliser
/// (OVR, TMF) conditions and VTM do not concern a pressure controller: known, without a bit of their own.
fn status(token: &str) -> Option<RegulatorStatus> {
    Some(match token {
        "LCK" => RegulatorStatus::LOCKED,
        "HLD" => RegulatorStatus::HELD,
        "EXH" => RegulatorStatus::EXHAUSTING,
        "POV" => RegulatorStatus::PRESSURE_OVER_RANGE,
        "ADC" => RegulatorStatus::CONVERTER_FAILED,
        "OPL" => RegulatorStatus::OVERPRESSURE_LIMIT,
        "MOV" | "VOV" | "TOV" | "OVR" | "TMF" | "VTM" => RegulatorStatus::default(),
        _ => return None,
    })
}

/// A number as the units write it: an optional sign, digits, optionally a point and digits; nothing else.
fn number(token: &str) -> Option<f64> {
    let digits = token.strip_prefix(['+', '-']).unwrap_or(token);
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, "0"));
    let all_digits = |s: &str| !s.is_empty() && s.bytes().all(|c| c.is_ascii_digit());
    if all_digits(whole) && all_digits(fraction) { token.parse().ok().filter(|x: &f64| x.is_finite()) } else { None }
}

/// Value of the last decimal place of a number.
fn last_place(token: &str) -> f64 {
    let places = token.split_once('.').map_or(0, |(_, fraction)| fraction.len());
    10f64.powi(-(places as i32))
}

/// The value in a register reply, `A   020 = 16384`.
pub fn register(line: &[u8], id: u8) -> Option<u32> {
    let text = std::str::from_utf8(line).ok()?.trim_ascii();
    if text.as_bytes().first() != Some(&id) {
        return None;
    }
    text.rsplit_once('=')?.1.trim_ascii().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(line: &str) -> Result<Frame, FrameError> {
        Columns::default().parse(line.as_bytes(), b'A')
    }

    #[test]
    fn a_frame_is_id_columns_and_tokens() {
        let f = parse("A +050.42 +050.40").unwrap();
        assert_eq!((f.pressure, f.setpoint, f.resolution), (50.42, 50.40, 0.01));
        assert_eq!(f.status, RegulatorStatus::default());
        let f = parse("A +01.104 +00.000 LCK").unwrap();
        assert_eq!((f.pressure, f.setpoint, f.status), (1.104, 0.0, RegulatorStatus::LOCKED));
        assert_eq!(parse("A -00.013 +00.000").unwrap().pressure, -0.013);
        let f = parse("A +01.1 +00.0 POV HLD XYZ MOV Q7").unwrap();
        assert!(f.status.contains(RegulatorStatus::PRESSURE_OVER_RANGE.with(RegulatorStatus::HELD)));
        assert!(f.status.contains(RegulatorStatus::UNKNOWN_TOKEN));
        assert_eq!(f.unknown, "XYZ Q7");
    }

    #[test]
    fn every_known_token_is_known() {
        for token in ["LCK", "HLD", "MOV", "VOV", "POV", "TOV", "OVR", "VTM", "ADC", "EXH", "OPL", "TMF"] {
            let f = parse(&format!("A +1.0 +1.0 {token}")).unwrap();
            assert!(!f.status.contains(RegulatorStatus::UNKNOWN_TOKEN), "{token}");
            assert!(f.unknown.is_empty());
        }
    }

    #[test]
    fn another_number_of_columns_is_an_error_not_a_guess() {
        for (line, found) in [("A", 0), ("A +1.0", 1), ("A +1.0 +1.0 +1.0", 3), ("A +14.62 +25.5 +50.0 +1.0 N2", 4)] {
            let error = parse(line).unwrap_err();
            assert!(matches!(error, FrameError::ColumnCount { expected: 2, found: f, .. } if f == found), "{error}");
        }
        // A broken first column followed by enough tokens names the token.
        assert!(matches!(parse("A +1.x +1.0"), Err(FrameError::NotANumber { .. })));
        assert!(matches!(parse("A +1.0 LCK"), Err(FrameError::NotANumber { .. })));
    }

    #[test]
    fn what_is_not_a_plain_number_is_not_read_as_one() {
        for token in ["nan", "inf", "1e3", "+", ".5", "5.", "--5", "+-5", "0x10", "5,0"] {
            assert!(parse(&format!("A {token} +1.0")).is_err(), "{token}");
        }
    }

    #[test]
    fn other_ids_rejections_and_garbage_are_told_apart() {
        assert!(matches!(parse("B +1.0 +1.0"), Err(FrameError::WrongId { id: 'A', .. })));
        assert!(matches!(parse(""), Err(FrameError::WrongId { .. })));
        assert_eq!(parse("?"), Err(FrameError::Rejected));
        assert_eq!(parse("A ?"), Err(FrameError::Rejected));
        assert!(matches!(Columns::default().parse(b"A \xff1.0 +1.0", b'A'), Err(FrameError::NotText(_))));
        let error = Columns::default().parse(b"\x00\xff", b'A').unwrap_err().to_string();
        assert!(error.contains(r"`\x00\xff`"), "{error}");
    }

    const HEADING: &str = "A D00 ID_ NAME______________________ TYPE_______ WIDTH NOTES___________________";

    #[test]
    fn the_unit_says_what_its_columns_are() {
        let lines = [
            HEADING,
            "A D01 700 Unit ID                    string          1",
            "A D02 006 Gauge Press                s decimal     7/3 010 03 PSIG",
            "A D03 003 Flow Temp                  s decimal     7/2 002 02 `C",
            "A D04 034 Gauge Press Setpt          s decimal     7/3 010 03 PSIG",
            "A D05 703 Gas                        string          6",
            "A D06 701 *Error                     string          3 ADC",
            "A D07 702 *Status                    string          3 HLD",
        ];
        let columns = Columns::from_manifest(&lines, b'A').unwrap().unwrap();
        assert_eq!(columns.columns, [Column::Pressure, Column::Number, Column::Setpoint, Column::Text]);
        assert_eq!(columns.pascals_per_unit(), Some(crate::units::PASCAL_PER_PSI));
        let f = columns.parse(b"A +05.001 +21.30 +05.000 N2 HLD", b'A').unwrap();
        assert_eq!((f.pressure, f.setpoint, f.status), (5.001, 5.0, RegulatorStatus::HELD));
        assert!(columns.parse(b"A +05.001 +05.000", b'A').is_err());
    }

    #[test]
    fn a_list_that_cannot_be_used_is_refused_and_no_list_at_all_is_none() {
        let absolute = [HEADING, "A D02 002 Abs Press s decimal 7/2 010 02 PSIA"];
        assert_eq!(Columns::from_manifest(&absolute, b'A'), Err(ManifestError::Absolute("PSIA".into())));
        let flow = [HEADING, "A D02 005 Mass Flow s decimal 7/2 012 02 SCCM"];
        assert_eq!(Columns::from_manifest(&flow, b'A'), Err(ManifestError::Missing("pressure")));
        let legacy = ["A  D00 NAME_______ TYPE_____ MinVal_  MaxVal_  UNITS__"];
        for lines in [&legacy[..], &["?"], &[], &[HEADING]] {
            assert_eq!(Columns::from_manifest(lines, b'A'), Ok(None));
        }
        let kilopascal = [
            HEADING,
            "A D02 006 Gauge Press s decimal 7/2 006 02 kPa",
            "A D03 034 Gauge Press Setpt s decimal 7/2 006 02 kPa",
        ];
        let columns = Columns::from_manifest(&kilopascal, b'A').unwrap().unwrap();
        assert_eq!(columns.pascals_per_unit(), Some(1e3));
    }

    #[test]
    fn a_register_is_what_follows_the_equals_sign() {
        assert_eq!(register(b"A   020 = 16384", b'A'), Some(16384));
        assert_eq!(register(b"A020 =00512", b'A'), Some(512));
        assert_eq!(register(b"B   020 = 00512", b'A'), None);
        assert_eq!(register(b"?", b'A'), None);
    }
}

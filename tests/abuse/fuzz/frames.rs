//! Alicat lines: a number is read to the letter or not at all, and nothing is made up.

use freerig::hardware::alicat_frame::{Columns, register};
use freerig::signal::RegulatorStatus;

use super::{feed, files};

const WORDS: [&str; 14] = [
    " LCK",
    " POV",
    " HLD",
    " ",
    "\r",
    "A ",
    "B ",
    "?",
    "+",
    "-",
    ".",
    " N2",
    " *Status",
    "A D09 006 Gauge Press s decimal 7/3 010 03 PSIG\r",
];

/// The seeds hold one exchange a file: the unit's answers, each to its CR. Lists of columns come before frames.
#[test]
fn whatever_a_unit_answers_is_read_to_the_letter_or_not_at_all() {
    let accepted = feed(files(&["tests/abuse/corpus/frames"]), &WORDS, 30_000, |bytes| {
        let lines: Vec<&[u8]> = bytes.split(|&b| b == b'\r' || b == b'\n').collect();
        let columns = match Columns::from_manifest(&lines, b'A') {
            Ok(Some(columns)) => columns,
            Ok(None) => Columns::default(),
            Err(error) => {
                assert!(!error.to_string().is_empty());
                Columns::default()
            }
        };
        assert!(columns.pascals_per_unit().is_none_or(|unit| unit.is_finite() && unit > 0.0));
        let mut accepted = false;
        for line in lines {
            let _ = register(line, b'A');
            match columns.parse(line, b'A') {
                Err(error) => {
                    let text = error.to_string();
                    assert!(text.chars().all(|c| !c.is_control()), "a log takes it: {text:?}");
                }
                Ok(frame) => {
                    accepted = true;
                    let text = std::str::from_utf8(line).unwrap();
                    let tokens: Vec<&str> = text.split_ascii_whitespace().collect();
                    assert_eq!(tokens[0], "A");
                    // A gauge's columns have no set-point.
                    assert_eq!(frame.setpoint.is_nan(), !columns.has_setpoint());
                    let setpoint = columns.has_setpoint().then_some(frame.setpoint);
                    for value in [Some(frame.pressure), setpoint].into_iter().flatten() {
                        assert!(tokens.iter().any(|token| token.parse() == Ok(value)), "{value} in {text}");
                    }
                    let finest = if columns.has_setpoint() { f64::MIN_POSITIVE } else { 0.0 };
                    assert!((finest..=1.0).contains(&frame.resolution), "{}", frame.resolution);
                    assert!(frame.unknown.split(' ').all(|token| token.is_empty() || tokens.contains(&token)));
                    assert_eq!(frame.unknown.is_empty(), !frame.status.contains(RegulatorStatus::UNKNOWN_TOKEN));
                }
            }
        }
        accepted
    });
    assert!(accepted > 1000, "only {accepted} are accepted: the mutations are too wild to say anything");
}

//! Calibration files: what is accepted reads back as it was written.

use freerig::config::Calibration;

use super::{Written, explained, feed, files};

const WORDS: [&str; 12] = [
    "[lumped]\n",
    "[gains.x]\n",
    "{ value = 1.0, method = \"m\" }",
    "value",
    "standard_uncertainty = 0.1, ",
    "\"\"",
    "\\\"",
    "= 1\n",
    "date = \"2026-02-30\", ",
    "run = \"../x\", ",
    "true",
    "\u{7f}",
];

#[test]
fn whatever_a_calibration_says_is_refused_with_its_rules_or_reads_back() {
    let (file, again) = (Written::new("paper.toml"), tempfile::tempdir().unwrap());
    let accepted = feed(files(&["calibration/paper.toml", "tests/abuse/corpus/calibration"]), &WORDS, 2000, |bytes| {
        match Calibration::read(file.with(bytes)) {
            Err(error) => {
                explained(&error);
                false
            }
            Ok(read) => {
                let free = read.free();
                let values =
                    [free.length, free.radius, free.mass, free.inertia, free.axial_stiffness, free.torsional_stiffness];
                assert!(values.iter().all(|value| value.is_finite() && *value > 0.0), "{values:?}");
                assert!(free.gamma.abs() < std::f64::consts::FRAC_PI_2 && free.gamma != 0.0);
                let path = read.write(again.path()).unwrap();
                assert_eq!(path.parent(), Some(again.path()));
                let back = Calibration::read(&path).unwrap_or_else(|error| panic!("written, but not read: {error}"));
                assert_eq!(back, read);
                true
            }
        }
    });
    assert!(accepted > 100, "only {accepted} are accepted: the mutations are too wild to say anything");
}

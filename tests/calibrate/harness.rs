//! What every test of `freerig calibrate` needs: a folder with the example rig, the command, what it says.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

/// A folder with the example rig.
pub fn bench() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR"));
    fs::copy(source.join("rig.toml"), folder.path().join("rig.toml")).unwrap();
    fs::create_dir(folder.path().join("calibration")).unwrap();
    fs::copy(source.join("calibration/paper.toml"), folder.path().join("calibration/paper.toml")).unwrap();
    folder
}

pub fn freerig(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_freerig")).args(args).current_dir(folder).output().unwrap()
}

#[track_caller]
pub fn json(output: &Output) -> Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("stdout is one JSON object")
}

#[track_caller]
pub fn refused(output: &Output, status: i32, words: &[&str]) {
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(status), "{text}");
    for word in words {
        assert!(text.contains(word), "{word}: {text}");
    }
}

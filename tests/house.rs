//! The floors of the house: imports go downwards only, and the pure floors touch nothing outside.

use std::fs;
use std::path::{Path, PathBuf};

/// From the top; those of one row do not rank against each other.
const FLOORS: [&[&str]; 14] = [
    &["cli"],
    &["daemon"],
    &["record"],
    &["config"],
    &["rt"],
    &["sim"],
    &["plan"],
    &["control"],
    &["ident"],
    &["hardware"],
    &["fem"],
    &["trajectory"],
    &["model"],
    &["clock", "signal", "units"],
];
/// Floors without clock, file, socket and environment.
const PURE: [&str; 6] = ["model", "fem", "control", "ident", "trajectory", "plan"];
/// What they may not name.
const IMPURE: [&str; 9] =
    ["std::fs", "std::env", "std::net", "std::os", "std::process", "Instant::now", "SystemTime", "tokio", "std::io"];

fn height(floor: &str) -> Option<usize> {
    FLOORS.iter().position(|row| row.contains(&floor))
}

fn sources(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, into);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            into.push(path);
        }
    }
}

/// Floor, file and code of every line that is neither comment nor a file's own tests.
fn lines() -> Vec<(String, String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let mut lines = Vec::new();
    for file in files {
        let name = file.strip_prefix(&root).unwrap().to_string_lossy().into_owned();
        let floor = name.split(['/', '.']).next().unwrap().to_owned();
        let text = fs::read_to_string(&file).unwrap();
        let own = text.split("#[cfg(test)]\nmod tests").next().unwrap();
        for (number, line) in own.lines().enumerate() {
            let code = line.split("//").next().unwrap();
            lines.push((floor.clone(), format!("src/{name}:{}", number + 1), code.to_owned()));
        }
    }
    lines
}

/// The floors that a line names after `crate::`.
fn named(code: &str) -> impl Iterator<Item = &str> {
    code.split("crate::")
        .skip(1)
        .map(|rest| rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or(""))
}

#[test]
fn imports_go_downwards_only() {
    let mut seen = 0;
    for (floor, place, code) in lines() {
        let Some(own) = height(&floor) else {
            assert!(matches!(floor.as_str(), "lib" | "main"), "{place}: a floor that the house does not have");
            continue;
        };
        for other in named(&code) {
            let Some(height) = height(other) else { continue };
            assert!(height >= own, "{place}: {floor} names {other}, a floor above it: {}", code.trim());
            seen += 1;
        }
    }
    assert!(seen > 500, "{seen} names of floors: this test does not read the house any more");
}

#[test]
fn pure_floors_read_no_clock_file_socket_or_environment() {
    let mut read = 0;
    for (floor, place, code) in lines() {
        if PURE.contains(&floor.as_str()) {
            read += 1;
            let found = IMPURE.iter().find(|name| code.contains(*name));
            assert!(found.is_none(), "{place}: {floor} is a pure floor, and names {}", found.unwrap());
        }
    }
    assert!(read > 10_000, "{read} lines: this test does not read the house any more");
}

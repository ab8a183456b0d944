//! Packages of others that are timed beside freerig, each in a Python process of its own.
//!
//! Their scripts are part of this program and go to `python3 -c`; the task, the same numbers that freerig gets, is JSON
//! on stdin. What comes back is answers, not errors: freerig judges both by one measure.

use std::io::{Seek, SeekFrom, Write};
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::Context as _;
use serde::Deserialize;
use serde_json::Value;

use super::{patience, row};
use crate::cli::Failure;
use crate::record::{BenchRow, Timed};

/// Longest time that a script gets.
const PATIENCE: Duration = Duration::from_secs(120);

/// One answer of a peer.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Answer {
    /// Which task of those it was given.
    pub task: String,
    /// Task, method and resolution.
    pub case: String,
    /// Processor time of the solve, s.
    pub time_s: Option<f64>,
    /// What it found.
    #[serde(default)]
    pub values: Vec<f64>,
    /// Why it found nothing.
    pub failed: Option<String>,
}

impl Answer {
    /// As a row of the table.
    pub fn row(&self, suite: &'static str, name: &str, error: Option<f64>) -> BenchRow {
        let why = self.failed.as_ref().map_or(String::new(), |why| format!(": {why}"));
        row(suite, name, format!("{}{why}", self.case), error, self.time_s)
    }

    /// As one side of a comparison; none without an answer of a known `error`.
    pub fn timed(&self, name: &str, error: Option<f64>) -> Option<Timed> {
        let (error, time_s) = (error?, self.time_s?);
        Some(Timed { who: format!("{name}, {}", self.how()), error, time_s })
    }

    /// The case without its task.
    fn how(&self) -> &str {
        self.case.strip_prefix(&self.task).unwrap_or(&self.case).trim_start_matches(", ")
    }
}

/// What became of a peer.
#[derive(Clone, Debug)]
pub(super) enum Peer {
    /// Its name with the version, and what it says.
    Answers { name: String, answers: Vec<Answer> },
    /// Why there are none, as a row of the table.
    None(BenchRow),
}

/// Asks `package`, called `name` in the table, by `script` about `task` for `suite`.
pub(super) fn ask(
    suite: &'static str,
    (package, name): (&str, &str),
    script: &str,
    task: &Value,
) -> Result<Peer, Failure> {
    let none = |why: String, failed: bool| -> Result<Peer, Failure> {
        Ok(Peer::None(BenchRow { failed, ..row(suite, name, format!("not run: {why}"), None, None) }))
    };
    let mut input = tempfile::tempfile().context("a file for the task")?;
    input.write_all(task.to_string().as_bytes()).and_then(|()| input.rewind()).context("the task")?;
    let mut output = tempfile::tempfile().context("a file for the answers")?;
    let mut command = Command::new("python3");
    command.args(["-W", "ignore", "-c", &format!("{}{script}", include_str!("peers/common.py"))]);
    // One thread each, as freerig has.
    for threads in ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"] {
        command.env(threads, "1");
    }
    command.stdin(input).stdout(output.try_clone().context("the answers")?).stderr(Stdio::null());
    let mut child = match command.spawn() {
        Ok(child) => child,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return none(format!("python3 not found; install it, then `pip install {package}`"), false);
        }
        Err(error) => return Err(anyhow::Error::new(error).context("python3").into()),
    };
    let ended = patience::wait(&mut child, PATIENCE, &mut || {}).context("python3")?;
    output.seek(SeekFrom::Start(0)).context("the answers")?;
    let text = std::io::read_to_string(output).context("the answers")?;
    let mut lines = text.lines().map(serde_json::from_str::<Value>);
    let Some(Ok(head)) = lines.next() else {
        return none(format!("its script ended without a word; `pip install --upgrade {package}`"), true);
    };
    let Some(version) = head["version"].as_str() else {
        return none(format!("{package} not found; `pip install {package}`"), false);
    };
    let name = format!("{name} {version}");
    let mut answers: Vec<Answer> = lines.filter_map(|line| serde_json::from_value(line.ok()?).ok()).collect();
    if !ended {
        let (task, case) = (String::new(), "the rest".into());
        let why = Some(format!("not finished in {} s", PATIENCE.as_secs()));
        answers.push(Answer { task, case, time_s: None, values: Vec::new(), failed: why });
    }
    Ok(Peer::Answers { name, answers })
}

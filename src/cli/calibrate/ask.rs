//! Questions to a person at the terminal. Ctrl-C is an answer, too: the rig is not left under pressure.

use std::io::{self, IsTerminal, Write as _};

use anyhow::anyhow;
use tokio::sync::oneshot;

use crate::cli::{Context, Failure};

/// Whether somebody is at the terminal.
pub(super) fn somebody() -> bool {
    io::stdin().is_terminal()
}

/// The line that is typed after `question`.
///
/// # Errors
/// Ctrl-C, or the end of the input.
pub(super) fn line(question: &str) -> Result<String, Failure> {
    // The prompt has no line end, so that the answer stands beside it.
    let _ = write!(io::stderr().lock(), "{question} ");
    let _ = io::stderr().lock().flush();
    let (typed, answer) = oneshot::channel();
    // Nothing can take a read of the terminal back: after Ctrl-C its thread ends with the process.
    std::thread::Builder::new().name("terminal".into()).spawn(move || {
        let mut line = String::new();
        if io::stdin().read_line(&mut line).is_ok_and(|read| read > 0) {
            // Nobody waits for it after Ctrl-C.
            let _ = typed.send(line);
        }
    })?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let answer = runtime.block_on(async {
        tokio::select! {
            line = answer => line.ok(),
            _ = tokio::signal::ctrl_c() => None,
        }
    });
    answer.ok_or_else(|| {
        Failure::failed(anyhow!("given up at a question")).remedy("the old calibration is untouched; start again")
    })
}

/// The number that is typed after `question`; asked again until it is one.
pub(super) fn number(question: &str, context: &Context) -> Result<f64, Failure> {
    loop {
        match line(question)?.trim().parse::<f64>() {
            Ok(number) if number.is_finite() => return Ok(number),
            _ => context.note("a number, with a decimal point"),
        }
    }
}

/// The numbers that are typed after `question`, apart by blanks or commas; none of an empty line.
pub(super) fn numbers(question: &str, context: &Context) -> Result<Vec<f64>, Failure> {
    loop {
        let line = line(question)?;
        let words = line.split([' ', ',', '\t', '\n', '\r']).filter(|word| !word.is_empty());
        match words.map(|word| word.parse::<f64>().ok().filter(|x| x.is_finite())).collect::<Option<Vec<_>>>() {
            Some(numbers) => return Ok(numbers),
            None => context.note("numbers with decimal points, apart by blanks"),
        }
    }
}

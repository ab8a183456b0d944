//! What the program says about itself: on stderr, or with its fields into the journal where stderr goes there anyway.

use std::io::{IsTerminal, stderr};

use tracing::level_filters::LevelFilter;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// Before the names of the fields in the journal: `journalctl FREERIG_FAULT=imu_stale`.
const PREFIX: &str = "FREERIG";

/// Says what is at `level` or worse, or what `RUST_LOG` asks for.
pub fn start(level: LevelFilter) {
    let filter = EnvFilter::builder().with_default_directive(level.into()).from_env_lossy();
    // rerun announces the hidden port behind the live view, which nobody is to use.
    let filter = match "re_grpc_server=warn".parse() {
        Ok(quiet) => filter.add_directive(quiet),
        Err(_) => filter,
    };
    let journal = is_journal().then(tracing_journald::layer).and_then(Result::ok);
    let lines = journal.is_none().then(|| {
        tracing_subscriber::fmt::layer().with_writer(stderr).with_ansi(stderr().is_terminal()).with_target(false)
    });
    let journal = journal.map(|journal| journal.with_field_prefix(Some(PREFIX.into())));
    // Only a second start in one process fails, and then there is a log already.
    let _ = tracing_subscriber::registry().with(filter).with(journal).with(lines).try_init();
}

/// Whether stderr is the journal's, as systemd says it in `JOURNAL_STREAM`.
fn is_journal() -> bool {
    let stream = std::env::var("JOURNAL_STREAM").unwrap_or_default();
    rustix::fs::fstat(stderr()).is_ok_and(|file| stream == format!("{}:{}", file.st_dev, file.st_ino))
}

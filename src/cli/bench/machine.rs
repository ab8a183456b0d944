//! On what and with what a benchmark was run.

use std::fs::read_to_string;

use jiff::Zoned;

use crate::cli::latency::kernel;

/// Load of the machine over the last minute.
pub(super) fn load() -> String {
    let all = read_to_string("/proc/loadavg").unwrap_or_default();
    all.split_whitespace().next().unwrap_or("unknown").to_owned()
}

/// Processor, kernel, versions and date; `before` is the load at the start.
pub(super) fn facts(before: &str, seconds: f64) -> Vec<(String, String)> {
    let cpu = read_to_string("/proc/cpuinfo").unwrap_or_default();
    let field = |line: &str| line.strip_prefix("model name")?.split_once(':').map(|(_, name)| name.trim().to_owned());
    let model = cpu.lines().find_map(field).unwrap_or_else(|| "unknown".into());
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let version = env!("CARGO_PKG_VERSION");
    [
        ("machine", format!("{model}, {cores} core{}", if cores == 1 { "" } else { "s" })),
        ("kernel", kernel()),
        ("versions", format!("freerig {version}, {}", env!("FREERIG_RUSTC"))),
        ("date", Zoned::now().strftime("%Y-%m-%d %H:%M %:z").to_string()),
        ("load", format!("{before} at the start, {} at the end, {seconds:.0} s later", load())),
        ("seeds", "0, 1, 2 and so on up to a study's count: the same in every run".into()),
        ("times", "processor time of one thread where not said otherwise".into()),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into()
}

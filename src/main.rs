//! Parses, dispatches, prints the final error with its remedy.
#![forbid(unsafe_code)]

fn main() -> std::process::ExitCode {
    freerig::cli::main()
}

//! Parses, dispatches, prints the final error with its remedy.

fn main() -> std::process::ExitCode {
    freerig::cli::main()
}

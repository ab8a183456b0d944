//! Writes the manual pages and the shells' completions, from the command line's own description, into the folder
//! `manual` of the build: `cargo run --release --example freerig-manual`, before `cargo deb`.

use std::error::Error;

use clap_complete::{Shell, generate_to};

fn main() -> Result<(), Box<dyn Error>> {
    let program = std::env::current_exe()?;
    let folder = program.ancestors().nth(2).ok_or("the program is not where cargo puts an example")?.join("manual");
    // What an earlier version had is not to be packed.
    std::fs::remove_dir_all(&folder).or_else(|error| match error.kind() {
        std::io::ErrorKind::NotFound => Ok(()),
        _ => Err(error),
    })?;
    std::fs::create_dir_all(&folder)?;
    clap_mangen::generate_to(freerig::cli::command(), &folder)?;
    for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
        generate_to(shell, &mut freerig::cli::command(), "freerig", &folder)?;
    }
    println!("{}", folder.display());
    Ok(())
}

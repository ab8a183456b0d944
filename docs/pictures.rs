//! Makes the pictures of the README anew, by the program's own commands on its simulated rigs with the seeds of their
//! rig.toml: `cargo build --release`, then `cargo run --release --example freerig-pictures` at the top of the
//! repository.

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A picture: its file, its title, the command that draws it, the page where it then stands, and the caption there.
type Picture = (&'static str, &'static str, &'static [&'static str], &'static str, &'static str);

const PICTURES: [Picture; 4] = [
    (
        "trajectory.svg",
        "The paper's trajectory on the simulated rig, before anything has been measured",
        &["trajectory", "--stepped"],
        "report.html",
        "Response",
    ),
    (
        "ringdown.svg",
        "Plucks of the simulated FREE and what is fitted to them",
        &["calibrate", "damping", "--stepped", "--script", "answers.toml"],
        "calibration.html",
        "as it is: the record",
    ),
    (
        "workspace.svg",
        "What a module of four FREEs of 60 deg reaches",
        &["plan", "workspace", "--gamma", "60deg"],
        "workspace-60deg.html",
        "60 deg: the plate's centre",
    ),
    (
        "whisk.svg",
        "The figure eight of a planned whisk, from above",
        &["--rig", "experiments/module/rig.toml", "plan", "whisk", "--output", "whisk.toml"],
        "plan-whisk-eight.html",
        "Way of the plate's centre, from above",
    ),
];

fn main() -> Result<(), Box<dyn Error>> {
    let here = std::env::current_dir()?;
    let program = std::env::current_exe()?;
    let program = program.ancestors().nth(2).ok_or("the program is not where cargo puts an example")?.join("freerig");
    // Runs and calibrations go to a copy.
    let place = tempfile::tempdir()?;
    let files = ["paper", "module-l", "module-r"].map(|name| format!("calibration/{name}.toml"));
    for name in files.iter().map(String::as_str).chain(["rig.toml", "experiments/module/rig.toml"]) {
        let to = place.path().join(name);
        fs::create_dir_all(to.parent().ok_or("a file without a folder")?)?;
        fs::copy(here.join(name), to)?;
    }
    fs::write(place.path().join("answers.toml"), "ready = [\"damping\"]\n")?;
    let folder = here.join("docs/pictures");
    fs::create_dir_all(&folder)?;
    for (file, title, command, page, caption) in PICTURES {
        let done = Command::new(&program).args(command).current_dir(place.path()).output()?;
        if !done.status.success() {
            return Err(format!("freerig {}: {}", command.join(" "), String::from_utf8_lossy(&done.stderr)).into());
        }
        let page = find(&place.path().join("runs"), page)?.ok_or(format!("there is no {page}"))?;
        let page = fs::read_to_string(page)?;
        let drawing = drawing(&page, caption).ok_or(format!("there is no drawing with the caption `{caption}`"))?;
        fs::write(folder.join(file), on_white(drawing, title))?;
        println!("{}", folder.join(file).display());
    }
    Ok(())
}

/// The file `name` in `folder` or in one of its folders.
fn find(folder: &Path, name: &str) -> Result<Option<PathBuf>, std::io::Error> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.file_name().is_some_and(|n| n == name) {
            return Ok(Some(path));
        }
        if path.is_dir()
            && let Some(found) = find(&path, name)?
        {
            return Ok(Some(found));
        }
    }
    Ok(None)
}

/// The `<svg>` beside the caption that begins with `caption`.
fn drawing<'p>(page: &'p str, caption: &str) -> Option<&'p str> {
    let figure = page.split("<figure").find(|figure| {
        figure.split_once("<figcaption>").is_some_and(|(_, text)| text.trim_start().starts_with(caption))
    })?;
    let (from, to) = (figure.find("<svg")?, figure.rfind("</svg>")?);
    figure.get(from..to + "</svg>".len())
}

/// With a title, and with a ground of its own: a dark page shows through otherwise.
fn on_white(svg: &str, title: &str) -> String {
    let (tag, rest) = svg.split_once('>').unwrap_or((svg, ""));
    format!("{tag}>\n<title>{title}</title>\n<rect width=\"100%\" height=\"100%\" fill=\"#FFFFFF\"/>{rest}\n")
}

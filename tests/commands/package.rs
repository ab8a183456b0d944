//! The package: what it installs agrees with the program and with itself.

use std::path::Path;
use std::process::Command;

const EXAMPLE: &str = include_str!("../../rig.toml");
const INSTALLED: &str = include_str!("../../systemd/rig.toml");
const UNIT: &str = include_str!("../../systemd/freerig.service");
const MANIFEST: &str = include_str!("../../Cargo.toml");

#[test]
fn the_installed_rig_is_the_example_with_the_services_places() {
    let different: Vec<_> = EXAMPLE.lines().zip(INSTALLED.lines()).filter(|(a, b)| a != b).map(|(_, b)| b).collect();
    assert_eq!(EXAMPLE.lines().count(), INSTALLED.lines().count());
    let expected = [
        "calibration_directory = \"/var/lib/freerig/calibration\"",
        "directory = \"/var/lib/freerig/runs\"",
        "path = \"/run/freerig/control.sock\"",
        "group = \"freerig\"               # its members may control the rig, besides the daemon's own user",
    ];
    assert_eq!(different, expected);
}

#[test]
fn the_unit_has_the_places_of_its_rig_under_its_own_name() {
    for line in [
        "ExecStart=/usr/bin/freerig run --rig /etc/%N/rig.toml",
        "ExecStopPost=/usr/bin/freerig vent --rig /etc/%N/rig.toml",
        "StateDirectory=%N",
        "RuntimeDirectory=%N",
        "WorkingDirectory=/var/lib/%N",
    ] {
        assert!(UNIT.lines().any(|l| l == line), "{line}");
    }
    for name in ["freerig.service", "freerig@.service"] {
        assert!(
            MANIFEST.contains(&format!("[\"systemd/freerig.service\", \"usr/lib/systemd/system/{name}\", \"644\"]"))
        );
    }
}

#[test]
fn every_file_of_the_package_is_there_and_its_scripts_are_scripts() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let manifest: toml::Table = MANIFEST.parse().unwrap();
    let deb = &manifest["package"]["metadata"]["deb"];
    for asset in deb["assets"].as_array().unwrap() {
        let source = asset[0].as_str().unwrap();
        // What the build makes is not there before it.
        if !source.starts_with("target/") {
            let folder = here.join(source.split('*').next().unwrap());
            assert!(folder.exists(), "{source}");
        }
    }
    for script in ["postinst", "prerm", "postrm"] {
        let path = here.join(deb["maintainer-scripts"].as_str().unwrap()).join(script);
        let checked = Command::new("sh").arg("-n").arg(&path).status().unwrap();
        assert!(checked.success(), "{}", path.display());
    }
}

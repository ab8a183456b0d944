//! The section against independently computed references.

use std::collections::HashMap;

use freerig::fem::ends::{End, Ends, Equilibrium};
use freerig::fem::section::{LimitKind, Mesh, Section, SectionError, curve_within};
use freerig::fem::tube::Tube;
use freerig::units::PASCAL_PER_PSI as PSI;

/// One row of a reference; empty fields are missing.
type Row = HashMap<String, f64>;

fn table(name: &str) -> Vec<Row> {
    let path = format!("{}/tests/reference/{name}", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(&path).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    lines
        .map(|line| {
            let fields = names.iter().zip(line.split(','));
            fields.filter_map(|(name, field)| Some((name.to_string(), field.parse().ok()?))).collect()
        })
        .collect()
}

/// The angles of a table in the order in which they come.
fn by_angle(rows: Vec<Row>) -> Vec<(f64, Vec<Row>)> {
    let mut groups: Vec<(f64, Vec<Row>)> = Vec::new();
    for row in rows {
        match groups.last_mut() {
            Some((angle, group)) if *angle == row["Gamma_deg"] => group.push(row),
            _ => groups.push((row["Gamma_deg"], vec![row])),
        }
    }
    groups
}

fn tube(degrees: f64, width_mm: f64) -> Tube {
    Tube { fiber_width: width_mm * 1e-3, ..Tube::reference(degrees.to_radians()) }
}

type Points = Vec<Result<Equilibrium, SectionError>>;

fn curve(tube: &Tube, mesh: Mesh, rows: &[Row], ends: Ends) -> Points {
    let pressures: Vec<f64> = rows.iter().map(|row| row["P_psi"] * PSI).collect();
    Section::new(tube, mesh).unwrap().curve(&pressures, ends).unwrap()
}

fn assert_within(got: f64, want: f64, relative: f64, absolute: f64, what: &str) {
    assert!((got - want).abs() <= (relative * want.abs()).max(absolute), "{what}: {got} for {want}");
}

/// Free columns: twist 0.2 %, stretch - 1 1 % or 2e-5, radii 0.1 %; past the limit, its pressure within 1 %.
fn check_free(tube: &Tube, rows: &[Row]) {
    for (row, point) in rows.iter().zip(curve(tube, Mesh::default(), rows, Ends::FREE)) {
        let name = format!("{} deg, {} psi", row["Gamma_deg"], row["P_psi"]);
        match (row.get("tau_rad_per_mm"), point) {
            (Some(&twist), Ok(point)) => {
                assert_within(point.twist * 1e-3, twist, 2e-3, 1e-12, &name);
                assert_within(point.stretch - 1.0, row["lambda_z"] - 1.0, 0.01, 2e-5, &name);
                assert_within(point.outer_radius_mean * 1e3, row["ro_mean_mm"], 1e-3, 0.0, &name);
                assert_within(point.outer_radius_at_fiber * 1e3, row["ro_fibre_mm"], 1e-3, 0.0, &name);
                assert!(point.force.abs() < 1e-6 && point.moment.abs() < 1e-9, "{name}: free");
            }
            (None, Err(SectionError::BeyondLimit { limit, .. })) => {
                assert_eq!(limit.kind, LimitKind::Pressure);
                assert_within(limit.pressure / PSI, row["limit_psi_free"], 0.01, 0.0, &name);
            }
            (want, got) => panic!("{name}: {want:?} but {got:?}"),
        }
    }
}

/// Blocked columns up to `last` psi, within 1 %. A state past the fold at the strip's end is refused by name; returns
/// how many of the listed rows were compared and how many lie past a fold.
fn check_blocked(tube: &Tube, rows: &[Row], last: f64) -> (usize, usize) {
    let (mut compared, mut folded) = (0, 0);
    for (row, point) in rows.iter().zip(curve(tube, Mesh::default(), rows, Ends::BLOCKED)) {
        let name = format!("{} deg, {} psi, blocked", row["Gamma_deg"], row["P_psi"]);
        let Some(&force) = row.get("F_N").filter(|_| row["P_psi"] <= last) else { continue };
        match point {
            Ok(point) => {
                assert_within(point.force, force, 0.01, 1e-9, &name);
                assert_within(point.moment * 1e3, row["M_Nmm"], 0.01, 1e-9, &name);
                compared += 1;
            }
            Err(SectionError::BeyondLimit { limit, .. }) => {
                assert_eq!(limit.kind, LimitKind::Folding, "{name}");
                folded += 1;
            }
            Err(error) => panic!("{name}: {error}"),
        }
    }
    (compared, folded)
}

#[test]
fn free_tubes_agree_at_every_angle_and_pressure() {
    for (degrees, rows) in by_angle(table("section.csv")) {
        check_free(&tube(degrees, 0.4), &rows);
    }
}

#[test]
fn blocked_tubes_agree_at_every_angle_up_to_the_fold() {
    for (degrees, rows) in by_angle(table("section.csv")) {
        let counts = check_blocked(&tube(degrees, 0.4), &rows, 10.0);
        println!("{degrees} deg: {counts:?}");
    }
}

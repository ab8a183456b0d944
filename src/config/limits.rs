//! `[free.limits]`: how far a FREE may be driven, and from where on something is done about it.

use super::reader::Section;
use crate::control::Limits;
use crate::units::PASCAL_PER_PSI;

/// Highest pressure that makes sense in a FREE, psi.
pub(super) const PRESSURE_CEILING: f64 = 150.0;
/// Widest angle that makes sense: two turns and a half, deg.
const ANGLE_CEILING: f64 = 900.0;
/// How far the FREE turns at rest by noise and drift, rad: the soft envelope leaves room for it.
const SWAY: f64 = 1.0_f64.to_radians();

/// `full_scale` is that of whatever measures the pressure, or is told it, Pa.
pub(super) fn read_limits(mut section: Section<'_>, full_scale: f64) -> Limits {
    let psi = 0.1..=PRESSURE_CEILING;
    let max = section.number("max_pressure_psi", None, psi.clone());
    let warn = section.optional_number("warn_pressure_psi", psi.clone()).unwrap_or(max + 0.5 * PASCAL_PER_PSI);
    let hard = section.optional_number("hard_pressure_psi", psi.clone()).unwrap_or(max + PASCAL_PER_PSI);
    let proof = section.number("proof_pressure_psi", None, psi);
    let order = "max_pressure_psi < warn_pressure_psi < hard_pressure_psi < proof_pressure_psi";
    // A comparison with a stand-in (NaN) is false: what has been noted is not noted again.
    let beyond_proof = max >= proof;
    if beyond_proof {
        // The other limits are right beside the proof pressure: not they are to follow this one.
        section.reject(
            "max_pressure_psi",
            format!("must be below proof_pressure_psi, {}: what the FREE has been tested to", psi_text(proof)),
            format!("check it; write a working pressure well below, for example {:.1}", 0.5 * proof / PASCAL_PER_PSI),
        );
    }
    if warn <= max && !beyond_proof {
        section.reject("warn_pressure_psi", format!("must be in the order {order}"), higher(max, 0.5));
    }
    if hard <= warn && !beyond_proof {
        section.reject("hard_pressure_psi", format!("must be in the order {order}"), higher(warn, 0.5));
    }
    if proof <= hard && !beyond_proof {
        section.reject(
            "proof_pressure_psi",
            format!("must be in the order {order}; hard_pressure_psi is {}", psi_text(hard)),
            "lower the other limits: the proof pressure is what the FREE has been tested to",
        );
    }
    if full_scale < hard && (section.has("hard_pressure_psi") || !beyond_proof) {
        let rule = format!(
            "must be within the full scale of {} of the regulator and of what measures it: it could not be seen",
            psi_text(full_scale)
        );
        let key = if section.has("hard_pressure_psi") { "hard_pressure_psi" } else { "max_pressure_psi" };
        section.reject(key, rule, "lower it, or use a regulator of a wider range");
    }
    // Nothing else is held to a value that is refused.
    let max = if beyond_proof { f64::NAN } else { max };
    let zero = section.number("zero_pressure_psi", 0.2, 0.01..=2.0);
    if max <= zero {
        section.reject("zero_pressure_psi", "must be below max_pressure_psi", "write a lower value, for example 0.2");
    }
    let degrees = -ANGLE_CEILING..=ANGLE_CEILING;
    let soft = section.span("soft_angle_deg", (-120.0, 120.0), degrees.clone());
    let hard_angle = section.span("hard_angle_deg", (-150.0, 150.0), degrees);
    if soft.0 <= hard_angle.0 || soft.1 >= hard_angle.1 {
        section.reject(
            "soft_angle_deg",
            "must lie inside hard_angle_deg",
            "narrow it: outside the soft envelope the pressure is ramped down, outside the hard one vented",
        );
    }
    if soft.0 > -SWAY || soft.1 < SWAY {
        section.reject(
            "soft_angle_deg",
            format!("must leave at least {:.0} deg to either side of rest", SWAY.to_degrees()),
            "widen it: at rest the FREE sways, and the readings have noise and drift",
        );
    }
    let error = section.optional_number("tracking_error_deg", 0.1..=ANGLE_CEILING).unwrap_or(f64::INFINITY);
    let patience = section.number("tracking_error_s", 1.5, 0.0..=60.0);
    Limits {
        pressure_max: max,
        pressure_warn: warn,
        pressure_hard: hard,
        pressure_zero: zero,
        slew: section.number("slew_psi_per_s", 30.0, 0.1..=1000.0),
        angle_soft: soft,
        angle_hard: hard_angle,
        tracking_error: (error, patience),
    }
}

fn psi_text(pascals: f64) -> String {
    format!("{:.2} psi", pascals / PASCAL_PER_PSI)
}

fn higher(pascals: f64, margin: f64) -> String {
    format!("write a value above {:.2}, for example {:.2}", pascals / PASCAL_PER_PSI, pascals / PASCAL_PER_PSI + margin)
}

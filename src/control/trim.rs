//! What of a trim counts in a tick.
//!
//! A module's plan is followed in the model thread, which corrects the plan's pressures some fifty times a second
//! ([`Trim`]). The tick adds the latest correction, whatever has become of that thread: what is no number is none, none
//! is larger than [`MOST`], and one that grows old fades away, so that without the thread the plan is run as it stands.
//! The command's own limits, 0 to p_max and the slew, come after it.

use std::time::Duration;

use crate::clock::Time;
use crate::signal::{Quantity, Reference, Trim};
use crate::units::PASCAL_PER_PSI;

/// The largest correction of a pressure, Pa: 2 psi.
pub const MOST: f64 = 2.0 * PASCAL_PER_PSI;
/// So long a correction counts in full: five of the model thread's turns.
pub const FRESH: Duration = Duration::from_millis(100);
/// From this age on it does not count.
pub const GONE: Duration = Duration::from_millis(400);

/// The pressure `reference` of the FREE `free` with what of `trim` counts at `now`; of another quantity as it is.
pub(super) fn trimmed(reference: Reference, trim: &Trim, free: usize, now: Time) -> Reference {
    let wanted = trim.pressure.get(free).copied().filter(|p| p.is_finite() && *p != 0.0);
    match wanted {
        Some(wanted) if reference.quantity == Quantity::Pressure => {
            let position =
                reference.position + share(now.since(trim.time).max(trim.time.since(now))) * wanted.clamp(-MOST, MOST);
            Reference { position, ..reference }
        }
        _ => reference,
    }
}

/// What counts of a correction that is so far from the present, 1 to 0.
fn share(apart: Duration) -> f64 {
    let left = GONE.saturating_sub(apart).as_secs_f64() / (GONE - FRESH).as_secs_f64();
    left.min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trim_fades_with_its_age_and_is_never_more_than_it_may_be() {
        let made = Time::ZERO + Duration::from_secs(5);
        let with = |wanted: f64, age_ms: u64| {
            let trim = Trim { time: made, pressure: [0.0, wanted, 0.0, 0.0, 0.0, 0.0] };
            let reference = Reference { quantity: Quantity::Pressure, position: 1e4, ..Reference::default() };
            trimmed(reference, &trim, 1, made + Duration::from_millis(age_ms)).position - 1e4
        };
        for (age, share) in [(0, 1.0), (100, 1.0), (250, 0.5), (400, 0.0), (100_000, 0.0)] {
            assert!((with(1e3, age) - 1e3 * share).abs() < 1e-9, "{age} ms");
        }
        assert!((with(1e9, 0) - MOST).abs() < 1e-9 && (with(-1e9, 0) + MOST).abs() < 1e-9);
        for none in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(with(none, 0), 0.0);
        }
        // One of a thread that is a little ahead of the tick's nominal time, and one of a clock gone wrong; an angle is
        // nobody's plan of pressures; a FREE that is not there.
        let trim = Trim { time: made, pressure: [1e3; 6] };
        let pressure = Reference { quantity: Quantity::Pressure, ..Reference::default() };
        assert_eq!(trimmed(pressure, &trim, 0, made - Duration::from_millis(20)).position, 1e3);
        assert_eq!(trimmed(pressure, &trim, 0, Time::ZERO).position, 0.0);
        let angle = Reference { quantity: Quantity::Angle, position: 0.1, ..Reference::default() };
        assert_eq!(trimmed(angle, &trim, 0, made), angle);
        assert_eq!(trimmed(pressure, &trim, 99, made), pressure);
    }
}

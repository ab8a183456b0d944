//! The fault matrix: what can go wrong, how long it must last, what the rig does about it, what a person should do.

use crate::signal::FaultCode;

/// What the rig does about a fault, from the mildest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reaction {
    /// Nothing; it may refuse to arm.
    #[default]
    None,
    /// Say so and go on.
    Warn,
    /// Keep the pressures, freeze the integrators; resumes (as Hold) when the cause is gone in time.
    Hold,
    /// Take the pressures down within the ramp time, then vent; latches.
    Ramp,
    /// Pressures to zero at once and the dump valve open; latches.
    Vent,
}

impl Reaction {
    /// Stable name, as in the fault table and in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Reaction::None => "none",
            Reaction::Warn => "warn",
            Reaction::Hold => "hold",
            Reaction::Ramp => "ramp down",
            Reaction::Vent => "vent",
        }
    }

    /// Whether the fault stays latched until it is cleared.
    pub const fn latches(self) -> bool {
        matches!(self, Reaction::Ramp | Reaction::Vent)
    }
}

/// One row of the matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// The fault.
    pub code: FaultCode,
    /// When it is there.
    pub condition: &'static str,
    /// How long the condition must hold.
    pub debounce: &'static str,
    /// First reaction.
    pub reaction: Reaction,
    /// Reaction if it goes on or gets worse; the same as `reaction` where there is only one.
    pub then: Reaction,
    /// What a person should do.
    pub remedy: &'static str,
}

/// The fault matrix, in the order of the stable numbers.
pub const MATRIX: [Row; FaultCode::ALL.len()] = [
    Row {
        code: FaultCode::OverpressureHard,
        condition: "measured pressure above hard_pressure",
        debounce: "1 sample",
        reaction: Reaction::Vent,
        then: Reaction::Vent,
        remedy: "Look for a stuck regulator valve or a wrong full scale; check the regulator by hand before clearing.",
    },
    Row {
        code: FaultCode::OverpressureSoft,
        condition: "measured pressure above warn_pressure",
        debounce: "100 ms",
        reaction: Reaction::Ramp,
        then: Reaction::Ramp,
        remedy: "The regulator overshoots: lower max_pressure or the gains, or tune the regulator itself.",
    },
    Row {
        code: FaultCode::PressureSensorRange,
        condition: "pressure reading not a number or outside the sensor's range, POV",
        debounce: "3 samples",
        reaction: Reaction::Vent,
        then: Reaction::Vent,
        remedy: "Check the sensor's cable and full_scale in rig.toml; power the regulator off and on.",
    },
    Row {
        code: FaultCode::PressureStale,
        condition: "pressure reading older than 3 device periods, or older than 1.5 and, with the fastest fill since, \
                    possibly above hard_pressure",
        debounce: "none, the age is the debounce",
        reaction: Reaction::Vent,
        then: Reaction::Vent,
        remedy: "Check the regulator's cable and power and the line's baud rate; `freerig doctor` talks to every unit.",
    },
    Row {
        code: FaultCode::PressureNotFollowing,
        condition: "pressure away from where the command should have brought it, and not approaching",
        debounce: "1 s in sum",
        reaction: Reaction::Vent,
        then: Reaction::Vent,
        remedy: "Look for a leak, a burst FREE, a kinked tube, a closed supply; check the regulator's lag and dead time \
                 in the calibration.",
    },
    Row {
        code: FaultCode::SupplyLow,
        condition: "supply pressure too low (reported only where there is a supply sensor)",
        debounce: "500 ms",
        reaction: Reaction::Ramp,
        then: Reaction::Ramp,
        remedy: "Open the supply, start the compressor.",
    },
    Row {
        code: FaultCode::ImuStale,
        condition: "no fresh IMU reading for 3 device periods: hold; for 200 ms: ramp down",
        debounce: "none, the age is the debounce",
        reaction: Reaction::Hold,
        then: Reaction::Ramp,
        remedy: "Check the IMU's cable, address and power; on a Raspberry Pi use software I2C (dtoverlay=i2c-gpio).",
    },
    Row {
        code: FaultCode::ImuImplausible,
        condition: "IMU reading with a norm off by more than 0.02, a jump against the gyro, a tilt near 180 deg, or a \
                    chip found reset: hold; none plausible for 200 ms: ramp down",
        debounce: "3 samples",
        reaction: Reaction::Hold,
        then: Reaction::Ramp,
        remedy: "Look for a loose IMU, brown-outs and corrupted I2C reads; `freerig doctor` measures the error rate.",
    },
    Row {
        code: FaultCode::AngleLimit,
        condition: "angle outside its soft envelope: ramp down; outside its hard envelope: vent",
        debounce: "1 sample",
        reaction: Reaction::Ramp,
        then: Reaction::Vent,
        remedy: "Check the program against the angle limits in rig.toml, and that the FREE turns the way its winding \
                 angle says.",
    },
    Row {
        code: FaultCode::TrackingError,
        condition: "angle further from its reference than tracking_error",
        debounce: "as configured",
        reaction: Reaction::Ramp,
        then: Reaction::Ramp,
        remedy: "Ask for less, slow the program down, or tune: `freerig tune`; a leak or a load shows here first.",
    },
    Row {
        code: FaultCode::Deadline,
        condition: "late ticks among the last 100, those of one stall counted once",
        debounce: "5: warn; 20: ramp down",
        reaction: Reaction::Warn,
        then: Reaction::Ramp,
        remedy: "Give the daemon its real-time rights and a quiet core (`freerig doctor`, `freerig latency`), or a longer \
                 period.",
    },
    Row {
        code: FaultCode::ClientLost,
        condition: "no heartbeat from the client that runs the experiment (never with --detach)",
        debounce: "1.5 s",
        reaction: Reaction::Ramp,
        then: Reaction::Ramp,
        remedy: "Run the experiment again; with --detach it outlives its terminal.",
    },
    Row {
        code: FaultCode::RegulatorStatus,
        condition: "the regulator reports ADC or OPL, HLD or EXH while armed, rejects a command, accepted another set-point, or \
                    takes it from its analogue input",
        debounce: "1 sample",
        reaction: Reaction::Ramp,
        then: Reaction::Ramp,
        remedy: "Look at the regulator's display; set its set-point source to serial; cancel a hold on its panel.",
    },
    Row {
        code: FaultCode::BusLost,
        condition: "a device or its bus does not answer after the recovery ladder",
        debounce: "none, the ladder is the debounce",
        reaction: Reaction::Vent,
        then: Reaction::Vent,
        remedy: "Check cable and power, then clear; the set-point zero is the first frame after reconnecting.",
    },
    Row {
        code: FaultCode::ConfigChanged,
        condition: "a configuration file differs from what was loaded",
        debounce: "none",
        reaction: Reaction::Warn,
        then: Reaction::Warn,
        remedy: "A changed calibration is taken up at the next arming; for a changed rig.toml restart the daemon, or put the old one back: until then arming is refused.",
    },
    Row {
        code: FaultCode::RealtimeLost,
        condition: "no FIFO scheduling or no locked memory, with require_realtime = true",
        debounce: "none",
        reaction: Reaction::Warn,
        then: Reaction::Warn,
        remedy: "Use the systemd unit or grant rtprio and memlock (`freerig doctor` says how); until then arming is \
                 refused.",
    },
    Row {
        code: FaultCode::VentFailed,
        condition: "pressure not below zero_pressure, or unknown without a dump valve, vent_time after a vent",
        debounce: "vent_time",
        reaction: Reaction::Vent,
        then: Reaction::Vent,
        remedy: "Software can do no more: shut the supply and open the line by hand. Stand clear of the FREE.",
    },
    Row {
        code: FaultCode::EmergencyStop,
        condition: "emergency stop: command, SIGUSR1 or input",
        debounce: "none",
        reaction: Reaction::Vent,
        then: Reaction::Vent,
        remedy: "Release the stop, see to its reason, then `freerig clear`.",
    },
];

/// The row of `code`.
pub fn row(code: FaultCode) -> &'static Row {
    &MATRIX[(code as usize - 1).min(MATRIX.len() - 1)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_matrix_has_every_fault_once_in_the_order_of_its_number() {
        for (index, code) in FaultCode::ALL.into_iter().enumerate() {
            assert_eq!(MATRIX[index].code, code);
            assert_eq!(row(code).code, code);
            assert_eq!(code as usize, index + 1);
            assert!(row(code).reaction <= row(code).then);
            assert!(row(code).remedy.ends_with('.') && !row(code).remedy.contains("  "), "{}", row(code).remedy);
        }
    }
}

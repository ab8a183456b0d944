//! What a refused request means and what to do about it.

use crate::signal::RefusalCode;

impl RefusalCode {
    /// Stable name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            RefusalCode::None => "none",
            RefusalCode::WrongState => "wrong_state",
            RefusalCode::EmergencyStop => "emergency_stop",
            RefusalCode::FaultPresent => "fault_present",
            RefusalCode::ConfigChanged => "config_changed",
            RefusalCode::NotRealtime => "not_realtime",
            RefusalCode::NotVented => "not_vented",
            RefusalCode::NoPressure => "no_pressure",
            RefusalCode::NoImu => "no_imu",
            RefusalCode::NotCalibrated => "not_calibrated",
            RefusalCode::NotStill => "not_still",
            RefusalCode::BadProgram => "bad_program",
            RefusalCode::BadGains => "bad_gains",
            RefusalCode::Busy => "busy",
        }
    }

    /// What is the matter.
    pub const fn message(self) -> &'static str {
        match self {
            RefusalCode::None => "nothing was refused",
            RefusalCode::WrongState => "the rig is not in a state that allows it",
            RefusalCode::EmergencyStop => "the emergency stop is pressed",
            RefusalCode::FaultPresent => "the condition of a fault holds",
            RefusalCode::ConfigChanged => "a configuration file differs from what was loaded",
            RefusalCode::NotRealtime => "require_realtime is set and the loop has no real-time rights",
            RefusalCode::NotVented => "the pressure is not below zero_pressure",
            RefusalCode::NoPressure => "there is no fresh pressure reading",
            RefusalCode::NoImu => "there is no fresh IMU reading",
            RefusalCode::NotCalibrated => "the IMU's gyro is not calibrated",
            RefusalCode::NotStill => "the FREE moves while its angle is tared",
            RefusalCode::BadProgram => "the program asks for what this rig cannot do",
            RefusalCode::BadGains => "the gains are negative, not finite, or of a FREE that is not there",
            RefusalCode::Busy => "the program before has not been put away yet",
        }
    }

    /// What to do about it.
    pub const fn remedy(self) -> &'static str {
        match self {
            RefusalCode::None => "Nothing.",
            RefusalCode::WrongState => {
                "See `freerig status`: arm from disarmed, start from hold, clear when faulted, then try again."
            }
            RefusalCode::EmergencyStop => "Release the stop, then `freerig clear`.",
            RefusalCode::FaultPresent => "Remove the fault's cause: `freerig status` names it and its remedy.",
            RefusalCode::ConfigChanged => {
                "`freerig disarm` and `arm` take up a changed calibration; a changed rig.toml needs a restart of the daemon."
            }
            RefusalCode::NotRealtime => "Grant the rights (`freerig doctor` says how) or set require_realtime = false.",
            RefusalCode::NotVented => "Wait, or open the line by hand; check the regulator's zero and zero_pressure.",
            RefusalCode::NoPressure => "Check the regulator's cable, power and line: `freerig doctor`.",
            RefusalCode::NoImu => "Check the IMU's cable, address and power: `freerig doctor`.",
            RefusalCode::NotCalibrated => "Leave the IMU at rest for some seconds, then arm again.",
            RefusalCode::NotStill => "Let the FREE come to rest and keep hands off, then arm again.",
            RefusalCode::BadProgram => {
                "Give it a positive duration, axes only for FREEs of the rig, and angles only where there is an IMU."
            }
            RefusalCode::BadGains => "Write gains that are finite and not negative: signs are the program's affair.",
            RefusalCode::Busy => "Try again in a moment.",
        }
    }
}

//! Opening I2C buses, and what their errors mean.
//!
//! Linux sets a bus timeout only through a raw ioctl (`I2C_TIMEOUT`), which needs unsafe code; this crate forbids
//! it. A stuck bus therefore blocks its owner's thread for the adapter's own timeout, usually 1 s, and nobody
//! else: the tick sees the readings age and reacts, but a regulator on that same bus is out of reach meanwhile.

use std::io;
use std::path::Path;
use std::sync::Arc;

use embedded_hal::i2c::{Error, ErrorKind};
use linux_embedded_hal::I2cdev;

use super::HardwareError;

/// Opens the bus behind `device` (`/dev/i2c-N`). One handle for each chip: a handle opens its file anew whenever
/// the address changes.
pub fn open(device: &Path) -> Result<I2cdev, HardwareError> {
    I2cdev::new(device).map_err(|error| {
        let error = io::Error::from(error);
        let remedy = match error.kind() {
            io::ErrorKind::NotFound => {
                "Enable the bus (on a Raspberry Pi `dtparam=i2c_arm=on`, or `dtoverlay=i2c-gpio` for a BNO055; \
                 `modprobe i2c-dev`), or correct `device` in rig.toml"
            }
            io::ErrorKind::PermissionDenied => "Add the user that runs freerig to the group of the file (`i2c`)",
            _ => "Check that the file is an I2C bus of this machine (`ls /dev/i2c-*`)",
        };
        HardwareError::Open {
            device: format!("I2C bus {}", device.display()).into(),
            reason: error.to_string(),
            remedy: remedy.into(),
        }
    })
}

/// What a failed transfer with `device` means.
pub(super) fn transfer_error(device: &Arc<str>, error: &impl Error) -> HardwareError {
    let device = device.clone();
    match error.kind() {
        ErrorKind::NoAcknowledge(_) => HardwareError::NoAnswer { device, detail: "not acknowledged".into() },
        kind => HardwareError::Transfer { device, detail: format!("{kind}, {error:?}") },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bus_that_is_not_there_says_how_to_get_it() {
        let error = open(Path::new("/nonexistent/i2c-1")).err().expect("no such bus").to_string();
        assert!(error.contains("/nonexistent/i2c-1") && error.contains("dtparam=i2c_arm=on"), "{error}");
    }
}

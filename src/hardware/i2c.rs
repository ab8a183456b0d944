//! Opening I2C buses, and what their errors mean.
//!
//! Linux sets a bus timeout only through a raw ioctl (`I2C_TIMEOUT`), which needs unsafe code; this crate forbids
//! it. A stuck bus therefore blocks its owner's thread for the adapter's own timeout, usually 1 s, and nobody
//! else: the tick sees the readings age and reacts, but a regulator on that same bus is out of reach meanwhile.

use std::io;
use std::path::Path;
use std::sync::Arc;

use embedded_hal::i2c::{Error, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use linux_embedded_hal::{I2CError, I2cdev};
use rustix::io::Errno;

use super::HardwareError;

/// A bus of the Linux kernel's.
pub struct LinuxI2c(I2cdev);

/// Its error. Adapters differ in what they make of a missing acknowledge (ENXIO, EREMOTEIO): here it is one thing.
#[derive(Debug)]
pub struct LinuxI2cError(I2CError);

impl LinuxI2cError {
    /// What the system said.
    fn errno(&self) -> Option<Errno> {
        use linux_embedded_hal::i2cdev::linux::LinuxI2CError::{Errno as Raw, Io};
        let raw = match self.0.inner() {
            Raw(raw) => Some(*raw),
            Io(error) => error.raw_os_error(),
        };
        raw.map(Errno::from_raw_os_error)
    }
}

impl Error for LinuxI2cError {
    fn kind(&self) -> ErrorKind {
        match self.errno() {
            Some(Errno::NXIO | Errno::REMOTEIO) => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown),
            // The adapter itself is gone.
            Some(Errno::NODEV) => ErrorKind::Other,
            _ => self.0.kind(),
        }
    }
}

impl ErrorType for LinuxI2c {
    type Error = LinuxI2cError;
}

impl I2c for LinuxI2c {
    fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), LinuxI2cError> {
        I2c::<u8>::transaction(&mut self.0, address, operations).map_err(LinuxI2cError)
    }
}

/// Opens the bus behind `device` (`/dev/i2c-N`). One handle for each chip: a handle opens its file anew whenever
/// the address changes.
pub fn open(device: &Path) -> Result<LinuxI2c, HardwareError> {
    I2cdev::new(device).map(LinuxI2c).map_err(|error| {
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
    fn adapters_differ_in_what_they_call_a_missing_acknowledge() {
        use linux_embedded_hal::i2cdev::linux::LinuxI2CError;
        let device: Arc<str> = "BNO055".into();
        let said = |errno: Errno| {
            let error = LinuxI2cError(LinuxI2CError::Errno(errno.raw_os_error()).into());
            transfer_error(&device, &error)
        };
        let nak = HardwareError::NoAnswer { device: device.clone(), detail: "not acknowledged".into() };
        assert_eq!([said(Errno::NXIO), said(Errno::REMOTEIO)], [nak.clone(), nak.clone()]);
        for other in [Errno::NODEV, Errno::IO, Errno::TIMEDOUT, Errno::AGAIN] {
            assert!(matches!(said(other), HardwareError::Transfer { .. }), "{other}: {:?}", said(other));
        }
    }

    #[test]
    fn a_bus_that_is_not_there_says_how_to_get_it() {
        let error = open(Path::new("/nonexistent/i2c-1")).err().expect("no such bus").to_string();
        assert!(error.contains("/nonexistent/i2c-1") && error.contains("dtparam=i2c_arm=on"), "{error}");
    }
}

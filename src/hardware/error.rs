//! What can go wrong with a device: which one, where, what was seen and what to do about it.

use std::sync::Arc;

use thiserror::Error;

/// A failure of a device or of its bus. `device` names model, bus and address, for example
/// `BNO055 at 0x28 on /dev/i2c-1`.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum HardwareError {
    /// The bus itself cannot be opened.
    #[error("{device} cannot be opened: {reason}. {remedy}")]
    Open {
        /// Bus and device file.
        device: Arc<str>,
        /// What the system says.
        reason: String,
        /// What to do.
        remedy: String,
    },
    /// Nothing answers at the address, or not in time.
    #[error("{device} does not answer ({detail}); check its power, its cable and its address in rig.toml")]
    NoAnswer {
        /// Model, bus and address.
        device: Arc<str>,
        /// What was seen instead of an answer.
        detail: String,
    },
    /// The transfer failed on the bus.
    #[error("{device}: the transfer failed ({detail}); check cable lengths, pull-ups and the bus speed")]
    Transfer {
        /// Model, bus and address.
        device: Arc<str>,
        /// What the bus reports.
        detail: String,
    },
    /// Something else answers at the address.
    #[error(
        "{device} is not what rig.toml says: expected {expected}, found {found}; check the address, or exchange the device"
    )]
    WrongIdentity {
        /// Model, bus and address.
        device: Arc<str>,
        /// What should be there.
        expected: String,
        /// What is there.
        found: String,
    },
    /// An answer that makes no sense.
    #[error("{device} answered what cannot be understood: {detail}")]
    Malformed {
        /// Model, bus and address.
        device: Arc<str>,
        /// What arrived, and what is wrong with it.
        detail: String,
    },
    /// What was written is not what is read back.
    #[error(
        "{device} did not take over {what}: wrote {written}, read back {read}; power-cycle it, and exchange it if that does not help"
    )]
    NotTaken {
        /// Model, bus and address.
        device: Arc<str>,
        /// Which register or setting.
        what: &'static str,
        /// What was written.
        written: String,
        /// What was read back.
        read: String,
    },
    /// The device reports that it is broken.
    #[error("{device} reports a failure of its own: {detail}; power-cycle it, and exchange it if that does not help")]
    DeviceFault {
        /// Model, bus and address.
        device: Arc<str>,
        /// The registers or tokens that say so.
        detail: String,
    },
    /// The device works, but is set up in a way that is not safe to use.
    #[error("{device} is not safe to use: {reason}. {remedy}")]
    Unsafe {
        /// Model, bus and address.
        device: Arc<str>,
        /// What is set up wrongly.
        reason: String,
        /// What to do.
        remedy: String,
    },
}

impl HardwareError {
    /// Whether the device works and is refused all the same: only a person changes that.
    pub const fn is_refusal(&self) -> bool {
        matches!(self, Self::Unsafe { .. })
    }

    /// Whether trying again without touching the device can help.
    pub const fn is_transient(&self) -> bool {
        matches!(self, Self::NoAnswer { .. } | Self::Transfer { .. } | Self::Malformed { .. })
    }
}

//! A device's handle on its bus, which can be let go of.
//!
//! An adapter that has been unplugged does not come back under its name as long as somebody holds its old file open:
//! so the handle of a device that fails is closed *before* the bus is opened anew, and stays closed until that works.

use std::fmt;

use embedded_hal::i2c::{Error, ErrorKind, ErrorType, I2c, Operation};

use crate::hardware::{DeviceStatistics, HardwareError};

/// Opens the bus.
pub(super) type Open<'o, I> = &'o mut dyn FnMut() -> Result<I, HardwareError>;

/// An open bus, or none.
#[derive(Debug)]
pub(super) struct Handle<I>(Option<I>);

impl<I> Handle<I> {
    /// A handle on `bus`.
    pub fn on(bus: I) -> Self {
        Self(Some(bus))
    }

    /// A handle on nothing: every transfer fails.
    pub const fn closed() -> Self {
        Self(None)
    }
}

/// An address that no device has: all ones, like the nine clocks that free a bus.
const NOBODY: u8 = 0x7F;

impl<I: I2c> Handle<I> {
    /// Closes a device's handle, then opens the bus anew; `replace` gives the device its handle. Whether the bus is
    /// open.
    ///
    /// A device that was interrupted while it answered holds the data line until it has been clocked to the end of its
    /// byte. Reading from nobody does that: nine clocks with the data line let go. Whether that is possible is the
    /// adapter's to say; nothing is lost where it is not.
    pub fn renew(open: Open<'_, I>, statistics: &DeviceStatistics, mut replace: impl FnMut(Self)) -> bool {
        replace(Self::closed());
        match open() {
            Ok(mut bus) => {
                statistics.reopens.increment();
                let _ = bus.read(NOBODY, &mut [0]);
                replace(Self::on(bus));
                true
            }
            Err(error) => {
                statistics.note_error(&error);
                false
            }
        }
    }
}

/// Why a transfer failed.
#[derive(Debug)]
pub(super) enum HandleError<E> {
    /// The bus is not open.
    Closed,
    /// The bus's own error.
    Bus(E),
}

impl<E: Error> Error for HandleError<E> {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Closed => ErrorKind::Other,
            Self::Bus(error) => error.kind(),
        }
    }
}

impl<E: fmt::Debug> fmt::Display for HandleError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Closed => f.write_str("the bus is not open"),
            Self::Bus(error) => write!(f, "{error:?}"),
        }
    }
}

impl<I: ErrorType> ErrorType for Handle<I> {
    type Error = HandleError<I::Error>;
}

impl<I: I2c> I2c for Handle<I> {
    fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), Self::Error> {
        let bus = self.0.as_mut().ok_or(HandleError::Closed)?;
        bus.transaction(address, operations).map_err(HandleError::Bus)
    }
}

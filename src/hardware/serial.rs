//! Serial lines of the operating system, and the thread in which their owner lives.
//!
//! No `flush` anywhere: on a serial line it waits in `tcdrain`, without a limit. A line that has been unplugged
//! reads as ended and writes as failed; both lead to opening it again.

use std::future::Future;
use std::io;
use std::thread::JoinHandle;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio_serial::{DataBits, FlowControl, Parity, SerialStream, StopBits};

use super::HardwareError;
use super::serial_owner::SerialOwner;
use super::wiring::SerialWiring;

/// Opens the line, 8N1, without flow control, for this process alone. To be called within a runtime.
pub fn open(wiring: &SerialWiring) -> Result<SerialStream, HardwareError> {
    let path = wiring.device.to_string_lossy();
    let builder = tokio_serial::new(path.as_ref(), wiring.baud)
        .data_bits(DataBits::Eight)
        .parity(Parity::None)
        .stop_bits(StopBits::One)
        .flow_control(FlowControl::None);
    let failed = |error: tokio_serial::Error| {
        let remedy = match error.kind() {
            tokio_serial::ErrorKind::NoDevice | tokio_serial::ErrorKind::Io(io::ErrorKind::NotFound) => {
                "Plug the adapter in, or correct `device` in rig.toml (ls /dev/serial/by-id)"
            }
            tokio_serial::ErrorKind::Io(io::ErrorKind::PermissionDenied) => {
                "Add this user to the group that owns the device (often dialout)"
            }
            tokio_serial::ErrorKind::Io(io::ErrorKind::ResourceBusy) => {
                "Another program has it open: close that one (fuser shows which)"
            }
            _ => "Check the adapter, its cable and the baud rate",
        };
        HardwareError::Open {
            device: format!("serial line {} ({path})", wiring.name).into(),
            reason: error.to_string(),
            remedy: remedy.to_owned(),
        }
    };
    let mut stream = SerialStream::open(&builder).map_err(failed)?;
    stream.set_exclusive(true).map_err(failed)?;
    Ok(stream)
}

/// Starts the owner's thread with a runtime of its own. `on_start` runs first in it: real-time promotion.
pub fn spawn<F, Fut, S>(
    name: &str,
    owner: SerialOwner<F>,
    on_start: impl FnOnce() + Send + 'static,
) -> io::Result<JoinHandle<()>>
where
    F: FnMut() -> Fut + Send + 'static,
    Fut: Future<Output = Result<S, HardwareError>>,
    S: AsyncRead + AsyncWrite + Unpin,
{
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    std::thread::Builder::new().name(format!("serial-{name}")).spawn(move || {
        on_start();
        runtime.block_on(owner.run());
    })
}

//! The bench of the hardware-in-the-loop test, outside the emulator: freerig's simulated chips and plant, in the
//! emulated machine's time, behind an emulated USB adapter for the I2C bus and an emulated serial port.
//!
//! `hil-bench RIG USB SERIAL TIME ORDERS`: the rig file, the emulator's three sockets, and a folder. A file `unplug`
//! there pulls the adapter's plug, a file `plug` puts it in again; each goes when it has been done. The file `truth`
//! there says the first FREE's true pressure in Pa, ten times a second. It ends with its standard input.

mod adapter;
mod pace;
mod redir;

use std::error::Error;
use std::io::{Read, stdin};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{sleep, spawn};
use std::time::Duration;

use freerig::clock::{Clock, Stepper};
use freerig::config::Rig;
use freerig::sim::SimRig;
use freerig::sim::chips::{MemoryStream, SerialLine};
use tokio::io::{AsyncReadExt, AsyncWriteExt};

use pace::Pace;

/// Pace of everything that is waited for.
const PACE: Duration = Duration::from_millis(100);

/// Whether the adapter is to be plugged in, and its connection while it is.
#[derive(Default)]
struct Plug {
    pulled: bool,
    stream: Option<UnixStream>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let paths: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [rig, usb, serial, time, orders] = &paths[..] else {
        return Err("usage: hil-bench RIG USB SERIAL TIME ORDERS".into());
    };
    let rig = Rig::load(rig)?;
    let axes: Vec<_> = rig.control.frees.iter().map(|f| f.imu.map_or([0.0, 0.0, 1.0], |imu| imu.axis)).collect();
    let stepper = Stepper::new();
    let clock = stepper.clock();
    let sim = SimRig::new(&rig.bench, &rig.wiring, &axes, &clock);
    let (bus, _) = sim.i2c(0).ok_or("the rig has no I2C bus")?;
    let line = Arc::clone(sim.line(0).ok_or("the rig has no serial line")?);
    let plug = Arc::new(Mutex::new(Plug::default()));
    let pace = Pace::new(time, stepper);

    spawn({
        let (usb, plug, pace) = (usb.clone(), Arc::clone(&plug), pace.clone());
        move || {
            loop {
                if let Some(stream) = insert(&usb, &plug) {
                    let ended = adapter::serve(stream, bus.clone(), &pace);
                    eprintln!("hil-bench: the adapter's connection has ended: {ended:?}");
                }
                sleep(PACE);
            }
        }
    });
    spawn({
        let (serial, clock, pace) = (serial.clone(), clock.fork(), pace.clone());
        move || {
            loop {
                let ended = serve_line(&serial, &line, &clock, &pace);
                eprintln!("hil-bench: the serial line's connection has ended: {ended:?}");
                sleep(PACE);
            }
        }
    });
    spawn({
        let (orders, plant) = (orders.clone(), sim.plant());
        move || {
            loop {
                obey(&orders, &plug);
                let pressure = plant.lock().unwrap_or_else(PoisonError::into_inner).pressure(0, clock.now());
                if let Err(error) = tell(&orders, pressure) {
                    eprintln!("hil-bench: {error}");
                }
                sleep(PACE);
            }
        }
    });
    stdin().read_to_end(&mut Vec::new())?;
    Ok(())
}

/// The adapter's connection, if it is to be plugged in and the emulator listens.
fn insert(usb: &Path, plug: &Mutex<Plug>) -> Option<UnixStream> {
    let mut plug = plug.lock().unwrap_or_else(PoisonError::into_inner);
    let stream = if plug.pulled { None } else { UnixStream::connect(usb).ok() };
    plug.stream = stream.as_ref().and_then(|stream| stream.try_clone().ok());
    stream
}

/// Does what the files in `orders` ask for.
fn obey(orders: &Path, plug: &Mutex<Plug>) {
    for (name, pulled) in [("unplug", true), ("plug", false)] {
        if std::fs::remove_file(orders.join(name)).is_ok() {
            let mut plug = plug.lock().unwrap_or_else(PoisonError::into_inner);
            plug.pulled = pulled;
            if let Some(stream) = plug.stream.take_if(|_| pulled) {
                // The emulator may have gone first.
                let _ = stream.shutdown(Shutdown::Both);
            }
            eprintln!("hil-bench: {name}");
        }
    }
}

/// Writes the true pressure, in one step.
fn tell(orders: &Path, pressure: f64) -> std::io::Result<()> {
    let fresh = orders.join("truth.new");
    std::fs::write(&fresh, format!("{pressure:.0}\n"))?;
    std::fs::rename(fresh, orders.join("truth"))
}

/// Moves bytes between the emulator's serial port and the line until one of them ends. What the line has for the
/// machine is looked for as often as the time is asked: that clock wakes nobody.
fn serve_line(serial: &Path, line: &Arc<Mutex<SerialLine>>, clock: &Clock, pace: &Pace) -> std::io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let mut port = tokio::net::UnixStream::connect(serial).await?;
        let mut line = MemoryStream::open(line, clock.fork())?;
        let (mut sent, mut got) = ([0; 256], [0; 256]);
        loop {
            tokio::select! {
                count = port.read(&mut sent) => {
                    let count = count?;
                    if count == 0 {
                        return Ok(());
                    }
                    // A unit takes it ill when it is spoken to too soon.
                    pace.now();
                    line.write_all(&sent[..count]).await?;
                }
                count = line.read(&mut got) => {
                    let count = count?;
                    if count == 0 {
                        return Ok(());
                    }
                    port.write_all(&got[..count]).await?;
                }
                () = tokio::time::sleep(pace::STEP) => {}
            }
        }
    })
}

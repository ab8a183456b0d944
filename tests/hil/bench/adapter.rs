//! An i2c-tiny-usb adapter, as Linux's driver of that name expects it, in front of a simulated I2C bus.

use std::io;
use std::os::unix::net::UnixStream;

use embedded_hal::i2c::{I2c, Operation};
use freerig::sim::chips::SimI2c;

use super::pace::Pace;
use super::redir::{Link, PACKET, Packet, kind};

/// What the driver looks for.
const VENDOR: u16 = 0x0403;
const PRODUCT: u16 = 0xc631;
const DEVICE: [u8; 18] = [
    18,
    1,
    0x10,
    1,
    0xff,
    0,
    0,
    PACKET,
    VENDOR as u8,
    (VENDOR >> 8) as u8,
    PRODUCT as u8,
    (PRODUCT >> 8) as u8,
    5,
    2,
    0,
    0,
    0,
    1,
];
/// One configuration with one interface of the vendor's own class, powered by the bus, without endpoints.
const CONFIGURATION: [u8; 18] = [9, 2, 18, 0, 1, 1, 0, 0x80, 50, 9, 4, 0, 0, 0, 0xff, 0, 0, 0];
/// Bit of the request's type: the answer goes to the computer.
const TO_COMPUTER: u8 = 0x80;
/// Bits of the request's type: the vendor's own.
const OF_VENDOR: u8 = 0x40;
/// Status of a control transfer.
const DONE: u8 = 0;
const STALL: u8 = 4;

/// The driver's requests; a transfer is 4 with two bits for its place in the transaction.
const FUNCTIONS: u8 = 1;
const STATUS: u8 = 3;
const TRANSFER: u8 = 4;
const BEGIN: u8 = 1;
const END: u8 = 2;
/// Plain I2C messages.
const I2C: u32 = 1;
/// Bit of a message's flags: it is read.
const READ: u16 = 1;

/// The adapter.
struct Adapter<'p> {
    bus: SimI2c,
    pace: &'p Pace,
    /// What has been written since the transaction began.
    written: Vec<Vec<u8>>,
    /// How the latest transfer went: nothing yet, acknowledged, not acknowledged.
    status: u8,
}

/// A control request.
struct Control {
    request: u8,
    of: u8,
    value: u16,
    index: u16,
    length: usize,
}

/// Serves the adapter until its connection ends.
pub fn serve(stream: UnixStream, bus: SimI2c, pace: &Pace) -> io::Result<()> {
    let mut link = Link::open(stream, VENDOR, PRODUCT)?;
    let mut adapter = Adapter { bus, pace, written: Vec::new(), status: 0 };
    loop {
        let Packet { kind, id, body } = link.receive()?;
        match (kind, &body[..]) {
            (kind::SET_CONFIGURATION, _) | (kind::GET_CONFIGURATION, _) => {
                link.send(kind::CONFIGURATION_STATUS, id, &[DONE, 1])?;
            }
            (kind::SET_ALT_SETTING, &[interface, ..]) | (kind::GET_ALT_SETTING, &[interface]) => {
                link.send(kind::ALT_SETTING_STATUS, id, &[DONE, interface, 0])?;
            }
            (kind::CONTROL, &[endpoint, request, of, _, v0, v1, i0, i1, l0, l1, ref data @ ..]) => {
                let [value, index, length] = [[v0, v1], [i0, i1], [l0, l1]].map(u16::from_le_bytes);
                let control = Control { request, of, value, index, length: length.into() };
                let (status, answer) = match adapter.control(&control, data) {
                    Some(answer) => (DONE, answer),
                    None => (STALL, Vec::new()),
                };
                let done = if of & TO_COMPUTER == 0 { length } else { answer.len() as u16 };
                let [l0, l1] = done.to_le_bytes();
                let head = [endpoint, request, of, status, v0, v1, i0, i1, l0, l1];
                link.send(kind::CONTROL, id, &[&head, &answer[..]].concat())?;
            }
            (kind::RESET, _) => adapter.written.clear(),
            // Whatever else there is asks for no answer of a device without further endpoints.
            _ => {}
        }
    }
}

impl Adapter<'_> {
    /// Carries out a request; none for one that it does not know.
    fn control(&mut self, control: &Control, data: &[u8]) -> Option<Vec<u8>> {
        let answer = match (control.of & OF_VENDOR != 0, control.request) {
            // GET_DESCRIPTOR
            (false, 6) => match control.value >> 8 {
                1 => DEVICE.to_vec(),
                2 => CONFIGURATION.to_vec(),
                _ => return None,
            },
            // GET_STATUS
            (false, 0) => vec![0, 0],
            (false, _) => Vec::new(),
            (true, FUNCTIONS) => I2C.to_le_bytes().into(),
            (true, STATUS) => vec![self.status],
            (true, request) if request & !(BEGIN | END) == TRANSFER => self.transfer(control, data),
            // The bus keeps its own pace.
            (true, _) => Vec::new(),
        };
        Some(answer.into_iter().take(control.length).collect())
    }

    /// One message of a transaction. Writes wait for the read or the end behind them, so that the chip sees one
    /// transaction with its repeated start; what they are worth is known then.
    fn transfer(&mut self, control: &Control, data: &[u8]) -> Vec<u8> {
        if control.request & BEGIN != 0 {
            self.written.clear();
        }
        let read = control.value & READ != 0;
        let mut answer = vec![0; if read { control.length } else { 0 }];
        if !read {
            self.written.push(data.to_vec());
        }
        self.status = 1;
        if read || control.request & END != 0 {
            let mut operations: Vec<_> = self.written.iter().map(|bytes| Operation::Write(bytes)).collect();
            if read {
                operations.push(Operation::Read(&mut answer));
            }
            // A chip that starts must not be late by what the bench's time lags behind.
            self.pace.now();
            if self.bus.transaction(control.index as u8, &mut operations).is_err() {
                self.status = 2;
            }
            self.written.clear();
        }
        answer
    }
}

//! The USB redirection protocol 0.7 (`usbredirproto.h` of the spice project), as far as one adapter with nothing but
//! its control endpoint needs it. Everything is little-endian and packed.

use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;

/// Kinds of packets.
pub mod kind {
    pub const HELLO: u32 = 0;
    pub const DEVICE_CONNECT: u32 = 1;
    pub const RESET: u32 = 3;
    pub const INTERFACE_INFO: u32 = 4;
    pub const EP_INFO: u32 = 5;
    pub const SET_CONFIGURATION: u32 = 6;
    pub const GET_CONFIGURATION: u32 = 7;
    pub const CONFIGURATION_STATUS: u32 = 8;
    pub const SET_ALT_SETTING: u32 = 9;
    pub const GET_ALT_SETTING: u32 = 10;
    pub const ALT_SETTING_STATUS: u32 = 11;
    pub const CONTROL: u32 = 100;
}

/// Capabilities that the emulator insists on: packet sizes in the endpoints' description, 64-bit ids, 32-bit lengths.
const CAPABILITIES: u32 = 1 << 4 | 1 << 5 | 1 << 6;
/// Bytes of the version text in a hello.
const VERSION: usize = 64;
/// Interfaces and endpoints in their descriptions.
const PLACES: usize = 32;
/// Longer packets than any that a control endpoint takes.
const LONGEST: usize = 1 << 17;
/// An endpoint that there is none of.
const NO_ENDPOINT: u8 = 255;
/// Full speed.
const SPEED: u8 = 1;
/// Largest packet of the control endpoint.
pub const PACKET: u8 = 64;

/// One packet.
#[derive(Debug)]
pub struct Packet {
    pub kind: u32,
    pub id: u64,
    pub body: Vec<u8>,
}

/// A connection to the emulator, after the hellos.
pub struct Link(UnixStream);

impl Link {
    /// Exchanges the hellos and presents a device of `vendor` and `product` with one interface of the vendor's own
    /// class.
    pub fn open(mut stream: UnixStream, vendor: u16, product: u16) -> io::Result<Self> {
        let mut hello = [0; VERSION + 4];
        hello[..9].copy_from_slice(b"hil-bench");
        hello[VERSION..].copy_from_slice(&CAPABILITIES.to_le_bytes());
        // The ids of the hellos alone have 32 bits.
        stream.write_all(&[words(&[kind::HELLO, hello.len() as u32, 0]), hello.into()].concat())?;
        let [kind, length, _] = [word(&mut stream)?, word(&mut stream)?, word(&mut stream)?];
        if kind != kind::HELLO || length as usize > LONGEST {
            return Err(io::Error::other(format!("no hello: packet {kind} of {length} bytes")));
        }
        stream.read_exact(&mut vec![0; length as usize])?;
        let mut link = Self(stream);

        let mut interfaces = words(&[1]);
        interfaces.extend([0; 4 * PLACES]);
        interfaces[4 + PLACES] = 0xff;
        link.send(kind::INTERFACE_INFO, 0, &interfaces)?;
        // By endpoint, out then in: kind, interval, interface, and two bytes of packet size.
        let mut endpoints = vec![NO_ENDPOINT; PLACES];
        endpoints.extend([0; 4 * PLACES]);
        for control in [0, PLACES / 2] {
            endpoints[control] = 0;
            endpoints[3 * PLACES + 2 * control] = PACKET;
        }
        link.send(kind::EP_INFO, 0, &endpoints)?;
        let [[v0, v1], [p0, p1]] = [vendor.to_le_bytes(), product.to_le_bytes()];
        link.send(kind::DEVICE_CONNECT, 0, &[SPEED, 0xff, 0, 0, v0, v1, p0, p1])?;
        Ok(link)
    }

    /// The next packet.
    pub fn receive(&mut self) -> io::Result<Packet> {
        let [kind, length] = [word(&mut self.0)?, word(&mut self.0)?];
        let mut id = [0; 8];
        self.0.read_exact(&mut id)?;
        if length as usize > LONGEST {
            return Err(io::Error::other(format!("packet {kind} of {length} bytes")));
        }
        let mut body = vec![0; length as usize];
        self.0.read_exact(&mut body)?;
        Ok(Packet { kind, id: u64::from_le_bytes(id), body })
    }

    /// Sends a packet; an answer has the id of its question.
    pub fn send(&mut self, kind: u32, id: u64, body: &[u8]) -> io::Result<()> {
        let packet = [&words(&[kind, body.len() as u32]), &id.to_le_bytes()[..], body].concat();
        self.0.write_all(&packet)
    }
}

fn words(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

fn word(stream: &mut UnixStream) -> io::Result<u32> {
    let mut bytes = [0; 4];
    stream.read_exact(&mut bytes)?;
    Ok(u32::from_le_bytes(bytes))
}

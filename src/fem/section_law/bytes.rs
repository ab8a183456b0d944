//! A law as bytes and back: what a cache keeps.
//!
//! All numbers little-endian:
//!
//! | bytes | what |
//! | --- | --- |
//! | 16 | `freerig law` and five zeros |
//! | 32 | SHA-256 of everything that the law follows from: the code's version and the request |
//! | n | the law: grid, states of the points, lateral stiffness, errors |
//! | 32 | SHA-256 of all before |

use std::sync::Arc;

use sha2::{Digest, Sha256};
use thiserror::Error;

use super::{Errors, Request, SectionLaw, SectionLawError};
use crate::fem::material::Law as Rubber;
use crate::fem::rod::{Axis, Grid, Profile, Table};
use crate::fem::section::Mesh;

/// To be counted up whenever the same request leads to another law or other bytes.
const VERSION: u64 = 4;
const NAME: &[u8; 16] = b"freerig law\0\0\0\0\0";
/// A SHA-256.
const HASH: usize = 32;

/// What bytes are no law, or not the one asked for.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum BytesError {
    /// Not written by this program, cut off, or changed since.
    #[error("no whole law: truncated, damaged, or something else")]
    Damaged,
    /// Made by another version or for another tube, mesh or range.
    #[error("the law of another tube, mesh or range, or by another version")]
    Other,
    /// Whole, but no law.
    #[error(transparent)]
    Law(#[from] SectionLawError),
}

/// Numbers one after the other.
#[derive(Default)]
struct Writer(Vec<u8>);

impl Writer {
    fn integer(&mut self, value: u64) {
        self.0.extend(value.to_le_bytes());
    }

    fn numbers(&mut self, values: impl IntoIterator<Item = f64>) {
        for value in values {
            self.integer(value.to_bits());
        }
    }
}

struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn integer(&mut self) -> Result<u64, BytesError> {
        let (head, rest) = self.0.split_first_chunk().ok_or(BytesError::Damaged)?;
        self.0 = rest;
        Ok(u64::from_le_bytes(*head))
    }

    fn number(&mut self) -> Result<f64, BytesError> {
        Ok(f64::from_bits(self.integer()?))
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f64; N], BytesError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.number()?;
        }
        Ok(values)
    }

    /// A count of things that take at least eight bytes each.
    fn count(&mut self) -> Result<usize, BytesError> {
        let count = self.integer()?;
        usize::try_from(count).ok().filter(|n| *n <= self.0.len() / 8).ok_or(BytesError::Damaged)
    }
}

impl Request {
    /// SHA-256 of everything that the law of this request follows from: also a name for it in a cache.
    ///
    /// # Errors
    /// Where the request is none.
    pub fn fingerprint(&self) -> Result<[u8; HASH], SectionLawError> {
        let Request { tube, mesh, pressure, twist } = self.validated()?;
        let mut all = Writer::default();
        all.integer(VERSION);
        all.0.extend(env!("CARGO_PKG_VERSION").as_bytes());
        all.numbers([tube.inner_radius, tube.wall, tube.gamma, tube.fiber_ea, tube.fiber_width, pressure, twist]);
        all.integer(tube.fibers as u64);
        let (kind, moduli) = match tube.law {
            Rubber::Ogden { mu, alpha } => (0, [mu, alpha]),
            Rubber::NeoHookean { mu } => (1, [mu, 0.0]),
            Rubber::Linear { mu } => (2, [mu, 0.0]),
        };
        all.integer(kind);
        all.numbers(moduli);
        let (kind, counts, growth) = match mesh {
            Mesh::Counted { radial, strip, gap, growth } => (0, [radial, strip, gap], growth),
            Mesh::Graded { strip, growth } => (1, [0, strip, 0], growth),
        };
        all.integer(kind);
        counts.into_iter().for_each(|count| all.integer(count as u64));
        all.numbers([growth]);
        Ok(Sha256::digest(&all.0).into())
    }
}

impl SectionLaw {
    /// The law as bytes.
    ///
    /// # Errors
    /// None of a law that was built.
    pub fn to_bytes(&self) -> Result<Vec<u8>, SectionLawError> {
        let mut all = Writer(NAME.to_vec());
        all.0.extend(self.request.fingerprint()?);
        let grid = self.table.grid();
        for axis in [grid.stretch, grid.twist, grid.pressure] {
            all.numbers([axis.from, axis.to]);
            all.integer(axis.points as u64);
        }
        all.numbers(grid.skew);
        for state in self.table.known() {
            all.integer(u64::from(state.is_some()));
            all.numbers(state.into_iter().flatten());
        }
        all.numbers(self.lateral.iter().flat_map(Profile::numbers));
        let Errors { stretch, twist, states, mesh, bending, mostly } = self.errors;
        all.numbers([stretch, twist, mesh, bending, mostly]);
        all.integer(states as u64);
        let hash = Sha256::digest(&all.0);
        all.0.extend(hash);
        Ok(all.0)
    }

    /// The law of `request` from the bytes of [`SectionLaw::to_bytes`], the same to the last bit.
    ///
    /// # Errors
    /// Where they are not whole, or those of another request: it has to be built again.
    pub fn from_bytes(request: &Request, bytes: &[u8]) -> Result<SectionLaw, BytesError> {
        let request = request.validated()?;
        let (all, hash) = bytes.split_last_chunk::<HASH>().ok_or(BytesError::Damaged)?;
        let rest = all.strip_prefix(NAME).filter(|_| Sha256::digest(all).as_slice() == hash);
        let (fingerprint, rest) = rest.and_then(|r| r.split_first_chunk::<HASH>()).ok_or(BytesError::Damaged)?;
        if *fingerprint != request.fingerprint()? {
            return Err(BytesError::Other);
        }
        let mut from = Reader(rest);
        let mut axes = [Axis { from: 0.0, to: 0.0, points: 0 }; 3];
        for axis in &mut axes {
            let [low, high] = from.numbers()?;
            *axis = Axis { from: low, to: high, points: from.count()? };
        }
        let [stretch, twist, pressure] = axes;
        let grid = Grid { stretch, twist, pressure, skew: from.numbers()? };
        let mut states = Vec::new();
        for _ in 0..grid.points() {
            states.push(match from.integer()? {
                0 => None,
                _ => Some(from.numbers()?),
            });
        }
        let table = Table::from_known(grid, states.into_iter()).map_err(SectionLawError::from)?;
        let mut profile = || Ok::<_, BytesError>(Profile::of_numbers(&from.numbers()?));
        let lateral = [profile()?, profile()?, profile()?];
        let [stretch, twist, mesh, bending, mostly] = from.numbers()?;
        let states = usize::try_from(from.integer()?).map_err(|_| BytesError::Damaged)?;
        if !from.0.is_empty() {
            return Err(BytesError::Damaged);
        }
        let errors = Errors { stretch, twist, states, mesh, bending, mostly };
        Ok(SectionLaw { request, table: Arc::new(table), lateral, errors })
    }
}

//! Damping of a FREE that is plucked: turned by hand, held, and let go, several times in one record.
//!
//! | noun | what it gives |
//! | --- | --- |
//! | [`releases`] | where in the record the end was let go, and until when it moved alone |
//! | [`fit_plucks`] | ct over I (and kt over I) of a FREE that rings, ct over kt of one that creeps back |
//! | [`torsion_of_series`] | I, kt and ct from records with different added inertias |
//!
//! **Why not a damped sinusoid.** Rubber and fibres remember: beside its spring and its damper the end drags
//! Maxwell-slip elements ([`crate::model::Hysteresis`]), which stiffen small motions and damp large ones by as much as
//! the viscous part does. A sinusoid's decay is then no ct. What holds at every instant while nobody touches the end is
//!
//! ```text
//! I phi'' + ct phi' + kt (phi - phi0) + sum w_i s_i = 0,     s_i: strain of element i, known from the angles so far
//! ```
//!
//! linear in all that is not known, so it is fitted as it stands, with w_i >= 0: of a FREE that rings over the
//! intervals between readings (the angle by the cubic through both angles and rates), divided by I; of one that creeps
//! at each reading, divided by kt, I / kt taken as known (a correction of I kt / ct^2). Whether it rings is told by its
//! overshoot, its frequency by its rates over its angles, which no slow sampling can disguise; what is beyond the
//! sensor is refused. A FREE without friction is [`fit_ring_down`](crate::ident::fit_ring_down)'s.
//!
//! **Uncertainty.** That of the mean over the releases, by leaving out one after the other (jackknife): what differs
//! from pluck to pluck, noise and a clumsy hand alike, is in it; and what the elements cannot tell: friction that slips
//! beyond the turns looks like a spring, and where friction takes most of the energy little is left that is the
//! damper's. What is wrong in all of them is not in it: the scale of the gyro and, of a FREE that creeps, kt.

mod release;
mod series;
mod viscous;

use thiserror::Error;

pub use release::{Release, Rules, evened, releases};
pub use series::{Loaded, SeriesError, torsion_of_series};
pub use viscous::{PluckFit, Regime, fit_plucks};

use super::RingDownError;

/// Fewest releases of one record.
pub const RELEASES_MIN: usize = 3;

/// One reading of the end.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reading {
    /// When, s.
    pub time: f64,
    /// Angle, rad.
    pub angle: f64,
    /// Rate, rad/s.
    pub rate: f64,
}

/// Why there is no damping.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum PluckError {
    /// Too few readings.
    #[error("plucks need at least {least} readings; there are {count}")]
    TooFew {
        /// How many there are.
        count: usize,
        /// How many are needed.
        least: usize,
    },
    /// A number that is none, or times that do not increase.
    #[error("reading {0} is not finite, or not later than the one before it")]
    Reading(usize),
    /// Nothing was turned.
    #[error(
        "no excitation: the end was turned by {:.2} deg at most, and {:.1} deg are the least: turn it farther, hold it, and \
         let go at once",
        .farthest.to_degrees(), .least.to_degrees()
    )]
    NoExcitation {
        /// Farthest from rest, rad.
        farthest: f64,
        /// The rule, rad.
        least: f64,
    },
    /// Too few releases.
    #[error(
        "{found} releases can be told, at least {RELEASES_MIN} are needed: turn the end, hold it still for a second, let go \
         at once, let it come to rest, and again"
    )]
    Releases {
        /// How many there are.
        found: usize,
    },
    /// What a release shows cannot be trusted.
    #[error(transparent)]
    RingDown(#[from] RingDownError),
    /// What fits best is no FREE.
    #[error("what fits best is no FREE: damping {damping} 1/s or s, stiffness {stiffness} 1/s2")]
    NoFree {
        /// ct/I or ct/kt.
        damping: f64,
        /// kt/I; one of a FREE that creeps.
        stiffness: f64,
    },
    /// The fit did not come to an end.
    #[error("the fit did not converge")]
    NotConverged,
}

//! What the rubber and the fibres are, once for a batch: from files of tensile tests and of a bare tube's inflation.
//!
//! | noun | from | gives |
//! | --- | --- | --- |
//! | [`tensile`] | nominal stress against stretch | E, mu = E/3; Ogden's mu and alpha beside neo-Hooke and Hooke |
//! | [`inflation`] | a bare tube's outer radius against pressure | alpha, mu known or not; the same laws beside it |
//! | [`fiber`] | force against strain | EA, and the toe where it is slack |
//! | [`shore`] | E | Shore A, and back |

pub mod fiber;
pub mod inflation;
mod laws;
pub mod shore;
pub mod tensile;

pub use fiber::{FiberError, FiberFit, FiberPoint, Toe, fit_fiber};
pub use inflation::{BareTube, InflationError, InflationFit, InflationPoint, ReadingErrors, fit_inflation};
pub use laws::LawFit;
pub use shore::{ShoreError, modulus_of_shore_a, shore_a_of_modulus};
pub use tensile::{TensileError, TensileFit, TensilePoint, fit_tensile};

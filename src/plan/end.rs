//! Where a way in the pressures ends.

use std::fmt;

use super::Rest;
use crate::fem::module::{Kind, Loads, ModuleError, Path, State};
use crate::units::Pressure;

/// A share of the way below which an end is not pinned down any further.
const SHARE: f64 = 1e-4;
/// The arc length (radians, lengths, load factors) of the steps that look for a critical point.
const STEP: f64 = 0.1;
/// Half a psi, Pa: some degrees of bending or twist.
const RAMP: f64 = 3450.0;

/// What ends it.
#[derive(Clone, Debug, PartialEq)]
pub enum End {
    /// The module has no equilibrium of this branch beyond: it would snap.
    Limit,
    /// The branch goes on but is unstable: the rods buckle.
    Buckling,
    /// Tubes touch, which the model does not describe.
    Contact,
    /// The section's law or the rods' integration refuses.
    Domain(ModuleError),
}

/// An end and the pressures where it lies.
#[derive(Clone, Debug, PartialEq)]
pub struct Ended {
    /// What.
    pub end: End,
    /// Pa, of A, B, C, D.
    pub pressures: [f64; 4],
}

impl fmt::Display for End {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            End::Limit => write!(f, "passes a limit point and would snap"),
            End::Buckling => write!(f, "buckles"),
            End::Contact => write!(f, "has tubes that touch"),
            End::Domain(cause) => write!(f, "leaves what its model describes ({cause})"),
        }
    }
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c, d] = self.pressures.map(|p| Pressure::pascals(p).display_value());
        write!(f, "the module {} at A {a:.2}, B {b:.2}, C {c:.2}, D {d:.2} psi", self.end)
    }
}

impl Rest<'_> {
    /// The stable equilibrium at `to` (Pa), followed from `from` along the straight way between; else where the way
    /// ends.
    pub fn onward(&self, from: &State, to: &[f64; 4]) -> Result<State, Box<Ended>> {
        // Margins are compared over small steps.
        match self.module().equilibrium_closely_from(from, &self.loads(to)) {
            Ok(state) if state.stable() => Ok(state),
            found => Err(Box::new(self.locate(from, to, found.err()))),
        }
    }

    /// The same as [`Rest::onward`] in steps of half a psi, each of which must be stable.
    pub fn ramp(&self, from: &State, to: &[f64; 4]) -> Result<State, Box<Ended>> {
        let start = pressures(from);
        let far = start.iter().zip(to).fold(0.0, |far, (a, b)| f64::max(far, (b - a).abs()));
        let steps = (far / RAMP).ceil().max(1.0);
        let mut state = from.clone();
        for k in 1..=steps as usize {
            state = self.onward(&state, &between(&start, to, k as f64 / steps))?;
        }
        Ok(state)
    }

    fn locate(&self, from: &State, to: &[f64; 4], cause: Option<ModuleError>) -> Ended {
        let start = pressures(from);
        let at = |share: f64| between(&start, to, share);
        match cause {
            Some(ModuleError::Contact { .. }) => {
                // Contact is found after the fact: halve the way.
                let (mut low, mut high) = (0.0, 1.0);
                while high - low > SHARE {
                    let middle = 0.5 * (low + high);
                    match self.module().equilibrium_from(from, &self.loads(&at(middle))) {
                        Ok(_) => low = middle,
                        Err(_) => high = middle,
                    }
                }
                Ended { end: End::Contact, pressures: at(low) }
            }
            Some(ModuleError::Ends { fraction, cause: Some(cause) }) => {
                let end = match *cause {
                    ModuleError::Contact { .. } => End::Contact,
                    cause => End::Domain(cause),
                };
                Ended { end, pressures: at(fraction) }
            }
            other => self.critical(from, &self.loads(to), &at, other),
        }
    }

    /// The first critical point of the way from the stable `from`.
    fn critical(&self, from: &State, to: &Loads, at: &dyn Fn(f64) -> [f64; 4], cause: Option<ModuleError>) -> Ended {
        let found = Path::new(self.module(), from, to, STEP).and_then(|mut path| path.next_critical((-STEP, 1.0)));
        match found {
            Ok(Some(critical)) => {
                let end = if critical.kind == Kind::Limit { End::Limit } else { End::Buckling };
                Ended { end, pressures: at(critical.mu) }
            }
            Err(ModuleError::Ends { fraction, cause: Some(cause) }) => {
                let end =
                    if matches!(*cause, ModuleError::Contact { .. }) { End::Contact } else { End::Domain(*cause) };
                Ended { end, pressures: at(fraction) }
            }
            // The way is there and stable to the arc's eye, or the arc itself fails: what was said first stands.
            Ok(None) | Err(_) => match cause {
                Some(ModuleError::Ends { fraction, cause: None }) => Ended { end: End::Limit, pressures: at(fraction) },
                Some(cause) => Ended { end: End::Domain(cause), pressures: at(0.0) },
                None => Ended { end: End::Buckling, pressures: at(1.0) },
            },
        }
    }
}

/// The pressures of an equilibrium of four rods.
pub(super) fn pressures(state: &State) -> [f64; 4] {
    std::array::from_fn(|i| state.loads().pressures.get(i).copied().unwrap_or(0.0))
}

pub(super) fn between(from: &[f64; 4], to: &[f64; 4], share: f64) -> [f64; 4] {
    std::array::from_fn(|i| if share == 1.0 { to[i] } else { from[i] + share * (to[i] - from[i]) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_tells_its_pressures_in_the_unit_of_the_tables() {
        let pressures = [1.0, 0.0, 0.0, 3.4].map(|psi| Pressure::psi(psi).si());
        let said = Ended { end: End::Buckling, pressures }.to_string();
        assert_eq!(said, "the module buckles at A 1.00, B 0.00, C 0.00, D 3.40 psi");
    }
}

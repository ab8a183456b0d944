//! The tube that a command computes: the FREE of rig.toml, or what the flags say of it.

use anyhow::anyhow;

use super::free::subject;
use super::{Context, Failure};
use crate::config::Rig;
use crate::fem::material::Law;
use crate::fem::tube::{Tube, TubeError};
use crate::units::{Angle, Force, Length, Pressure};

/// Flags that describe a tube; what is not given is the FREE's of rig.toml.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "The FREE")]
pub struct TubeArgs {
    /// FREE of rig.toml that gives what is not given here; not needed where the rig has one
    #[arg(long, value_name = "NAME")]
    free: Option<String>,
    /// Winding angle from the axis; negative for an L FREE
    #[arg(long, value_name = "GAMMA", value_delimiter = ',', allow_hyphen_values = true)]
    gamma: Vec<Angle>,
    /// Length at rest
    #[arg(long)]
    length: Option<Length>,
    /// Inner diameter of the rubber tube
    #[arg(long)]
    inner_diameter: Option<Length>,
    /// Thickness of its wall
    #[arg(long)]
    wall: Option<Length>,
    /// Number of fibres
    #[arg(long, value_name = "N")]
    fibers: Option<usize>,
    /// Shear modulus of the rubber
    #[arg(long)]
    mu: Option<Pressure>,
    /// Exponent of its Ogden law (2: neo-Hookean)
    #[arg(long)]
    alpha: Option<f64>,
    /// Stiffness EA of one fibre, force per unit strain
    #[arg(long)]
    fiber_ea: Option<Force>,
    /// Arc of the circumference that one fibre covers
    #[arg(long)]
    fiber_width: Option<Length>,
}

impl TubeArgs {
    /// Whether a length was given.
    pub fn has_length(&self) -> bool {
        self.length.is_some()
    }

    /// The winding angles given.
    pub fn gammas(&self) -> &[Angle] {
        &self.gamma
    }

    /// Fastest change of the FREE's pressure that rig.toml allows, Pa/s.
    pub fn slew(&self, context: &Context) -> Result<f64, Failure> {
        let rig = Rig::load(&context.rig)?;
        let index = subject(&rig, self.free.as_deref())?;
        Ok(rig.control.frees[index].limits.slew)
    }

    /// The tube and its length, m. What neither the flags nor the FREE's calibration say is the reference FREE's, and
    /// is told.
    pub fn tube(&self, context: &Context) -> Result<(Tube, f64), Failure> {
        if self.gamma.len() > 1 {
            let angles = self.gamma.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
            let error = anyhow!("--gamma {angles}: one winding angle belongs here");
            return Err(Failure::usage(error).remedy("ask for one after the other"));
        }
        self.one(self.gamma.first().copied(), context)
    }

    /// A tube for each winding angle given, and their length; the FREE's own where none is.
    pub fn tubes(&self, context: &Context) -> Result<(Vec<Tube>, f64), Failure> {
        let (first, length) = self.one(self.gamma.first().copied(), context)?;
        let mut tubes = vec![first];
        for gamma in self.gamma.iter().skip(1) {
            tubes.push(self.one(Some(*gamma), context)?.0);
        }
        Ok((tubes, length))
    }

    fn one(&self, gamma: Option<Angle>, context: &Context) -> Result<(Tube, f64), Failure> {
        let rig = Rig::load(&context.rig)?;
        let index = subject(&rig, self.free.as_deref())?;
        let calibration = &rig.calibrations[index];
        let (known, assumed) = calibration.tube();
        let given = [
            ("inner_diameter_mm", self.inner_diameter.is_some()),
            ("wall_mm", self.wall.is_some()),
            ("fibers", self.fibers.is_some()),
            ("fiber_width_mm", self.fiber_width.is_some()),
            ("shear_modulus_mpa", self.mu.is_some()),
            ("ogden_exponent", self.alpha.is_some()),
            ("fiber_stiffness_n", self.fiber_ea.is_some()),
        ];
        let missing: Vec<&str> = assumed.into_iter().filter(|key| !given.contains(&(key, true))).collect();
        if !missing.is_empty() {
            let name = &rig.control.frees[index].name;
            let list = missing.join(", ");
            context.note(format!("not in the calibration of `{name}`, taken from the reference FREE: {list}"));
        }
        let (mu, alpha) = match known.law {
            Law::Ogden { mu, alpha } => (mu, alpha),
            Law::NeoHookean { mu } => (mu, 2.0),
            Law::Linear { mu } => (mu, 0.0),
        };
        let law = Law::ogden(self.mu.map_or(mu, Pressure::si), self.alpha.unwrap_or(alpha));
        let tube = Tube {
            inner_radius: self.inner_diameter.map_or(known.inner_radius, |d| 0.5 * d.si()),
            wall: self.wall.map_or(known.wall, Length::si),
            gamma: gamma.map_or(known.gamma, Angle::si),
            fibers: self.fibers.unwrap_or(known.fibers),
            fiber_ea: self.fiber_ea.map_or(known.fiber_ea, Force::si),
            fiber_width: self.fiber_width.map_or(known.fiber_width, Length::si),
            law: law.map_err(|error| Failure::usage(error).remedy("give another --mu or --alpha"))?,
        };
        let tube = tube.validated().map_err(|error| {
            Failure::usage(by_flag(error)).remedy("give another value, or correct the calibration that has it")
        })?;
        let length = self.length.map_or(calibration.free().length, Length::si);
        if length <= 0.0 {
            let error = anyhow!("--length {}: must be positive", Length::metres(length));
            return Err(Failure::usage(error).remedy("give the length at rest"));
        }
        Ok((tube, length))
    }
}

/// The same in the units of the flags, and with their names.
fn by_flag(error: TubeError) -> anyhow::Error {
    let mm = Length::metres;
    match error {
        TubeError::InnerRadius(radius) => anyhow!("--inner-diameter {}: must be positive", mm(2.0 * radius)),
        TubeError::Wall { wall, inner_radius } => anyhow!(
            "--wall {}: must be from {} to {} at an inner diameter of {}",
            mm(wall),
            mm(0.005 * inner_radius),
            mm(2.0 * inner_radius),
            mm(2.0 * inner_radius)
        ),
        TubeError::Gamma(gamma) => {
            anyhow!("--gamma {}: its magnitude must be between 0.1 and 89.9 deg", Angle::radians(gamma))
        }
        TubeError::FiberWidth { width, share } => anyhow!(
            "--fiber-width {}: must be from 0 mm to the fibre's share of the circumference, {}",
            mm(width),
            mm(share)
        ),
        TubeError::Fibers(_) => anyhow!("--fibers: {error}"),
        TubeError::FiberStiffness(_) => anyhow!("--fiber-ea: {error}"),
        TubeError::Material(_) => error.into(),
    }
}

//! What is varied among designs, from where to where: `gamma=10deg..80deg:15`.

use crate::fem::material::Law;
use crate::fem::tube::Tube;
use crate::plan::study::Candidate;
use crate::units::{Angle, Force, Length, Pressure};

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Parameter {
    Gamma,
    Wall,
    InnerDiameter,
    Fibers,
    FiberWidth,
    FiberEa,
    Mu,
    Alpha,
    Spacing,
}

impl Parameter {
    const ALL: [(Parameter, &'static str, &'static str); 9] = [
        (Parameter::Gamma, "gamma", "deg"),
        (Parameter::Wall, "wall", "mm"),
        (Parameter::InnerDiameter, "inner-diameter", "mm"),
        (Parameter::Fibers, "fibers", ""),
        (Parameter::FiberWidth, "fiber-width", "mm"),
        (Parameter::FiberEa, "fiber-ea", "N"),
        (Parameter::Mu, "mu", "MPa"),
        (Parameter::Alpha, "alpha", ""),
        (Parameter::Spacing, "spacing", "mm"),
    ];

    fn parse(self, text: &str) -> Result<f64, String> {
        let bare = |text: &str| match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(format!("`{text}` is no number")),
        };
        match self {
            Parameter::Gamma => text.parse::<Angle>().map(Angle::si).map_err(|error| error.to_string()),
            Parameter::Mu => text.parse::<Pressure>().map(Pressure::si).map_err(|error| error.to_string()),
            Parameter::FiberEa => text.parse::<Force>().map(Force::si).map_err(|error| error.to_string()),
            Parameter::Fibers | Parameter::Alpha => bare(text),
            Parameter::Wall | Parameter::InnerDiameter | Parameter::FiberWidth | Parameter::Spacing => {
                text.parse::<Length>().map(Length::si).map_err(|error| error.to_string())
            }
        }
    }

    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|p| p.0 == self).map_or("", |p| p.1)
    }

    /// Its unit; empty where it has none.
    pub fn unit(self) -> &'static str {
        Self::ALL.iter().find(|p| p.0 == self).map_or("", |p| p.2)
    }

    /// Its name and unit, for an axis.
    pub fn label(self) -> String {
        if self.unit().is_empty() { self.name().into() } else { format!("{} ({})", self.name(), self.unit()) }
    }

    /// `value` (SI) in the unit that it is shown in.
    pub fn shown(self, value: f64) -> f64 {
        match self {
            Parameter::Gamma => value.to_degrees(),
            Parameter::Mu => 1e-6 * value,
            Parameter::Wall | Parameter::InnerDiameter | Parameter::FiberWidth | Parameter::Spacing => 1e3 * value,
            Parameter::Fibers | Parameter::FiberEa | Parameter::Alpha => value,
        }
    }

    fn set(self, candidate: Candidate, value: f64) -> Candidate {
        let tube = candidate.tube;
        let tube = match self {
            Parameter::Gamma => Tube { gamma: value, ..tube },
            Parameter::Wall => Tube { wall: value, ..tube },
            Parameter::InnerDiameter => Tube { inner_radius: 0.5 * value, ..tube },
            Parameter::Fibers => Tube { fibers: value as usize, ..tube },
            Parameter::FiberWidth => Tube { fiber_width: value, ..tube },
            Parameter::FiberEa => Tube { fiber_ea: value, ..tube },
            Parameter::Mu => Tube { law: tube.law.with_shear_modulus(value), ..tube },
            Parameter::Alpha => Tube { law: Law::Ogden { mu: tube.law.shear_modulus(), alpha: value }, ..tube },
            Parameter::Spacing => return Candidate { spacing: Some(value), ..candidate },
        };
        Candidate { tube, ..candidate }
    }

    /// That of a candidate, SI.
    pub fn get(self, candidate: &Candidate) -> f64 {
        let tube = &candidate.tube;
        match self {
            Parameter::Gamma => tube.gamma,
            Parameter::Wall => tube.wall,
            Parameter::InnerDiameter => 2.0 * tube.inner_radius,
            Parameter::Fibers => tube.fibers as f64,
            Parameter::FiberWidth => tube.fiber_width,
            Parameter::FiberEa => tube.fiber_ea,
            Parameter::Mu => tube.law.shear_modulus(),
            Parameter::Alpha => tube.law.exponent().unwrap_or(f64::NAN),
            Parameter::Spacing => candidate.spacing.unwrap_or(f64::NAN),
        }
    }

    fn whole(self) -> bool {
        self == Parameter::Fibers
    }
}

/// One parameter and the values that it takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sweep {
    pub parameter: Parameter,
    from: f64,
    to: f64,
    count: Option<usize>,
}

/// Most values of a parameter.
const COUNTS: std::ops::RangeInclusive<usize> = 2..=10_000;

impl std::str::FromStr for Sweep {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let form =
            || format!("`{text}` is no sweep; write NAME=FROM..TO or NAME=FROM..TO:COUNT, as in gamma=10deg..80deg:15");
        let (name, range) = text.split_once('=').ok_or_else(form)?;
        let (from, to) = range.split_once("..").ok_or_else(form)?;
        let (to, count) = match to.split_once(':') {
            None => (to, None),
            Some((to, count)) => (to, Some(count.parse::<usize>().map_err(|_| form())?)),
        };
        let names = || Parameter::ALL.map(|p| p.1).join(", ");
        let known = Parameter::ALL.iter().find(|p| p.1 == name);
        let (parameter, ..) = *known.ok_or_else(|| format!("`{name}` cannot be swept; one of: {}", names()))?;
        let sweep = Sweep { parameter, from: parameter.parse(from)?, to: parameter.parse(to)?, count };
        if sweep.from == sweep.to {
            return Err(format!("`{text}` goes nowhere: FROM and TO must differ"));
        }
        if let Some(count) = count.filter(|count| !COUNTS.contains(count)) {
            return Err(format!("{count} values of {name}: must be between {} and {}", COUNTS.start(), COUNTS.end()));
        }
        Ok(sweep)
    }
}

impl std::fmt::Display for Sweep {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Sweep { parameter, from, to, .. } = self;
        let (name, unit) = (parameter.name(), parameter.unit());
        // As it was typed: the conversion from and to SI leaves some noise at the end.
        let typed = |value: f64| (1e9 * parameter.shown(value)).round() / 1e9;
        write!(f, "{name}={}{unit}..{}{unit}", typed(*from), typed(*to))?;
        self.count.map_or(Ok(()), |count| write!(f, ":{count}"))
    }
}

impl Sweep {
    /// Its values, SI, in order; as many as it says, or `count`, or, of fibres, every whole number.
    ///
    /// # Errors
    /// Fibres in parts.
    pub fn values(&self, count: usize) -> Result<Vec<f64>, String> {
        let whole = self.parameter.whole();
        let span = self.to - self.from;
        let count = match self.count {
            Some(count) => count,
            None if whole => span.abs() as usize + 1,
            None => count,
        };
        let values: Vec<f64> = (0..count).map(|i| self.from + span * i as f64 / (count - 1) as f64).collect();
        match values.iter().find(|value| whole && (value.fract() != 0.0 || **value < 0.0)) {
            Some(value) => Err(format!(
                "{self}: {value} {} cannot be built; FROM, TO and what lies between must be whole",
                self.parameter.name()
            )),
            None => Ok(values),
        }
    }
}

/// Every combination of the sweeps' values, the last sweep's running fastest.
///
/// # Errors
/// A parameter that is swept twice, fibres in parts.
pub fn combinations(base: Candidate, sweeps: &[Sweep], count: usize) -> Result<Vec<Candidate>, String> {
    let mut all = vec![base];
    for (i, sweep) in sweeps.iter().enumerate() {
        let name = sweep.parameter.name();
        if sweeps[..i].iter().any(|other| other.parameter == sweep.parameter) {
            return Err(format!("`{name}` is swept twice; sweep it once"));
        }
        let values = sweep.values(count)?;
        let of = |candidate: Candidate| values.iter().map(move |value| sweep.parameter.set(candidate, *value));
        all = all.into_iter().flat_map(of).collect();
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn base() -> Candidate {
        Candidate { tube: Tube::reference(1.0), spacing: None }
    }

    #[test]
    fn every_combination_is_there_once_the_last_sweep_fastest() {
        let sweeps: Vec<Sweep> =
            ["gamma=10deg..30deg:3", "fibers=4..6", "spacing=18mm..20mm:2"].map(|s| s.parse().unwrap()).into();
        let all = combinations(base(), &sweeps, 15).unwrap();
        assert_eq!(all.len(), 3 * 3 * 2);
        let key = |c: &Candidate| {
            (c.tube.gamma.to_degrees().round() as i32, c.tube.fibers, (1e3 * c.spacing.unwrap()).round() as i32)
        };
        assert_eq!(key(&all[0]), (10, 4, 18));
        assert_eq!(key(&all[1]), (10, 4, 20));
        assert_eq!(key(&all[2]), (10, 5, 18));
        assert_eq!(key(&all[17]), (30, 6, 20));
        let mut keys: Vec<_> = all.iter().map(key).collect();
        keys.dedup();
        assert_eq!(keys.len(), all.len());
    }

    #[test]
    fn a_sweep_reads_as_it_was_typed() {
        for text in ["gamma=-30deg..54.7356deg:3", "wall=0.7mm..0.9mm", "mu=0.35MPa..0.7MPa", "fibers=4..6"] {
            assert_eq!(text.parse::<Sweep>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn what_is_no_sweep_is_said() {
        for (text, said) in [
            ("gamma", "is no sweep"),
            ("gamma=10deg", "is no sweep"),
            ("gamma=10deg..20deg:x", "is no sweep"),
            ("gamma=10deg..20deg:1", "must be between 2 and 10000"),
            ("gamma=10deg..10deg", "goes nowhere"),
            ("gamma=10..20", "unit"),
            ("colour=1..2", "cannot be swept"),
            ("alpha=nan..2", "is no number"),
        ] {
            let error = text.parse::<Sweep>().unwrap_err();
            assert!(error.contains(said), "{text}: {error}");
        }
        let parts: Sweep = "fibers=4..6:4".parse().unwrap();
        assert!(parts.values(15).unwrap_err().contains("must be whole"));
        let twice = ["mu=0.2MPa..0.3MPa", "mu=0.4MPa..0.5MPa"].map(|s| s.parse::<Sweep>().unwrap());
        assert!(combinations(base(), &twice, 2).unwrap_err().contains("swept twice"));
    }
}

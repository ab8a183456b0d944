//! The rubber and the fibres, once for a batch, from files of tests: no rig is needed.
//!
//! E is the slope at rest of the tensile curves, mu = E/3 (the rubber is incompressible); alpha is what fits the
//! inflation of a bare tube best with that mu, the neo-Hookean and the linear law beside it; EA is the slope of a
//! fibre's force over its strain. Where only tension was tested, alpha is that of the tensile curves; where only
//! inflation was, mu and alpha are both the inflation's.

use serde::Serialize;

use super::{CalibrationError, Finding, FoundValue};
use crate::config::calibration::{Calibration, Entry, Key, keys};
use crate::config::material::{Material, Test};
use crate::fem::material::Law;
use crate::ident::Measured;
use crate::ident::material::{
    FiberFit, InflationError, InflationFit, LawFit, TensileError, TensileFit, fit_fiber, fit_inflation, fit_tensile,
    modulus_of_shore_a, shore_a_of_modulus,
};
use crate::record::material_sheet;
use crate::units::PASCAL_PER_PSI;

const MEGA: f64 = 1e6;
/// Gent's formula is right within so many units of hardness; beyond it the report says so.
const SHORE_TOLERANCE: f64 = 5.0;

/// A law as one of the tests has it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LawRow {
    /// `tension` or `inflation`.
    pub test: &'static str,
    /// `Ogden`, `neo-Hookean` or `linear`.
    pub law: &'static str,
    /// Shear modulus, MPa.
    pub shear_modulus_mpa: f64,
    /// Ogden's exponent; `null` for the laws that have none.
    pub ogden_exponent: Option<f64>,
    /// Root mean square deviation, Pa.
    pub rmsd_pa: f64,
    /// The same as a share of the measured range, per cent.
    pub rmsd_percent: f64,
}

/// Largest RMSD of Ogden's law as a share of the measured range: what is above it is another quantity, or another unit.
const RMSD_MAX: f64 = 0.15;

/// An inflation begins with the tube at rest: its least radius is at most so many times that.
const BEGIN_MAX: f64 = 1.3;
/// Half-width of a 95 % interval in standard uncertainties, where there are many degrees of freedom.
const NORMAL: f64 = 1.96;

/// What the tests of `material` say of the FREE of `calibration`, and the laws by their RMSD; `date` is today's.
///
/// # Errors
/// Where a test does not carry what it is for.
pub fn evaluate(
    material: &Material,
    calibration: &Calibration,
    date: &str,
) -> Result<(Finding, Vec<LawRow>), CalibrationError> {
    let tensile = tensile(material)?;
    let inflation = inflation(material, tensile.as_ref())?;
    let fiber = fiber(material)?;
    let sound = |fit: &LawFit, file: String| match fit.rmsd_share {
        share if share > RMSD_MAX => Err(CalibrationError::Material(format!(
            "{file}: even Ogden's law leaves {:.0} % of the range over (at most {:.0} % may be): are units, section, lengths \
             and the tube right?",
            100.0 * share,
            100.0 * RMSD_MAX
        ))),
        _ => Ok(()),
    };
    if let Some(fit) = &tensile {
        sound(&fit.ogden, files(&material.tensile))?;
    }
    if let (Some(fit), Some((test, ..))) = (&inflation, &material.inflation) {
        sound(&fit.ogden, test.file.display().to_string())?;
    }
    let mut batch = Batch { calibration: calibration.clone(), date, values: Vec::new() };
    if let Some(fit) = &tensile {
        let names = material.tensile.iter().map(Test::source).collect::<Vec<_>>().join(", ");
        let count = match fit.specimens {
            1 => "one specimen".to_owned(),
            n => format!("{n} specimens"),
        };
        batch.note("youngs_modulus_mpa", fit.youngs_modulus.times(1.0 / MEGA));
        let method = format!("E/3, E the slope at rest of the tensile curves of {count}");
        batch.enter(&keys::SHEAR_MODULUS, fit.shear_modulus.times(1.0 / MEGA), fit.ogden.rmsd / MEGA, &method, &names);
        if let (None, Some(alpha)) = (&inflation, fit.ogden.alpha) {
            let method = format!("least squares over the tensile curves of {count}");
            batch.enter(&keys::OGDEN_EXPONENT, alpha, fit.ogden.rmsd / MEGA, &method, &names);
        }
    }
    if let (Some(fit), Some((test, ..))) = (&inflation, &material.inflation) {
        let residual = fit.ogden.rmsd / PASCAL_PER_PSI;
        let source = test.source();
        if tensile.is_none() {
            let method = "least squares over the inflation of a bare tube, with alpha";
            batch.enter(&keys::SHEAR_MODULUS, fit.ogden.shear_modulus.times(1.0 / MEGA), residual, method, &source);
        }
        if let Some(alpha) = fit.ogden.alpha {
            let method = "least squares over the inflation of a bare tube; residual in psi";
            batch.enter(&keys::OGDEN_EXPONENT, alpha, residual, method, &source);
        }
    }
    if let (Some(fit), Some(test)) = (&fiber, &material.fiber) {
        let method = match fit.toe {
            None => "slope of force over strain of one fibre",
            Some(_) => "slope of force over strain of one fibre, beyond its slack",
        };
        batch.enter(&keys::FIBER_STIFFNESS, fit.stiffness, fit.residual, method, &test.source());
    }
    let laws = rows(tensile.as_ref(), inflation.as_ref());
    let hardness = tensile.as_ref().and_then(|fit| shore(&fit.youngs_modulus));
    if let Some(hardness) = hardness {
        batch.note("shore_a_estimate", hardness);
    }
    let remarks = remarks(material, tensile.as_ref(), hardness, &laws);
    let facts = facts(material, tensile.as_ref(), fiber.as_ref(), hardness, &laws);
    let title = format!("Material of {}", calibration.name);
    let fits = (tensile.as_ref(), inflation.as_ref(), fiber.as_ref());
    let mut sheet = material_sheet(&title, material, fits, facts);
    sheet.remarks.clone_from(&remarks);
    Ok((Finding { calibration: batch.calibration, values: batch.values, remarks, sheet }, laws))
}

/// The calibration while it is filled.
struct Batch<'a> {
    calibration: Calibration,
    date: &'a str,
    values: Vec<FoundValue>,
}

impl Batch<'_> {
    /// Enters `found`, in the unit of `key`, that came from the files `source`.
    fn enter(&mut self, key: &Key, found: Measured, residual: f64, method: &str, source: &str) {
        let found = widened(found);
        let before = self.calibration.entry(key).map(|entry| entry.value);
        let entry = Entry {
            value: found.value,
            standard_uncertainty: Some(found.uncertainty),
            method: method.to_owned(),
            residual: Some(residual),
            date: Some(self.date.to_owned()),
            run: Some(source.to_owned()),
            ..Entry::default()
        };
        self.calibration.set(key, entry);
        self.values.push(FoundValue { before, ..value(key.name, found) });
    }

    /// A value that has no place in the calibration.
    fn note(&mut self, key: &'static str, found: Measured) {
        self.values.push(value(key, widened(found)));
    }
}

/// With the standard uncertainty that stands for its 95 % interval: a calibration knows no degrees of freedom, and two
/// specimens that agree by chance are no better known than that.
fn widened(found: Measured) -> Measured {
    let (low, high) = found.interval();
    Measured { uncertainty: (high - low) / (2.0 * NORMAL), ..found }
}

fn value(key: &'static str, found: Measured) -> FoundValue {
    FoundValue { key, before: None, value: found.value, standard_uncertainty: found.uncertainty, prediction: None }
}

fn files<P>(tests: &[Test<P>]) -> String {
    tests.iter().map(|test| test.file.display().to_string()).collect::<Vec<_>>().join(", ")
}

fn unfit<P>(test: &Test<P>, line: Option<usize>, error: &dyn std::fmt::Display) -> CalibrationError {
    let line = line.map(|line| format!(":{line}")).unwrap_or_default();
    CalibrationError::Material(format!("{}{line}: {error}", test.file.display()))
}

fn tensile(material: &Material) -> Result<Option<TensileFit>, CalibrationError> {
    let curves: Vec<_> = material.tensile.iter().map(|test| test.points.clone()).collect();
    let Some(first) = material.tensile.first() else { return Ok(None) };
    fit_tensile(&curves).map(Some).map_err(|error| {
        let (specimen, index) = match error {
            TensileError::Point { specimen, index, .. } => (Some(specimen), Some(index)),
            TensileError::SmallStrain { specimen, .. } | TensileError::TooShort { specimen, .. } => {
                (Some(specimen), None)
            }
            _ => (None, None),
        };
        let test = specimen.and_then(|i| material.tensile.get(i)).unwrap_or(first);
        unfit(test, index.and_then(|i| test.lines.get(i).copied()), &error)
    })
}

fn inflation(material: &Material, tensile: Option<&TensileFit>) -> Result<Option<InflationFit>, CalibrationError> {
    let Some((test, tube, errors)) = &material.inflation else { return Ok(None) };
    let least = test.points.iter().map(|p| p.outer_radius).fold(f64::INFINITY, f64::min);
    let rest = tube.inner_radius + tube.wall;
    if least > BEGIN_MAX * rest {
        let (least, rest) = (1e3 * least, 1e3 * rest);
        let reason = format!(
            "the least outer radius is {least:.3} mm, that of the tube at rest {rest:.3} mm: is its unit right, and a \
             diameter called one?"
        );
        return Err(unfit(test, None, &reason));
    }
    let known = tensile.map(|fit| widened(fit.shear_modulus));
    fit_inflation(&test.points, tube, errors, known).map(Some).map_err(|error| {
        let line = match error {
            InflationError::NoEquilibrium { index, .. } => test.lines.get(index).copied(),
            _ => None,
        };
        unfit(test, line, &error)
    })
}

fn fiber(material: &Material) -> Result<Option<FiberFit>, CalibrationError> {
    let Some(test) = &material.fiber else { return Ok(None) };
    fit_fiber(&test.points).map(Some).map_err(|error| unfit(test, None, &error))
}

/// Shore A of E, with E's uncertainty.
fn shore(modulus: &Measured) -> Option<Measured> {
    let at = |e: f64| shore_a_of_modulus(e).ok();
    let value = at(modulus.value)?;
    let step = 1e-3 * modulus.value;
    let slope = (at(modulus.value + step)? - value) / step;
    Some(Measured { value, uncertainty: slope.abs() * modulus.uncertainty, ..*modulus })
}

fn rows(tensile: Option<&TensileFit>, inflation: Option<&InflationFit>) -> Vec<LawRow> {
    let row = |test, law, fit: &LawFit| LawRow {
        test,
        law,
        shear_modulus_mpa: match fit.law {
            Law::Ogden { mu, .. } | Law::NeoHookean { mu } | Law::Linear { mu } => mu / MEGA,
        },
        ogden_exponent: fit.alpha.map(|a| a.value),
        rmsd_pa: fit.rmsd,
        rmsd_percent: 100.0 * fit.rmsd_share,
    };
    let of = |test, ogden, neo, linear| {
        let mut rows = [row(test, "Ogden", ogden), row(test, "neo-Hookean", neo), row(test, "linear", linear)];
        rows.sort_by(|a, b| a.rmsd_pa.total_cmp(&b.rmsd_pa));
        rows
    };
    let tension = tensile.map(|f| of("tension", &f.ogden, &f.neo_hookean, &f.linear));
    let inflated = inflation.map(|f| of("inflation", &f.ogden, &f.neo_hookean, &f.linear));
    tension.into_iter().chain(inflated).flatten().collect()
}

fn remarks(
    material: &Material,
    tensile: Option<&TensileFit>,
    hardness: Option<Measured>,
    laws: &[LawRow],
) -> Vec<String> {
    let mut remarks = Vec::new();
    if tensile.is_some_and(|fit| fit.specimens == 1) {
        remarks.push("one specimen: how specimens differ is not in the uncertainty of E and mu".to_owned());
    }
    for test in ["tension", "inflation"] {
        let best = laws.iter().find(|row| row.test == test);
        if let Some(best) = best.filter(|best| best.law != "Ogden") {
            remarks.push(format!("in {test} the {} law fits better than Ogden's with mu = E/3", best.law));
        }
    }
    if let (Some(estimate), Some(measured)) = (hardness, material.shore_a)
        && (estimate.value - measured).abs() > SHORE_TOLERANCE
    {
        let modulus = modulus_of_shore_a(measured).map_or_else(|_| "-".into(), |e| format!("{:.3} MPa", e / MEGA));
        remarks.push(format!(
            "Shore A {measured:.1} was measured and {:.1} is what E says (Gent); {measured:.1} would be E = {modulus}: \
             another batch, a wrong section, or a wrong gauge length?",
            estimate.value
        ));
    }
    remarks
}

fn facts(
    material: &Material,
    tensile: Option<&TensileFit>,
    fiber: Option<&FiberFit>,
    hardness: Option<Measured>,
    laws: &[LawRow],
) -> Vec<(String, String)> {
    let mut facts = Vec::new();
    let mut fact = |name: &str, value: String| facts.push((name.to_owned(), value));
    if let Some(fit) = tensile {
        let mega =
            |m: &Measured| format!("{:.4} +- {:.4} MPa (standard uncertainty)", m.value / MEGA, m.uncertainty / MEGA);
        fact("E", mega(&widened(fit.youngs_modulus)));
        fact("mu = E/3", mega(&widened(fit.shear_modulus)));
        fact("tension", format!("{} points of {} specimens", fit.points, fit.specimens));
    }
    if let Some(shore) = hardness {
        let beside = material.shore_a.map_or(String::new(), |measured| format!("; measured: {measured:.1}"));
        fact("Shore A", format!("{:.1} +- {:.1} by Gent's formula{beside}", shore.value, shore.uncertainty));
    }
    for row in laws {
        let alpha = row.ogden_exponent.map_or(String::new(), |alpha| format!(", alpha {alpha:.3}"));
        let name = format!("{}: {}", row.test, row.law);
        let (rmsd, percent, mu) = (row.rmsd_pa / PASCAL_PER_PSI, row.rmsd_percent, row.shear_modulus_mpa);
        fact(&name, format!("RMSD {rmsd:.4} psi, {percent:.2} % of the range; mu {mu:.4} MPa{alpha}"));
    }
    if let Some(fit) = fiber {
        fact("EA of one fibre", format!("{:.1} +- {:.1} N", fit.stiffness.value, fit.stiffness.uncertainty));
        if let Some(toe) = &fit.toe {
            fact("its slack", format!("{:.2} % strain", 100.0 * toe.slack));
        }
    }
    let tests = material.tensile.iter().map(Test::source);
    let tests =
        tests.chain(material.inflation.iter().map(|t| t.0.source())).chain(material.fiber.iter().map(Test::source));
    fact("from", tests.collect::<Vec<_>>().join(", "));
    facts
}

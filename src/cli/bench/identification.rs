//! Ring-downs of FREEs that the fit does not know: errors, coverage, time; and the two plain methods beside it.

use serde_json::json;

use super::claim::claim;
use super::peer::{self, Peer};
use super::{Size, in_parallel, row, stopwatch};
use crate::cli::Failure;
use crate::ident::ringdown::{PlainDecay, curve_fit, log_decrement};
use crate::record::{BenchRow, BenchSuite, Claim, Timed};
use crate::sim::identification::{CYCLES, Errors, Study, record, trial};
use crate::sim::ringdown::{Plucked, Sensing};

const SUITE: &str = "identification";
/// Lengths of the records, cycles at most, and noise of the angles, deg, of the comparison.
const CASES: [(f64, f64); 5] = [(2.0, 0.05), (5.0, 0.05), (30.0, 0.01), (30.0, 0.05), (30.0, 0.2)];
/// The case in which scipy is compared.
const COMPARED: (f64, f64) = (30.0, 0.05);
/// Of so many FREEs of the study the comparison takes one.
const SHARE: u64 = 5;
/// Seeds of the sensor's noise in the study and in the comparison.
const SEEDS: (u64, u64) = (1000, 5000);
const METHODS: [&str; 3] = ["this fit", "log decrement", "curve fit"];

/// Runs the study, then the comparison.
pub(super) fn run(size: &Size<'_>) -> Result<BenchSuite, Failure> {
    let study = |seed| {
        let begun = stopwatch::thread_time();
        let found = trial(seed, &Sensing::imu(SEEDS.0 + seed), CYCLES);
        (found, stopwatch::thread_time() - begun)
    };
    let all = in_parallel("identification", "FREEs", size.count, study);
    let time = all.iter().map(|t| t.1).sum::<f64>() / all.len() as f64;
    let refused = all.iter().filter(|t| t.0.is_err()).count();
    let trials: Vec<_> = all.into_iter().filter_map(|t| t.0.ok()).collect();
    let Study { median, worst, coverage, count } = Study::of(&trials);
    let mut rows = Vec::new();
    for (name, pick) in PARAMETERS {
        let (middle, most) = (pick(&median), pick(&worst));
        for (what, error) in [("median", middle), ("worst", most)] {
            let error = (count > 0).then_some(error);
            rows.push(row(SUITE, METHODS[0], format!("{} FREEs, {name}, {what}", size.count), error, Some(time)));
        }
    }
    let percent = |x: f64| format!("{:.1} %", 100.0 * x);
    let mut facts = vec![
        ("FREEs".into(), format!("{} of 3 to 15 Hz, damping ratio 0.02 to 0.3; {refused} refused", size.count)),
        (
            "95 % intervals that hold the truth".into(),
            PARAMETERS.map(|(name, pick)| format!("{name} {}", percent(pick(&coverage)))).join(", "),
        ),
    ];
    let some = (size.count / SHARE).max(1);
    let mut own = Vec::new();
    let mut curves: Vec<_> = METHODS.iter().map(|m| ((*m).to_owned(), Vec::new(), Vec::new())).collect();
    for (cycles, noise) in CASES {
        let sensing = |seed| Sensing { noise: f64::to_radians(noise), ..Sensing::imu(SEEDS.1 + seed) };
        let label = format!("{cycles} cycles, {noise} deg");
        for (k, name) in METHODS.into_iter().enumerate() {
            let one = |seed| {
                let truth = Plucked::seeded(seed);
                let (times, angles) = record(&truth, &sensing(seed), cycles);
                let begun = stopwatch::thread_time();
                let of = |plain: PlainDecay| Errors::of_plain(&plain, &truth);
                let errors = match k {
                    0 => trial(seed, &sensing(seed), cycles).ok().map(|t| t.errors()),
                    1 => log_decrement(&times, &angles).ok().map(of),
                    _ => curve_fit(&times, &angles).ok().map(of),
                };
                (errors, stopwatch::thread_time() - begun)
            };
            let found = in_parallel(&label, "FREEs", some, one);
            let time = found.iter().map(|f| f.1).sum::<f64>() / some as f64;
            let good: Vec<Errors> = found.iter().filter_map(|f| f.0).collect();
            let median = Errors::median(&good);
            for (parameter, pick) in PARAMETERS {
                let case = format!("{label}, {parameter}, median of {some}");
                let error = (!good.is_empty()).then(|| pick(&median));
                rows.push(row(SUITE, name, case, error, Some(time)));
            }
            if (cycles, noise) == COMPARED && !good.is_empty() {
                own.push(Timed { who: format!("freerig, {name}"), error: median.damping, time_s: time });
            }
            if noise == 0.05 {
                curves[k].1.push(cycles);
                curves[k].2.push((100.0 * median.damping).max(f64::MIN_POSITIVE).log10());
            }
        }
    }
    let claims = beside(some, &own, &mut rows)?.into_iter().collect();
    facts.push(("time".into(), "processor time of one fit, mean of all".into()));
    Ok(BenchSuite {
        name: SUITE,
        title: "Identification by ring-down",
        facts,
        rows,
        claims,
        caption: "Median error of ct against the length of the record, at 0.05 deg of noise",
        x_label: "cycles, at most",
        y_label: "log10 of the error of ct in %",
        curves,
        ..BenchSuite::default()
    })
}

/// scipy's curve fit on the same records of [`COMPARED`], from the same start.
fn beside(count: u64, own: &[Timed], rows: &mut Vec<BenchRow>) -> Result<Option<Claim>, Failure> {
    let (cycles, noise) = COMPARED;
    let case = format!("{cycles} cycles, {noise} deg");
    let plucks: Vec<_> = (0..count)
        .filter_map(|seed| {
            let truth = Plucked::seeded(seed);
            let sensing = Sensing { noise: f64::to_radians(noise), ..Sensing::imu(SEEDS.1 + seed) };
            let (times, angles) = record(&truth, &sensing, cycles);
            let start = log_decrement(&times, &angles).ok()?;
            Some((truth, json!({ "times": times, "angles": angles, "decay": start.decay, "omega": start.omega })))
        })
        .collect();
    let task = json!({ "name": case, "plucks": plucks.iter().map(|p| &p.1).collect::<Vec<_>>() });
    match peer::ask(SUITE, ("scipy", "scipy curve_fit"), include_str!("peers/ringdown.py"), &task)? {
        Peer::None(row) => {
            rows.push(row);
            Ok(None)
        }
        Peer::Answers { name, answers } => {
            let of = |(answer, (truth, _)): (&peer::Answer, &(Plucked, _))| match answer.values[..] {
                [decay, omega] => Some((Errors::of_plain(&PlainDecay { decay, omega }, truth), answer.time_s?)),
                _ => None,
            };
            let found: Vec<_> = answers.iter().zip(&plucks).filter_map(of).collect();
            let errors: Vec<Errors> = found.iter().map(|f| f.0).collect();
            let time = found.iter().map(|f| f.1).sum::<f64>() / found.len().max(1) as f64;
            let median = Errors::median(&errors);
            for (parameter, pick) in PARAMETERS {
                let error = (!errors.is_empty()).then(|| pick(&median));
                rows.push(row(SUITE, &name, format!("{case}, {parameter}, median of {count}"), error, Some(time)));
            }
            let theirs = [Timed { who: name, error: median.damping, time_s: time }];
            // The same minimum to rounding, by either.
            Ok(claim(&format!("ct from a ring-down, {case}"), 1.001 * median.damping, own, &theirs))
        }
    }
}

/// The error of one parameter.
type Pick = fn(&Errors) -> f64;

/// What is identified.
const PARAMETERS: [(&str, Pick); 3] = [("kt", |e| e.stiffness), ("ct", |e| e.damping), ("f", |e| e.frequency)];

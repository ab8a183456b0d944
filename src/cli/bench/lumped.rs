//! Integrators of the lumped model against independent reference solutions: error against time over the step.

use std::time::Instant;

use anyhow::anyhow;

use super::{Size, row};
use crate::cli::{Failure, Progress};
use crate::config::gains::preset;
use crate::model::{Feedback, Free, Kinematics, Law, Load, Lumped, LumpedState};
use crate::record::BenchSuite;
use crate::trajectory::{Sequence, SequenceError, paper_steps, paper_trajectory};
use crate::units::PASCAL_PER_PSI;

const SUITE: &str = "lumped";
/// Steps per 10 ms.
const STEPS: [u32; 6] = [5, 10, 20, 40, 80, 160];
const METHODS: [(&str, Integrate); 2] = [("Radau IIA, order 5", radau), ("Runge-Kutta, order 4", runge_kutta)];

/// FREE, feedback, reference and what the reference solution says.
struct Case {
    name: &'static str,
    free: Free,
    feedback: Feedback,
    signal: Sequence,
    solution: &'static str,
}

type Integrate = fn(&Lumped, &Feedback, &mut LumpedState, &mut f64, &dyn Fn(f64) -> f64, f64) -> Option<()>;

/// Every integrator with every step on every reference solution.
pub(super) fn run(_: &Size<'_>) -> Result<BenchSuite, Failure> {
    let (cases, start) = (cases()?, Instant::now());
    let total = cases.len() * METHODS.len() * STEPS.len();
    let mut progress = Progress::new("lumped", total as f64, "runs");
    let (mut rows, mut curves, mut done) = (Vec::new(), Vec::new(), 0.0);
    for (n, case) in cases.iter().enumerate() {
        let rotations = rotations(case)?;
        for (method, integrate) in METHODS {
            let (mut x, mut y) = (Vec::new(), Vec::new());
            for steps in STEPS {
                let begun = Instant::now();
                let error = largest_error(case, &rotations, integrate, steps)?;
                let time = begun.elapsed().as_secs_f64();
                let name = format!("{}, step {:.4} ms", case.name, 10.0 / f64::from(steps));
                rows.push(row(SUITE, method, name, error, Some(time)));
                if let Some(error) = error {
                    x.push((1e3 * time).log10());
                    y.push(error.max(f64::MIN_POSITIVE).log10());
                }
                done += 1.0;
                progress.set(done, case.name);
            }
            // The published loop: stiff, and in its limits now and then.
            if n < 2 {
                curves.push((format!("{method}, {}", case.name), x, y));
            }
        }
    }
    Ok(BenchSuite {
        name: SUITE,
        title: "Integrators of the lumped model",
        facts: vec![
            ("reference solutions".into(), "independent of freerig, to 1e-8 rad".into()),
            ("error".into(), "largest of the rotation, over the largest rotation".into()),
            ("wall time".into(), format!("{:.1} s", start.elapsed().as_secs_f64())),
        ],
        rows,
        table: None,
        caption: "Error against time over the step",
        x_label: "log10 of the time in ms",
        y_label: "log10 of the relative error",
        curves,
    })
}

fn cases() -> Result<[Case; 5], Failure> {
    let limit = 10.0 * PASCAL_PER_PSI;
    let loop_of = |name: &str| -> Result<Feedback, Failure> {
        let gains = preset(name).ok_or_else(|| anyhow!("there are no gains `{name}`"))?;
        Ok(Feedback::pid(gains.proportional, gains.integral, gains.derivative, 0.0, limit))
    };
    let pressure = || -> Result<Sequence, SequenceError> { Sequence::constant(5.0 * PASCAL_PER_PSI, 1.0) };
    let (paper, published) = (Free::paper(), Free::published_code());
    Ok([
        Case {
            name: "published trajectory",
            free: published,
            feedback: loop_of("published-trajectory")?,
            signal: paper_trajectory()?,
            solution: include_str!("../../../tests/reference/lumped/published_trajectory_nonlinear.csv"),
        },
        Case {
            name: "paper trajectory",
            free: paper,
            feedback: loop_of("paper-pi")?,
            signal: paper_trajectory()?,
            solution: include_str!("../../../tests/reference/lumped/paper_trajectory_pi_nonlinear.csv"),
        },
        Case {
            name: "published steps",
            free: published,
            feedback: loop_of("published-step")?,
            signal: paper_steps()?,
            solution: include_str!("../../../tests/reference/lumped/published_step_nonlinear.csv"),
        },
        Case {
            name: "published, 5 psi",
            free: published,
            feedback: Feedback::open(),
            signal: pressure()?,
            solution: include_str!("../../../tests/reference/lumped/published_openloop_5psi_nonlinear.csv"),
        },
        Case {
            name: "paper, 5 psi",
            free: paper,
            feedback: Feedback::open(),
            signal: pressure()?,
            solution: include_str!("../../../tests/reference/lumped/paper_openloop_5psi_nonlinear.csv"),
        },
    ])
}

/// Time (s) and rotation (rad) of the reference solution.
fn rotations(case: &Case) -> Result<Vec<(f64, f64)>, Failure> {
    let field = |line: &str, k: usize| line.split(',').nth(k).and_then(|f| f.parse().ok());
    let line = |line: &str| {
        field(line, 0).zip(field(line, 2)).ok_or_else(|| anyhow!("{}: `{line}` is no line of a solution", case.name))
    };
    Ok(case.solution.lines().skip(1).map(line).collect::<Result<_, _>>()?)
}

/// Largest error of the rotation over its largest magnitude; `None` where the motion is lost. The FREE's own direction is
/// positive.
fn largest_error(
    case: &Case,
    solution: &[(f64, f64)],
    integrate: Integrate,
    steps: u32,
) -> Result<Option<f64>, Failure> {
    let model = Lumped::new(case.free, Law::Nonlinear(Kinematics::Published))?;
    let (mut state, mut integral) = (LumpedState::default(), 0.0);
    let size = solution.iter().fold(0.0, |m: f64, s| m.max(s.1.abs()));
    let mut worst = 0.0f64;
    for pair in solution.windows(2) {
        let span = pair[1].0 - pair[0].0;
        let parts = (span / 0.01 * f64::from(steps)).ceil().max(1.0);
        let h = span / parts;
        for k in 0..parts as u32 {
            let begin = pair[0].0 + f64::from(k) * h;
            // A jump at the end of a step belongs to the next.
            let signal = |t: f64| case.signal.at(begin + t.min(h * (1.0 - 1e-6))).0;
            if integrate(&model, &case.feedback, &mut state, &mut integral, &signal, h).is_none() {
                return Ok(None);
            }
        }
        worst = worst.max((state.rotation - pair[1].1).abs());
    }
    Ok((worst < size).then_some(worst / size))
}

fn radau(
    model: &Lumped,
    feedback: &Feedback,
    state: &mut LumpedState,
    integral: &mut f64,
    signal: &dyn Fn(f64) -> f64,
    h: f64,
) -> Option<()> {
    model.advance(state, integral, feedback, Load::default(), signal, h).ok()?;
    Some(())
}

/// The classical one, as a program without special care would have it.
fn runge_kutta(
    model: &Lumped,
    feedback: &Feedback,
    state: &mut LumpedState,
    integral: &mut f64,
    signal: &dyn Fn(f64) -> f64,
    h: f64,
) -> Option<()> {
    let x = [state.extension, state.rotation, state.extension_rate, state.rotation_rate, *integral];
    let state_of =
        |x: &[f64; 5]| LumpedState { extension: x[0], rotation: x[1], extension_rate: x[2], rotation_rate: x[3] };
    let slope = |x: [f64; 5], t: f64| -> Option<[f64; 5]> {
        let (state, wanted) = (state_of(&x), signal(t));
        let pressure = feedback.limited(feedback.command(wanted, &state, x[4]));
        let [s, phi] = model.acceleration(&state, pressure, Load::default()).ok()?;
        Some([x[2], x[3], s, phi, wanted - state.rotation])
    };
    let add = |k: &[f64; 5], by: f64| std::array::from_fn(|i| x[i] + by * k[i]);
    let k1 = slope(x, 0.0)?;
    let k2 = slope(add(&k1, 0.5 * h), 0.5 * h)?;
    let k3 = slope(add(&k2, 0.5 * h), 0.5 * h)?;
    let k4 = slope(add(&k3, h), h)?;
    let next: [f64; 5] = std::array::from_fn(|i| x[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]));
    next.iter().all(|v| v.is_finite()).then(|| (*state, *integral) = (state_of(&next), next[4]))
}

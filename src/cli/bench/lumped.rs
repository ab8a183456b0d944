//! Integrators of the lumped model against independent reference solutions: error against time over the step, beside
//! scipy's on the two trajectories.

use anyhow::anyhow;
use serde_json::json;

use super::claim::claim;
use super::peer::{self, Peer};
use super::{Size, row, stopwatch};
use crate::cli::{Failure, Progress};
use crate::config::gains::preset;
use crate::model::{Feedback, Free, Kinematics, Law, Load, Lumped, LumpedState};
use crate::record::{BenchRow, BenchSuite, Claim, Curve, Timed};
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

/// scipy's methods and relative tolerances: two explicit ones, two for stiff problems.
const PEERS: [&str; 4] = ["LSODA", "RK45", "DOP853", "Radau"];
const TOLERANCES: [f64; 2] = [1e-3, 1e-6];
/// Errors at which times are compared.
const LEVELS: [f64; 2] = [1e-4, 1e-6];
/// The cases that are trajectories in a loop, stiff and in their limits now and then: those are drawn and compared.
const TRAJECTORIES: usize = 2;
/// Angles, deg, and times, s, of the paper's trajectory.
const GOALS: [f64; 3] = [40.0, 10.0, 70.0];
const MOVE: f64 = 1.5;
const SLOT: f64 = 3.0;

type Integrate = fn(&Lumped, &Feedback, &mut LumpedState, &mut f64, &dyn Fn(f64) -> f64, f64) -> Option<()>;

/// Every integrator with every step on every reference solution.
pub(super) fn run(_: &Size<'_>) -> Result<BenchSuite, Failure> {
    let cases = cases()?;
    let total = cases.len() * METHODS.len() * STEPS.len();
    let mut progress = Progress::new("lumped", total as f64, "runs");
    let (mut rows, mut curves, mut own, mut done) = (Vec::new(), Vec::new(), Vec::new(), 0.0);
    for (n, case) in cases.iter().enumerate() {
        let rotations = rotations(case)?;
        let mut best = Vec::new();
        for (method, integrate) in METHODS {
            let mut found = Vec::new();
            for steps in STEPS {
                let begun = stopwatch::thread_time();
                let error = largest_error(case, &rotations, integrate, steps)?;
                let time_s = stopwatch::thread_time() - begun;
                let how = format!("step {:.4} ms", 10.0 / f64::from(steps));
                rows.push(row(SUITE, method, format!("{}, {how}", case.name), error, Some(time_s)));
                let who = format!("freerig, {method}, {how}");
                found.extend(error.map(|error| Timed { who, error, time_s }));
                done += 1.0;
                progress.set(done, case.name);
            }
            if n < TRAJECTORIES {
                curves.push(Timed::curve(format!("{method}, {}", case.name), &found));
            }
            best.extend(found);
        }
        own.push((rotations, best));
    }
    let claims = beside(&cases[..TRAJECTORIES], &own, &mut rows, &mut curves)?;
    Ok(BenchSuite {
        name: SUITE,
        title: "Integrators of the lumped model",
        facts: vec![
            ("reference solutions".into(), "independent of freerig, to 1e-8 rad".into()),
            ("error".into(), "largest of the rotation, over the largest rotation".into()),
            ("time".into(), "processor time of one run of the whole course".into()),
            (
                "failed".into(),
                format!(
                    "Runge-Kutta's motion is lost where a step is longer than it is stable with: {:.2} ms where the \
                     paper's FREE turns",
                    1e3 * longest_step(&Free::paper())
                ),
            ),
        ],
        rows,
        claims,
        caption: "Error against time over the step, of the two trajectories; the other cases are in the rows",
        x_label: "log10 of the time in ms",
        y_label: "log10 of the relative error",
        curves,
        ..BenchSuite::default()
    })
}

/// The longest step, s, with which Runge-Kutta of order 4 is stable in the rotation of `free`, which is overdamped: it
/// bears 2.785 times the time constant of the fastest decay.
fn longest_step(free: &Free) -> f64 {
    let (frequency, damping) = (free.natural_frequencies().1, free.damping_ratios().1);
    2.785 / (frequency * (damping + (damping * damping - 1.0).sqrt()))
}

/// What is known of a case's rotation, and how freerig did.
type Own = (Vec<(f64, f64)>, Vec<Timed>);

/// scipy on the trajectories `cases`.
fn beside(
    cases: &[Case],
    own: &[Own],
    rows: &mut Vec<BenchRow>,
    curves: &mut Vec<Curve>,
) -> Result<Vec<Claim>, Failure> {
    let Some((first, _)) = own.first() else { return Ok(Vec::new()) };
    let of = |case: &Case| {
        let f = &case.free;
        let free = json!({
            "gamma": f.gamma, "length": f.length, "radius": f.radius, "mass": f.mass, "inertia": f.inertia,
            "axial_stiffness": f.axial_stiffness, "torsional_stiffness": f.torsional_stiffness,
            "axial_damping": f.axial_damping, "torsional_damping": f.torsional_damping,
        });
        let Feedback { proportional, integral, high, .. } = case.feedback;
        json!({ "name": case.name, "free": free, "proportional": proportional, "integral": integral, "limit": high })
    };
    let task = json!({
        "times": first.iter().skip(1).map(|sample| sample.0).collect::<Vec<_>>(),
        "goals": GOALS.map(f64::to_radians), "move": MOVE, "slot": SLOT,
        "methods": PEERS, "tolerances": TOLERANCES, "cases": cases.iter().map(of).collect::<Vec<_>>(),
    });
    let (name, answers) = match peer::ask(SUITE, ("scipy", "scipy solve_ivp"), include_str!("peers/lumped.py"), &task)?
    {
        Peer::None(row) => {
            rows.push(row);
            return Ok(Vec::new());
        }
        Peer::Answers { name, answers } => (name, answers),
    };
    let mut claims = Vec::new();
    for (case, (known, own)) in cases.iter().zip(own) {
        let size = known.iter().fold(0.0, |m: f64, s| m.max(s.1.abs()));
        let mut theirs = Vec::new();
        for answer in answers.iter().filter(|answer| answer.task == case.name) {
            let off =
                known.iter().zip(&answer.values).fold(0.0, |m: f64, (known, found)| m.max((known.1 - found).abs()));
            let error = (answer.values.len() == known.len() && off < size).then_some(off / size);
            rows.push(answer.row(SUITE, &name, error));
            theirs.extend(answer.timed(&name, error));
        }
        for method in PEERS {
            let whose = format!("{name}, {method},");
            let found: Vec<Timed> = theirs.iter().filter(|t| t.who.starts_with(&whose)).cloned().collect();
            curves.push(Timed::curve(format!("{whose} {}", case.name), &found));
        }
        claims.extend(LEVELS.iter().filter_map(|level| claim(case.name, *level, own, &theirs)));
    }
    Ok(claims)
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

/// Largest error of the rotation over its largest magnitude; `None` where the motion is lost. The FREE's own direction
/// is positive.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runge_kutta_is_lost_with_steps_longer_than_it_is_stable_with() {
        let cases = cases().unwrap();
        let case = cases.iter().find(|case| case.name == "paper, 5 psi").unwrap();
        let rotations = rotations(case).unwrap();
        let limit = longest_step(&case.free);
        for steps in STEPS {
            let error = largest_error(case, &rotations, runge_kutta, steps).unwrap();
            assert_eq!(error.is_some(), 0.01 / f64::from(steps) < limit, "{steps}: {error:?}, {limit}");
        }
    }
}

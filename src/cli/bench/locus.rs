//! The root locus beside python-control's: the same loop, the same gains, how far the poles are apart.

use anyhow::anyhow;
use nalgebra::Complex;
use serde_json::json;

use super::peer::{self, Peer};
use super::{row, stopwatch};
use crate::cli::Failure;
use crate::control::root_locus::LocusLoop;
use crate::control::tune::Target;
use crate::model::Free;
use crate::record::{BenchRow, Claim, Timed};
use crate::sim::controlled::{pid, tuned};

const SUITE: &str = "control";
/// Factors on the gains.
const FACTORS: usize = 200;
/// From a hundredth of the tuned gains to ten times as much.
const RANGE: (f64, f64) = (0.01, 10.0);

/// The locus of the paper's FREE behind the bench's devices.
pub(super) fn beside(rows: &mut Vec<BenchRow>) -> Result<Option<Claim>, Failure> {
    let free = Free::paper();
    let control = pid(free, tuned(&free, &Target::PID)?);
    let channel = &control.frees[0];
    let imu = channel.imu.as_ref().ok_or_else(|| anyhow!("the bench's FREE has an IMU"))?;
    let (gains, lag) = (channel.gains, channel.regulator.lag.as_secs_f64());
    let locus = LocusLoop::new(&free, &gains, &channel.regulator, imu, control.period);
    let factors: Vec<f64> =
        (0..FACTORS).map(|i| RANGE.0 * (RANGE.1 / RANGE.0).powf(i as f64 / (FACTORS - 1) as f64)).collect();
    let (points, time_s) = stopwatch::best(|| Ok(locus.locus(&factors)))?;
    let seen = imu.delay.as_secs_f64() + 0.5 * (imu.period.as_secs_f64() - control.period.as_secs_f64());
    let task = json!({
        "radius": free.radius, "gamma": free.gamma, "inertia": free.inertia, "damping": free.torsional_damping,
        "stiffness": free.torsional_stiffness, "lag": lag, "seen": seen, "delay": locus.delay(),
        "proportional": gains.proportional, "integral": gains.integral, "derivative": gains.derivative,
        "filter": gains.derivative_filter, "factors": factors,
    });
    let case = format!("root locus, {FACTORS} gains");
    let (name, answers) = match peer::ask(SUITE, ("control", "python-control"), include_str!("peers/locus.py"), &task)?
    {
        Peer::None(missing) => {
            rows.push(BenchRow { failed: false, ..row(SUITE, "freerig", case, None, Some(time_s)) });
            rows.push(missing);
            return Ok(None);
        }
        Peer::Answers { name, answers } => (name, answers),
    };
    let Some(answer) = answers.first().filter(|answer| answer.failed.is_none()) else {
        rows.push(row(SUITE, &name, case, None, None));
        return Ok(None);
    };
    let theirs: Vec<_> = answer.values.chunks_exact(2).map(|z| Complex::new(z[0], z[1])).collect();
    let own: Vec<_> = points.iter().flat_map(|point| &point.extended).collect();
    let each = points.first().map_or(0, |point| point.extended.len());
    // Distance of each pole from the peer's nearest at the same gain, over its size.
    let error = (own.len() == theirs.len()).then(|| {
        let near = |(n, z): (usize, &&Complex<f64>)| {
            let first = n / each * each;
            let apart = theirs[first..first + each].iter().map(|other| (other - **z).norm());
            apart.fold(f64::INFINITY, f64::min) / z.norm()
        };
        own.iter().enumerate().map(near).fold(0.0, f64::max)
    });
    rows.push(row(SUITE, "freerig", format!("{case}, apart from python-control"), error, Some(time_s)));
    rows.push(row(SUITE, &name, format!("{case}, apart from freerig"), error, answer.time_s));
    Ok(error.zip(answer.time_s).map(|(error, theirs)| Claim {
        task: case,
        error,
        own: Timed { who: "freerig".into(), error, time_s },
        peer: Timed { who: name, error, time_s: theirs },
    }))
}

//! Readings of an IMU in a run, and the pages of what is made of them.

use nalgebra::{Quaternion, UnitQuaternion};

use super::plot::{Line, Plot};
use super::sheet::Sheet;
use super::{Result, Run, palette};
use crate::control::swing_twist::swing_twist;
use crate::ident::imu::{AxisFit, StillFit};
use crate::ident::pluck::{PluckFit, Reading, Release};
use crate::signal::ImuHealth;

/// One reading.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImuReading {
    /// When it was taken, s since the program's start.
    pub time: f64,
    /// Orientation, unit quaternion (w, x, y, z), sensor to world.
    pub quaternion: [f64; 4],
    /// Twist about the FREE's axis since the tare, rad, within half a turn.
    pub angle: f64,
    /// Rate about the FREE's axis, rad/s.
    pub rate: f64,
}

impl Run {
    /// Every good reading of the IMU of the FREE `subject` while the program ran, each once; `axis` is the FREE's in
    /// the sensor's frame.
    ///
    /// # Errors
    /// Where the samples cannot be read.
    pub fn imu_readings(&self, subject: usize, axis: [f64; 3]) -> Result<Vec<ImuReading>> {
        let unit = |[w, x, y, z]: [f64; 4]| UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let mut readings = Vec::new();
        let mut sequence = None;
        for (record, _) in self.records()? {
            let Some(free) = record.frees().get(subject).filter(|_| record.program_time.is_finite()) else { continue };
            let sample = &free.imu;
            let fresh = sequence != Some(sample.sequence) && sample.health == ImuHealth::Good;
            // The first one seen may have come before the program.
            if fresh && sequence.is_some() {
                let turned = (unit(free.estimate.tare).inverse() * unit(sample.quaternion)).into_inner();
                readings.push(ImuReading {
                    time: record.program_time - record.time.since(sample.time).as_secs_f64(),
                    quaternion: sample.quaternion,
                    angle: swing_twist([turned.w, turned.i, turned.j, turned.k], axis).0,
                    rate: sample.rate.iter().zip(axis).map(|(r, a)| r * a).sum(),
                });
            }
            sequence = Some(sample.sequence);
        }
        Ok(readings)
    }
}

/// The page of an IMU: at rest and while its FREE turned, with `facts` above the drawings.
pub fn imu_sheet(
    title: &str,
    (still, fit): (&[ImuReading], &StillFit),
    (turning, axis): (&[ImuReading], &AxisFit),
    simulated: bool,
    facts: Vec<(String, String)>,
) -> Sheet {
    let time: Vec<f64> = still.iter().map(|r| r.time).collect();
    let mean = still.iter().map(|r| r.angle).sum::<f64>() / still.len().max(1) as f64;
    let middle = time.iter().sum::<f64>() / time.len().max(1) as f64;
    let degrees = |of: fn(&ImuReading) -> f64, readings: &[ImuReading]| -> Vec<f64> {
        readings.iter().map(|r| of(r).to_degrees()).collect()
    };
    let drift = time.iter().map(|t| (mean + fit.drift.value * (t - middle)).to_degrees()).collect();
    let at_rest = vec![
        Line::new("angle", palette::BLUE, &time, degrees(|r| r.angle, still)).width(1),
        Line::new("drift", palette::ORANGE, &time, drift).dashed(),
    ];
    let turned: Vec<f64> = turning.iter().map(|r| r.time).collect();
    let found = turning.iter().map(|r| about(turning, r, axis.axis).to_degrees()).collect();
    let while_turning = vec![
        Line::new("about the axis in rig.toml", palette::BLUE, &turned, degrees(|r| r.angle, turning)),
        Line::new("about the axis that was found", palette::ORANGE, &turned, found).dashed(),
    ];
    let plot = |y_label: &str, lines| Plot {
        x_label: "time (s)".into(),
        y_label: y_label.into(),
        height: 300,
        lines,
        ..Plot::default()
    };
    let rates = vec![Line::new("rate", palette::BLUE, &time, degrees(|r| r.rate, still)).width(1)];
    Sheet {
        title: title.into(),
        simulated,
        facts,
        figures: vec![
            ("Left alone: the angle".into(), plot("angle (deg)", at_rest)),
            ("Left alone: the gyro".into(), plot("rate (deg/s)", rates)),
            ("Under a gentle pressure".into(), plot("angle (deg)", while_turning)),
        ],
        ..Sheet::default()
    }
}

/// Twist of `reading` about `axis` since the first of `all`, rad.
fn about(all: &[ImuReading], reading: &ImuReading, axis: [f64; 3]) -> f64 {
    let unit = |[w, x, y, z]: [f64; 4]| UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let turned = (unit(all[0].quaternion).inverse() * unit(reading.quaternion)).into_inner();
    swing_twist([turned.w, turned.i, turned.j, turned.k], axis).0
}

/// One record of plucks: its title, its readings, where the end moved alone, and the fit.
pub type Plucked<'a> = (String, &'a [Reading], &'a [Release], &'a PluckFit);

/// The page of a damping, with `facts` above the drawings.
pub fn damping_sheet(title: &str, records: &[Plucked], simulated: bool, facts: Vec<(String, String)>) -> Sheet {
    let mut figures = Vec::new();
    for (name, record, releases, fit) in records {
        let time: Vec<f64> = record.iter().map(|r| r.time).collect();
        let angle = record.iter().map(|r| r.angle.to_degrees()).collect();
        let mut lines = vec![Line::new("angle", palette::GREY, &time, angle).width(1)];
        for (n, release) in releases.iter().enumerate() {
            let alone = &record[release.first..release.end];
            let (time, angle): (Vec<f64>, Vec<f64>) = alone.iter().map(|r| (r.time, r.angle.to_degrees())).unzip();
            lines.push(Line::new(if n == 0 { "let go" } else { "" }, palette::BLUE, &time, angle));
        }
        let plot = |y_label: &str, height, lines| Plot {
            x_label: "time (s)".into(),
            y_label: y_label.into(),
            height,
            lines,
            ..Plot::default()
        };
        figures.push((format!("{name}: the record"), plot("angle (deg)", 320, lines)));
        // The widest release is as good as any to look at.
        let widest = releases.iter().max_by(|a, b| a.turn.abs().total_cmp(&b.turn.abs()));
        let Some(widest) = widest else { continue };
        let (from, to) = (record[widest.first].time, record[widest.end - 1].time);
        let seen: Vec<_> = fit.balance.iter().filter(|(t, ..)| *t >= from && *t <= to).collect();
        let time: Vec<f64> = seen.iter().map(|(t, ..)| *t).collect();
        let asked = seen.iter().map(|(_, _, asked)| asked.to_degrees()).collect();
        let fitted = seen.iter().map(|(_, fitted, _)| fitted.to_degrees()).collect();
        let lines = vec![
            Line::new("inertia and damper", palette::BLUE, &time, asked),
            Line::new("spring and friction", palette::ORANGE, &time, fitted).dashed(),
        ];
        figures.push((format!("{name}: moments over kt after the widest turn"), plot("moment / kt (deg)", 300, lines)));
    }
    Sheet { title: title.into(), simulated, facts, figures, ..Sheet::default() }
}

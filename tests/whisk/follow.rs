//! The plate led along its path, on modules that are not the model's.

use std::sync::Arc;

use freerig::config::{Rig, Whisk};
use freerig::daemon::experiment::{Attendance, Job, Progress, run};
use freerig::daemon::{Bench, PoseDesk, Stepped, procedure};
use freerig::record::{Apart, Run, TipPath};
use freerig::units::PASCAL_PER_PSI as PSI;

use crate::harness::{WIDTH, parse, plan, rig};

/// Runs `whisk`; `watch` sees every look at the rig.
fn carry_out(
    rig: &Rig,
    whisk: &Whisk,
    open_loop: bool,
    poses: &Arc<PoseDesk>,
    watch: &mut dyn FnMut(&Progress<'_>),
) -> Run {
    let experiment = parse(&whisk.to_toml(&[]), rig).unwrap();
    let mut bench = Stepped::new(rig).unwrap();
    procedure::arm(&mut bench, rig, false).unwrap();
    let job = Job { stepped: true, open_loop, poses: Arc::clone(poses), ..Job::new(experiment, Attendance::Here) };
    run(&mut bench, rig, &job, watch).unwrap().remove(0)
}

#[test]
fn explore() {
    let seeds: Vec<u64> =
        std::env::var("SEEDS").unwrap_or("1,2,3".into()).split(',').map(|s| s.parse().unwrap()).collect();
    let payload = std::env::var("PAYLOAD").unwrap_or("0".into());
    let tracker = std::env::var("TRACKER").is_ok();
    for seed in seeds {
        let (_folder, rig) = rig(&[
            ("seed = 1", &format!("seed = {seed}")),
            ("damping_percent = 20", &format!("payload_g = {payload}\ndamping_percent = 20")),
        ]);
        let whisk = plan(&rig, 3);
        for open in [true, false] {
            let begun = std::time::Instant::now();
            let poses = Arc::default();
            let _ = tracker;
            let run = carry_out(&rig, &whisk, open, &poses, &mut |_| {});
            let took = begun.elapsed().as_secs_f64();
            let path = TipPath::of(&run).unwrap().unwrap();
            let part = |from: f64, to: f64| {
                let pick = |p: &[Option<nalgebra::Vector3<f64>>]| {
                    path.t.iter().zip(p).filter(|(t, _)| **t >= from && **t < to).map(|(_, p)| *p).collect::<Vec<_>>()
                };
                let e = Apart::between(&pick(&path.truth), &pick(&path.planned)).unwrap();
                let est = Apart::between(&pick(&path.truth), &pick(&path.estimated));
                (e.rms * 1e3, e.peak * 1e3, est.map(|e| e.rms * 1e3))
            };
            println!(
                "seed {seed} payload {payload} open {open}: all {:.3?} periods {:.3?} {:.3?} {:.3?} {} {took:.0} s",
                part(2.0, 14.0),
                part(2.0, 6.0),
                part(6.0, 10.0),
                part(10.0, 14.0),
                run.result_name()
            );
            if !open {
                let text = std::fs::read_to_string(run.folder.join("tip.csv")).unwrap();
                let last = text.lines().last().unwrap();
                println!("   {last}");
                let _ = std::fs::copy(run.folder.join("tip.csv"), format!("/tmp/tip-{seed}.csv"));
            }
            let mean: Vec<_> = path.truth.iter().zip(&path.planned).filter_map(|(a, b)| Some((*a)? - (*b)?)).collect();
            let m = mean.iter().sum::<nalgebra::Vector3<f64>>() / mean.len() as f64 * 1e3;
            println!("   mean off {:.3} {:.3} {:.3} mm", m.x, m.y, m.z);
        }
        let _ = (WIDTH, PSI);
        let _ = |b: &mut Stepped| b.latest();
    }
}

//! `report.html`: one page, self-contained (plots inline, no script), to be read, printed and mailed.

use std::path::PathBuf;

use super::document::{RunKind, StartDocument, StopDocument};
use super::html::{Page, degrees, escape, prose};
use super::metrics::{ErrorMetrics, FreeMetrics, Metrics, ON_THE_WAY, TipMetrics};
use super::module::TipPath;
use super::plot::Plot;
use super::recorded::Recorded;
use super::run::{REPORT_NAME, Run, write_atomically};
use super::signals::Signals;
use super::{Result, figures, prediction};
use crate::signal::Quantity;
use crate::units::PASCAL_PER_PSI;

/// Share of a report's making that its first reading of the samples takes.
const READING: f64 = 0.4;

/// Makes the report of `run` in its folder; returns where it is, and its figures. `watch` is told how far it is, 0 to
/// 1.
///
/// # Errors
/// Where the samples cannot be read or the file cannot be written.
pub fn write_report(run: &Run, watch: &mut dyn FnMut(f64)) -> Result<(PathBuf, Metrics)> {
    let path = run.folder.join(REPORT_NAME);
    let (html, metrics) = html(run, watch)?;
    write_atomically(&path, html.as_bytes())?;
    Ok((path, metrics))
}

/// The report of `run` as HTML, and its figures.
fn html(run: &Run, watch: &mut dyn FnMut(f64)) -> Result<(String, Metrics)> {
    let start = run.start();
    let recorded = Recorded::of(run, &mut |share| watch(READING * share))?;
    let signals = &recorded.frees;
    let mut predictions = Vec::new();
    for (index, signals) in signals.iter().enumerate() {
        predictions.push(prediction::dynamic(signals));
        watch(READING + (0.7 - READING) * (index + 1) as f64 / recorded.frees.len() as f64);
    }
    let tip = TipPath::of(run)?;
    let metrics = Metrics::from(run, &recorded, &predictions, tip.as_ref());

    let title = heading(start);
    let mut page = Page::new(&title);
    page.raw("<header>");
    page.raw(&format!("<h1>{}</h1><p class=\"badges\">", escape(&title)));
    if start.simulated() {
        page.badge("simulated", "SIMULATED");
    }
    page.badge(run.result_name(), run.result_name());
    if !run.is_complete() {
        page.raw("</p><p class=\"warning\">This run has no stop document: it is under way or was cut off. What is shown was recorded up to then.");
    }
    page.raw("</p>");
    if let Some(stop) = run.stop().filter(|s| !s.message.is_empty()) {
        page.raw(&format!("<p class=\"warning\">{}</p>", prose(&ending(stop, signals))));
    }
    if !start.note.is_empty() {
        page.raw(&format!("<p class=\"note\">{}</p>", escape(&start.note)));
    }
    if let Some(remark) = recorded.remark() {
        page.raw(&format!("<p class=\"warning\">{}</p>", escape(&remark)));
    }
    page.raw("</header><main>");

    if let Some(path) = &tip {
        tip_section(&mut page, path, metrics.tip, start)?;
    }
    for ((signals, prediction), metrics) in signals.iter().zip(&predictions).zip(&metrics.frees) {
        free_section(&mut page, run, signals, prediction, metrics)?;
    }
    watch(0.8);
    repeats(&mut page, run)?;
    page.raw("<section><h2>States, faults, limits</h2>");
    if let Some(first) = signals.first() {
        page.raw(&figures::timeline(run, first)?.svg()?);
    }
    watch(0.9);
    faults(&mut page, run.stop(), signals);
    page.raw("</section><section><h2>Loop</h2>");
    loop_table(&mut page, run, &metrics);
    if !start.stepped {
        page.figure("Ticks by their timing", &figures::latency(run)?.svg()?);
    }
    page.raw("</section><section><h2>What ran</h2>");
    provenance(&mut page, run);
    page.raw("</section></main><footer>");
    page.raw(&format!(
        "<p>Errors are reference - angle while the program ran; the angle is the estimate that the controller acts on. \
         Settling: until within 2 % of the move for the rest of the hold. Steady error: mean over the last fifth of \
         the hold. RMSD: RMS of angle - model over the range of the {}. freerig {}.</p>",
        if start.kind == RunKind::Sweep { "angle" } else { "reference" },
        escape(&start.freerig_version)
    ));
    page.raw("</footer>");
    Ok((page.end(), metrics))
}

fn heading(start: &StartDocument) -> String {
    let what = start.name();
    if start.subject.is_empty() { what.into() } else { format!("{what} - {}", start.subject) }
}

/// Why the run ended, and when the fault was seen that ended it.
fn ending(stop: &StopDocument, signals: &[Signals]) -> String {
    let seen = stop.faults.iter().find(|f| f.latched).map(|f| {
        let at = signals.first().map_or(f.t_s, |s| s.since_program(f.t_s));
        format!(" First seen: {} of {} at {at:.3} s.", f.name, f.free.as_deref().unwrap_or("the rig"))
    });
    format!("{}{}", stop.message, seen.unwrap_or_default())
}

/// The way of a module's plate.
fn tip_section(page: &mut Page, path: &TipPath, metrics: Option<TipMetrics>, start: &StartDocument) -> Result<()> {
    page.raw("<section><h2>Plate</h2><div class=\"cards\">");
    let mm = |m: f64| format!("{:.3} mm", 1e3 * m);
    if let Some(whisk) = &start.whisk {
        page.card("path", if whisk.closed_loop { "followed in closed loop" } else { "as planned, open loop" });
    }
    if let Some(TipMetrics { estimated, truth }) = metrics {
        page.card("RMS error, estimated", &mm(estimated.rms));
        page.card("peak error, estimated", &mm(estimated.peak));
        if let Some(truth) = truth.filter(|_| start.simulated()) {
            page.card("RMS error, true (SIMULATED)", &mm(truth.rms));
            page.card("peak error, true (SIMULATED)", &mm(truth.peak));
        }
    }
    page.raw("</div>");
    if path.is_thinned() {
        page.raw(&format!(
            "<p class=\"warning\">A long run: the plate's way is looked at every {:.2} s.</p>",
            path.step
        ));
    }
    page.figure("Way of the plate's centre, from above", &figures::tip_from_above(path).svg()?);
    page.figure("The same over time", &figures::tip_over_time(path).svg()?);
    page.raw("</section>");
    Ok(())
}

fn free_section(
    page: &mut Page,
    run: &Run,
    signals: &Signals,
    prediction: &std::result::Result<Vec<f64>, String>,
    metrics: &FreeMetrics,
) -> Result<()> {
    let simulated = run.start().simulated();
    page.raw(&format!("<section><h2>{}</h2>", escape(&signals.name)));
    let model = prediction.as_ref().ok().map(Vec::as_slice);
    figures_table(page, metrics, simulated);
    if let Some(reason) = &metrics.model_refusal {
        page.raw(&format!("<p class=\"warning\">No comparison with the model: {}</p>", escape(reason)));
    }
    if signals.quantity == Quantity::Pressure && !signals.in_module {
        page.figure("Twist against pressure", &figures::sweep(signals).svg()?);
    }
    let marked = |plot: Plot| Plot { marks: figures::marks(run, signals), ..plot }.svg();
    page.figure("Response", &marked(figures::response(signals, model))?);
    if let Some(table) = &signals.temperatures {
        page.figure("What the knob sets", &marked(figures::temperature(signals, table))?);
    }
    // Pressures that were commanded, without a model to compare with, have none.
    let error = figures::error(signals, model);
    if !error.lines.is_empty() {
        page.figure("Error", &marked(error)?);
    }
    page.figure("Pressure", &marked(figures::pressure(signals))?);
    if signals.quantity == Quantity::Angle {
        page.figure("Controller's terms", &marked(figures::terms(signals))?);
        moves_table(page, metrics);
    }
    page.raw("</section>");
    Ok(())
}

fn figures_table(page: &mut Page, metrics: &FreeMetrics, simulated: bool) {
    page.raw("<div class=\"cards\">");
    if let Some(ErrorMetrics { rms_rad, peak_rad, final_rad }) = metrics.error {
        page.card("RMS error", &degrees(rms_rad));
        page.card("peak error", &degrees(peak_rad));
        page.card("final error", &degrees(final_rad));
    }
    if let (Some(rad), Some(percent)) = (metrics.model_rmsd_rad, metrics.model_rmsd_percent) {
        page.card("RMSD to the model", &format!("{percent:.2} % <small>{}</small>", degrees(rad)));
    }
    let moving = if metrics.on_the_way { format!(", {ON_THE_WAY}") } else { String::new() };
    if let (Some(rad), Some(percent)) = (metrics.rest_rmsd_rad, metrics.rest_rmsd_percent) {
        page.card("RMSD to the model at rest", &format!("{percent:.2} % <small>{}{moving}</small>", degrees(rad)));
    }
    if let (Some(rad), Some(percent)) = (metrics.hysteresis_rad, metrics.hysteresis_percent) {
        page.card("hysteresis", &format!("{percent:.2} % <small>{}{moving}</small>", degrees(rad)));
    }
    if let Some(pressure) = metrics.highest_pressure_pa {
        page.card("highest pressure", &format!("{:.2} psi", pressure / PASCAL_PER_PSI));
    }
    if let Some(truth) = metrics.true_error.filter(|_| simulated) {
        page.card("RMS error of the true angle (SIMULATED)", &degrees(truth.rms_rad));
        page.card("its peak (SIMULATED)", &degrees(truth.peak_rad));
    }
    page.raw("</div>");
}

fn moves_table(page: &mut Page, metrics: &FreeMetrics) {
    if metrics.moves.is_empty() {
        return;
    }
    page.raw("<table><caption>Moves</caption><thead><tr><th>at</th><th>from</th><th>to</th><th>overshoot</th>");
    page.raw("<th>settling</th><th>steady error</th></tr></thead><tbody>");
    for m in &metrics.moves {
        let settling = m.settling_s.map_or("does not settle".into(), |s| format!("{s:.3} s"));
        page.raw(&format!(
            "<tr><td>{:.2} s</td><td>{}</td><td>{}</td><td>{:.2} % <small>{}</small></td>\
             <td>{settling}</td><td>{}</td></tr>",
            m.start_s,
            degrees(m.from_rad),
            degrees(m.to_rad),
            m.overshoot_percent,
            degrees(m.overshoot_rad),
            degrees(m.steady_error_rad),
        ));
    }
    page.raw("</tbody></table>");
}

/// Mean and scatter over the runs of a `--repeat` group, as far as they have been run.
fn repeats(page: &mut Page, run: &Run) -> Result<()> {
    let group = group_of(run)?;
    if group.len() < 2 {
        return Ok(());
    }
    page.raw(&format!("<section><h2>{} repetitions</h2>", group.len()));
    let mut signals: Vec<Signals> = Vec::new();
    let mut metrics: Vec<Metrics> = Vec::new();
    for run in &group {
        let Ok(recorded) = Recorded::of(run, &mut |_| {}) else { continue };
        let predictions: Vec<_> = recorded.frees.iter().map(prediction::dynamic).collect();
        metrics.push(Metrics::from(run, &recorded, &predictions, None));
        signals.extend(recorded.frees.into_iter().next());
    }
    let of = |pick: &dyn Fn(&FreeMetrics) -> Option<f64>| -> Vec<f64> {
        metrics.iter().filter_map(|m| pick(m.frees.first()?)).collect()
    };
    page.raw("<div class=\"cards\">");
    let degrees = 180.0 / std::f64::consts::PI;
    let rows: [(&str, Vec<f64>, f64, &str); 4] = [
        ("RMS error", of(&|m| Some(m.error?.rms_rad)), degrees, "&deg;"),
        ("peak error", of(&|m| Some(m.error?.peak_rad)), degrees, "&deg;"),
        ("RMSD to the model", of(&|m| m.model_rmsd_percent), 1.0, " %"),
        ("hysteresis", of(&|m| m.hysteresis_percent), 1.0, " %"),
    ];
    for (name, values, scale, unit) in rows {
        if let Some((mean, scatter)) = mean_and_scatter(&values) {
            page.card(name, &format!("{:.3}{unit} <small>&plusmn; {:.3}{unit}</small>", mean * scale, scatter * scale));
        }
    }
    page.raw("</div>");
    let (mean, apart) = figures::repeats(&signals);
    page.figure("Response", &mean.svg()?);
    page.figure("Scatter", &apart.svg()?);
    page.raw("</section>");
    Ok(())
}

/// The runs of the same group, in the order of their repetition; only `run` where it has none.
pub(super) fn group_of(run: &Run) -> Result<Vec<Run>> {
    let Some(own) = &run.start().repetition else { return Ok(vec![run.clone()]) };
    let own = if own.group.is_empty() { run.id() } else { &own.group };
    let Some(runs) = run.folder.parent() else { return Ok(vec![run.clone()]) };
    let mut group: Vec<Run> = Run::list(runs)?
        .into_iter()
        .flatten()
        .filter(|r| r.id() == own || r.start().repetition.as_ref().is_some_and(|x| x.group == own))
        .collect();
    group.sort_by_key(|r| r.start().repetition.as_ref().map_or(0, |x| x.index));
    Ok(group)
}

/// Mean and sample standard deviation; `None` without values.
pub fn mean_and_scatter(values: &[f64]) -> Option<(f64, f64)> {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let sum: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (!values.is_empty()).then(|| (mean, (sum / (n - 1.0).max(1.0)).sqrt()))
}

fn faults(page: &mut Page, stop: Option<&StopDocument>, signals: &[Signals]) {
    let Some(stop) = stop else { return };
    if !stop.limits_seen.is_empty() {
        page.raw(&format!("<p>Limits in force at some time: {}.</p>", escape(&stop.limits_seen.join(", "))));
    }
    if stop.faults.is_empty() {
        page.raw("<p>No fault was seen.</p>");
        return;
    }
    page.raw("<table><caption>First time that each fault was seen</caption><thead><tr><th>at</th><th class=\"text\">fault</th>");
    page.raw("<th class=\"text\">FREE</th><th class=\"text\">latched</th><th class=\"text\">condition and remedy</th></tr></thead><tbody>");
    for f in &stop.faults {
        page.raw(&format!(
            "<tr><td>{:.3} s</td><td class=\"text\">{} <small>{}</small></td><td class=\"text\">{}</td>\
             <td class=\"text\">{}</td><td class=\"text\">{}</td></tr>",
            signals.first().map_or(f.t_s, |s| s.since_program(f.t_s)),
            escape(&f.name),
            f.code,
            escape(f.free.as_deref().unwrap_or("rig")),
            if f.latched { "yes" } else { "no" },
            prose(&f.message)
        ));
    }
    page.raw("</tbody></table>");
}

fn loop_table(page: &mut Page, run: &Run, metrics: &Metrics) {
    page.raw("<div class=\"cards\">");
    page.card("records", &metrics.records.to_string());
    page.card("deadline misses", &metrics.deadline_misses.to_string());
    if let Some(stop) = run.stop() {
        page.card("records lost", &stop.lost_records.to_string());
    }
    if let Some(stop) = run.stop().filter(|_| !run.start().stepped) {
        let l = &stop.loop_statistics;
        page.card("wake-up p50, p99, max", &micros([l.latency_p50_us, l.latency_p99_us, l.latency_max_us]));
        page.card("execution p50, p99, max", &micros([l.execution_p50_us, l.execution_p99_us, l.execution_max_us]));
    }
    page.raw("</div>");
    if run.start().stepped {
        page.raw("<p>On the stepped clock every tick comes at its very time: there is no timing to report.</p>");
    }
}

fn micros(values: [f64; 3]) -> String {
    values.map(|v| if v < 10.0 { format!("{v:.1}") } else { format!("{v:.0}") }).join(", ") + " &micro;s"
}

fn provenance(page: &mut Page, run: &Run) {
    let start = run.start();
    page.raw("<table class=\"facts\"><tbody>");
    page.fact("run", run.id());
    page.fact("experiment", start.kind.name());
    page.fact("started", &start.started);
    if let Some(stop) = run.stop() {
        page.fact("duration", &format!("{:.3} s", stop.duration_s));
    }
    if let Some(r) = &start.repetition {
        page.fact("repetition", &format!("{} of {}", r.index, r.of));
    }
    let clock = if start.stepped { ", stepped clock" } else { ", real time" };
    let backend = if start.simulated() { "SIMULATED devices and plant" } else { "devices on this machine's buses" };
    let seed = start.seed.map_or(String::new(), |s| format!(", seed {s}"));
    page.fact("rig", &format!("{backend}{clock}{seed}"));
    page.fact("tick", &format!("{:.3} ms ({:.0} Hz)", start.tick_period_s * 1e3, 1.0 / start.tick_period_s));
    let rights = match (start.stepped, start.realtime.granted, start.realtime.detail.as_str()) {
        (true, ..) => "none needed on the stepped clock".into(),
        (_, true, detail) => format!("granted {detail}"),
        (_, false, detail) => format!("not granted {detail}"),
    };
    page.fact("real-time rights", rights.trim());
    for free in &start.frees {
        let g = &free.gains;
        let preset = if free.preset.is_empty() { String::new() } else { format!(" ({})", free.preset) };
        page.fact(
            &format!("gains of {}", free.name),
            &format!(
                "Kp {:.0} Pa/rad, Ki {:.0} Pa/(rad s), Kd {:.0} Pa s/rad{preset}",
                g.proportional_pa_per_rad, g.integral_pa_per_rad_s, g.derivative_pa_s_per_rad
            ),
        );
        let m = &free.model;
        page.fact(
            &format!("model of {}", free.name),
            &format!(
                "winding angle {:.1} deg, length {:.0} mm, fibre radius {:.2} mm, kt {} N m/rad, ke {} N/m, ct {} N m s/rad",
                m.gamma_rad.to_degrees(),
                m.length_m * 1e3,
                m.radius_m * 1e3,
                m.torsional_stiffness_nm_per_rad,
                m.axial_stiffness_n_per_m,
                m.torsional_damping_nms_per_rad
            ),
        );
        if !free.calibration_sha256.is_empty() {
            page.fact(&format!("calibration of {}", free.name), &format!("sha256 {}", free.calibration_sha256));
        }
    }
    if !start.rig_sha256.is_empty() {
        page.fact("rig.toml", &format!("sha256 {}", start.rig_sha256));
    }
    page.fact("software", &format!("freerig {} on {} ({})", start.freerig_version, start.host, start.kernel));
    page.raw("</tbody></table>");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scatter_is_the_sample_standard_deviation() {
        assert_eq!(mean_and_scatter(&[]), None);
        assert_eq!(mean_and_scatter(&[3.0]), Some((3.0, 0.0)));
        let (mean, scatter) = mean_and_scatter(&[1.0, 2.0, 3.0]).unwrap();
        assert!((mean - 2.0).abs() < 1e-12 && (scatter - 1.0).abs() < 1e-12);
    }
}

//! rerun: a run's batches as columns of scalars, states, events and a drawing.
//!
//! Timelines: `t`, the time since the run's start, and `tick`. In the units of the bench: degrees and psi.

use std::path::Path;
use std::time::Duration;

use arrow::array::{AsArray, RecordBatch};
use arrow::compute::concat_batches;
use arrow::datatypes::{UInt8Type, UInt32Type, UInt64Type};
use rerun::{
    Color, LineStrips3D, Mesh3D, Points3D, RecordingStream, RecordingStreamBuilder, Scalars, SeriesLines, StateChange,
    StateConfiguration, TextDocument, TextLog, TextLogLevel, TimeColumn, Transform3D, ViewCoordinates,
};

use super::columns::{column_name, limit_names, state_of};
use super::document::StartDocument;
use super::lanes::state_color;
use super::run::RRD_NAME;
use super::samples::floats;
use super::shape::{self, Pose};
use super::{RecordError, Result, blueprint, palette};
use crate::model::Free;
use crate::signal::FaultSet;
use crate::units::PASCAL_PER_PSI;

/// Name under which rerun's viewer keeps freerig's runs together.
pub const APPLICATION_ID: &str = "freerig";
/// Time between two drawings, s.
const FRAME: f64 = 0.02;
/// One record waits for so many that are written.
const WAITING: usize = 64;
/// Most records that wait.
const MOST_WAITING: usize = 16_384;
/// Longest wait for rerun's file at the end.
const FLUSH_TIMEOUT: Duration = Duration::from_secs(30);

impl From<rerun::RecordingStreamError> for RecordError {
    fn from(error: rerun::RecordingStreamError) -> Self {
        RecordError::Rerun(error.to_string())
    }
}

impl From<rerun::SerializationError> for RecordError {
    fn from(error: rerun::SerializationError) -> Self {
        RecordError::Rerun(error.to_string())
    }
}

/// A builder of the stream of the run `start`, with its blueprint.
pub(super) fn builder(start: &StartDocument, truth: bool) -> RecordingStreamBuilder {
    let simulated = if start.simulated() { " (SIMULATED)" } else { "" };
    RecordingStreamBuilder::new(APPLICATION_ID)
        .enabled(true)
        .recording_id(start.id.clone())
        .recording_name(format!("{}{simulated}", start.id))
        .with_blueprint(blueprint::of(start, truth))
}

/// `run.rrd` while it is written.
///
/// rerun keeps something in memory for every chunk until the file's end, so the chunks grow with the run: one record
/// waits here for every [`WAITING`] that are written. A day takes some thousand chunks, not millions; a kill costs
/// what waits, here and not of the samples.
pub struct RerunFile {
    sink: RerunSink,
    waiting: Vec<RecordBatch>,
    rows_waiting: usize,
    rows_written: usize,
}

impl RerunFile {
    /// Creates `run.rrd` in `folder`.
    ///
    /// # Errors
    /// Where the file cannot be created.
    pub fn create(folder: &Path, start: &StartDocument, truth: bool) -> Result<Self> {
        let stream = builder(start, truth).save(folder.join(RRD_NAME))?;
        let sink = RerunSink::new(stream, start, truth)?;
        Ok(Self { sink, waiting: Vec::new(), rows_waiting: 0, rows_written: 0 })
    }

    /// Appends `batch`.
    ///
    /// # Errors
    /// Where rerun refuses it.
    pub fn send(&mut self, batch: RecordBatch) -> Result<()> {
        self.rows_waiting += batch.num_rows();
        self.waiting.push(batch);
        if self.rows_waiting >= (self.rows_written / WAITING).min(MOST_WAITING) { self.write() } else { Ok(()) }
    }

    fn write(&mut self) -> Result<()> {
        let Some(first) = self.waiting.first() else { return Ok(()) };
        let all = concat_batches(&first.schema(), &self.waiting).map_err(|e| RecordError::Rerun(e.to_string()))?;
        self.waiting.clear();
        self.rows_waiting = 0;
        self.rows_written += all.num_rows();
        self.sink.send(&all)
    }

    /// Writes everything out.
    ///
    /// # Errors
    /// Where that does not succeed (the disk is full).
    pub fn finish(mut self) -> Result<()> {
        self.write()?;
        self.sink.stream.flush_with_timeout(FLUSH_TIMEOUT).map_err(|e| RecordError::Rerun(e.to_string()))
    }
}

/// One scalar series: where it goes, what it is made from and how it looks.
struct Series {
    entity: String,
    column: String,
    minus: Option<String>,
    scale: f64,
}

struct FreeView {
    entity: String,
    name: String,
    free: Free,
    faults: u32,
    limits: u8,
}

/// Sends batches to a stream of rerun.
pub(super) struct RerunSink {
    stream: RecordingStream,
    series: Vec<Series>,
    frees: Vec<FreeView>,
    state: Option<u8>,
    rig_faults: u32,
    latched: u32,
    next_frame: f64,
}

impl RerunSink {
    /// Sends what does not change: styles, the drawing at rest, the start document.
    pub(super) fn new(stream: RecordingStream, start: &StartDocument, truth: bool) -> Result<Self> {
        stream.set_log_time_enabled(false);
        stream.set_log_tick_enabled(false);
        let mut sink = Self {
            stream,
            series: Vec::new(),
            frees: Vec::new(),
            state: None,
            rig_faults: 0,
            latched: 0,
            next_frame: f64::NEG_INFINITY,
        };
        let text = toml::to_string(start).unwrap_or_default();
        let simulated = if start.simulated() { "**SIMULATED** devices and plant.\n\n" } else { "" };
        let text = format!("# {}\n\n{simulated}{}\n\n```toml\n{text}\n```", start.id, start.note);
        sink.stream.log_static("document", &TextDocument::from_markdown(text))?;
        for (i, free) in start.frees.iter().enumerate() {
            let place = (i, start.frees.len());
            sink.add_free(place, &free.name, free.model.into(), truth)?;
        }
        sink.series("loop/latency", "latency", "latency_ns", 1e-3, palette::BLUE, 1.0)?;
        sink.series("loop/execution", "execution of the tick before", "execution_ns", 1e-3, palette::ORANGE, 1.0)?;
        sink.series("loop/skipped", "periods skipped", "skipped", 1.0, palette::RED, 2.0)?;
        sink.stream.log_static(
            "states/life_cycle",
            &StateConfiguration::new()
                .with_values([
                    "boot",
                    "disarmed",
                    "arming",
                    "hold",
                    "track",
                    "identify",
                    "ramp_down",
                    "faulting",
                    "faulted",
                ])
                .with_colors((0..=8).map(|state| color(state_color(state)))),
        )?;
        Ok(sink)
    }

    fn add_free(&mut self, place: (usize, usize), name: &str, free: Free, truth: bool) -> Result<()> {
        let deg = 180.0 / std::f64::consts::PI;
        let psi = 1.0 / PASCAL_PER_PSI;
        let e = format!("frees/{name}");
        let c = |column: &str| column_name(name, column);
        self.series(&format!("{e}/angle/reference"), "reference", &c("reference_rad"), deg, palette::GREY, 2.5)?;
        if truth {
            self.series(
                &format!("{e}/angle/true"),
                "true (SIMULATED)",
                &c("true_angle_rad"),
                deg,
                palette::GREEN,
                1.0,
            )?;
        }
        self.series(&format!("{e}/angle/estimate"), "angle", &c("angle_rad"), deg, palette::BLUE, 1.5)?;
        self.series(&format!("{e}/error"), "error", &c("reference_rad"), deg, palette::RED, 1.5)?;
        if let Some(error) = self.series.last_mut() {
            error.minus = Some(c("angle_rad"));
        }
        self.series(&format!("{e}/pressure/command"), "command", &c("command_pa"), psi, palette::GREY, 2.0)?;
        self.series(&format!("{e}/pressure/measured"), "pressure", &c("pressure_pa"), psi, palette::BLUE, 1.5)?;
        self.series(&format!("{e}/terms/p"), "P", &c("p_pa"), psi, palette::BLUE, 1.5)?;
        self.series(&format!("{e}/terms/i"), "I", &c("i_pa"), psi, palette::GREEN, 1.5)?;
        self.series(&format!("{e}/terms/d"), "D", &c("d_pa"), psi, palette::ORANGE, 1.5)?;
        self.series(&format!("{e}/terms/ff"), "feedforward", &c("ff_pa"), psi, palette::PURPLE, 1.5)?;
        self.series(&format!("{e}/terms/wanted"), "sum", &c("wanted_pa"), psi, palette::GREY, 1.0)?;
        let entity = format!("rig/{name}");
        self.draw_at_rest(&entity, place, &free)?;
        self.frees.push(FreeView { entity, name: name.into(), free, faults: 0, limits: 0 });
        Ok(())
    }

    fn series(&mut self, entity: &str, name: &str, column: &str, scale: f64, rgb: u32, width: f32) -> Result<()> {
        let style = SeriesLines::new().with_names([name]).with_colors([color(rgb)]).with_widths([width]);
        self.stream.log_static(entity, &style)?;
        self.series.push(Series { entity: entity.into(), column: column.into(), minus: None, scale });
        Ok(())
    }

    /// What of the drawing stands still: the FREEs hang side by side, z downwards from base to tip.
    fn draw_at_rest(&self, entity: &str, (index, count): (usize, usize), free: &Free) -> Result<()> {
        let stream = &self.stream;
        if index == 0 {
            stream.log_static("rig", &ViewCoordinates::RIGHT_HAND_Z_DOWN())?;
        }
        let r = free.radius as f32;
        let fibers = LineStrips3D::update_fields().with_radii([0.06 * r]).with_colors([color(palette::FIBER)]);
        stream.log_static(format!("{entity}/fibers"), &fibers)?;
        let x = (index as f32 - (count as f32 - 1.0) / 2.0) * 5.0 * r;
        stream.log_static(entity, &Transform3D::from_translation([x, 0.0, 0.0]))?;
        let mesh = |m: &shape::Mesh, rgb: u32| {
            Mesh3D::new(m.points.iter().copied())
                .with_vertex_normals(m.normals.iter().copied())
                .with_triangle_indices(m.triangles.iter().copied())
                .with_albedo_factor(color(rgb).0)
        };
        stream.log_static(format!("{entity}/tube"), &mesh(&shape::tube(), palette::RUBBER))?;
        let base = shape::cap(1.6 * r, 0.5 * r);
        stream.log_static(format!("{entity}/base"), &Transform3D::from_translation([0.0, 0.0, -0.5 * r]))?;
        stream.log_static(format!("{entity}/base"), &mesh(&base, palette::METAL))?;
        stream.log_static(format!("{entity}/tip/cap"), &mesh(&shape::cap(1.15 * r, 0.6 * r), palette::METAL))?;
        // What the viewer frames when it opens: the FREE with its pointers, not only what stands still.
        let (wide, low) = (2.0 * r, 0.85 * free.length as f32);
        let corners = Points3D::new([[-wide, -wide, 0.0], [wide, wide, low]]);
        let unseen = Color::from_unmultiplied_rgba(0, 0, 0, 0);
        stream.log_static(format!("{entity}/frame"), &corners.with_radii([1e-6]).with_colors([unseen]))?;
        // Pointers under the cap: the end as it stands, and where it should stand.
        let pointer = |z: f32, length: f32, width: f32, rgb: u32| {
            LineStrips3D::new([vec![[0.0, 0.0, z], [length, 0.0, z]]]).with_radii([width]).with_colors([color(rgb)])
        };
        stream.log_static(format!("{entity}/tip/pointer"), &pointer(0.6 * r, 3.0 * r, 0.12 * r, palette::BLUE))?;
        stream.log_static(format!("{entity}/wanted/pointer"), &pointer(0.6 * r, 3.0 * r, 0.07 * r, palette::GREY))?;
        Ok(())
    }

    /// Sends `batch`.
    ///
    /// # Errors
    /// Where rerun refuses it.
    pub(super) fn send(&mut self, batch: &RecordBatch) -> Result<()> {
        let (Some(t), Some(tick)) = (floats(batch, "t_s"), batch.column_by_name("tick")) else {
            return Ok(());
        };
        let ticks = tick.as_primitive::<UInt64Type>().values();
        let times = |rows: &[usize]| {
            [
                TimeColumn::new_duration_secs("t", rows.iter().map(|&i| t.value(i))),
                TimeColumn::new_sequence("tick", rows.iter().map(|&i| ticks[i] as i64)),
            ]
        };
        let all: Vec<usize> = (0..batch.num_rows()).collect();
        let all_times = times(&all);
        for series in &self.series {
            let Some(mut values) = numbers(batch, &series.column) else { continue };
            if let Some(minus) = &series.minus {
                let Some(other) = numbers(batch, minus) else { continue };
                values.iter_mut().zip(other).for_each(|(v, o)| *v -= o);
            }
            values.iter_mut().for_each(|v| *v *= series.scale);
            if values.iter().all(|v| v.is_nan()) {
                continue;
            }
            let columns = Scalars::new(values).columns_of_unit_batches()?;
            self.stream.send_columns(series.entity.as_str(), all_times.clone(), columns)?;
        }
        self.send_changes(batch, &times)?;
        let mut frames = Vec::new();
        for row in 0..batch.num_rows() {
            // Half a microsecond against rounding.
            if t.value(row) + 5e-7 >= self.next_frame {
                frames.push(row);
                self.next_frame = t.value(row) + FRAME;
            }
        }
        self.send_drawing(batch, &frames, &times(&frames))
    }

    fn send_drawing(&self, batch: &RecordBatch, rows: &[usize], times: &[TimeColumn; 2]) -> Result<()> {
        if rows.is_empty() {
            return Ok(());
        }
        for view in &self.frees {
            let column = |name: &str| floats(batch, &column_name(&view.name, name));
            let at =
                |column: Option<&arrow::array::Float64Array>, row: usize| column.map_or(f64::NAN, |c| c.value(row));
            let (angle, true_angle, extension) =
                (column("angle_rad"), column("true_angle_rad"), column("true_extension_m"));
            let (pressure, reference) = (column("pressure_pa"), column("reference_rad"));
            let poses: Vec<Pose> = rows
                .iter()
                .map(|&row| {
                    let (estimate, truth) = (at(angle, row), at(true_angle, row));
                    let angle = if truth.is_finite() { truth } else { estimate };
                    Pose::of(&view.free, angle, at(extension, row), at(pressure, row))
                })
                .collect();
            let send = |entity: &str, columns: Vec<_>| {
                self.stream.send_columns(format!("{}/{entity}", view.entity), times.clone(), columns)
            };
            let turned = |angle: f64| {
                rerun::Quaternion::from_xyzw([0.0, 0.0, (angle / 2.0).sin() as f32, (angle / 2.0).cos() as f32])
            };
            let fibers = LineStrips3D::new(poses.iter().flat_map(|p| p.fibers(&view.free)))
                .columns(std::iter::repeat_n(shape::FIBERS, poses.len()))?;
            send("fibers", fibers.collect())?;
            let scales = poses.iter().map(|p| [p.radius as f32, p.radius as f32, p.length as f32]);
            send("tube", Transform3D::new().with_many_scale(scales).columns_of_unit_batches()?.collect())?;
            let tips = || poses.iter().map(|p| [0.0, 0.0, p.length as f32]);
            let tip = Transform3D::new()
                .with_many_translation(tips())
                .with_many_quaternion(poses.iter().map(|p| turned(p.angle)));
            send("tip", tip.columns_of_unit_batches()?.collect())?;
            // Where no angle is asked the second pointer hides behind the first.
            let wanted = rows.iter().zip(&poses).map(|(&row, pose)| {
                let wanted = at(reference, row);
                turned(if wanted.is_finite() { wanted } else { pose.angle })
            });
            let wanted = Transform3D::new().with_many_translation(tips()).with_many_quaternion(wanted);
            send("wanted", wanted.columns_of_unit_batches()?.collect())?;
        }
        Ok(())
    }

    /// States, faults and limits where they change, as lanes and as a log of events.
    fn send_changes(&mut self, batch: &RecordBatch, times: &dyn Fn(&[usize]) -> [TimeColumn; 2]) -> Result<()> {
        let stream = &self.stream;
        let change = |row: usize, lane: &str, text: String| -> Result<()> {
            let columns = StateChange::single(text).columns_of_unit_batches()?;
            Ok(stream.send_columns(format!("states/{lane}"), times(&[row]), columns)?)
        };
        let event = |row: usize, level: &str, text: String| -> Result<()> {
            let columns = TextLog::new(text).with_level(level).columns_of_unit_batches()?;
            Ok(stream.send_columns("events", times(&[row]), columns)?)
        };
        let bytes = |name: &str| batch.column_by_name(name).and_then(|c| c.as_primitive_opt::<UInt8Type>().cloned());
        let words = |name: &str| batch.column_by_name(name).and_then(|c| c.as_primitive_opt::<UInt32Type>().cloned());
        if let (Some(states), Some(rig), Some(latched)) = (bytes("state"), words("rig_faults"), words("latched_faults"))
        {
            for row in 0..batch.num_rows() {
                if self.state != Some(states.value(row)) {
                    self.state = Some(states.value(row));
                    let name = state_of(states.value(row)).name();
                    change(row, "life_cycle", name.into())?;
                    event(row, TextLogLevel::INFO, format!("state: {name}"))?;
                }
                if self.rig_faults != rig.value(row) {
                    for text in appeared(self.rig_faults, rig.value(row)) {
                        event(row, TextLogLevel::ERROR, text)?;
                    }
                    self.rig_faults = rig.value(row);
                    change(row, "rig_faults", fault_names(rig.value(row)))?;
                }
                if self.latched != latched.value(row) {
                    self.latched = latched.value(row);
                    change(row, "latched", fault_names(self.latched))?;
                }
            }
        }
        for view in &mut self.frees {
            let name = &view.name;
            let (faults, limits) = (words(&column_name(name, "faults")), bytes(&column_name(name, "limits")));
            let (Some(faults), Some(limits)) = (faults, limits) else { continue };
            for row in 0..batch.num_rows() {
                let (now, limits) = (faults.value(row), limits.value(row));
                if view.faults != now {
                    for text in appeared(view.faults, now) {
                        event(row, TextLogLevel::ERROR, format!("{name}: {text}"))?;
                    }
                    view.faults = now;
                    change(row, &format!("{name}_faults"), fault_names(now))?;
                }
                if view.limits != limits {
                    view.limits = limits;
                    let names: Vec<_> = limit_names(limits).collect();
                    change(row, &format!("{name}_limits"), names.join(", "))?;
                }
            }
        }
        Ok(())
    }
}

fn appeared(before: u32, now: u32) -> impl Iterator<Item = String> {
    let new = FaultSet(now & !before).iter().map(|c| format!("fault: {}", c.name())).collect::<Vec<_>>();
    let gone = FaultSet(before & !now).iter().map(|c| format!("fault gone: {}", c.name())).collect::<Vec<_>>();
    new.into_iter().chain(gone)
}

fn fault_names(set: u32) -> String {
    FaultSet(set).iter().map(|c| c.name()).collect::<Vec<_>>().join(", ")
}

fn color(rgb: u32) -> Color {
    Color::from_u32(rgb << 8 | 0xFF)
}

/// A column of any number type as `f64`.
fn numbers(batch: &RecordBatch, name: &str) -> Option<Vec<f64>> {
    if let Some(floats) = floats(batch, name) {
        return Some(floats.values().to_vec());
    }
    let column = batch.column_by_name(name)?;
    if let Some(words) = column.as_primitive_opt::<UInt32Type>() {
        return Some(words.values().iter().map(|&v| v.into()).collect());
    }
    column.as_primitive_opt::<UInt64Type>().map(|wide| wide.values().iter().map(|&v| v as f64).collect())
}

//! The columns of `samples.arrows`: one table of names for writing and reading.
//!
//! [`visit`] walks through a record once, field by field, in a fixed order; the writer, the reader and the
//! schema are three visitors of the same walk, so that they cannot disagree. It takes every struct apart
//! without `..`: a field that is added to [`TickRecord`] does not compile until it is recorded.

use std::sync::Arc;

use arrow::array::{
    Array, ArrayRef, BooleanArray, Float64Array, RecordBatch, UInt8Array, UInt16Array, UInt32Array, UInt64Array,
};
use arrow::datatypes::{DataType, Field, Schema, SchemaRef};
use arrow::error::ArrowError;

use crate::clock::Time;
use crate::signal::{
    Estimate, FaultCode, FreeTick, ImuHealth, ImuSample, LimitSet, PressureSample, Quantity, Reference, Refusal,
    RefusalCode, RegulatorHealth, RequestKind, State, Terms, TickRecord, Truth,
};

/// What a walk through a record does at each field. The first part of a name is the FREE (or empty).
trait Visitor {
    fn float(&mut self, free: &str, name: &str, value: &mut f64);
    fn wide(&mut self, free: &str, name: &str, value: &mut u64);
    fn word(&mut self, free: &str, name: &str, value: &mut u32);
    fn short(&mut self, free: &str, name: &str, value: &mut u16);
    fn byte(&mut self, free: &str, name: &str, value: &mut u8);
    fn flag(&mut self, free: &str, name: &str, value: &mut bool);
}

/// Walks through `record` (and the first `names.len()` entries of `truth`); `t` is the time since the run's
/// start, s, which readers want and which the reader of records passes over.
fn visit(v: &mut impl Visitor, t: f64, record: &mut TickRecord, truth: Option<&mut [Truth]>, names: &[String]) {
    let TickRecord {
        tick,
        time,
        latency_ns,
        execution_ns,
        skipped,
        state,
        request,
        estop,
        realtime,
        config_changed,
        supply_low,
        heartbeat,
        trim,
        refusal,
        program_time,
        latched,
        faults,
        vent,
        free_count: _,
        frees,
    } = record;
    v.float("", "t_s", &mut { t });
    v.wide("", "tick", tick);
    visit_time(v, "", "time_ns", time);
    v.word("", "latency_ns", latency_ns);
    v.word("", "execution_ns", execution_ns);
    v.wide("", "skipped", skipped);
    coded(v, "", "state", state, |s| s as u8, state_of);
    coded(v, "", "request", request, |r| r as u8, request_of);
    v.flag("", "estop", estop);
    v.flag("", "realtime", realtime);
    v.flag("", "config_changed", config_changed);
    v.flag("", "supply_low", supply_low);
    visit_time(v, "", "heartbeat_ns", heartbeat);
    let Refusal { code, free, fault } = refusal;
    coded(v, "", "refusal", code, |c| c as u8, refusal_of);
    v.byte("", "refusal_free", free);
    coded(v, "", "refusal_fault", fault, |f| f.map_or(0, |f| f as u8), fault_of);
    v.float("", "program_time_s", program_time);
    v.word("", "latched_faults", &mut latched.0);
    v.word("", "rig_faults", &mut faults.0);
    v.flag("", "vent", vent);
    visit_time(v, "", "trim_time_ns", &mut trim.time);
    for ((name, free), trim) in names.iter().zip(frees.iter_mut()).zip(&mut trim.pressure) {
        visit_free(v, name, free);
        v.float(name, "trim_pa", trim);
    }
    if let Some(truth) = truth {
        for (name, Truth { angle, extension, pressure, position: [x, y, z] }) in names.iter().zip(truth) {
            v.float(name, "true_angle_rad", angle);
            v.float(name, "true_extension_m", extension);
            v.float(name, "true_pressure_pa", pressure);
            v.float(name, "true_x_m", x);
            v.float(name, "true_y_m", y);
            v.float(name, "true_z_m", z);
        }
    }
}

fn visit_free(v: &mut impl Visitor, n: &str, free: &mut FreeTick) {
    let FreeTick { imu, pressure, reference, estimate, terms, wanted, command, limits, faults } = free;

    let Reference { quantity, position, rate, acceleration } = reference;
    coded(v, n, "reference_quantity", quantity, |q| q as u8, quantity_of);
    v.float(n, "reference_si", position);
    v.float(n, "reference_rate_si", rate);
    v.float(n, "reference_acceleration_si", acceleration);
    // For readers: the reference in a column of its own unit, not a number where it is of the other.
    let of = |q| if *quantity == q { *position } else { f64::NAN };
    v.float(n, "reference_rad", &mut of(Quantity::Angle));
    v.float(n, "reference_pa", &mut of(Quantity::Pressure));

    let Estimate { tare: [tw, tx, ty, tz], angle, rate, measured_angle, measured_rate, tilt, age, sequence, valid } =
        estimate;
    v.float(n, "angle_rad", angle);
    v.float(n, "rate_rad_s", rate);
    v.float(n, "measured_angle_rad", measured_angle);
    v.float(n, "measured_rate_rad_s", measured_rate);
    v.float(n, "tilt_rad", tilt);
    v.float(n, "estimate_age_s", age);
    v.word(n, "estimate_sequence", sequence);
    v.flag(n, "estimate_valid", valid);
    for (name, value) in ["tare_qw", "tare_qx", "tare_qy", "tare_qz"].into_iter().zip([tw, tx, ty, tz]) {
        v.float(n, name, value);
    }

    v.float(n, "command_pa", command);
    v.float(n, "wanted_pa", wanted);
    let Terms { proportional, integral, derivative, feedforward, filtered_rate } = terms;
    v.float(n, "p_pa", proportional);
    v.float(n, "i_pa", integral);
    v.float(n, "d_pa", derivative);
    v.float(n, "ff_pa", feedforward);
    v.float(n, "filtered_rate_rad_s", filtered_rate);
    v.byte(n, "limits", &mut limits.0);
    v.word(n, "faults", &mut faults.0);

    let PressureSample { time, sequence, pressure, setpoint, status, health } = pressure;
    v.float(n, "pressure_pa", pressure);
    v.float(n, "setpoint_pa", setpoint);
    visit_time(v, n, "pressure_time_ns", time);
    v.word(n, "pressure_sequence", sequence);
    v.short(n, "pressure_status", &mut status.0);
    coded(v, n, "pressure_health", health, |h| h as u8, regulator_health_of);

    let ImuSample { time, sequence, quaternion: [w, x, y, z], rate, acceleration, calibration, health } = imu;
    visit_time(v, n, "imu_time_ns", time);
    v.word(n, "imu_sequence", sequence);
    for (name, value) in ["imu_qw", "imu_qx", "imu_qy", "imu_qz"].into_iter().zip([w, x, y, z]) {
        v.float(n, name, value);
    }
    for (name, value) in ["imu_rate_x_rad_s", "imu_rate_y_rad_s", "imu_rate_z_rad_s"].into_iter().zip(rate) {
        v.float(n, name, value);
    }
    for (name, value) in ["imu_ax_m_s2", "imu_ay_m_s2", "imu_az_m_s2"].into_iter().zip(acceleration) {
        v.float(n, name, value);
    }
    v.byte(n, "imu_calibration", calibration);
    coded(v, n, "imu_health", health, |h| h as u8, imu_health_of);
}

fn visit_time(v: &mut impl Visitor, free: &str, name: &str, time: &mut Time) {
    let mut nanoseconds = time.as_nanos();
    v.wide(free, name, &mut nanoseconds);
    *time = Time::from_nanos(nanoseconds);
}

/// An enum of stable numbers, as a byte.
fn coded<T: Copy>(v: &mut impl Visitor, n: &str, name: &str, value: &mut T, to: fn(T) -> u8, from: fn(u8) -> T) {
    let mut code = to(*value);
    v.byte(n, name, &mut code);
    *value = from(code);
}

/// The state of a stable number.
pub fn state_of(code: u8) -> State {
    match code {
        1 => State::Disarmed,
        2 => State::Arming,
        3 => State::Hold,
        4 => State::Track,
        5 => State::Identify,
        6 => State::RampDown,
        7 => State::Faulting,
        8 => State::Faulted,
        _ => State::Boot,
    }
}

fn request_of(code: u8) -> RequestKind {
    match code {
        1 => RequestKind::Arm,
        2 => RequestKind::Disarm,
        3 => RequestKind::Clear,
        4 => RequestKind::Start,
        5 => RequestKind::Stop,
        6 => RequestKind::Gains,
        _ => RequestKind::None,
    }
}

fn refusal_of(code: u8) -> RefusalCode {
    match code {
        1 => RefusalCode::WrongState,
        2 => RefusalCode::EmergencyStop,
        3 => RefusalCode::FaultPresent,
        4 => RefusalCode::ConfigChanged,
        5 => RefusalCode::NotRealtime,
        6 => RefusalCode::NotVented,
        7 => RefusalCode::NoPressure,
        8 => RefusalCode::NoImu,
        9 => RefusalCode::NotCalibrated,
        10 => RefusalCode::NotStill,
        11 => RefusalCode::BadProgram,
        12 => RefusalCode::BadGains,
        13 => RefusalCode::Busy,
        _ => RefusalCode::None,
    }
}

fn fault_of(code: u8) -> Option<FaultCode> {
    FaultCode::ALL.into_iter().find(|&f| f as u8 == code)
}

fn quantity_of(code: u8) -> Quantity {
    match code {
        1 => Quantity::Angle,
        2 => Quantity::Pressure,
        _ => Quantity::None,
    }
}

fn regulator_health_of(code: u8) -> RegulatorHealth {
    match code {
        1 => RegulatorHealth::Good,
        2 => RegulatorHealth::Unmeasured,
        3 => RegulatorHealth::Lost,
        _ => RegulatorHealth::Absent,
    }
}

fn imu_health_of(code: u8) -> ImuHealth {
    match code {
        1 => ImuHealth::Good,
        2 => ImuHealth::Implausible,
        3 => ImuHealth::Restarting,
        4 => ImuHealth::Lost,
        _ => ImuHealth::Absent,
    }
}

/// Values of one column while a batch fills up, or of a batch that was read.
enum Column {
    Float(Vec<f64>),
    Wide(Vec<u64>),
    Word(Vec<u32>),
    Short(Vec<u16>),
    Byte(Vec<u8>),
    Flag(Vec<bool>),
}

impl Column {
    /// An empty column of `data_type`, one of those that the schema uses.
    fn empty(data_type: &DataType) -> Self {
        match data_type {
            DataType::UInt64 => Column::Wide(Vec::new()),
            DataType::UInt32 => Column::Word(Vec::new()),
            DataType::UInt16 => Column::Short(Vec::new()),
            DataType::UInt8 => Column::Byte(Vec::new()),
            DataType::Boolean => Column::Flag(Vec::new()),
            _ => Column::Float(Vec::new()),
        }
    }

    fn take(&mut self) -> ArrayRef {
        match self {
            Column::Float(v) => Arc::new(Float64Array::from(std::mem::take(v))),
            Column::Wide(v) => Arc::new(UInt64Array::from(std::mem::take(v))),
            Column::Word(v) => Arc::new(UInt32Array::from(std::mem::take(v))),
            Column::Short(v) => Arc::new(UInt16Array::from(std::mem::take(v))),
            Column::Byte(v) => Arc::new(UInt8Array::from(std::mem::take(v))),
            Column::Flag(v) => Arc::new(BooleanArray::from(std::mem::take(v))),
        }
    }
}

/// Makes the schema.
#[derive(Default)]
struct Describe(Vec<Field>);

impl Describe {
    fn add(&mut self, free: &str, name: &str, data_type: DataType) {
        let name = if free.is_empty() { name.to_owned() } else { column_name(free, name) };
        self.0.push(Field::new(name, data_type, false));
    }
}

impl Visitor for Describe {
    fn float(&mut self, free: &str, name: &str, _: &mut f64) {
        self.add(free, name, DataType::Float64);
    }
    fn wide(&mut self, free: &str, name: &str, _: &mut u64) {
        self.add(free, name, DataType::UInt64);
    }
    fn word(&mut self, free: &str, name: &str, _: &mut u32) {
        self.add(free, name, DataType::UInt32);
    }
    fn short(&mut self, free: &str, name: &str, _: &mut u16) {
        self.add(free, name, DataType::UInt16);
    }
    fn byte(&mut self, free: &str, name: &str, _: &mut u8) {
        self.add(free, name, DataType::UInt8);
    }
    fn flag(&mut self, free: &str, name: &str, _: &mut bool) {
        self.add(free, name, DataType::Boolean);
    }
}

/// Appends a record to the columns.
struct Append<'a>(std::slice::IterMut<'a, Column>);

macro_rules! append {
    ($method:ident, $variant:ident, $type:ty) => {
        fn $method(&mut self, _: &str, _: &str, value: &mut $type) {
            if let Some(Column::$variant(values)) = self.0.next() {
                values.push(*value);
            }
        }
    };
}

impl Visitor for Append<'_> {
    append!(float, Float, f64);
    append!(wide, Wide, u64);
    append!(word, Word, u32);
    append!(short, Short, u16);
    append!(byte, Byte, u8);
    append!(flag, Flag, bool);
}

/// Takes a record out of a batch whose schema has been checked.
struct Extract<'a> {
    columns: std::slice::Iter<'a, ArrayRef>,
    row: usize,
}

macro_rules! extract {
    ($method:ident, $array:ty, $type:ty) => {
        fn $method(&mut self, _: &str, _: &str, value: &mut $type) {
            if let Some(array) = self.columns.next().and_then(|c| c.as_any().downcast_ref::<$array>()) {
                *value = array.value(self.row);
            }
        }
    };
}

impl Visitor for Extract<'_> {
    extract!(float, Float64Array, f64);
    extract!(wide, UInt64Array, u64);
    extract!(word, UInt32Array, u32);
    extract!(short, UInt16Array, u16);
    extract!(byte, UInt8Array, u8);
    extract!(flag, BooleanArray, bool);
}

/// Name of the column `name` of the FREE `free`.
pub fn column_name(free: &str, name: &str) -> String {
    format!("{free}.{name}")
}

/// The schema of a run with the FREEs `names`, with or without the simulated rig's truth.
pub fn schema(names: &[String], truth: bool) -> SchemaRef {
    let mut describe = Describe::default();
    let mut nothing = [Truth::default(); crate::signal::MAX_FREES];
    visit(&mut describe, 0.0, &mut TickRecord::default(), truth.then_some(&mut nothing[..]), names);
    Arc::new(Schema::new(describe.0))
}

/// Columns that fill up, record by record, into a batch.
pub struct BatchBuilder {
    schema: SchemaRef,
    names: Vec<String>,
    truth: bool,
    columns: Vec<Column>,
    rows: usize,
}

impl BatchBuilder {
    /// An empty batch for the FREEs `names`.
    pub fn new(names: &[String], truth: bool) -> Self {
        let schema = schema(names, truth);
        let columns = schema.fields().iter().map(|f| Column::empty(f.data_type())).collect();
        Self { schema, names: names.to_vec(), truth, columns, rows: 0 }
    }

    /// What the batches look like.
    pub fn schema(&self) -> &SchemaRef {
        &self.schema
    }

    /// Records in the batch so far.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Appends `record`, at `t` seconds since the run's start. Where the builder has truth columns and `truth`
    /// is shorter than the FREEs, the rest is not a number.
    pub fn push(&mut self, t: f64, record: &TickRecord, truth: Option<&[Truth]>) {
        const UNKNOWN: Truth =
            Truth { angle: f64::NAN, extension: f64::NAN, pressure: f64::NAN, position: [f64::NAN; 3] };
        let mut all = [UNKNOWN; crate::signal::MAX_FREES];
        for (to, from) in all.iter_mut().zip(truth.unwrap_or_default()) {
            *to = *from;
        }
        let mut record = *record;
        let truth = self.truth.then_some(&mut all[..]);
        visit(&mut Append(self.columns.iter_mut()), t, &mut record, truth, &self.names);
        self.rows += 1;
    }

    /// The batch; the builder is empty afterwards.
    ///
    /// # Errors
    /// None in practice: the columns are of one length and of the schema's types.
    pub fn take(&mut self) -> Result<RecordBatch, ArrowError> {
        self.rows = 0;
        RecordBatch::try_new(self.schema.clone(), self.columns.iter_mut().map(Column::take).collect())
    }
}

/// Row `row` of `batch`, whose schema is that of [`schema`] for `names` and `truth`.
pub fn record_at(batch: &RecordBatch, row: usize, names: &[String], truth: bool) -> (TickRecord, Vec<Truth>) {
    let mut record = TickRecord { free_count: names.len() as u8, ..TickRecord::default() };
    let mut truths = vec![Truth::default(); if truth { names.len() } else { 0 }];
    let mut extract = Extract { columns: batch.columns().iter(), row };
    visit(&mut extract, 0.0, &mut record, truth.then_some(&mut truths[..]), names);
    (record, truths)
}

/// Names of the limits in `set`.
pub fn limit_names(set: u8) -> impl Iterator<Item = &'static str> {
    LimitSet::NAMES.into_iter().filter(move |(l, _)| LimitSet(set).contains(*l)).map(|(_, name)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_names_of_the_columns_are_unique_and_those_that_are_promised() {
        let schema = schema(&["a".into(), "b".into()], true);
        let mut names: Vec<_> = schema.fields().iter().map(|f| f.name().clone()).collect();
        let promised =
            ["t_s", "tick", "state", "a.reference_rad", "a.angle_rad", "b.rate_rad_s", "b.command_pa", "b.p_pa"];
        for name in promised {
            assert!(names.iter().any(|n| n == name), "{name}");
        }
        let count = names.len();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), count);
    }

    #[test]
    fn the_stable_numbers_go_there_and_back() {
        for code in 0..=8 {
            assert_eq!(state_of(code) as u8, code);
        }
        for code in 0..=13 {
            assert_eq!(refusal_of(code) as u8, code);
        }
        for fault in FaultCode::ALL {
            assert_eq!(fault_of(fault as u8), Some(fault));
        }
        for code in 0..=6 {
            assert_eq!(request_of(code) as u8, code);
        }
        for code in 0..=2 {
            assert_eq!(quantity_of(code) as u8, code);
        }
        for code in 0..=3 {
            assert_eq!(regulator_health_of(code) as u8, code);
        }
        for code in 0..=4 {
            assert_eq!(imu_health_of(code) as u8, code);
        }
    }
}

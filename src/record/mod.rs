//! The record of a run: `runs/ID/` with its start and stop document, every record of the loop, rerun's file,
//! the live view, plots and the report. The only floor that knows rerun.
//!
//! | file | what |
//! | --- | --- |
//! | `run.toml` | start document (written first) and stop document (written last; without it the run is *incomplete*) |
//! | `samples.arrows` | Arrow IPC stream: every input, decision and command of every tick, bit for bit |
//! | `run.rrd` | the same for rerun's viewer, with a blueprint |
//! | `report.html` | one self-contained page with plots and a table of figures |
//!
//! A run that was killed is readable up to its last whole batch (100 ms); its `run.rrd` lacks its last sixtieth.

mod bars;
mod bench;
mod bench_page;
mod blueprint;
mod canvas;
mod columns;
mod comparison;
mod design;
mod document;
mod drive;
mod error;
mod export;
mod figures;
mod free_document;
mod html;
mod imu;
mod lanes;
mod live;
mod loads;
mod locus;
mod material;
mod metrics;
mod model;
mod module;
mod page;
mod palette;
mod plot;
mod prediction;
mod quota;
mod recorded;
mod recorder;
mod regulator;
mod relay;
mod report;
mod rerun_sink;
mod rest;
mod run;
mod samples;
mod shape;
mod sheet;
mod signals;
mod stiffness;
mod study;
mod sweep;
mod tally;
mod tip;
mod tube;
mod views;
mod way;
mod whisk;
mod workspace;

pub use bench::{BenchRow, BenchSuite, Claim, Curve, Timed};
pub use bench_page::BenchReport;
pub use columns::column_name;
pub use comparison::{Comparison, Deviation, Row};
pub use design::design_sheet;
pub use document::{
    Backend, ErrorDocument, FORMAT, FaultDocument, LoopDocument, MomentDocument, RealtimeDocument, Repetition,
    RunDocument, RunKind, RunResult, StartDocument, StopDocument, sha256,
};
pub use error::{RecordError, Result};
pub use export::{Exported, Format, TIME_BASE, export};
pub use free_document::{FreeDocument, GainsDocument, HysteresisDocument, LimitsDocument, ModelDocument};
pub use imu::{ImuReading, damping_sheet, imu_sheet};
pub use live::{LiveFeed, LiveOptions, LiveView};
pub use loads::{LoadsDrawing, draw_loads};
pub use locus::locus_sheet;
pub use material::material_sheet;
pub use metrics::{ErrorMetrics, FreeMetrics, Metrics, MoveMetrics, ON_THE_WAY, TipMetrics};
pub use model::model_sheet;
pub use module::{Apart, ModuleDocument, TipPath, WhiskDocument};
pub use quota::Quota;
pub use recorder::{RecordOptions, Recorder};
pub use regulator::{RegulatorRecord, gauge_sheet, regulator_sheet};
pub use report::{mean_and_scatter, write_report};
pub use rerun_sink::APPLICATION_ID;
pub use rest::Rest;
pub use run::{DOCUMENT_NAME, REPORT_NAME, RRD_NAME, Run};
pub use samples::{Batches, FILE_NAME as SAMPLES_NAME, Records, Table, Tables, floats};
pub use sheet::Sheet;
pub use stiffness::stiffness_sheet;
pub use study::{Labelled, Study, StudyDocument, study_sheet};
pub use tip::{TipLine, TipWriter, read as read_tip};
pub use tube::TubeDocument;
pub use way::way_sheet;
pub use whisk::whisk_sheet;
pub use workspace::{ModuleDrawing, workspace_recording, workspace_sheet};

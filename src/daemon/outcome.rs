//! What came of a run, as the socket, `--json` and the commands say it.

use super::api::{FreeResult, RunResult, TipResult};
use crate::record::{Metrics, RecordError, Run};

impl RunResult {
    /// What came of `run`, from its documents and its samples.
    ///
    /// # Errors
    /// Where the samples cannot be read.
    pub fn of(run: &Run) -> Result<Self, RecordError> {
        let metrics = Metrics::of(run)?;
        let frees = metrics.frees.into_iter().map(|free| FreeResult {
            name: free.free,
            rms_error_rad: free.error.map(|e| e.rms_rad),
            peak_error_rad: free.error.map(|e| e.peak_rad),
            final_error_rad: free.error.map(|e| e.final_rad),
            model_rmsd_rad: free.model_rmsd_rad,
            hysteresis_rad: free.hysteresis_rad,
        });
        Ok(Self {
            id: run.id().to_owned(),
            folder: run.folder.display().to_string(),
            simulated: metrics.simulated,
            outcome: run.result_name().to_owned(),
            reason: run.stop().map(|stop| stop.message.clone()).filter(|message| !message.is_empty()),
            frees: frees.collect(),
            tip: metrics.tip.map(|tip| TipResult {
                rms_error_m: tip.estimated.rms,
                peak_error_m: tip.estimated.peak,
                true_rms_error_m: tip.truth.map(|t| t.rms),
                true_peak_error_m: tip.truth.map(|t| t.peak),
            }),
        })
    }
}

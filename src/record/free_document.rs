//! One FREE in a run's start document: its model, its gains, its limits, as they were.

use serde::{Deserialize, Serialize};

use super::tube::TubeDocument;
use crate::config::Temperatures;
use crate::control::{ControllerKind, DerivativeOn, FreeControl, Gains, Limits};
use crate::model::{ELEMENTS, Free, Hysteresis};

/// One FREE as it was controlled.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FreeDocument {
    /// Name in rig.toml.
    pub name: String,
    /// Which gains these are: a preset's name, or empty.
    #[serde(default)]
    pub preset: String,
    /// SHA-256 of the text of its calibration file, hexadecimal; empty where it has none.
    #[serde(default)]
    pub calibration_sha256: String,
    /// Its lumped model.
    pub model: ModelDocument,
    /// Its hysteresis, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hysteresis: Option<HysteresisDocument>,
    /// Its tube as finite elements see it, where it has a calibration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tube: Option<TubeDocument>,
    /// What its knob sets, where it turns one and that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperatures: Option<TemperaturesDocument>,
    /// Its gains.
    pub gains: GainsDocument,
    /// Whether the derivative term looks at the error rather than at the measurement.
    #[serde(default)]
    pub derivative_on_error: bool,
    /// Share of the inverse model that is fed forward, 0 to 1.
    #[serde(default)]
    pub feedforward: f64,
    /// Whether its model leads (`controller = "model"`).
    #[serde(default)]
    pub model_leads: bool,
    /// Its limits.
    pub limits: LimitsDocument,
}

impl FreeDocument {
    /// The document of `free`, without preset and calibration.
    pub fn new(free: &FreeControl) -> Self {
        Self {
            name: free.name.clone(),
            preset: String::new(),
            calibration_sha256: String::new(),
            model: free.free.into(),
            hysteresis: None,
            tube: None,
            temperatures: None,
            gains: free.gains.into(),
            derivative_on_error: free.derivative_on == DerivativeOn::Error,
            feedforward: free.feedforward,
            model_leads: matches!(free.controller, ControllerKind::Model(_)),
            limits: free.limits.into(),
        }
    }
}

/// Lumped parameters of a FREE, as [`Free`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ModelDocument {
    pub gamma_rad: f64,
    pub length_m: f64,
    pub radius_m: f64,
    pub mass_kg: f64,
    pub inertia_kg_m2: f64,
    pub axial_stiffness_n_per_m: f64,
    pub torsional_stiffness_nm_per_rad: f64,
    pub axial_damping_ns_per_m: f64,
    pub torsional_damping_nms_per_rad: f64,
}

/// What a knob sets at its angles.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TemperaturesDocument {
    pub angles_rad: Vec<f64>,
    pub temperatures_degc: Vec<f64>,
}

impl From<&Temperatures> for TemperaturesDocument {
    fn from(table: &Temperatures) -> Self {
        let (angles_rad, temperatures_degc) = table.rows().iter().copied().unzip();
        Self { angles_rad, temperatures_degc }
    }
}

impl TemperaturesDocument {
    /// The table; none where the numbers are none of one.
    pub fn table(&self) -> Option<Temperatures> {
        Temperatures::new(self.angles_rad.iter().copied().zip(self.temperatures_degc.iter().copied()).collect())
    }
}

/// Torsional hysteresis: Maxwell-slip elements.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HysteresisDocument {
    pub thresholds_rad: [f64; ELEMENTS],
    pub weights_nm_per_rad: [f64; ELEMENTS],
}

impl From<Hysteresis> for HysteresisDocument {
    fn from(h: Hysteresis) -> Self {
        Self { thresholds_rad: *h.thresholds(), weights_nm_per_rad: *h.weights() }
    }
}

impl From<HysteresisDocument> for Hysteresis {
    /// None where the numbers are none of a hysteresis.
    fn from(d: HysteresisDocument) -> Self {
        Hysteresis::new(d.thresholds_rad, d.weights_nm_per_rad).unwrap_or_default()
    }
}

impl From<Free> for ModelDocument {
    fn from(f: Free) -> Self {
        Self {
            gamma_rad: f.gamma,
            length_m: f.length,
            radius_m: f.radius,
            mass_kg: f.mass,
            inertia_kg_m2: f.inertia,
            axial_stiffness_n_per_m: f.axial_stiffness,
            torsional_stiffness_nm_per_rad: f.torsional_stiffness,
            axial_damping_ns_per_m: f.axial_damping,
            torsional_damping_nms_per_rad: f.torsional_damping,
        }
    }
}

impl From<ModelDocument> for Free {
    fn from(d: ModelDocument) -> Self {
        Self {
            gamma: d.gamma_rad,
            length: d.length_m,
            radius: d.radius_m,
            mass: d.mass_kg,
            inertia: d.inertia_kg_m2,
            axial_stiffness: d.axial_stiffness_n_per_m,
            torsional_stiffness: d.torsional_stiffness_nm_per_rad,
            axial_damping: d.axial_damping_ns_per_m,
            torsional_damping: d.torsional_damping_nms_per_rad,
        }
    }
}

/// PID gains, as [`Gains`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GainsDocument {
    pub proportional_pa_per_rad: f64,
    pub integral_pa_per_rad_s: f64,
    pub derivative_pa_s_per_rad: f64,
    pub derivative_filter_hz: f64,
}

impl From<Gains> for GainsDocument {
    fn from(g: Gains) -> Self {
        Self {
            proportional_pa_per_rad: g.proportional,
            integral_pa_per_rad_s: g.integral,
            derivative_pa_s_per_rad: g.derivative,
            derivative_filter_hz: g.derivative_filter,
        }
    }
}

/// Limits of a FREE, as [`Limits`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LimitsDocument {
    pub pressure_max_pa: f64,
    pub pressure_warn_pa: f64,
    pub pressure_hard_pa: f64,
    pub pressure_zero_pa: f64,
    pub slew_pa_per_s: f64,
    pub angle_soft_rad: (f64, f64),
    pub angle_hard_rad: (f64, f64),
    pub tracking_error_rad: f64,
    pub tracking_error_s: f64,
}

impl From<Limits> for LimitsDocument {
    fn from(l: Limits) -> Self {
        Self {
            pressure_max_pa: l.pressure_max,
            pressure_warn_pa: l.pressure_warn,
            pressure_hard_pa: l.pressure_hard,
            pressure_zero_pa: l.pressure_zero,
            slew_pa_per_s: l.slew,
            angle_soft_rad: l.angle_soft,
            angle_hard_rad: l.angle_hard,
            tracking_error_rad: l.tracking_error.0,
            tracking_error_s: l.tracking_error.1,
        }
    }
}

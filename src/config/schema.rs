//! The keys of calibration/NAME.toml: unit, range and meaning of each.

/// Version of the schema.
pub const SCHEMA_VERSION: i64 = 1;

/// One key of the schema.
#[derive(Debug)]
pub struct Key {
    /// Section that it stands in.
    pub section: &'static str,
    /// Its name, which ends in its unit.
    pub name: &'static str,
    /// Whether a calibration without it is none.
    pub required: bool,
    /// Lowest and highest value, in the unit of the name.
    pub range: (f64, f64),
    /// What it is.
    pub meaning: &'static str,
}

/// The keys of the schema.
pub mod keys {
    use super::Key;

    macro_rules! keys {
        ($($constant:ident: $section:literal $name:literal $required:literal $range:expr, $meaning:literal;)+) => {
            $(
                #[doc = $meaning]
                pub const $constant: Key = Key {
                    section: $section, name: $name, required: $required, range: $range, meaning: $meaning,
                };
            )+
            pub(super) const ALL: &[Key] = &[$($constant),+];
        };
    }

    keys! {
        WINDING_ANGLE: "geometry" "winding_angle_deg" true (-89.0, 89.0),
            "Winding angle of the fibres from the tube's axis; negative for an L FREE, which turns positive under pressure";
        LENGTH: "geometry" "length_mm" true (1.0, 2000.0), "Length at rest between the ends";
        FIBER_RADIUS: "geometry" "fiber_radius_mm" true (0.1, 200.0), "Radius of the fibres at rest";
        INNER_DIAMETER: "geometry" "inner_diameter_mm" false (0.1, 400.0), "Inner diameter of the tube";
        WALL: "geometry" "wall_mm" false (0.01, 50.0), "Thickness of the tube's wall";
        FIBERS: "geometry" "fibers" false (1.0, 200.0), "Number of fibres in the family";
        FIBER_WIDTH: "geometry" "fiber_width_mm" false (0.01, 20.0), "Width of a fibre's strip along the circumference";
        SHEAR_MODULUS: "material" "shear_modulus_mpa" false (0.001, 100.0), "Shear modulus mu of the rubber";
        OGDEN_EXPONENT: "material" "ogden_exponent" false (-20.0, 20.0), "Exponent alpha of the first-order Ogden law";
        FIBER_STIFFNESS: "material" "fiber_stiffness_n" false (0.1, 1e6), "EA of one fibre, force per unit strain";
        EFFECTIVE_ANGLE: "lumped" "effective_winding_angle_deg" false (-89.0, 89.0),
            "Winding angle with which the lumped model turns as was measured; it takes the place of the geometry's there";
        END_MASS: "lumped" "end_mass_kg" true (1e-6, 100.0), "Mass of the end cap and of what hangs on it";
        END_INERTIA: "lumped" "end_inertia_kg_m2" true (1e-12, 10.0), "Rotational inertia of the end about the axis";
        AXIAL_STIFFNESS: "lumped" "axial_stiffness_n_per_m" true (0.1, 1e8), "Axial stiffness ke";
        TORSIONAL_STIFFNESS: "lumped" "torsional_stiffness_nm_per_rad" true (1e-6, 1e4), "Torsional stiffness kt";
        AXIAL_DAMPING: "lumped" "axial_damping_ns_per_m" true (0.0, 1e6), "Axial damping ce";
        TORSIONAL_DAMPING: "lumped" "torsional_damping_nms_per_rad" true (0.0, 1e3), "Torsional damping ct";
        REGULATOR_LAG: "regulator" "lag_ms" false (0.0, 5000.0), "First-order lag of the regulator";
        REGULATOR_DEAD_TIME: "regulator" "dead_time_ms" false (0.0, 1000.0), "Dead time of the regulator";
        FASTEST_FILL: "regulator" "fastest_fill_psi_per_s" false (0.1, 1e4), "Fastest rise of the pressure";
        ZERO_CODE: "regulator" "zero_code" false (0.0, 4095.0),
            "DAC code at which an analogue regulator begins to open";
        PRESSURE_PER_CODE: "regulator" "span_pa_per_code" false (0.01, 1e4), "Pressure per DAC code above it";
        IMU_DELAY: "imu" "delay_ms" false (0.0, 500.0), "From the motion to its reading";
        IMU_NOISE: "imu" "angle_noise_deg" false (0.0, 10.0), "White noise of the angle, standard deviation of a reading";
        IMU_DRIFT: "imu" "angle_drift_deg_per_s" false (-10.0, 10.0), "Drift of the angle at rest";
        IMU_RATE_NOISE: "imu" "rate_noise_deg_per_s" false (0.0, 100.0),
            "White noise of the rate, standard deviation of a reading";
    }
}

/// Every key, in the order of the file.
pub const SCHEMA: &[Key] = keys::ALL;

//! What a module reaches: its fifteen paths and the plates found, on a page and as a recording in space.

use std::path::Path;
use std::time::Duration;

use rerun::blueprint::{
    Blueprint, BlueprintPanel, ContainerLike, Horizontal, SelectionPanel, Spatial3DView, TimePanel,
    components::PanelState,
};
use rerun::{
    Color, LineStrips3D, Points3D, RecordingStream, RecordingStreamBuilder, TimeColumn, Transform3D, ViewCoordinates,
};

use super::plot::{Line, Plot};
use super::rerun_sink::APPLICATION_ID;
use super::sheet::Sheet;
use super::views::{Curve, Views};
use super::{RecordError, Result, palette};
use crate::fem::module::square;
use crate::plan::Pose;
use crate::plan::workspace::{CasePath, Reach};
use crate::units::PASCAL_PER_PSI;

/// The paper's cases, what is under pressure in them, and their colours.
const CASES: [(u8, &str, u32); 5] = [
    (1, "all four", palette::FIBER),
    (2, "a diagonal pair", palette::PURPLE),
    (3, "one", palette::GREEN),
    (4, "two neighbours", palette::BLUE),
    (5, "three", palette::ORANGE),
];
/// Height of a drawing over the pressure, pixels.
const HEIGHT: u32 = 260;
/// Longest wait for rerun's file.
const FLUSH_TIMEOUT: Duration = Duration::from_secs(30);

/// A module and what it reaches.
#[derive(Clone, Copy, Debug)]
pub struct ModuleDrawing<'a> {
    /// What it is called: "60 deg".
    pub name: &'a str,
    /// Its fifteen paths.
    pub paths: &'a [CasePath],
    /// The plates found.
    pub reach: &'a Reach,
    /// Distance of neighbouring FREEs, m.
    pub spacing: f64,
    /// Outer radius of a FREE, m.
    pub radius: f64,
}

fn look(number: u8) -> (String, u32) {
    let case = CASES.iter().find(|case| case.0 == number);
    case.map_or((String::new(), palette::GREY), |(number, what, rgb)| (format!("Case {number}: {what}"), *rgb))
}

/// The page of `modules`, with `facts` and `remarks` above the drawings and a link to the `recording` beside it.
pub fn workspace_sheet(
    title: &str,
    modules: &[ModuleDrawing<'_>],
    facts: Vec<(String, String)>,
    remarks: Vec<String>,
    recording: &str,
) -> Sheet {
    let mut sheet = Sheet { title: title.into(), facts, remarks, ..Sheet::default() };
    sheet.links.push(("in space, for rerun's viewer".into(), recording.into()));
    for module in modules {
        let curves = module.paths.iter().map(|path| {
            let (label, rgb) = look(path.case.number);
            let points = path.poses.iter().map(|pose| pose.position).collect();
            Curve { label, rgb, points, on: Some(path.case.on), ended: path.ended.is_some(), ..Curve::default() }
        });
        let outlines = [module.reach.xy.corners.clone(), module.reach.xz.corners.clone()];
        let outline = Some(("hull of all plates found".to_owned(), outlines));
        let caption = format!(
            "{}: the plate's centre from above and from the side; circles: the FREEs from above, A at the upper right, \
             filled where under pressure; a cross: the path ends there",
            module.name
        );
        sheet.views.push((caption, Views { curves: curves.collect(), outline }));
        sheet.figures.extend(over_pressure(module));
    }
    sheet
}

type Quantity = (&'static str, fn(&Pose, &Pose) -> f64);

/// The first path of each case over its pressure; the others are its mirror images.
fn over_pressure(module: &ModuleDrawing<'_>) -> Vec<(String, Plot)> {
    const QUANTITIES: [Quantity; 3] = [
        ("sideways (mm)", |pose, rest| {
            1e3 * (pose.position[0] - rest.position[0]).hypot(pose.position[1] - rest.position[1])
        }),
        ("along z (mm)", |pose, rest| 1e3 * (pose.position[2] - rest.position[2])),
        ("turn (deg)", |pose, _| (2.0 * pose.rotation[3].atan2(pose.rotation[0])).to_degrees()),
    ];
    let first = |number: u8| module.paths.iter().find(|path| path.case.number == number);
    let chosen: Vec<&CasePath> = CASES.iter().filter_map(|case| first(case.0)).collect();
    let plot = |(label, of): &Quantity| {
        let lines = chosen.iter().filter_map(|path| {
            let rest = path.poses.first()?;
            let (name, rgb) = look(path.case.number);
            let psi: Vec<f64> = path.pressures.iter().map(|p| p / PASCAL_PER_PSI).collect();
            let values = path.poses.iter().map(|pose| of(pose, rest)).collect();
            Some(Line::new(&format!("{name} ({})", path.case.letters()), rgb, &psi, values))
        });
        let plot = Plot {
            x_label: "pressure (psi)".into(),
            y_label: (*label).into(),
            height: HEIGHT,
            lines: lines.collect(),
            ..Plot::default()
        };
        (format!("{}: {label}", module.name), plot)
    };
    QUANTITIES.iter().map(plot).collect()
}

/// Writes the recording of `modules` to `path`: paths as lines, the plates found as points, and each path's plate on
/// the timeline `pressure_pa`.
///
/// # Errors
/// Where rerun refuses it or the file cannot be written.
pub fn workspace_recording(path: &Path, title: &str, modules: &[ModuleDrawing<'_>]) -> Result<()> {
    let views = modules.iter().enumerate().map(|(i, module)| -> ContainerLike {
        Spatial3DView::new(module.name).with_origin(format!("/module_{i}")).with_contents(["$origin/**"]).into()
    });
    let blueprint = Blueprint::new(Horizontal::new(views.collect::<Vec<_>>()))
        .with_auto_views(false)
        .with_auto_layout(false)
        .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
        .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
        .with_time_panel(TimePanel::new().with_timeline("pressure_pa"));
    let stream = RecordingStreamBuilder::new(APPLICATION_ID)
        .enabled(true)
        .recording_name(title)
        .with_blueprint(blueprint)
        .save(path)?;
    stream.set_log_time_enabled(false);
    stream.set_log_tick_enabled(false);
    for (i, module) in modules.iter().enumerate() {
        module.send(&stream, &format!("module_{i}"))?;
    }
    stream.flush_with_timeout(FLUSH_TIMEOUT).map_err(|e| RecordError::Rerun(e.to_string()))
}

fn color(rgb: u32) -> Color {
    Color::from_u32(rgb << 8 | 0xFF)
}

fn single(point: [f64; 3]) -> [f32; 3] {
    point.map(|x| x as f32)
}

impl ModuleDrawing<'_> {
    fn send(&self, stream: &RecordingStream, entity: &str) -> Result<()> {
        stream.log_static(entity, &ViewCoordinates::RIGHT_HAND_Z_UP())?;
        let Some(rest) = self.paths.iter().find_map(|path| path.poses.first()) else { return Ok(()) };
        let thin = 0.04 * self.radius as f32;
        let frees = square(self.spacing).map(|base| {
            let (x, y) = (base.x as f32, base.y as f32);
            [[x, y, 0.0], [x, y, rest.position[2] as f32]]
        });
        let frees = LineStrips3D::new(frees)
            .with_radii([thin])
            .with_colors([color(palette::RUBBER)])
            .with_labels(["A", "B", "C", "D"]);
        stream.log_static(format!("{entity}/frees_at_rest"), &frees)?;
        let found = Points3D::new(self.reach.found.iter().map(|(_, pose)| single(pose.position)))
            .with_radii([1.5 * thin])
            .with_colors([color(palette::METAL)]);
        stream.log_static(format!("{entity}/plates_found"), &found)?;
        for path in self.paths {
            self.send_path(stream, &format!("{entity}/case_{}/{}", path.case.number, path.case.letters()), path, thin)?;
        }
        Ok(())
    }

    /// A path, and its plate: a square with an arrow along its own x.
    fn send_path(&self, stream: &RecordingStream, entity: &str, path: &CasePath, thin: f32) -> Result<()> {
        let (label, rgb) = look(path.case.number);
        let line = LineStrips3D::new([path.poses.iter().map(|pose| single(pose.position)).collect::<Vec<_>>()])
            .with_radii([2.0 * thin])
            .with_colors([color(rgb)])
            .with_labels([format!("{label} ({})", path.case.letters())])
            .with_show_labels(false);
        stream.log_static(format!("{entity}/path"), &line)?;
        let half = (0.5 * self.spacing + self.radius) as f32;
        let corners =
            [[half, half, 0.0], [-half, half, 0.0], [-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0]];
        let strips = [corners.to_vec(), vec![[0.0; 3], [half, 0.0, 0.0]], vec![[0.0; 3], [0.0, 0.0, half]]];
        let plate = LineStrips3D::new(strips).with_radii([thin]).with_colors([color(rgb)]);
        stream.log_static(format!("{entity}/plate"), &plate)?;
        let times = TimeColumn::new_sequence("pressure_pa", path.pressures.iter().map(|p| p.round() as i64));
        let pose = Transform3D::new()
            .with_many_translation(path.poses.iter().map(|pose| single(pose.position)))
            .with_many_quaternion(path.poses.iter().map(|pose| {
                let [w, x, y, z] = pose.rotation.map(|q| q as f32);
                rerun::Quaternion::from_xyzw([x, y, z, w])
            }));
        stream.send_columns(format!("{entity}/plate"), [times], pose.columns_of_unit_batches()?)?;
        Ok(())
    }
}

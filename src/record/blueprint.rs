//! What rerun's viewer shows at first glance: left the signals of each FREE, right the FREE itself, what state
//! the rig is in, and how the loop ran.

use rerun::blueprint::{
    Blueprint, BlueprintPanel, ContainerLike, Horizontal, SelectionPanel, Spatial3DView, StateTimelineView, Tabs,
    TextDocumentView, TextLogView, TimePanel, TimeSeriesView, Vertical, components::PanelState,
};

use super::document::StartDocument;

/// The blueprint of the run `start`.
pub(super) fn of(start: &StartDocument, truth: bool) -> Blueprint {
    let simulated = if truth || start.simulated() { " (SIMULATED)" } else { "" };
    let signals = start.frees.iter().map(|free| {
        let name = &free.name;
        let view = |title: &str, entity: &str| -> ContainerLike {
            TimeSeriesView::new(title)
                .with_origin(format!("/frees/{name}/{entity}"))
                .with_contents(["$origin/**"])
                .into()
        };
        let views = [
            view("angle [deg]", "angle"),
            view("error [deg]", "error"),
            view("pressure [psi]", "pressure"),
            view("terms [psi]", "terms"),
        ];
        Vertical::new(views).with_name(format!("{name}{simulated}")).with_row_shares(vec![3.0, 1.5, 2.0, 2.0]).into()
    });
    let mut signals: Vec<ContainerLike> = signals.collect();
    let left = match signals.len() {
        1 => signals.swap_remove(0),
        _ => Tabs::new(signals).into(),
    };
    let rig: ContainerLike = Spatial3DView::new("FREE").with_origin("/rig").with_contents(["$origin/**"]).into();
    let states: ContainerLike =
        StateTimelineView::new("states, faults, limits").with_origin("/states").with_contents(["$origin/**"]).into();
    let timing = TimeSeriesView::new("loop [us]")
        .with_origin("/loop")
        .with_contents(["/loop/latency", "/loop/execution"])
        .into();
    let skipped = TimeSeriesView::new("skipped").with_origin("/loop/skipped").with_contents(["$origin/**"]).into();
    let events = TextLogView::new("events").with_origin("/events").into();
    let document = TextDocumentView::new("run").with_origin("/document").into();
    let right = Vertical::new([rig, states, Tabs::new([timing, skipped, events, document]).into()])
        .with_row_shares(vec![3.0, 1.6, 1.8])
        .into();
    Blueprint::new(Horizontal::new([left, right]).with_column_shares(vec![3.0, 2.0]))
        .with_auto_views(false)
        .with_auto_layout(false)
        .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
        .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
        .with_time_panel(TimePanel::new().with_state(PanelState::Collapsed).with_timeline("t"))
}

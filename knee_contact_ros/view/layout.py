"""The layout of the scene: what is seen where, for one knee or for several side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import rerun.blueprint as rrb
from rerun.blueprint.components import PlayState

from knee_contact_ros.view.outlines import NEWTONS_PER_MM, KneeOutlines
from knee_contact_ros.view.plots import (
    BODY_WEIGHTS,
    CONTACT_POINT,
    DEPTHS,
    FLEXION,
    LAYER,
    NEWTONS,
    PLOTS,
    SLIDING,
    Plot,
)
from knee_contact_ros.view.sagittal import ARROW, LEGEND, MM, PATH, SAGITTAL, extent_of
from knee_contact_ros.view.scene import CURVES, EVENTS, STATES, TIMELINE

PATH_SPAN = 1.5
"""How long [s] the contact point's way stays: a little more than a stride"""
LIVE_SPAN = 6.0
"""How long [s] the curves are seen while they grow"""
CLOSE = 10.0
"""How far [mm] the close view reaches beyond where the contact goes"""
CELLS = 9
"""Views beside the planes of a knee that has the screen for itself"""
DARK = (16, 17, 20)


def blueprint(drawings: Sequence[KneeOutlines], latency: bool = False, follow: bool = False) -> rrb.Blueprint:
    """The layout for these knees, with or without the latency; the view may follow the newest answers."""
    plots = [plot for plot in PLOTS if latency or not plot.live]
    arranged = _one if len(drawings) == 1 else _beside
    knees = [
        arranged(
            drawing, {plot.path: _plot(drawing.knee, plot, follow) for plot in plots}, _states(drawing.knee, follow)
        )
        for drawing in drawings
    ]
    return rrb.Blueprint(
        rrb.Horizontal(*knees) if len(knees) > 1 else knees[0],
        rrb.TimePanel(
            timeline=TIMELINE, state="collapsed", play_state=PlayState.Following if follow else PlayState.Paused
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _one(drawing: KneeOutlines, plots: Mapping[str, rrb.View], states: rrb.View) -> rrb.Container:
    """A knee that has the screen for itself: nine cells beside the planes, none of them empty."""
    cells: dict[str, rrb.View | rrb.Container] = {**plots, "states": states}
    if len(cells) > CELLS:
        cells[CONTACT_POINT] = rrb.Tabs(plots[CONTACT_POINT], cells.pop(SLIDING))
    left = [_plane(drawing), _close(drawing), _events(drawing.knee)]
    return rrb.Horizontal(
        rrb.Vertical(*left, row_shares=[5, 3, 4]), rrb.Grid(*cells.values(), grid_columns=3), column_shares=[4, 9]
    )


def _beside(drawing: KneeOutlines, plots: Mapping[str, rrb.View], states: rrb.View) -> rrb.Container:
    """A knee in a column of its own: what is looked at less lies behind."""
    in_front = [plots[path] for path in (FLEXION, CONTACT_POINT, BODY_WEIGHTS, DEPTHS)]
    flexion, point, force, depth = in_front
    behind = [plot for path, plot in plots.items() if plot not in in_front and path not in (NEWTONS, SLIDING)]
    return rrb.Vertical(
        rrb.Horizontal(_plane(drawing), rrb.Vertical(_close(drawing), _events(drawing.knee))),
        rrb.Grid(
            flexion,
            rrb.Tabs(point, plots[SLIDING]),
            rrb.Tabs(force, plots[NEWTONS]),
            rrb.Tabs(depth, states, *behind),
            grid_columns=2,
        ),
        row_shares=[4, 5],
        name=drawing.knee,
    )


def _plane(drawing: KneeOutlines) -> rrb.Spatial2DView:
    extent = extent_of(drawing)
    bounds = rrb.VisualBounds2D(x_range=[-1.3 * extent, 1.3 * extent], y_range=[-2.3 * extent, 0.6 * extent])
    title = f"{drawing.knee}: sagittal [mm], arrow {NEWTONS_PER_MM:g} N/mm"
    return _spatial(drawing, title, "$origin/**", bounds)


def _close(drawing: KneeOutlines) -> rrb.Spatial2DView:
    low, high = drawing.contact_range
    middle, half = 0.5 * MM * (low + high), 0.5 * MM * (high - low) + CLOSE
    height = -MM * float(drawing.tibia[abs(drawing.tibia[:, 0]).argmin(), 1])
    bounds = rrb.VisualBounds2D(
        x_range=[middle - half, middle + half], y_range=[height - 0.3 * half, height + 0.15 * half]
    )
    contents = ["$origin/**", f"- $origin/{LEGEND}", f"- $origin/{ARROW}"]
    return _spatial(drawing, f"{drawing.knee}: contact, overlap and path [mm]", contents, bounds)


def _spatial(
    drawing: KneeOutlines, name: str, contents: str | list[str], bounds: rrb.VisualBounds2D
) -> rrb.Spatial2DView:
    root = f"{drawing.knee}/{SAGITTAL}"
    recent = rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-PATH_SPAN),
        end=rrb.TimeRangeBoundary.cursor_relative(seconds=0.0),
    )
    overrides = {f"{root}/{PATH}": rrb.VisibleTimeRanges([recent])}
    return rrb.Spatial2DView(
        origin=root, contents=contents, name=name, background=DARK, visual_bounds=bounds,
        overrides=overrides,  # type: ignore[arg-type]
    )  # fmt: skip


def _plot(knee: str, plot: Plot, follow: bool) -> rrb.TimeSeriesView:
    paths = [plot.path, LAYER] if plot.path == DEPTHS else [plot.path]
    return rrb.TimeSeriesView(
        origin=f"{knee}/{CURVES}",
        contents=[f"$origin/{path}" for path in paths],
        name=f"{knee}: {plot.title[0].lower()}{plot.title[1:]}",
        axis_x=_time_axis(follow),
        plot_legend=rrb.PlotLegend(visible=False),  # it would cover curves; the title tells the colours
    )


def _states(knee: str, follow: bool) -> rrb.StateTimelineView:
    return rrb.StateTimelineView(
        origin=f"{knee}/{STATES}", name=f"{knee}: contact and level", time_view=_time_axis(follow)
    )


def _events(knee: str) -> rrb.TextLogView:
    stamp = rrb.encodings.TimelineColumn(TIMELINE, visible=False)  # too narrow to be read; the text tells the time
    columns = rrb.TextLogColumns(timeline_columns=[stamp], text_log_columns=["Body"])
    return rrb.TextLogView(origin=f"{knee}/{EVENTS}", name=f"{knee}: events", columns=columns)


def _time_axis(follow: bool) -> rrb.TimeAxis:
    if not follow:
        return rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)
    cursor = rrb.TimeRangeBoundary.cursor_relative
    return rrb.TimeAxis(view_range=rrb.TimeRange(start=cursor(seconds=-LIVE_SPAN), end=cursor(seconds=0.0)))

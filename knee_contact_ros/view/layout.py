"""The layout of the scene in Rerun's viewer, for one knee or for several side by side."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import PlayState

from knee_contact_ros.view.colours import BACKGROUND, KNEE_COLOURS
from knee_contact_ros.view.frame import Frame, common, frame_of
from knee_contact_ros.view.outlines import KneeOutlines
from knee_contact_ros.view.plots import DEPTHS, DETAILS, FLEXION, KNEE, LAYER, READ_OFF, Plot, plots_of
from knee_contact_ros.view.sagittal import BODY, CAMERA, PATH
from knee_contact_ros.view.scene import CURVES, EVENTS, STATES, TIMELINE

PATH_SPAN = 1.5
"""Time [s] for which the path of the contact point stays visible: a little more than a stride"""
LIVE_SPAN = 6.0
"""Time [s] of the curves that is visible while they grow"""
HEIGHTS = [1.03, 0.78, 1.12, 1.07]
"""Relative heights of four plots beside the plane, so that their ticks are legible; three are equally high"""
ABREAST = 2
"""Largest number of planes side by side; further ones stand below, or their words would overlap"""
LONGEST_TITLE = 105
"""Most letters of a title on a screen of 1600 pixels; Rerun cuts longer ones"""
MAIN, BEHIND, READ = "Knee", "Cost, levels, estimates, events", "Pressure, patch, strain"
"""Names of the tabs"""


def blueprint(drawings: Sequence[KneeOutlines], latency: bool = False, follow: bool = False) -> rrb.Blueprint:
    """Make the layout for knees, with or without a plot of the latency; with `follow` it shows the newest answers."""
    frame = common([frame_of(drawing) for drawing in drawings])
    planes = [_plane(drawing, frame, len(drawings) > 1) for drawing in drawings]
    by_path = {plot.path: plot for drawing in drawings for plot in plots_of(drawing, latency)}
    main, details, read = (
        [_plot(drawings, by_path[plot.path], follow) for plot in plots if plot.path in by_path]
        for plots in (KNEE, DETAILS, READ_OFF)
    )
    wide = len(drawings) <= ABREAST
    texts = [rrb.Vertical(_states(one.knee, follow, wide), _events(one.knee), row_shares=[1, 2]) for one in drawings]
    return rrb.Blueprint(
        rrb.Tabs(
            rrb.Horizontal(
                rrb.Grid(*planes, grid_columns=min(ABREAST, len(planes))),
                rrb.Vertical(*main, row_shares=HEIGHTS if len(main) == len(HEIGHTS) else None),
                name=MAIN,
            ),
            rrb.Horizontal(rrb.Vertical(*details), rrb.Horizontal(*texts), name=BEHIND),
            *([rrb.Grid(*read, grid_columns=ABREAST, name=READ)] if read else []),
        ),
        rrb.TimePanel(
            timeline=TIMELINE, state="collapsed", play_state=PlayState.Following if follow else PlayState.Paused
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def title_of(drawings: Sequence[KneeOutlines], plot: Plot) -> str:
    """Return the title of a plot: its quantities, unit and colours; with several knees, the colours of the knees."""
    weight = " or ".join(sorted({f"{drawing.body_weight:.0f}" for drawing in drawings}))
    several = len(drawings) > 1
    title = ((several and plot.title_of_several) or plot.title).format(weight=weight)
    if plot.path == DEPTHS and any(drawing.has_bone for drawing in drawings):
        title += "; bone begins, pink"
    names = [
        f"{drawing.knee} {KNEE_COLOURS[place % len(KNEE_COLOURS)].name}"
        for place, drawing in enumerate(drawings)
        if plot.path in {one.path for one in plots_of(drawing, latency=True)}
    ]
    if not several:
        return title
    full = f"{title}: {', '.join(names)}"
    return full if len(full) <= LONGEST_TITLE or plot.path == FLEXION else f"{title}: colours as of the flexion angle"


def _plane(drawing: KneeOutlines, frame: Frame, several: bool) -> rrb.Spatial2DView:
    """Make the view of a knee's sagittal plane."""
    camera = f"{drawing.knee}/{CAMERA}"
    recent = rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-PATH_SPAN),
        end=rrb.TimeRangeBoundary.cursor_relative(seconds=0.0),
    )
    return rrb.Spatial2DView(
        origin=camera, contents=["$origin/**", f"{rr.new_entity_path([drawing.knee, BODY])}/**"],
        name=plane_title(drawing, several), background=BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=frame.x, y_range=frame.y),
        overrides={f"{camera}/{PATH}": rrb.VisibleTimeRanges([recent])},
    )  # fmt: skip


def plane_title(drawing: KneeOutlines, several: bool = False) -> str:
    """Return the title of a knee's plane; it is shorter where several planes stand side by side."""
    knee = drawing.anatomy
    drawn = " (drawn only)" if knee.thickness_is_drawn else ""
    cartilage = f"cartilage 2 × {1e3 * knee.thickness:.2g} mm{drawn}"
    return f"{drawing.knee}: {cartilage}" if several else f"{drawing.knee}: sagittal plane, {cartilage}"


def _plot(drawings: Sequence[KneeOutlines], plot: Plot, follow: bool) -> rrb.TimeSeriesView:
    """Make the view of a plot with the curves of all knees."""
    contents = []
    for drawing in drawings:
        paths = [plot.path, *([LAYER] if plot.path == DEPTHS and drawing.has_bone else [])]
        contents += [rr.new_entity_path([drawing.knee, CURVES, path]) for path in paths]
    return rrb.TimeSeriesView(
        origin="/",
        contents=contents,
        name=title_of(drawings, plot),
        axis_x=_time_axis(follow),
        plot_legend=rrb.PlotLegend(visible=False),  # it would cover curves; the title tells the colours
    )


def _states(knee: str, follow: bool, wide: bool) -> rrb.StateTimelineView:
    """Make the view of a knee's contact states and levels."""
    name = f"{knee}: contact and level" if wide else knee  # what they are stands above them, too
    return rrb.StateTimelineView(origin=f"{knee}/{STATES}", name=name, time_view=_time_axis(follow))


def _events(knee: str) -> rrb.TextLogView:
    """Make the view of a knee's events."""
    stamp = rrb.encodings.TimelineColumn(TIMELINE, visible=False)  # too narrow to be read; the text tells the time
    columns = rrb.TextLogColumns(timeline_columns=[stamp], text_log_columns=["Body"])
    return rrb.TextLogView(origin=f"{knee}/{EVENTS}", name=f"{knee}: events", columns=columns)


def _time_axis(follow: bool) -> rrb.TimeAxis:
    """Make a time axis that is common to all plots, or that follows the newest answers."""
    if not follow:
        return rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)
    cursor = rrb.TimeRangeBoundary.cursor_relative
    return rrb.TimeAxis(view_range=rrb.TimeRange(start=cursor(seconds=-LIVE_SPAN), end=cursor(seconds=0.0)))

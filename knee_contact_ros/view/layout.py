"""The layout of the scene: what is seen where, for one knee or for several side by side."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import PlayState

from knee_contact_ros.view.colours import BACKGROUND, OF_KNEES
from knee_contact_ros.view.frame import Frame, common, frame_of
from knee_contact_ros.view.outlines import KneeOutlines
from knee_contact_ros.view.plots import DEPTHS, DETAILS, FLEXION, KNEE, LAYER, READ_OFF, Plot, plots_of
from knee_contact_ros.view.sagittal import BODY, CAMERA, PATH
from knee_contact_ros.view.scene import CURVES, EVENTS, STATES, TIMELINE

PATH_SPAN = 1.5
"""How long [s] the contact point's way stays: a little more than a stride"""
LIVE_SPAN = 6.0
"""How long [s] the curves are seen while they grow"""
HEIGHTS = [1.03, 0.78, 1.12, 1.07]
"""Of four plots beside the plane, so that their ticks can be read; three have room enough to be alike"""
ABREAST = 2
"""So many planes side by side; more of them stand below, or their words would cover each other"""
LONGEST_TITLE = 105
"""Letters that stand above a plot on a screen of 1600 pixels; Rerun cuts what is longer"""
MAIN, BEHIND, READ = "Knee", "Cost, levels, estimates, events", "Pressure, patch, strain"
"""The tabs"""


def blueprint(drawings: Sequence[KneeOutlines], latency: bool = False, follow: bool = False) -> rrb.Blueprint:
    """The layout for these knees, with or without the latency; the view may follow the newest answers."""
    frame = common([frame_of(drawing) for drawing in drawings])
    planes = [_plane(drawing, frame, len(drawings) > 1) for drawing in drawings]
    shown = {plot.path: plot for drawing in drawings for plot in plots_of(drawing, latency)}
    main, details, read = (
        [_plot(drawings, shown[plot.path], follow) for plot in plots if plot.path in shown]
        for plots in (KNEE, DETAILS, READ_OFF)
    )
    wide = len(drawings) <= ABREAST
    told = [rrb.Vertical(_states(one.knee, follow, wide), _events(one.knee), row_shares=[1, 2]) for one in drawings]
    return rrb.Blueprint(
        rrb.Tabs(
            rrb.Horizontal(
                rrb.Grid(*planes, grid_columns=min(ABREAST, len(planes))),
                rrb.Vertical(*main, row_shares=HEIGHTS if len(main) == len(HEIGHTS) else None),
                name=MAIN,
            ),
            rrb.Horizontal(rrb.Vertical(*details), rrb.Horizontal(*told), name=BEHIND),
            *([rrb.Grid(*read, grid_columns=ABREAST, name=READ)] if read else []),
        ),
        rrb.TimePanel(
            timeline=TIMELINE, state="collapsed", play_state=PlayState.Following if follow else PlayState.Paused
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def title_of(drawings: Sequence[KneeOutlines], plot: Plot) -> str:
    """What stands above a plot: what it shows and in which unit, and which colour is what."""
    weight = " or ".join(sorted({f"{drawing.body_weight:.0f}" for drawing in drawings}))
    several = len(drawings) > 1
    title = ((several and plot.title_of_several) or plot.title).format(weight=weight)
    if plot.path == DEPTHS and any(drawing.has_bone for drawing in drawings):
        title += "; bone begins, pink"
    names = [
        f"{drawing.knee} {OF_KNEES[place % len(OF_KNEES)].name}"
        for place, drawing in enumerate(drawings)
        if plot.path in {one.path for one in plots_of(drawing, latency=True)}
    ]
    if not several:
        return title
    told = f"{title}: {', '.join(names)}"
    return told if len(told) <= LONGEST_TITLE or plot.path == FLEXION else f"{title}: colours as of the flexion angle"


def _plane(drawing: KneeOutlines, frame: Frame, several: bool) -> rrb.Spatial2DView:
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
    """What stands above the plane of a knee; the narrower one of several has room for less."""
    knee = drawing.anatomy
    drawn = " (drawn only)" if knee.thickness_is_drawn else ""
    cartilage = f"cartilage 2 × {1e3 * knee.thickness:.2g} mm{drawn}"
    return f"{drawing.knee}: {cartilage}" if several else f"{drawing.knee}: sagittal plane, {cartilage}"


def _plot(drawings: Sequence[KneeOutlines], plot: Plot, follow: bool) -> rrb.TimeSeriesView:
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
    name = f"{knee}: contact and level" if wide else knee  # what they are stands above them, too
    return rrb.StateTimelineView(origin=f"{knee}/{STATES}", name=name, time_view=_time_axis(follow))


def _events(knee: str) -> rrb.TextLogView:
    stamp = rrb.encodings.TimelineColumn(TIMELINE, visible=False)  # too narrow to be read; the text tells the time
    columns = rrb.TextLogColumns(timeline_columns=[stamp], text_log_columns=["Body"])
    return rrb.TextLogView(origin=f"{knee}/{EVENTS}", name=f"{knee}: events", columns=columns)


def _time_axis(follow: bool) -> rrb.TimeAxis:
    if not follow:
        return rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)
    cursor = rrb.TimeRangeBoundary.cursor_relative
    return rrb.TimeAxis(view_range=rrb.TimeRange(start=cursor(seconds=-LIVE_SPAN), end=cursor(seconds=0.0)))

"""The layout in Rerun: paths of entities, the visible part of the plane, views and tabs.

The layout is for one knee, or for several side by side, which share their plots. Entities are under the name of the
knee. Lengths are mm.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import PlayState

from ..model.types import MM, Floats
from ..streams.topics import LATERAL
from . import colours
from .anatomy import (
    MAGNIFICATION,
    NEWTONS_PER_MM,
    SURFACE_POINTS,
    KneeOutlines,
    lowest_at,
    to_tibia_frame,
)
from .plots import (
    DEPTHS,
    DETAIL_PLOTS,
    KNEE_PLOTS,
    LAYER,
    SOLVER_PLOTS,
    Plot,
    plots_of,
    title_of,
)

TIMELINE = "stamp"
"""The one timeline: it has the ROS stamps"""
CURVES = "curves"
EVENTS = "events"
STATES = "states"
ABOUT = "about"
GAIT = "gait"
"""Path under `KNEE/states`, as the two that follow"""
CONTACT = "contact"
LEVEL = "level"
CAMERA = "sagittal"
"""Path of the camera, with the marks in front of the knee"""
BODY = "body"
"""Path of the knee"""
LEG = "leg"
"""Path of the leg in space; the robot's name in its URDF"""
CONTACT_PATH_ENTITY = "contact_path"
SCALE_BAR = 10.0
"""Length of the scale bar [mm]"""
_FRAMED_ANGLES = np.radians([-5.0, 0.0, 15.0, 30.0, 45.0, 60.0, 70.0])
"""Flexion angles [rad] at which the whole knee must be visible"""
_MARGIN = 0.04
"""Margin around the knee, in heights of the knee"""
_WORD_HEIGHT = 0.07
"""Room for words below the marks, in heights of the knee: words keep their size when the plane is magnified"""
_PATH_SPAN = 1.5
"""Time [s] for which the path of the contact point stays visible: a little more than a stride"""
_LIVE_SPAN = 6.0
"""Time [s] of the curves that is visible while they grow"""
_MAX_COLUMNS = 2
"""Largest number of planes side by side; further ones go below, or their words would overlap"""


class Frame(NamedTuple):
    """Visible part and places of words, in mm on the screen, whose y points down."""

    x: tuple[float, float]
    """Left and right end of the visible part"""
    y: tuple[float, float]
    """Upper and lower end of the visible part"""
    axes: tuple[float, float]
    """Origin of the arrows to anterior and superior"""
    axis_length: float
    """Length of these arrows"""
    scale: tuple[float, float]
    """Left end of the scale bar"""
    femur_name: tuple[float, float]
    """Place of the femur's name, on its shaft, femur frame"""
    tibia_name: tuple[float, float]
    """Place of the tibia's name"""


def frame_of(drawing: KneeOutlines) -> Frame:
    """Return the visible part for a single knee."""
    knee = drawing.anatomy
    shapes = [_touching(drawing, angle) for angle in _FRAMED_ANGLES]
    points = MM * np.concatenate([*shapes, knee.tibia_bone])
    height = float(np.ptp(points[:, 1]))
    margin = _MARGIN * height
    word = _WORD_HEIGHT * height
    left, bottom = points.min(axis=0) - margin
    right, top = points.max(axis=0) + margin
    floor = -bottom - word
    shaft = knee.femur_bone[knee.femur_bone[:, 1] > knee.femur_bone[:, 1].max() - 1e-6]
    length = 0.09 * (right - left)
    return Frame(
        (left, right),
        (-top, -bottom),
        axes=(left + word, floor),
        axis_length=length,
        scale=(right - margin - SCALE_BAR, floor),
        femur_name=(MM * float(shaft[:, 0].mean()), -MM * float(shaft[0, 1]) + word),
        tibia_name=(MM * float(knee.tibia_bone[:, 0].mean()), floor - 0.5 * word),
    )


def _touching(drawing: KneeOutlines, angle: float) -> Floats:
    """Return the femur's bone [m], tibia frame, at a flexion angle [rad], touching the tibia."""
    knee = drawing.anatomy
    femur = to_tibia_frame(knee.femur_cartilage[:SURFACE_POINTS], angle, 0.0, 0.0)
    x, y = knee.tibia_cartilage[:SURFACE_POINTS].T
    return to_tibia_frame(
        knee.femur_bone, angle, 0.0, -float((lowest_at(femur[None], x[None])[0] - y).min())
    )


def bounds_of(drawings: Sequence[KneeOutlines]) -> rrb.VisualBounds2D:
    """Return the visible part that is large enough for all knees: side by side they have one scale."""
    frames = [frame_of(drawing) for drawing in drawings]
    ends = [np.array([frame[axis] for frame in frames]) for axis in (0, 1)]
    x, y = ((float(end[:, 0].min()), float(end[:, 1].max())) for end in ends)
    return rrb.VisualBounds2D(x_range=x, y_range=y)


def blueprint(
    drawings: Sequence[KneeOutlines], latency: bool = False, follow: bool = False
) -> rrb.Blueprint:
    """Make the layout for knees, with or without a plot of the latency; with `follow` it shows the newest answers."""
    bounds = bounds_of(drawings)
    planes = [_plane(drawing, bounds, len(drawings) > 1) for drawing in drawings]
    by_path = {plot.path: plot for drawing in drawings for plot in plots_of(drawing, latency)}
    knee, details, solver = (
        [_plot(drawings, by_path[plot.path], follow) for plot in plots if plot.path in by_path]
        for plots in (KNEE_PLOTS, DETAIL_PLOTS, SOLVER_PLOTS)
    )
    first = drawings[0].knee
    # The text of one knee stands for all: of the one with most to explain.
    explained = max(drawings, key=lambda one: (one.rings, one.has_bone))
    about = rrb.TextDocumentView(origin=f"{explained.knee}/{ABOUT}", name="What you see")
    # Both compartments of a knee have the same gait.
    walking = [one.knee for one in drawings if not one.knee.endswith(LATERAL)][:_MAX_COLUMNS]
    gait = _states(walking or [first], [GAIT], "Stance, shaded, and swing", follow)
    words = ": contact and level" if len(drawings) <= _MAX_COLUMNS else ""
    states = [_states([one.knee], [CONTACT, LEVEL], one.knee + words, follow) for one in drawings]
    return rrb.Blueprint(
        rrb.Tabs(
            rrb.Horizontal(
                rrb.Vertical(
                    rrb.Grid(*planes, grid_columns=min(_MAX_COLUMNS, len(planes))),
                    rrb.Horizontal(about, _events(first), column_shares=[3, 2]),
                    row_shares=[5, 2],
                ),
                rrb.Vertical(*knee, gait, row_shares=[5] * len(knee) + [1 + max(len(walking), 1)]),
                name="Knee",
            ),
            rrb.Grid(*details, grid_columns=_MAX_COLUMNS, name="Contact in detail"),
            rrb.Grid(*map(_leg, drawings), name="Leg"),
            rrb.Horizontal(
                rrb.Vertical(*solver),
                rrb.Vertical(*states, *(_events(one.knee) for one in drawings[1:])),
                name="For developers: cost and errors of the solver",
            ),
        ),
        rrb.TimePanel(
            timeline=TIMELINE,
            state="collapsed",
            play_state=PlayState.Following if follow else PlayState.Paused,
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def plane_title(drawing: KneeOutlines, several: bool = False) -> str:
    """Return the title of a knee's plane; it is shorter if several planes are side by side."""
    drawn = " (drawn only)" if drawing.anatomy.thickness_is_drawn else ""
    cartilage = f"cartilage 2 × {MM * drawing.anatomy.thickness:.2g} mm{drawn}"
    return f"{drawing.knee}: {'' if several else 'sagittal plane, '}{cartilage}"


def _plane(drawing: KneeOutlines, bounds: rrb.VisualBounds2D, several: bool) -> rrb.Spatial2DView:
    """Make the view of a knee's sagittal plane."""
    camera = f"{drawing.knee}/{CAMERA}"
    cursor = rrb.TimeRangeBoundary.cursor_relative
    recent = rrb.VisibleTimeRange(
        TIMELINE, start=cursor(seconds=-_PATH_SPAN), end=cursor(seconds=0.0)
    )
    return rrb.Spatial2DView(
        origin=camera,
        contents=["$origin/**", f"{rr.new_entity_path([drawing.knee, BODY])}/**"],
        name=plane_title(drawing, several),
        background=colours.BACKGROUND,
        visual_bounds=bounds,
        overrides={f"{camera}/{CONTACT_PATH_ENTITY}": rrb.VisibleTimeRanges([recent])},
    )


def _plot(drawings: Sequence[KneeOutlines], plot: Plot, follow: bool) -> rrb.TimeSeriesView:
    """Make the view of a plot with the curves of all knees."""
    contents = [
        rr.new_entity_path([drawing.knee, CURVES, path])
        for drawing in drawings
        for path in (plot.path, *([LAYER] if plot.path == DEPTHS and drawing.has_bone else []))
    ]
    # A legend would cover curves; the title names their colours.
    legend = rrb.PlotLegend(visible=False)
    return rrb.TimeSeriesView(
        origin="/",
        contents=contents,
        name=title_of(drawings, plot),
        axis_x=_time_axis(follow),
        plot_legend=legend,
    )


def _leg(drawing: KneeOutlines) -> rrb.Spatial3DView:
    """Make the view of a knee's leg in space, from its right side, y up."""
    eye = rrb.EyeControls3D(
        position=(0.0, 0.0, 0.9), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 1.0, 0.0)
    )
    name = f"{drawing.knee}: leg and contact force"
    return rrb.Spatial3DView(
        origin=f"{drawing.knee}/{LEG}", name=name, eye_controls=eye, line_grid=False
    )


def _states(
    knees: Sequence[str], paths: Sequence[str], name: str, follow: bool
) -> rrb.StateTimelineView:
    """Make a view of some states of knees."""
    contents = [rr.new_entity_path([knee, STATES, path]) for knee in knees for path in paths]
    return rrb.StateTimelineView(
        origin="/", contents=contents, name=name, time_view=_time_axis(follow)
    )


def _events(knee: str) -> rrb.TextLogView:
    """Make the view of a knee's events."""
    # The column of stamps is too narrow to be read; the text begins with the time.
    stamp = rrb.encodings.TimelineColumn(TIMELINE, visible=False)
    columns = rrb.TextLogColumns(timeline_columns=[stamp], text_log_columns=["Body"])
    return rrb.TextLogView(origin=f"{knee}/{EVENTS}", name=f"{knee}: events", columns=columns)


def about(drawing: KneeOutlines) -> str:
    """Return what the colours and scales in a knee's plane mean, as Markdown."""
    drawn = (
        " (drawn for orientation; the law knows no thickness)"
        if drawing.anatomy.thickness_is_drawn
        else ""
    )
    reaches_bone = ", **pink** where it reaches the bone" if drawing.has_bone else ""
    lines = [
        "The knee from the side, its front to the right, at the time of the cursor.",
        f"- **light blue**: cartilage, {MM * drawing.anatomy.thickness:.2g} mm on each bone{drawn}",
        f"- **blue**{reaches_bone}: overlap of both cartilages, "
        f"its depth drawn × {MAGNIFICATION:g}",
        f"- **orange arrow**: contact force on the femur, 1 mm for {NEWTONS_PER_MM:g} N",
        f"- **dot**: contact point (grey: apart); **yellow**: its way in the last {_PATH_SPAN:g} s",
        "- **grey band** below the curves: stance, from heel strike to toe-off",
    ]
    if drawing.rings:
        lines.append(
            "- **ripple** in force and depth: the first layer of this contact law has no damping, and rings"
        )
    return "\n".join(lines)


def _time_axis(follow: bool) -> rrb.TimeAxis:
    """Make a time axis that is common to all plots, or that follows the newest answers."""
    if not follow:
        return rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)
    cursor = rrb.TimeRangeBoundary.cursor_relative
    return rrb.TimeAxis(
        view_range=rrb.TimeRange(start=cursor(seconds=-_LIVE_SPAN), end=cursor(seconds=0.0))
    )

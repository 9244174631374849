"""The layout in Rerun: entities, plots with their curves, the visible part of the plane, and tabs.

The layout is for one knee, or for several side by side, which share their plots. Entities are under the name of the
knee. Lengths are mm; names of curves include the units.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import PlayState

from knee_contact_ros.model.types import FIELDS, FLAT, MM, Floats, Rows
from knee_contact_ros.streams.topics import LATERAL
from knee_contact_ros.view import colours
from knee_contact_ros.view.anatomy import (
    NEWTONS_PER_MM,
    SURFACE_POINTS,
    KneeOutlines,
    lowest_at,
    to_tibia_frame,
)

TIMELINE = "stamp"
"""The one timeline: it has the ROS stamps"""
CURVES, EVENTS, STATES, ABOUT = "curves", "events", "states", "about"
GAIT, CONTACT, LEVEL = "gait", "contact", "level"
"""Paths of the states under `KNEE/states`"""
CAMERA, BODY = "sagittal", "body"
"""Paths of the entities of the camera, with marks in front of the knee, and of the knee"""
LEG = "leg"
"""Path of the leg in space; the robot's name in its URDF"""
PATH = "contact_path"
MICRO = 1e6
MEGA = 1e-6
SCALE_BAR = 10.0
"""Length of the scale bar [mm]"""
SEEN = np.radians([-5.0, 0.0, 15.0, 30.0, 45.0, 60.0, 70.0])
"""Flexion angles [rad] at which the whole knee must be visible"""
MARGIN, WORD = 0.04, 0.07
"""Margin around the knee, and room for words below the marks, in heights of the knee: words keep their size"""
MAGNIFICATION = 10.0
"""Factor by which the depth of the drawn overlap is magnified along the normal"""
PATH_SPAN = 1.5
"""Time [s] for which the path of the contact point stays visible: a little more than a stride"""
LIVE_SPAN = 6.0
"""Time [s] of the curves that is visible while they grow"""
ABREAST = 2
"""Largest number of planes side by side; further ones go below, or their words would overlap"""
LONGEST_TITLE = 105
"""Largest number of letters of a title on a screen of 1600 pixels; Rerun cuts longer ones"""


class Series(NamedTuple):
    """A curve of a plot: its name, style and values."""

    name: str
    """Name with the unit"""
    colour: colours.Colour
    width: float
    """Width of the line"""
    values: Callable[[Any, float], Floats]
    """Function of answers (or of their readouts) and body weight [N] that returns the values in the unit"""


class Plot(NamedTuple):
    """Curves that share a view, and properties of the view."""

    path: str
    """Path of its entity under `KNEE/curves`"""
    title: str
    """Title with the unit, and the colours of the curves if one knee has the view"""
    series: tuple[Series, ...]
    title_of_several: str = ""
    """Title if several knees share the view, to which their colours are added; empty: as `title`"""
    live: bool = False
    """Whether only a running node has it"""
    steps: bool = False
    """Whether a value holds until the next one"""
    read_off: bool = False
    """Whether it shows readouts of answers instead of their fields"""


def single(
    path: str,
    title: str,
    name: str,
    colour: colours.Colour,
    width: float,
    field: str,
    factor: float = 1.0,
    **more: Any,
) -> Plot:
    """Plot of a single curve: a field of the answers, or of their readouts, times a factor."""

    def values(of: Any, _: float) -> Floats:
        return np.asarray(factor * (of if more.get("read_off") else of.view(FLAT))[field])

    return Plot(path, title, (Series(name, colour, width, values),), **more)


LAYER = "layer"
"""Path of the entity with the depth at which the second layer begins, shown with the depths"""
LAYER_NAME = "bone begins [mm]"
LAYER_COLOUR = colours.BONE
FLEXION, CONTACT_POINT, FORCES, DEPTHS = "flexion", "contact_point", "force", "depth"
DEGREES = math.degrees(1.0)
KNEE_PLOTS = (
    single(
        FLEXION,
        "Flexion angle [deg]",
        "flexion angle [deg]",
        colours.ANGLE,
        2.0,
        "flexion_angle",
        DEGREES,
    ),
    Plot(
        FORCES,
        "Contact force ± error, orange; load and force - load, grey [BW of {weight} N]",
        (
            Series(
                "force - error [BW]",
                colours.BAND,
                1.0,
                lambda of, weight: (of["contact_force"] - of["force_error_estimate"]) / weight,
            ),
            Series(
                "force + error [BW]",
                colours.BAND,
                1.0,
                lambda of, weight: (of["contact_force"] + of["force_error_estimate"]) / weight,
            ),
            Series(
                "contact force [BW]",
                colours.FORCE,
                3.0,
                lambda answers, weight: answers["contact_force"] / weight,
            ),
            Series(
                "load [BW]", colours.LOAD, 1.0, lambda answers, weight: answers["load"] / weight
            ),
            Series(
                "force - load [BW]",
                colours.LOAD,
                1.0,
                lambda of, weight: (of["contact_force"] - of["load"]) / weight,
            ),
        ),
        title_of_several="Contact force ± error, thick; load; force - load [BW of {weight} N]",
    ),
    Plot(
        DEPTHS,
        "Depth ± error, apart < 0 [mm]",
        (
            Series(
                "depth - error [mm]",
                colours.BAND,
                1.0,
                lambda of, _: MM * (_signed(of) - of["error_estimate"]),
            ),
            Series(
                "depth + error [mm]",
                colours.BAND,
                1.0,
                lambda of, _: MM * (_signed(of) + of["error_estimate"]),
            ),
            Series("depth [mm]", colours.DEPTH, 2.0, lambda answers, _: MM * _signed(answers)),
        ),
    ),
)
"""Plots next to the sagittal plane"""
SOLVER_PLOTS = (
    Plot(
        "error",
        "Estimated errors: depth, violet [µm]; force, orange [N]",
        (
            Series(
                "error of the force [N]",
                colours.FORCE,
                1.0,
                lambda answers, _: answers["force_error_estimate"],
            ),
            Series(
                "error of the depth [µm]",
                colours.ERROR,
                2.0,
                lambda answers, _: MICRO * answers["error_estimate"],
            ),
        ),
        title_of_several="Estimated errors: depth, thick [µm]; force [N]",
    ),
    single(
        "evaluations",
        "Contact law evaluations per tick",
        "evaluations per tick",
        colours.COST,
        1.5,
        "evaluations",
        steps=True,
    ),
    single(
        "latency",
        "Latency from load to answer [ms]",
        "latency [ms]",
        colours.ANGLE,
        1.0,
        "latency",
        MM,
        live=True,
    ),
)
"""Plots in the last tab"""
PLOT_UNITS = {"m": ("mm", MM), "m/s": ("mm/s", MM), "rad": ("deg", DEGREES)}
"""Unit in which a plot shows numbers, and the factor to it, by SI unit"""
DETAIL_PLOTS = (
    single(
        CONTACT_POINT,
        "Contact point on the plateau, anterior > 0 [mm]",
        "anterior [mm]",
        colours.CARTILAGE,
        2.0,
        "contact_point_x",
        MM,
    ),
    *(
        single(
            name,
            f"{field.plot} [{unit}]",
            f"{name.replace('_', ' ')} [{unit}]",
            colours.SLIP,
            2.0,
            name,
            factor,
        )
        for name, field in FIELDS.items()
        if field.plot
        for unit, factor in [PLOT_UNITS.get(field.unit, (field.unit, 1.0))]
    ),
    Plot(
        "pressure",
        "Contact pressure: peak, thick; mean [MPa]",
        (
            Series(
                "mean pressure [MPa]",
                colours.BAND,
                1.5,
                lambda read, _: MEGA * read["mean_pressure"],
            ),
            Series(
                "peak pressure [MPa]",
                colours.FORCE,
                2.5,
                lambda read, _: MEGA * read["peak_pressure"],
            ),
        ),
        read_off=True,
    ),
    single(
        "patch",
        "Half-width of the contact patch [mm]",
        "half-width [mm]",
        colours.CARTILAGE,
        2.0,
        "half_width",
        MM,
        read_off=True,
    ),
    single(
        "strain",
        "Nominal strain of the cartilage [%]",
        "strain [%]",
        colours.DEPTH,
        2.0,
        "strain",
        100.0,
        read_off=True,
    ),
    single(
        "loading_rate",
        "Loading rate [kN/s]",
        "loading rate [kN/s]",
        colours.SLIP,
        1.0,
        "loading_rate",
        1e-3,
        read_off=True,
    ),
)
"""Plots in the second tab"""
HEIGHT_DRIVEN = KNEE_PLOTS[1]._replace(
    title="Contact force ± error [BW of {weight} N]",
    title_of_several="Contact force ± error, thick [BW of {weight} N]",
    series=KNEE_PLOTS[1].series[:3],
)
"""Plot `FORCES` if the femoral height is prescribed, so that no load drives the model"""


def _signed(answers: Rows) -> Floats:
    """Return the depth [m]; negative when apart."""
    return np.asarray(answers["penetration_depth"] - answers["gap"])


def plots_of(drawing: KneeOutlines, latency: bool) -> list[Plot]:
    """Return the plots that a knee has curves for; `latency` says whether its answers have latencies."""
    plots = [
        HEIGHT_DRIVEN if plot.path == FORCES and drawing.height_prescribed else plot
        for plot in KNEE_PLOTS
    ]
    plots += [
        plot
        for plot in (*DETAIL_PLOTS, *SOLVER_PLOTS)
        if (drawing.patch or not plot.read_off)
        and (latency or not plot.live)
        and (drawing.point_moves or plot.path != CONTACT_POINT)
    ]
    return plots


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
    shapes = [_touching(drawing, angle) for angle in SEEN]
    points = MM * np.concatenate([*shapes, knee.tibia_bone])
    height = float(np.ptp(points[:, 1]))
    margin, word = MARGIN * height, WORD * height
    (left, bottom), (right, top) = points.min(axis=0) - margin, points.max(axis=0) + margin
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
    explained = max(
        drawings, key=lambda one: (one.rings, one.has_bone)
    )  # the one with most to tell
    about = rrb.TextDocumentView(origin=f"{explained.knee}/{ABOUT}", name="What you see")
    walking = [one.knee for one in drawings if not one.knee.endswith(LATERAL)][
        :ABREAST
    ]  # both compartments walk alike
    gait = _states(walking or [first], [GAIT], "Stance, shaded, and swing", follow)
    words = ": contact and level" if len(drawings) <= ABREAST else ""
    states = [_states([one.knee], [CONTACT, LEVEL], one.knee + words, follow) for one in drawings]
    return rrb.Blueprint(
        rrb.Tabs(
            rrb.Horizontal(
                rrb.Vertical(
                    rrb.Grid(*planes, grid_columns=min(ABREAST, len(planes))),
                    rrb.Horizontal(about, _events(first), column_shares=[3, 2]),
                    row_shares=[5, 2],
                ),
                rrb.Vertical(*knee, gait, row_shares=[5] * len(knee) + [1 + max(len(walking), 1)]),
                name="Knee",
            ),
            rrb.Grid(*details, grid_columns=ABREAST, name="Contact in detail"),
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


def title_of(drawings: Sequence[KneeOutlines], plot: Plot) -> str:
    """Return the title of a plot: its quantities, unit and colours; with several knees, the colours of the knees."""
    weight = " or ".join(sorted({f"{drawing.body_weight:.0f}" for drawing in drawings}))
    several = len(drawings) > 1
    title = ((several and plot.title_of_several) or plot.title).format(weight=weight)
    if plot.path == DEPTHS and any(drawing.has_bone for drawing in drawings):
        title += "; bone begins, pink"
    if plot.path == DEPTHS and any(drawing.rings for drawing in drawings):
        title += "; undamped layer rings"
    if not several:
        return title
    names = [
        f"{drawing.knee} {[*colours.KNEE_COLOURS][number % len(colours.KNEE_COLOURS)]}"
        for number, drawing in enumerate(drawings)
        if plot.path in {one.path for one in plots_of(drawing, latency=True)}
    ]
    full = f"{title}: {', '.join(names)}"
    return (
        full
        if len(full) <= LONGEST_TITLE or plot.path == FLEXION
        else f"{title}: colours as for flexion"
    )


def plane_title(drawing: KneeOutlines, several: bool = False) -> str:
    """Return the title of a knee's plane; it is shorter if several planes are side by side."""
    drawn = " (drawn only)" if drawing.anatomy.thickness_is_drawn else ""
    cartilage = f"cartilage 2 × {MM * drawing.anatomy.thickness:.2g} mm{drawn}"
    return f"{drawing.knee}: {'' if several else 'sagittal plane, '}{cartilage}"


def _plane(drawing: KneeOutlines, bounds: rrb.VisualBounds2D, several: bool) -> rrb.Spatial2DView:
    """Make the view of a knee's sagittal plane."""
    camera, cursor = f"{drawing.knee}/{CAMERA}", rrb.TimeRangeBoundary.cursor_relative
    recent = rrb.VisibleTimeRange(
        TIMELINE, start=cursor(seconds=-PATH_SPAN), end=cursor(seconds=0.0)
    )
    return rrb.Spatial2DView(
        origin=camera,
        contents=["$origin/**", f"{rr.new_entity_path([drawing.knee, BODY])}/**"],
        name=plane_title(drawing, several),
        background=colours.BACKGROUND,
        visual_bounds=bounds,
        overrides={f"{camera}/{PATH}": rrb.VisibleTimeRanges([recent])},
    )


def _plot(drawings: Sequence[KneeOutlines], plot: Plot, follow: bool) -> rrb.TimeSeriesView:
    """Make the view of a plot with the curves of all knees."""
    contents = [
        rr.new_entity_path([drawing.knee, CURVES, path])
        for drawing in drawings
        for path in (plot.path, *([LAYER] if plot.path == DEPTHS and drawing.has_bone else []))
    ]
    legend = rrb.PlotLegend(visible=False)  # it would cover curves; the title tells the colours
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
    stamp = rrb.encodings.TimelineColumn(
        TIMELINE, visible=False
    )  # too narrow to be read; the text tells the time
    columns = rrb.TextLogColumns(timeline_columns=[stamp], text_log_columns=["Body"])
    return rrb.TextLogView(origin=f"{knee}/{EVENTS}", name=f"{knee}: events", columns=columns)


def about(drawing: KneeOutlines) -> str:
    """Return what the colours and scales in a knee's plane mean, as Markdown."""
    drawn = " (an illustration: the law has none)" if drawing.anatomy.thickness_is_drawn else ""
    lines = [
        "The knee from the side, its front to the right, at the time of the cursor.",
        f"- **light blue**: cartilage, {MM * drawing.anatomy.thickness:.2g} mm on each bone{drawn}",
        f"- **blue**{', **pink** where it reaches the bone' if drawing.has_bone else ''}: overlap of both cartilages, "
        f"its depth drawn × {MAGNIFICATION:g}",
        f"- **orange arrow**: contact force on the femur, 1 mm for {NEWTONS_PER_MM:g} N",
        f"- **dot**: contact point (grey: apart); **yellow**: its way in the last {PATH_SPAN:g} s",
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
        view_range=rrb.TimeRange(start=cursor(seconds=-LIVE_SPAN), end=cursor(seconds=0.0))
    )

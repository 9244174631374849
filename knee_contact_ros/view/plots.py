"""The plots beside the knee in Rerun: which curves they have, with their colours, units and titles."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..model.types import FIELDS, FLAT, MM, Floats, Rows
from . import colours
from .anatomy import KneeOutlines

DEGREES = math.degrees(1.0)
MICROMETRES = 1e6
MEGAPASCALS = 1e-6
LONGEST_TITLE = 105
"""Largest number of letters of a title on a screen of 1600 pixels; Rerun cuts longer ones"""
FLEXION = "flexion"
CONTACT_POINT = "contact_point"
FORCES = "force"
DEPTHS = "depth"
LAYER = "layer"
"""Path of the entity with the depth at which the second layer begins, shown with the depths"""
LAYER_NAME = "bone begins [mm]"
LAYER_COLOUR = colours.BONE


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
    from_readouts: bool = False
    """Whether it shows readouts of answers instead of their fields"""


def _single(
    path: str,
    title: str,
    name: str,
    colour: colours.Colour,
    width: float,
    field: str,
    factor: float = 1.0,
    **more: Any,
) -> Plot:
    """Make a plot of a single curve: a field of the answers, or of their readouts, times a factor."""

    def values(rows: Any, _weight: float) -> Floats:
        numbers = rows if more.get("from_readouts") else rows.view(FLAT)
        return np.asarray(factor * numbers[field])

    return Plot(path, title, (Series(name, colour, width, values),), **more)


def _field(name: str, factor: float) -> Callable[[Any, float], Floats]:
    """Return the function of a curve that is a field times a factor."""
    return lambda rows, _weight: factor * rows[name]


def _error_band(
    what: str, unit: str, bound: Callable[[float, Any, float], Floats]
) -> tuple[Series, Series]:
    """Make the curves of a quantity minus and plus its error; `bound` is a function of the sign, as `values` else."""
    return (
        Series(f"{what} - error [{unit}]", colours.BAND, 1.0, partial(bound, -1.0)),
        Series(f"{what} + error [{unit}]", colours.BAND, 1.0, partial(bound, 1.0)),
    )


def _force_bound(sign: float, answers: Any, weight: float) -> Floats:
    return np.asarray((answers["contact_force"] + sign * answers["force_error_estimate"]) / weight)


def _depth_bound(sign: float, answers: Any, _weight: float) -> Floats:
    return np.asarray(MM * (_signed_depth(answers) + sign * answers["error_estimate"]))


def _signed_depth(answers: Rows) -> Floats:
    """Return the depth [m]; negative when apart."""
    return np.asarray(answers["penetration_depth"] - answers["gap"])


_FORCE_SERIES = (
    *_error_band("force", "BW", _force_bound),
    Series(
        "contact force [BW]",
        colours.FORCE,
        3.0,
        lambda answers, weight: answers["contact_force"] / weight,
    ),
)
_LOAD_SERIES = (
    Series("load [BW]", colours.LOAD, 1.0, lambda answers, weight: answers["load"] / weight),
    Series(
        "force - load [BW]",
        colours.LOAD,
        1.0,
        lambda answers, weight: (answers["contact_force"] - answers["load"]) / weight,
    ),
)
_DEPTH_SERIES = (
    *_error_band("depth", "mm", _depth_bound),
    Series("depth [mm]", colours.DEPTH, 2.0, lambda answers, _: MM * _signed_depth(answers)),
)
_FLEXION_PLOT = _single(
    FLEXION,
    "Flexion angle [deg]",
    "flexion angle [deg]",
    colours.ANGLE,
    2.0,
    "flexion_angle",
    DEGREES,
)
KNEE_PLOTS = (
    _FLEXION_PLOT,
    Plot(
        FORCES,
        "Contact force (orange), load and their difference (grey) [BW of {weight} N]",
        (*_FORCE_SERIES, *_LOAD_SERIES),
        title_of_several="Contact force (thick), load, force - load [BW of {weight} N]",
    ),
    Plot(DEPTHS, "Depth, below 0 when apart [mm]", _DEPTH_SERIES),
)
"""Plots next to the sagittal plane"""
_FORCES_WITHOUT_LOAD = Plot(
    FORCES,
    "Contact force [BW of {weight} N]",
    _FORCE_SERIES,
    title_of_several="Contact force (thick) [BW of {weight} N]",
)
"""Plot `FORCES` if the femoral height is prescribed, so that no load drives the model"""
SOLVER_PLOTS = (
    Plot(
        "error",
        "Estimated errors: depth, violet [µm]; force, orange [N]",
        (
            Series(
                "error of the force [N]", colours.FORCE, 1.0, _field("force_error_estimate", 1.0)
            ),
            Series(
                "error of the depth [µm]",
                colours.ERROR_BAND,
                2.0,
                _field("error_estimate", MICROMETRES),
            ),
        ),
        title_of_several="Estimated errors: depth, thick [µm]; force [N]",
    ),
    _single(
        "evaluations",
        "Contact law evaluations per tick",
        "evaluations per tick",
        colours.COST,
        1.5,
        "evaluations",
        steps=True,
    ),
    _single(
        "latency",
        "Latency from load to answer [ms]",
        "latency [ms]",
        colours.ANGLE,
        1.0,
        "latency",
        1e3,
        live=True,
    ),
)
"""Plots in the last tab"""
_PLOT_UNITS = {"m": ("mm", MM), "m/s": ("mm/s", MM), "rad": ("deg", DEGREES)}
"""Unit in which a plot shows numbers, and the factor to it, by SI unit"""


def _fields_with_plots() -> list[Plot]:
    """Make the plots of the fields of the answer that have one of their own."""
    plots = []
    for name, field in FIELDS.items():
        unit, factor = _PLOT_UNITS.get(field.unit, (field.unit, 1.0))
        if field.plot:
            title = f"{field.plot} [{unit}]"
            curve = f"{name.replace('_', ' ')} [{unit}]"
            plots.append(_single(name, title, curve, colours.SLIP, 2.0, name, factor))
    return plots


DETAIL_PLOTS = (
    _single(
        CONTACT_POINT,
        "Contact point on the plateau, anterior > 0 [mm]",
        "anterior [mm]",
        colours.CARTILAGE,
        2.0,
        "contact_point_x",
        MM,
    ),
    *_fields_with_plots(),
    Plot(
        "pressure",
        "Contact pressure: peak, thick; mean [MPa]",
        (
            Series("mean pressure [MPa]", colours.BAND, 1.5, _field("mean_pressure", MEGAPASCALS)),
            Series(
                "peak pressure [MPa]", colours.FORCE, 2.5, _field("peak_pressure", MEGAPASCALS)
            ),
        ),
        from_readouts=True,
    ),
    _single(
        "patch",
        "Half-width of the contact patch [mm]",
        "half-width [mm]",
        colours.CARTILAGE,
        2.0,
        "half_width",
        MM,
        from_readouts=True,
    ),
    _single(
        "strain",
        "Nominal strain of {thickness} mm of cartilage [%]",
        "strain [%]",
        colours.DEPTH,
        2.0,
        "strain",
        100.0,
        from_readouts=True,
    ),
    _single(
        "loading_rate",
        "Loading rate [kN/s]",
        "loading rate [kN/s]",
        colours.SLIP,
        1.0,
        "loading_rate",
        1e-3,
        from_readouts=True,
    ),
)
"""Plots in the second tab"""


def plots_of(knee: KneeOutlines, latency: bool) -> list[Plot]:
    """Return the plots that a knee has curves for; `latency` says whether its answers have latencies."""
    flexion, forces, depths = KNEE_PLOTS
    if knee.height_prescribed:
        forces = _FORCES_WITHOUT_LOAD
    others = [
        plot
        for plot in (*DETAIL_PLOTS, *SOLVER_PLOTS)
        if (knee.patch or not plot.from_readouts)
        and (latency or not plot.live)
        and (knee.point_moves or plot.path != CONTACT_POINT)
    ]
    return [flexion, forces, depths, *others]


def title_of(knees: Sequence[KneeOutlines], plot: Plot) -> str:
    """Return the title of a plot: its quantities, unit and colours; with several knees, the colours of the knees."""
    weight = " or ".join(sorted({f"{knee.body_weight:.0f}" for knee in knees}))
    thick = {f"{MM * knee.patch.thickness:.3g}" for knee in knees if knee.patch}
    several = len(knees) > 1
    title = ((several and plot.title_of_several) or plot.title).format(
        weight=weight, thickness=" or ".join(sorted(thick))
    )
    if plot.path == DEPTHS and any(knee.has_bone for knee in knees):
        title += "; bone begins, pink"
    if plot.path == DEPTHS and any(knee.rings for knee in knees):
        title += "; undamped layer rings"
    if not several:
        return title
    names = [
        f"{knee.knee} {[*colours.KNEE_COLOURS][number % len(colours.KNEE_COLOURS)]}"
        for number, knee in enumerate(knees)
        if plot.path in {one.path for one in plots_of(knee, latency=True)}
    ]
    full = f"{title}: {', '.join(names)}"
    if len(full) <= LONGEST_TITLE or plot.path == FLEXION:
        return full
    return f"{title}: colours as for flexion"

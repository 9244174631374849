"""The curves of the scene: a plot is one entity, with its series in the order given here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.types import Rows
from knee_contact_ros.view.colours import ANGLE, BAND, BONE, CARTILAGE, COST, DEPTH, ERROR, FORCE, LOAD, SLIP, Colour
from knee_contact_ros.view.outlines import KneeOutlines

Floats = NDArray[np.float64]
MM = 1e3
MICRO = 1e6
MEGA = 1e-6


NOISE, LEAST = 3.0, 0.01
"""Noise of force less load: `NOISE` times the estimated error of the force, and at least `LEAST` [BW]"""


class Series(NamedTuple):
    """A curve of a plot: its name, style and values."""

    name: str
    """Name with the unit"""
    colour: Colour
    width: float
    """Width of the line"""
    values: Callable[[Any, float], Floats]
    """Function of answers (or of their readouts) and body weight [N] that returns the values in the unit"""


class Plot(NamedTuple):
    """Curves that share a view, and what is known of the view."""

    path: str
    """Path of its entity under `KNEE/curves`"""
    title: str
    """Title with the unit, and the colours of the curves if one knee has the view"""
    series: tuple[Series, ...]
    title_of_several: str = ""
    """Title where several knees share the view and their colours are added to it; empty: as `title`"""
    live: bool = False
    """Whether only a running node has it"""
    steps: bool = False
    """Whether a value holds until the next one"""
    read_off: bool = False
    """Whether it shows readouts of answers, and not their fields"""


def _excess(answers: Rows, weight: float) -> Floats:
    """Return contact force less load [BW]; 0 where it is noise."""
    excess = answers["contact_force"] - answers["load"]
    noise = np.maximum(NOISE * np.nan_to_num(answers["force_error_estimate"]), LEAST * weight)
    return np.asarray(np.where(np.abs(excess) > noise, excess, 0.0) / weight)


LAYER = "layer"
"""Path of the entity with the depth at which the second layer begins, shown with the depths"""
LAYER_NAME = "bone begins [mm]"
LAYER_COLOUR = BONE
FLEXION, CONTACT_POINT, FORCES, DEPTHS = "flexion", "contact_point", "force", "depth"
KNEE = (
    Plot(FLEXION, "Flexion angle [deg]", (
        Series("flexion angle [deg]", ANGLE, 2.0, lambda answers, _: np.degrees(answers["flexion_angle"])),
    )),
    Plot(FORCES, "Contact force ± error, orange; load and force - load, grey [BW of {weight} N]", (
        Series("force - error [BW]", BAND, 1.0,
               lambda of, weight: (of["contact_force"] - of["force_error_estimate"]) / weight),
        Series("force + error [BW]", BAND, 1.0,
               lambda of, weight: (of["contact_force"] + of["force_error_estimate"]) / weight),
        Series("contact force [BW]", FORCE, 3.0, lambda answers, weight: answers["contact_force"] / weight),
        Series("load [BW]", LOAD, 1.0, lambda answers, weight: answers["load"] / weight),
        Series("force - load [BW]", LOAD, 1.0, _excess),
    ), title_of_several="Contact force ± error, thick; load; force - load [BW of {weight} N]"),
    Plot(DEPTHS, "Depth ± error, apart < 0 [mm]", (
        Series("depth - error [mm]", BAND, 1.0, lambda of, _: MM * (_signed(of) - of["error_estimate"])),
        Series("depth + error [mm]", BAND, 1.0, lambda of, _: MM * (_signed(of) + of["error_estimate"])),
        Series("depth [mm]", DEPTH, 2.0, lambda answers, _: MM * _signed(answers)),
    )),
    Plot(CONTACT_POINT, "Contact point on the plateau, anterior > 0 [mm]", (
        Series("anterior [mm]", CARTILAGE, 2.0, lambda answers, _: MM * answers["contact_point"]["x"]),
    )),
)  # fmt: skip
"""Plots beside the sagittal plane"""
DETAILS = (
    Plot("sliding", "Sliding velocity, anterior > 0 [mm/s]", (
        Series("sliding velocity [mm/s]", SLIP, 2.0, lambda answers, _: MM * answers["sliding_velocity"]),
    )),
    Plot("error", "Estimated errors: depth, violet [µm]; force, orange [N]", (
        Series("error of the force [N]", FORCE, 1.0, lambda answers, _: answers["force_error_estimate"]),
        Series("error of the depth [µm]", ERROR, 2.0, lambda answers, _: MICRO * answers["error_estimate"]),
    ), title_of_several="Estimated errors: depth, thick [µm]; force [N]"),
    Plot("evaluations", "Contact law evaluations per tick", (
        Series("evaluations per tick", COST, 1.5, lambda answers, _: answers["evaluations"]),
    ), steps=True),
    Plot("latency", "Latency from load to answer [ms]", (
        Series("latency [ms]", ANGLE, 1.0, lambda answers, _: MM * answers["latency"]),
    ), live=True),
)  # fmt: skip
"""Plots in the second tab"""
READ_OFF = (
    Plot("pressure", "Contact pressure: peak, thick; mean [MPa]", (
        Series("mean pressure [MPa]", BAND, 1.5, lambda read, _: MEGA * read["mean_pressure"]),
        Series("peak pressure [MPa]", FORCE, 2.5, lambda read, _: MEGA * read["peak_pressure"]),
    ), read_off=True),
    Plot("patch", "Half-width of the contact patch [mm]", (
        Series("half-width [mm]", CARTILAGE, 2.0, lambda read, _: MM * read["half_width"]),
    ), read_off=True),
    Plot("strain", "Nominal strain of the cartilage [%]", (
        Series("strain [%]", DEPTH, 2.0, lambda read, _: 100.0 * read["strain"]),
    ), read_off=True),
    Plot("loading_rate", "Loading rate [kN/s]", (
        Series("loading rate [kN/s]", SLIP, 1.0, lambda read, _: 1e-3 * read["loading_rate"]),
    ), read_off=True),
)  # fmt: skip
"""Plots in the third tab"""


FORCE_PLACE, LOAD_PLACE = 2, 3
"""Places of contact force and load among the series of `FORCES`"""


HEIGHT_DRIVEN = KNEE[1]._replace(
    title="Contact force ± error [BW of {weight} N]",
    title_of_several="Contact force ± error, thick [BW of {weight} N]",
    series=KNEE[1].series[:LOAD_PLACE],
)
"""Plot `FORCES` where the femoral height is prescribed: no load drives the model there"""


def _signed(answers: Rows) -> Floats:
    """Return the depth [m]; negative when apart."""
    return np.asarray(answers["penetration_depth"] - answers["gap"])


def plots_of(drawing: KneeOutlines, latency: bool) -> list[Plot]:
    """Return the plots that a knee has curves for; `latency` says whether its answers have latencies."""
    plots = [plot for plot in KNEE if drawing.point_moves or plot.path != CONTACT_POINT]
    if drawing.height_prescribed:
        plots = [HEIGHT_DRIVEN if plot.path == FORCES else plot for plot in plots]
    plots += [plot for plot in DETAILS if latency or not plot.live]
    return [*plots, *READ_OFF] if drawing.patch else plots

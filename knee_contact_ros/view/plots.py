"""The curves: one plot an entity, its series in this order."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.types import Rows
from knee_contact_ros.view.colours import ANGLE, BAND, BONE, CARTILAGE, COST, DEPTH, ERROR, FORCE, LOAD, SLIP, Colour

Floats = NDArray[np.float64]
MM = 1e3
MICRO = 1e6


class Series(NamedTuple):
    """A curve."""

    name: str
    """In the legend, with its unit"""
    colour: Colour
    width: float
    values: Callable[[Rows, float], Floats]
    """Of answers and body weight [N], in that unit"""


class Plot(NamedTuple):
    """Curves that share a view."""

    path: str
    """Of its entity under `KNEE/curves`"""
    title: str
    series: tuple[Series, ...]
    live: bool = False
    """Whether only a running node has it"""
    steps: bool = False
    """Whether a value holds until the next one"""


LAYER = "layer"
"""Entity with the depth at which the second layer begins, shown with the depths"""
LAYER_NAME = "bone begins [mm]"
LAYER_COLOUR = BONE
FLEXION, CONTACT_POINT, SLIDING, NEWTONS, BODY_WEIGHTS, DEPTHS = (
    "flexion", "contact_point", "sliding", "force_newton", "force_body_weights", "depth"
)  # fmt: skip
PLOTS = (
    Plot(FLEXION, "Flexion angle [deg]", (
        Series("flexion angle [deg]", ANGLE, 2.0, lambda shown, _: np.degrees(shown["flexion_angle"])),
    )),
    Plot(CONTACT_POINT, "Contact point, anterior > 0 [mm]", (
        Series("anterior [mm]", CARTILAGE, 2.0, lambda shown, _: MM * shown["contact_point"]["x"]),
    )),
    Plot(SLIDING, "Sliding velocity, anterior > 0 [mm/s]", (
        Series("sliding velocity [mm/s]", SLIP, 2.0, lambda shown, _: MM * shown["sliding_velocity"]),
    )),
    Plot(NEWTONS, "Force ± error [N]; load grey", (
        Series("force - error [N]", BAND, 1.0, lambda shown, _: shown["contact_force"] - shown["force_error_estimate"]),
        Series("force + error [N]", BAND, 1.0, lambda shown, _: shown["contact_force"] + shown["force_error_estimate"]),
        Series("contact force [N]", FORCE, 3.0, lambda shown, _: shown["contact_force"]),
        Series("load [N]", LOAD, 1.0, lambda shown, _: shown["load"]),
    )),
    Plot(BODY_WEIGHTS, "Force [BW]; load grey", (
        Series("contact force [BW]", FORCE, 3.0, lambda shown, weight: shown["contact_force"] / weight),
        Series("load [BW]", LOAD, 1.0, lambda shown, weight: shown["load"] / weight),
    )),
    Plot(DEPTHS, "Depth ± error [mm]; pink: bone", (
        Series("depth - error [mm]", BAND, 1.0, lambda of, _: MM * (of["penetration_depth"] - of["error_estimate"])),
        Series("depth + error [mm]", BAND, 1.0, lambda of, _: MM * (of["penetration_depth"] + of["error_estimate"])),
        Series("penetration depth [mm]", DEPTH, 2.0, lambda shown, _: MM * shown["penetration_depth"]),
        Series("gap [mm]", LOAD, 1.0, lambda shown, _: MM * shown["gap"]),
    )),
    Plot("error", "Error: depth [µm], orange force [N]", (
        Series("error of the force [N]", FORCE, 1.5, lambda shown, _: shown["force_error_estimate"]),
        Series("error of the depth [µm]", ERROR, 1.5, lambda shown, _: MICRO * shown["error_estimate"]),
    )),
    Plot("evaluations", "Contact law evaluations per tick", (
        Series("evaluations per tick", COST, 1.5, lambda shown, _: shown["evaluations"]),
    ), steps=True),
    Plot("latency", "Latency from load to answer [ms]", (
        Series("latency [ms]", ANGLE, 1.0, lambda shown, _: MM * shown["latency"]),
    ), live=True),
)  # fmt: skip

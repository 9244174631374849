"""Units of times, angles, forces, moments and lengths in files of others, and their factors to SI units."""

import math
import re
from pathlib import Path
from typing import Literal

from scipy import constants

from ..joint_reaction.leg import GRAVITY
from ..system.errors import UsageError
from .cells import NOT_A_NUMBER

ColumnName = str | int
"""Name of a column, or its place from 1"""

Dimension = Literal["time", "angle", "force", "moment", "length"]
"""What a unit measures"""
BODY_WEIGHTS = "BW"
"""Unit of force that needs the map's `body_weight`"""
PERCENT_BODY_WEIGHT = "%BW"
"""The same in percent"""
UNIT_FACTORS: dict[Dimension, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "angle": {"rad": 1.0, "deg": constants.degree, "mrad": 1e-3, "rev": 2.0 * math.pi},
    "force": {
        "N": 1.0,
        "kN": 1e3,
        "mN": 1e-3,
        "lbf": constants.lbf,
        "kgf": constants.kgf,
        BODY_WEIGHTS: 1.0,
        PERCENT_BODY_WEIGHT: 0.01,
        "N/kg": 1.0 / GRAVITY,
    },
    "moment": {
        "N*m": 1.0,
        "N*mm": 1e-3,
        "kN*m": 1e3,
        "lbf*in": constants.lbf * constants.inch,
        "lbf*ft": constants.lbf * constants.foot,
        "N*m/kg": 1.0 / GRAVITY,
        "N*mm/kg": 1e-3 / GRAVITY,
    },
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
}
"""Factors of units to s, rad, N, N m and m, by dimension; of those relative to the body to body weights"""
_ALIASES = {
    **dict.fromkeys(("sec", "second", "seconds"), "s"),
    **dict.fromkeys(("µs", "μs"), "us"),
    **dict.fromkeys(("degree", "degrees", "°"), "deg"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("newton", "newtons"), "N"),
    **dict.fromkeys(("lb", "lbs"), "lbf"),
    **dict.fromkeys(("kp", "kg"), "kgf"),
    **dict.fromkeys(("µm", "μm"), "um"),
    "xbw": BODY_WEIGHTS,
    "percentbw": PERCENT_BODY_WEIGHT,
}
"""Other names of units"""
_UNIT_NAMES = {
    unit.replace("*", "").lower(): unit
    for units in UNIT_FACTORS.values()
    for unit in units
    if unit != "mN"  # in lower case, MN would be the same
} | _ALIASES
"""Names of units by what is left of them without signs and in lower case"""
_NO_UNIT = re.compile(r"\d+|[RL]|right|left", re.IGNORECASE)
"""What stands in brackets behind a name and is no unit: an index, a side"""
_OTHER_UNITS = {"g", "V", "mV", "W", "Hz"}
"""Units of other quantities, which only a factor can turn into one of ours"""
_IF_FILE_IS_WRONG = (
    "; where the file is wrong, name the column by its place (column: 2), and the first row below the units "
    "(table.first_line)"
)
"""What helps against a wrong unit in a file"""
TYPICAL_BODY_WEIGHT = 700.0
"""Weight of a body [N] where none is given and only its order of magnitude counts"""
_LARGEST_CALIBRATION = math.log(2.0)
"""Logarithm of the largest factor that may be a sensor's calibration; a larger one converts a unit. Tuned; see the
weights in tests/lab/test_sensors.py"""


def unit_name(unit: str) -> str:
    """Return a unit as `UNIT_FACTORS` has it, also if it is written as KN, N.m or Degrees; other texts are kept."""
    return _UNIT_NAMES.get(re.sub(r"[\s.*·⋅-]", "", unit).lower(), unit)


def unit_factor(
    unit: str, dimension: Dimension, what: str, body_weight: float | None = None
) -> float:
    """Return the factor of a unit of a dimension to SI; `what` names the value in messages.

    Raises:
        UsageError: the unit is not one of this dimension, or needs the missing `body_weight` [N].
    """
    name = unit_name(unit)
    factors = UNIT_FACTORS[dimension]
    if name not in factors:
        raise UsageError(
            f"{what}: unit {unit!r} is not one of a {dimension}; allowed: {', '.join(factors)}"
        )
    if name not in {BODY_WEIGHTS, PERCENT_BODY_WEIGHT} and not name.endswith("/kg"):
        return factors[name]
    if body_weight is None:
        raise UsageError(f"{what}: unit {name} needs body_weight [N] in the map")
    return factors[name] * body_weight


def check_unit(
    path: Path,
    column: ColumnName,
    stated: str,
    unit: str,
    what: str,
    *,
    multiplier: float = 1.0,
    cure: str = _IF_FILE_IS_WRONG,
) -> tuple[str, ...]:
    """Check the unit that a file states of a column against the one that the user gives.

    Args:
        path: The file, for messages.
        column: The column, for messages.
        stated: Unit in the file; empty if there is none.
        unit: The given unit.
        what: Name of the given unit in messages.
        multiplier: What the column is multiplied by, which may convert it from one unit to the other.
        cure: End of the message.

    Returns:
        A note if the stated unit is not known, or nothing.

    Raises:
        UsageError: the units contradict each other.
    """
    name = unit_name(stated.lstrip("_"))
    dimension = next(kind for kind, units in UNIT_FACTORS.items() if unit_name(unit) in units)
    known = name in UNIT_FACTORS[dimension]
    if (
        not stated
        or _NO_UNIT.fullmatch(stated)
        or NOT_A_NUMBER.fullmatch(stated)
        or name == unit_name(unit)
    ):
        return ()
    if unit_name(unit) == f"{name}/kg":  # as in the C3D files of Plug-in Gait; peaks are checked
        return (f"{path.name} says {name} of column {column}, read as {unit_name(unit)}",)
    # The end of a column's name may be another word: _n the normal load, _m the medial one.
    if stated == "_n" or (stated[0] == "_" and not known):
        return ()
    unconverted = abs(math.log(abs(multiplier)))
    is_calibration = unconverted < _LARGEST_CALIBRATION
    if known:
        here, there = (
            unit_factor(each, dimension, what, TYPICAL_BODY_WEIGHT) for each in (unit, name)
        )
        converted = abs(math.log(abs(multiplier) * here / there))
        contradicts = converted >= min(unconverted, _LARGEST_CALIBRATION)
    else:
        is_unit = name in {*_UNIT_NAMES.values(), *_OTHER_UNITS} or "/" in name
        contradicts = is_calibration and is_unit
    if contradicts:
        raise UsageError(
            f"{path} says {stated.lstrip('_')} of column {column}, and {what} {unit}{cure}"
        )
    if known or not is_calibration:
        return ()
    return (f"{path.name}: {stated!r} is not a known unit ({what} {unit})",)

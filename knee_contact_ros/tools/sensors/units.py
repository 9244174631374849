"""Units of a file's columns, and their factors to SI units."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping

from knee_contact_ros.system.errors import UsageError

POUND_FORCE, KILOPOND, INCH = 4.4482216152605, 9.80665, 0.0254
TIME, ANGLE, FORCE, MOMENT = "time", "angle", "force", "moment"
BODY_WEIGHT = "BW"
"""Unit of force that needs the map's `body_weight`"""
UNITS: Mapping[str, Mapping[str, float]] = {
    TIME: {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    ANGLE: {"rad": 1.0, "deg": math.radians(1.0), "mrad": 1e-3, "rev": 2.0 * math.pi},
    FORCE: {"N": 1.0, "kN": 1e3, "mN": 1e-3, "lbf": POUND_FORCE, "kgf": KILOPOND, BODY_WEIGHT: math.nan},
    MOMENT: {"N*m": 1.0, "N*mm": 1e-3, "kN*m": 1e3, "lbf*in": POUND_FORCE * INCH, "lbf*ft": 12.0 * POUND_FORCE * INCH},
}
"""Factors of units to s, rad, N and N m, by quantity"""
ALIASES = {
    "sec": "s", "second": "s", "seconds": "s", "µs": "us", "μs": "us",
    "degree": "deg", "degrees": "deg", "°": "deg", "radian": "rad", "radians": "rad",
    "newton": "N", "newtons": "N", "lb": "lbf", "kp": "kgf", "Nm": "N*m", "Nmm": "N*mm", "N m": "N*m", "N mm": "N*mm",
}  # fmt: skip


def factor(unit: str, kind: str, what: str, body_weight: float | None = None) -> float:
    """Factor of a unit to SI; `kind` is the quantity that it must be of, `what` names the value in messages.

    Raises:
        UsageError: the unit is not known or is of another quantity, or it is BW and there is no `body_weight` [N].
    """
    name = ALIASES.get(unit, unit)
    if name == BODY_WEIGHT and kind == FORCE:
        if body_weight is None:
            raise UsageError(f"{what}: unit BW needs body_weight [N] in the map")
        return body_weight
    if name in UNITS[kind]:
        return UNITS[kind][name]
    known = ", ".join(UNITS[kind])
    other = next((quantity for quantity, units in UNITS.items() if name in units), None)
    if other is not None:
        raise UsageError(f"{what}: unit {unit} cannot be: it is a unit of {other}, and {kind} is wanted: {known}")
    near = difflib.get_close_matches(unit, UNITS[kind], n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}? " if near else ""
    raise UsageError(f"{what}: unit {unit!r} is not known; {hint}allowed: {known}")

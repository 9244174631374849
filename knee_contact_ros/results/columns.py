"""The numbers of answers as plain columns, with their units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.types import FLAT, Rows
from knee_contact_ros.system.errors import UsageError

NANOSECOND = 1e-9
DATES_FROM = 10 * 365 * 86_400 * 1_000_000_000
"""Stamps [ns] from which on they are dates; those of simulations and of trials begin near 0"""
TIME = "time"
UNITS = {
    TIME: "s", "flexion_angle": "rad", "load": "N", "contact_force": "N", "penetration_depth": "m", "gap": "m",
    "penetration_rate": "m/s", "sliding_velocity": "m/s", "contact_point": "m", "femoral_height": "m",
    "cartilage_depth": "m", "bone_depth": "m", "error_estimate": "m", "force_error_estimate": "N",
    "contact_wrench_force": "N", "contact_wrench_torque": "N m", "stamp": "ns", "femoral_x": "m", "latency": "s",
}  # fmt: skip
"""Of the fields, those of vectors without their component; what is missing has none"""


def time_of(rows: Rows) -> NDArray[np.float64]:
    """Stamps in seconds, shape (n,)."""
    seconds: NDArray[np.float64] = np.asarray(rows["stamp"]) * NANOSECOND
    return seconds


def begin_of(first: int) -> int:
    """The stamp [ns] from which on a person is told the time of answers: 0, or the first one if it is a date."""
    return first if first >= DATES_FROM else 0


def told(stamp: int, begin: int) -> str:
    """A stamp [ns] in seconds, as short as it can be told; `begin` is what `begin_of` gives."""
    return f"{NANOSECOND * (stamp - begin):{'+' if begin else ''}.3f}"


def columns(rows: Rows) -> dict[str, NDArray[Any]]:
    """Every number of every answer by its name, shape (n,) each, vectors as `contact_point_x`; first the time [s].

    Of some of the fields, those numbers alone.

    Raises:
        UsageError: the stamp is not among the fields.
    """
    if "stamp" not in (rows.dtype.names or ()):
        raise UsageError(f"fields {', '.join(rows.dtype.names or ())}: stamp must be one of them, which gives the time")
    flat = np.asarray(rows).view(FLAT)
    names = [name for name in FLAT.names or () if _is_of(name, rows.dtype)]
    return {TIME: time_of(rows)} | {name: np.ascontiguousarray(flat[name]) for name in names}


def _is_of(name: str, fields: np.dtype[Any]) -> bool:
    """Whether a number is in one of some fields, which lie where they lie in a whole answer."""
    place = _places(FLAT)[name][1]
    return any(begin <= place < begin + kind.itemsize for kind, begin, *_ in _places(fields).values())


def _places(fields: np.dtype[Any]) -> Mapping[str, tuple[Any, ...]]:
    """Of each field the kind of its values and the byte at which it begins."""
    return fields.fields or {}


def unit_of(name: str) -> str:
    """The SI unit of a column; empty if it has none."""
    return UNITS.get(name, UNITS.get(name.rsplit("_", 1)[0] if name[-2:] in ("_x", "_y", "_z") else "", ""))

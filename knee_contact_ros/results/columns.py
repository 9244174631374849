"""The numbers of answers as flat columns, with their units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.types import FLAT, NANOSECOND, Rows
from knee_contact_ros.system.errors import UsageError

DATES_FROM = 10 * 365 * 86_400 * 1_000_000_000
"""The least stamp [ns] that is a date; those of simulations and of trials begin near 0"""
TIME = "time"
"""Name of the column with the time"""
UNITS = {
    TIME: "s", "flexion_angle": "rad", "load": "N", "contact_force": "N", "penetration_depth": "m", "gap": "m",
    "penetration_rate": "m/s", "sliding_velocity": "m/s", "contact_point": "m", "femoral_height": "m",
    "cartilage_depth": "m", "bone_depth": "m", "error_estimate": "m", "force_error_estimate": "N",
    "contact_wrench_force": "N", "contact_wrench_torque": "N m", "stamp": "ns", "femoral_x": "m", "latency": "s",
}  # fmt: skip
"""SI units of the fields; components of a vector have that of the vector, and fields that are missing have none"""


def time_of(rows: Rows) -> NDArray[np.float64]:
    """Give the stamps in seconds, shape (n,)."""
    seconds: NDArray[np.float64] = np.asarray(rows["stamp"]) * NANOSECOND
    return seconds


def begin_of(first: int) -> int:
    """Give the stamp [ns] from which times are shown to people: the first stamp if it is a date, else 0."""
    return first if first >= DATES_FROM else 0


def begin_in(rows: Rows) -> int:
    """Give the stamp [ns] from which times of answers are shown to people, see `begin_of`; 0 without answers."""
    return begin_of(int(rows["stamp"][0])) if len(rows) else 0


def stamp_text(stamp: int, begin: int) -> str:
    """Write a stamp [ns] in seconds from a stamp `begin`, which is that of `begin_of`."""
    return f"{NANOSECOND * (stamp - begin):{'+' if begin else ''}.3f}"


def columns(rows: Rows) -> dict[str, NDArray[Any]]:
    """Give all numbers of answers as columns by name, shape (n,) each: first the time [s], then those of all fields.

    Vectors are columns of their components, as `contact_point_x`. Rows that have only some of the fields give the
    numbers of these.

    Raises:
        UsageError: the stamp is not among the fields.
    """
    if "stamp" not in (rows.dtype.names or ()):
        raise UsageError(f"fields {', '.join(rows.dtype.names or ())}: stamp must be one of them, which gives the time")
    flat = np.asarray(rows).view(FLAT)
    names = [name for name in FLAT.names or () if _is_of(name, rows.dtype)]
    return {TIME: time_of(rows)} | {name: np.ascontiguousarray(flat[name]) for name in names}


def _is_of(name: str, fields: np.dtype[Any]) -> bool:
    """Whether a number is in one of some fields, which have the same places as in a complete answer."""
    place = _places(FLAT)[name][1]
    return any(begin <= place < begin + kind.itemsize for kind, begin, *_ in _places(fields).values())


def _places(fields: np.dtype[Any]) -> Mapping[str, tuple[Any, ...]]:
    """Give type and offset [B] of each field."""
    return fields.fields or {}


def unit_of(name: str) -> str:
    """Give the SI unit of a column; empty if it has none."""
    return UNITS.get(name, UNITS.get(name.rsplit("_", 1)[0] if name[-2:] in ("_x", "_y", "_z") else "", ""))

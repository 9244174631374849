"""What goes through the model: the answer to one tick, and the enumerations it uses.

The values equal the constants in `msg/KneeContact.msg`.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import NamedTuple


class ContactState(IntEnum):
    """The deepest layer in contact."""

    SEPARATED = 0
    CARTILAGE = 1
    BONE = 2


class Fidelity(IntEnum):
    """The level of the model that computed a tick."""

    QUASI_STATIC = 0
    FIRST_ORDER = 1
    DYNAMIC = 2


class Status(IntFlag):
    """What a reader of a tick must know about it."""

    OK = 0
    STALE_INPUT = 1
    """The gap between stamps is longer than allowed."""
    TIME_RESET = 2
    """Stamps went back; the state was started anew."""
    INPUT_HELD = 4
    """No flexion angle at or after this stamp came in time; the last one was held."""
    NOT_CONVERGED = 8
    """A tolerance was not met; `error_estimate` and `force_error_estimate` say by how much."""
    INPUT_REJECTED = 16
    """A sample was refused since the last tick."""
    IMPLAUSIBLE = 32
    """The depth makes no sense: see `plausible_depth.py`."""


class Point(NamedTuple):
    """A point in the tibia frame [m]: x anterior, y superior, z to the right."""

    x: float
    y: float
    z: float


class Contact(NamedTuple):
    """The answer to one tick, under the field names of `KneeContact.msg`."""

    flexion_angle: float
    """[rad] positive in flexion"""
    load: float
    """[N] compressive load that drove the tick"""
    contact_force: float
    """[N] normal contact force; >= 0 unless the law may pull"""
    penetration_depth: float
    """[m] >= 0; 0 when apart"""
    gap: float
    """[m] >= 0; 0 in contact"""
    penetration_rate: float
    """[m/s] > 0 when approaching"""
    sliding_velocity: float
    """[m/s] of the femur's surface relative to the tibia's, at the contact and along it; > 0 anteriorly (Eq. 6)"""
    contact_point: Point
    """[m] on the plateau, in the tibia frame (when apart: the point closest to the femur); z is 0, as all is planar"""
    femoral_height: float
    """[m] height of the femoral reference point above the plateau's origin"""
    cartilage_depth: float
    """[m] part of the depth in the first layer"""
    bone_depth: float
    """[m] part of the depth in the second layer"""
    contact_state: int
    """a `ContactState`"""
    fidelity: int
    """a `Fidelity`"""
    status: int
    """a set of `Status` bits"""
    error_estimate: float
    """[m] estimated error of `penetration_depth` against the exact solution of the scene"""
    force_error_estimate: float
    """[N] the same of `contact_force`"""
    evaluations: int
    """contact law evaluations that this tick took"""


NUMBERS = tuple(
    number
    for name in Contact._fields
    for number in (("contact_point_x", "contact_point_y") if name == "contact_point" else (name,))
)
"""Names of an answer's numbers, in their order: the fields of `Contact` without the contact point's z, which is 0"""
COLUMN = {name: column for column, name in enumerate(NUMBERS)}
"""Where each of them stands"""

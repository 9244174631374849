"""The answer to one tick, and the enumerations it uses.

`Contact` is declared here once, and everything that holds answers holds rows of `ROW`: the kernel writes them, messages
and recordings are made of their bytes, reports and viewers name their fields. The values of the enumerations equal the
constants in `msg/KneeContact.msg`.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from enum import IntEnum, IntFlag
from typing import Annotated, Any, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

Real = Annotated[float, np.float64]
Small = Annotated[int, np.uint8]
Count = Annotated[int, np.uint32]
Nanoseconds = Annotated[int, np.int64]
Rows = NDArray[Any]
"""Answers: an array of `ROW`, shape (n,)"""


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


UNUSABLE = Status.STALE_INPUT | Status.TIME_RESET | Status.INPUT_HELD | Status.NOT_CONVERGED | Status.IMPLAUSIBLE
"""Any of these: nothing must be controlled by the answer. A refused sample is no reason, as it was not used."""


class Row(np.record):  # type: ignore[misc]  # final to the stubs alone
    """A record whose attributes are numbers of Python's own, and records of the declared classes."""

    def __getattribute__(self, name: str) -> Any:
        value = super().__getattribute__(name)
        if isinstance(value, np.void):
            return value.view((PARTS[name], value.dtype))
        return value.item() if isinstance(value, np.generic) else value

    def __repr__(self) -> str:
        return f"({', '.join(f'{name}={getattr(self, name)!r}' for name in self.dtype.names or ())})"

    __str__ = __repr__


class Point(Row):  # type: ignore[misc]
    """A vector in the tibia frame, [m] or [N] or [N m]: x anterior, y superior, z to the right."""

    x: Real
    y: Real
    z: Real
    """0, or about the axis of flexion: all is planar"""


class Wrench(Row):  # type: ignore[misc]
    """What acts on a body, at the origin of the tibia frame; as `geometry_msgs/msg/Wrench` has it."""

    force: Point
    """[N]"""
    torque: Point
    """[N m]"""


class Contact(Row):  # type: ignore[misc]
    """The answer to one tick: first what `KneeContact.msg` tells, under its names, in its order and with its types."""

    flexion_angle: Real
    """[rad] positive in flexion"""
    load: Real
    """[N] compressive load that drove the tick"""
    contact_force: Real
    """[N] normal contact force; >= 0 unless the law may pull"""
    penetration_depth: Real
    """[m] >= 0; 0 when apart"""
    gap: Real
    """[m] >= 0; 0 in contact"""
    penetration_rate: Real
    """[m/s] > 0 when approaching"""
    sliding_velocity: Real
    """[m/s] of the femur's surface relative to the tibia's, at the contact and along it; > 0 anteriorly (Eq. 6)"""
    contact_point: Point
    """[m] on the plateau, in the tibia frame (when apart: the point closest to the femur); z is 0, as all is planar"""
    femoral_height: Real
    """[m] height of the femoral reference point above the plateau's origin"""
    cartilage_depth: Real
    """[m] part of the depth in the first layer"""
    bone_depth: Real
    """[m] part of the depth in the second layer"""
    contact_state: Small
    """a `ContactState`"""
    fidelity: Small
    """a `Fidelity`"""
    status: Small
    """a set of `Status` bits"""
    error_estimate: Real
    """[m] estimated error of `penetration_depth` against the exact solution of the scene"""
    force_error_estimate: Real
    """[N] the same of `contact_force`"""
    evaluations: Count
    """contact law evaluations that this tick took; the last field of the message"""
    contact_wrench: Wrench
    """the contact force on the tibia, as it is published beside the message"""
    stamp: Nanoseconds
    """[ns]"""
    femoral_x: Real
    """[m] of the femoral reference point along the tibia's x axis"""
    normal_x: Real
    """of the tibial surface at the contact point, from tibia to femur"""
    normal_y: Real
    latency: Real
    """[s] from the load's arrival to the answer's publication, which the node measures; 0 elsewhere"""

    def __repr__(self) -> str:
        """In a line; `print` shows all fields."""
        return (
            f"<Contact at {1e-9 * self.stamp:.9g} s: load {self.load:.1f} N, contact force {self.contact_force:.1f} N, "
            f"depth {1e3 * self.penetration_depth:.3f} mm>"
        )


PARTS: dict[str, type[Row]] = {}
"""The classes of fields that have fields of their own, by name"""


def _fields(record: type[Row]) -> np.dtype[Any]:
    """The fields that a class declares, aligned as in C, and as CDR aligns them."""
    fields: list[tuple[str, Any]] = []
    for name, hint in get_type_hints(record, include_extras=True).items():
        if get_origin(hint) is Annotated:
            fields.append((name, hint.__metadata__[0]))
        else:
            PARTS[name] = hint
            fields.append((name, _fields(hint)))
    return np.dtype(fields, align=True)


def _place(name: str) -> slice:
    """Where a field's bytes lie in those of a row."""
    fields: Any = ROW.fields
    kind, begin, *_ = fields[name]
    return slice(begin, begin + kind.itemsize)


ROW = np.dtype((Contact, _fields(Contact)))
"""The type of a row, whose elements are `Contact`s"""
MESSAGE = slice(0, _place("evaluations").stop)
"""The bytes of a row that are those of a `KneeContact` behind its header, where a multiple of 8 B is reached"""
WRENCH = _place("contact_wrench")
"""Those of a `WrenchStamped` behind its header, likewise"""


def _numbers(kind: np.dtype[Any], before: str, at: int) -> Iterator[tuple[str, np.dtype[Any], int]]:
    """Name, type and place of every number in a type."""
    for name, (field, offset, *_) in (kind.fields or {}).items():
        if field.fields:
            yield from _numbers(field, f"{before}{name}_", at + offset)
        else:
            yield before + name, field, at + offset


_NAMES, _FORMATS, _OFFSETS = zip(*_numbers(ROW, "", 0), strict=True)
FLAT = np.dtype({"names": _NAMES, "formats": _FORMATS, "offsets": _OFFSETS, "itemsize": ROW.itemsize})
"""The same row with all of its numbers under names of their own: `contact_point_x`"""
TOLD = tuple(name for name, begin in zip(_NAMES, _OFFSETS, strict=True) if begin < MESSAGE.stop)
"""Those that the message has"""


CODES = {"f8": "d", "i8": "q", "u4": "I", "u1": "B"}
"""Of the same numbers in `struct`"""


def reader(*names: str) -> struct.Struct:
    """Takes some numbers, in their order in a row, out of its bytes: in a tenth of the time of an array's fields."""
    layout, end = "<", 0
    for name in names:
        kind, begin, *_ = FLAT.fields[name]  # type: ignore[index]  # it has fields
        layout, end = f"{layout}{begin - end}x{CODES[kind.str[1:]]}", begin + kind.itemsize
    return struct.Struct(layout)


def blank(number: int) -> Rows:
    """Rows to be filled by a kernel, shape (number,), zeros between the fields: a copy may have anything there."""
    return np.zeros(number, dtype=ROW)


def untold(number: int) -> Rows:
    """Rows of which nothing is known, shape (number,): not a number, or 0 where that cannot be."""
    rows = np.zeros(number, dtype=ROW)
    for name in _NAMES:
        if FLAT[name].kind == "f":
            rows.view(FLAT)[name] = np.nan
    return rows

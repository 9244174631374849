"""The answer to one tick, and the enumerations it uses.

`Contact` is declared only here. All answers are rows of `ROW`: the kernel writes them, messages and recordings copy
their bytes, reports and viewers use their field names. The values of the enumerations equal the
constants in `msg/KneeContact.msg`.
"""

import math
import struct
from collections import namedtuple
from enum import IntEnum, IntFlag
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[Any]
"""Answers: an array of `ROW`, shape (n,)"""
Floats = NDArray[np.float64]
"""Real numbers"""
Integers = NDArray[np.int64]
"""Whole numbers"""
Stamps = NDArray[np.int64]
"""Stamps [ns]"""
Indices = NDArray[np.intp]
"""Places in another array"""
Bytes = NDArray[np.uint8]
"""Memory, byte by byte"""
Counts = NDArray[np.uint32]
"""Numbers of evaluations"""
MM = 1e3
"""Number of millimetres in a metre"""

MIN_FLEXION = math.radians(-30.0)
"""Smallest plausible flexion angle [rad]: hyperextension of lax knees stays within 20 deg, the rest is for offsets"""
MAX_FLEXION = math.radians(170.0)
"""Largest plausible flexion angle [rad]: thigh and calf meet at about 160 deg"""
MAX_SURFACE_GAP = 0.01
"""Largest plausible gap [m] between femur and tibia"""
MAX_CONTACT_X = 0.06
"""Largest plausible distance [m] of a contact from the tibia's origin along x; half a plateau is about 25 mm long"""


class Field(NamedTuple):
    """Declaration of a field of an answer, besides its name and meaning."""

    unit: str = ""
    """SI unit; a vector's components have the vector's unit"""
    kind: type[np.generic] = np.float64
    """NumPy type; vectors use the class of the field instead"""
    plot: str = ""
    """Title of its plot in viewer and layouts; empty: they draw it in another way, or not at all"""
    added: bool = False
    """Whether messages of earlier versions lack it"""


Code = Annotated[int, Field(kind=np.uint8)]


class ContactState(IntEnum):
    """The deepest layer that is in contact.

    Example:
        >>> from knee_contact_ros import load_model
        >>> from knee_contact_ros.model.types import ContactState
        >>> ContactState(load_model("osteoarthritis").stream().tick(0.0, 0.3, 1500.0).contact_state)
        <ContactState.BONE: 2>
    """

    SEPARATED = 0
    CARTILAGE = 1
    BONE = 2


class Fidelity(IntEnum):
    """The level of the model that computed a tick.

    Example:
        >>> from knee_contact_ros import load_model
        >>> from knee_contact_ros.model.types import Fidelity
        >>> Fidelity(load_model().stream().tick(0.0, 0.3, 800.0).fidelity)
        <Fidelity.DYNAMIC: 2>
    """

    QUASI_STATIC = 0
    FIRST_ORDER = 1
    """A level of earlier versions, found in old recordings"""
    DYNAMIC = 2


class Status(IntFlag):
    """Flags that a reader of an answer must know; several may be set at once.

    Example:
        >>> from knee_contact_ros import load_model
        >>> from knee_contact_ros.model.types import Status
        >>> Status.IMPLAUSIBLE in Status(load_model().stream().tick(0.0, 3.1, 800.0).status)
        True
    """

    OK = 0
    STALE_INPUT = 1
    """The time between two samples is longer than allowed."""
    TIME_RESET = 2
    """The stamps went back in time; the model was started anew."""
    INPUT_HELD = 4
    """No flexion angle with this stamp or a later one came in time; the last angle was held."""
    NOT_CONVERGED = 8
    """A tolerance was not met; `error_estimate` and `force_error_estimate` give the size of the errors."""
    INPUT_REJECTED = 16
    """A sample was rejected since the last tick."""
    IMPLAUSIBLE = 32
    """Depth, gap, flexion angle or place of the contact are not those of a knee: see `KneeModel.plausible_depth`, and
    in `model/types.py` `MAX_SURFACE_GAP`, `MIN_FLEXION`, `MAX_FLEXION` and `MAX_CONTACT_X`."""
    DOUBTFUL_LOAD = 64
    """Of a contact: the frontal moment cannot be split between the compartments, or the load node doubts its estimate.
    Of an estimated load: a movement for which no constants were measured."""
    SEVERAL_PUBLISHERS = 128
    """Another publisher sends on a topic of the answers, so that subscribers get both mixed."""


NANOSECOND = 1e-9
"""Unit of stamps [s]"""
FIRST_DATE = 10 * 365 * 86_400 * 1_000_000_000
"""Smallest stamp [ns] that counts as a date, in 1979; stamps of simulations and trials begin near 0"""
UNUSABLE = (
    Status.STALE_INPUT
    | Status.TIME_RESET
    | Status.INPUT_HELD
    | Status.NOT_CONVERGED
    | Status.IMPLAUSIBLE
    | Status.SEVERAL_PUBLISHERS
)
"""An answer with any of these flags must not control anything. A rejected sample does not count, as it was not used;
whether a doubtful load is good enough is for the user to say."""


class Row(np.record):  # type: ignore[misc]  # final to the stubs alone
    """A NumPy record whose attributes are plain Python numbers or records of the declared classes."""

    def __getattribute__(self, name: str) -> Any:
        value = super().__getattribute__(name)
        if isinstance(value, np.void):
            return value.view((RECORD_CLASSES[name], value.dtype))
        return value.item() if isinstance(value, np.generic) else value

    def __repr__(self) -> str:
        values = [f"{name}={getattr(self, name)!r}" for name in self.dtype.names or ()]
        return f"({', '.join(values)})"

    __str__ = __repr__


class Point(Row):  # type: ignore[misc]
    """A vector in the tibia frame, [m] or [N] or [N m]: x anterior, y superior, z to the right.

    Example:
        >>> from knee_contact_ros import load_model
        >>> point = load_model({"tibia.slope": 0.1}).stream().tick(0.0, 0.3, 800.0).contact_point
        >>> print(f"{1e3 * point.x:.2f} mm, {1e3 * point.y:.2f} mm")
        3.35 mm, 0.34 mm
    """

    x: Annotated[float, Field()]
    y: Annotated[float, Field()]
    z: Annotated[float, Field()]
    """0, or about the axis of flexion: all is planar"""


class Wrench(Row):  # type: ignore[misc]
    """Force and torque on a body at the origin of the tibia frame, with the layout of `geometry_msgs/msg/Wrench`.

    Example:
        >>> from knee_contact_ros import load_model
        >>> load_model().stream().tick(0.0, 0.3, 800.0).contact_wrench.force.y
        -800.0
    """

    force: Annotated[Point, Field("N")]
    """Force on the body"""
    torque: Annotated[Point, Field("N m")]
    """Torque on the body about the origin of the tibia frame"""


class Contact(Row):  # type: ignore[misc]
    """The answer to one tick: the fields of `KneeContact.msg` (same names, order and types), then some more.

    A field's name, meaning, unit and plot are declared here and nowhere else; the message repeats them as comments.

    Example:
        >>> from knee_contact_ros import load_model
        >>> contact = load_model().stream().tick(0.0, 0.3, 800.0)
        >>> contact
        <Contact at 0 s: load 800.0 N, contact force 800.0 N, depth 0.468 mm>
    """

    flexion_angle: Annotated[float, Field("rad")]
    """Flexion angle, positive in flexion"""
    load: Annotated[float, Field("N")]
    """Compressive load that drove the tick"""
    contact_force: Annotated[float, Field("N")]
    """Normal contact force; >= 0 unless the law may pull"""
    penetration_depth: Annotated[float, Field("m")]
    """Penetration depth, >= 0; 0 when the surfaces are apart"""
    gap: Annotated[float, Field("m")]
    """Distance of the surfaces, >= 0; 0 in contact"""
    penetration_rate: Annotated[float, Field("m/s")]
    """Rate of the signed depth, > 0 when the surfaces approach each other"""
    sliding_velocity: Annotated[
        float, Field("m/s", plot="Sliding velocity, anterior > 0", added=True)
    ]
    """Velocity of the femur's surface relative to the tibia's along the contact, > 0 anteriorly (Eq. 6)"""
    contact_point: Annotated[Point, Field("m")]
    """Contact point on the plateau in the tibia frame (when apart: the point closest to the femur); z is 0"""
    femoral_height: Annotated[float, Field("m")]
    """Height of the femoral reference point above the origin of the tibia frame"""
    cartilage_depth: Annotated[float, Field("m")]
    """Part of the depth in the first layer"""
    bone_depth: Annotated[float, Field("m")]
    """Part of the depth in the second layer"""
    contact_state: Code
    """a `ContactState`: the deepest layer in contact"""
    fidelity: Code
    """a `Fidelity`: the level that computed the answer"""
    status: Code
    """a set of `Status` flags"""
    error_estimate: Annotated[float, Field("m")]
    """Estimated error of `penetration_depth` against the exact solution of the scene"""
    force_error_estimate: Annotated[float, Field("N", added=True)]
    """Estimated error of `contact_force` against the exact solution of the scene"""
    evaluations: Annotated[int, Field(kind=np.uint32)]
    """Evaluations of the contact that this tick took, and probes of its flights"""
    contact_wrench: Wrench
    """The contact force on the tibia, as it is published beside the message"""
    stamp: Annotated[int, Field("ns", np.int64)]
    """Time of the sample, as in the message's header"""
    femoral_x: Annotated[float, Field("m")]
    """x of the femoral reference point in the tibia frame"""
    normal_x: Annotated[float, Field()]
    """x of the unit normal of the tibial surface at the contact point, from tibia to femur"""
    normal_y: Annotated[float, Field()]
    latency: Annotated[float, Field("s")]
    """From the arrival of the load to the publication of the answer, measured by the node; 0 elsewhere"""

    def __repr__(self) -> str:
        """Return a summary in one line; `print` shows all fields."""
        return (
            f"<Contact at {1e-9 * self.stamp:.9g} s: load {self.load:.1f} N, contact force {self.contact_force:.1f} N, "
            f"depth {1e3 * self.penetration_depth:.3f} mm>"
        )


RECORD_CLASSES: dict[str, type[Row]] = {}
"""Classes of the fields that are records themselves, by field name"""
FIELDS: dict[str, Field] = {}
"""Declarations of the numbers of an answer, by their names in `FLAT`"""


def _fields(record: type[Row], before: str = "", unit: str = "") -> np.dtype[Any]:
    """Return the NumPy type of the fields that a class declares, aligned as in C and in CDR.

    Fills `RECORD_CLASSES` and `FIELDS`. The names of the class's numbers begin with `before`, and have a `unit` unless
    they declare their own.
    """
    fields: list[tuple[str, Any]] = []
    for name, hint in get_type_hints(record, include_extras=True).items():
        kind = getattr(hint, "__origin__", hint)
        field = getattr(hint, "__metadata__", (Field(),))[0]
        if issubclass(kind, Row):
            RECORD_CLASSES[name] = kind
            fields.append((name, _fields(kind, f"{before}{name}_", field.unit)))
        else:
            FIELDS[before + name] = field._replace(unit=field.unit or unit)
            fields.append((name, field.kind))
    return np.dtype(fields, align=True)


ROW = np.dtype((Contact, _fields(Contact)))
"""NumPy type of a row of answers, whose elements are `Contact` records"""
FLAT = np.dtype([(name, field.kind) for name, field in FIELDS.items()], align=True)
"""The same row as a flat record, in which nested numbers have names of their own, such as `contact_point_x`"""
_OFFSETS = [begin for _, begin, *_ in (FLAT.fields or {}).values()]
BYTE_OF: Any = namedtuple("Places", FIELDS)(*_OFFSETS)  # type: ignore[arg-type]  # a tuple to mypy
"""Byte of a row at which each number of `FLAT` begins, by its name: compiled code reads a named tuple as constants"""
WORD_OF = BYTE_OF._make(begin // 8 for begin in BYTE_OF)
"""The same of its 8-byte words"""
MESSAGE_FIELDS = tuple(FIELDS)[: BYTE_OF.index(BYTE_OF.contact_wrench_force_x)]
"""Names in `FLAT` of the numbers that the message has"""
MESSAGE_BYTES = slice(0, BYTE_OF[len(MESSAGE_FIELDS) - 1] + FLAT[MESSAGE_FIELDS[-1]].itemsize)
"""Bytes of a row that equal those of a `KneeContact` message after its header, if that ends at a multiple of 8 B"""
WRENCH_BYTES = slice(BYTE_OF.contact_wrench_force_x, BYTE_OF.stamp)
"""Bytes of a row that equal those of a `WrenchStamped` message after its header, if that ends at a multiple of 8 B"""
STRUCT_CODES = {"f8": "d", "i8": "q", "u4": "I", "u1": "B"}
"""Format characters of `struct` for NumPy's number types"""


def answer_struct(*names: str) -> struct.Struct:
    """Return a `struct` of the size of a row that reads some numbers of `FLAT`, named in their order, from its bytes.

    It takes a tenth of the time of reading fields of an array.
    """
    layout = "<"
    end = 0
    for name in names:
        kind, begin, *_ = FLAT.fields[name]  # type: ignore[index]  # it has fields
        layout += f"{begin - end}x{STRUCT_CODES[kind.str[1:]]}"
        end = begin + kind.itemsize
    return struct.Struct(f"{layout}{ROW.itemsize - end}x")


def blank_answers(number: int) -> Rows:
    """Return rows of zeros for a kernel to fill, shape (number,).

    Their padding bytes are 0, too; NumPy does not copy padding, so that a copy's may be anything.
    """
    return np.zeros(number, dtype=ROW)


def unknown_answers(number: int) -> Rows:
    """Return rows of unknown answers, shape (number,): real numbers are NaN, integers 0."""
    rows = np.zeros(number, dtype=ROW)
    for name in FIELDS:
        if FLAT[name].kind == "f":
            rows.view(FLAT)[name] = np.nan
    return rows

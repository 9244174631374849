"""Where an input comes from: a topic and, if its messages are of another type, the fields with the numbers."""

import math
import re
from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

JOINT_STATE_TYPE = "sensor_msgs/msg/JointState"
"""Type of messages of angles"""
WRENCH_STAMPED_TYPE = "geometry_msgs/msg/WrenchStamped"
"""Type of messages of forces"""
FIELD_UNITS = {
    JOINT_STATE_TYPE: {
        "rad": 1.0,
        "deg": math.pi / 180.0,
        "mrad": 1e-3,
        "rev": 2.0 * math.pi,
        "m": 1.0,
        "mm": 1e-3,
    },
    WRENCH_STAMPED_TYPE: {
        "N": 1.0,
        "kN": 1e3,
        "kgf": 9.80665,
        "lbf": 4.4482216152605,
        "Nm": 1.0,
        "Nmm": 1e-3,
    },
}
"""Factors from the unit of a field to rad, m, N or N m, by the type to which an input is converted"""
DYNAMIC_JOINT_STATES = "dynamic_joint_states"
"""Topic of the joint states of ros2_control"""
DYNAMIC_JOINT_STATE_TYPE = "control_msgs/msg/DynamicJointState"
"""Type of its messages"""
ON_ARRIVAL = "on arrival"
"""Words after a source whose messages have no stamp, or a wrong one; they get the time of their arrival"""
SOURCE_FORM = (
    "TOPIC, or TOPIC TYPE FIELD [UNIT], such as /encoder exo_msgs/Joint knee.angle deg; "
    f"optionally followed by: {ON_ARRIVAL}"
)
"""Form of the text of a source"""
_SOURCE = re.compile(
    rf"([~/\w*]+)(?:[:,]?\s+(\w+(?:/msg)?/\w+)[:,]?\s+(\S.*?))??(\s+{ON_ARRIVAL})?"
)
_FIELD = re.compile(r"([+-]?)((?:\w+(?:\[\d+\])*)(?:\.\w+(?:\[\d+\])*)*)(?:\s+(\S+))?")


class MessageNumber(NamedTuple):
    """A number in messages of some type."""

    path: tuple[str | int, ...]
    """Names of fields and indices of elements, from the message to the number"""
    factor: float
    """Factor to rad, N, m or N m, with the sign"""


class TopicSource(NamedTuple):
    """Topic of an input, and the form of its messages."""

    topic: str
    """Name of the topic; `*` matches any text"""
    type: str
    """Full name of the type, like `geometry_msgs/msg/Vector3Stamped`"""
    fields: tuple[MessageNumber, ...]
    """Fields with the numbers; none if the message is of the input's own type"""
    on_arrival: bool
    """Whether messages are stamped with the time of their arrival"""


IMU_TYPE, IMU_FIELD = "sensor_msgs/msg/Imu", "orientation"
"""Type of messages of an orientation without one in their source, and the field with the quaternion"""


@cache
def orientation_source(text: str) -> TopicSource:
    """Return the source of a quaternion that a text describes, with the fields x, y, z, w; see `source_of`.

    Raises:
        ValueError: the text does not describe a source of one field.
    """
    source = source_of(text, IMU_TYPE)
    path = source.fields[0].path if source.fields else (IMU_FIELD,)
    if len(source.fields) > 1:
        raise ValueError("allowed: TOPIC, or TOPIC TYPE FIELD of one quaternion")
    return source._replace(fields=tuple(MessageNumber((*path, part), 1.0) for part in "xyzw"))


@cache
def source_of(text: str, own_type: str) -> TopicSource:
    """Return the source that a text describes; without a type its messages are of the input's `own_type`.

    Raises:
        ValueError: the text does not describe a source, or its unit does not fit angles or forces.
    """
    match = _SOURCE.fullmatch(text.strip())
    if not match:
        raise ValueError(f"allowed: {SOURCE_FORM}")
    topic, kind, fields, arrival = match.groups()
    if not kind:
        dynamic = own_type == JOINT_STATE_TYPE and topic.rsplit("/", 1)[-1] == DYNAMIC_JOINT_STATES
        kind = DYNAMIC_JOINT_STATE_TYPE if dynamic else own_type
        return TopicSource(topic, kind, (), bool(arrival))
    # The type may be given as pkg/Type or pkg/msg/Type.
    package, *_, name = kind.split("/")
    units = FIELD_UNITS.get(own_type, {})
    numbers = tuple(_number(each, units) for each in fields.split(","))
    return TopicSource(topic, f"{package}/msg/{name}", numbers, bool(arrival))


def _number(text: str, units: Mapping[str, float]) -> MessageNumber:
    """Return the number in messages that a text `[+-]PATH [UNIT]` describes.

    Raises:
        ValueError: it has another form, or the unit is neither one of `units` nor a factor.
    """
    match = _FIELD.fullmatch(text.strip())
    if not match:
        raise ValueError(f"{text.strip()!r} is not a field; allowed: {SOURCE_FORM}")
    sign, path, unit = match.groups()
    try:
        factor = units[unit] if unit in units else float(unit or 1.0)
    except ValueError:
        raise ValueError(
            f"unit {unit!r} is not allowed; allowed: {', '.join(units)}, or a factor"
        ) from None
    if not math.isfinite(factor) or factor == 0.0:
        raise ValueError(f"a factor of {unit} is not allowed")
    steps = re.findall(r"\w+(?![\w\]])|\[\d+\]", path)
    places = tuple(int(step[1:-1]) if step.startswith("[") else step for step in steps)
    return MessageNumber(places, -factor if sign == "-" else factor)

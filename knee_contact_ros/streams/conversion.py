"""Conversion of messages of any type to joint states and wrenches for the pipelines, as a `TopicSource` describes.

A `Converter` reads a message by the definition of its type: the installed one live, the bag's offline. The code is the
same, and so are the bits. The usual inputs need no converter and cost nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from ..parameters.load_schema import LoadParameters
from ..parameters.schema import Parameters
from ..parameters.sources import (
    DYNAMIC_JOINT_STATE_TYPE,
    JOINT_STATE_TYPE,
    ON_ARRIVAL,
    MessageNumber,
    TopicSource,
)
from ..system.errors import UsageError, list_names
from . import messages
from .columns import BYTES, FIXED
from .messages import JointState, RefusedSampleError, WrenchStamped
from .topics import NANOSECONDS, types_in, typestore

if TYPE_CHECKING:
    from .orientations import OrientationJoin

Types = Callable[[TopicSource, str], Typestore]
"""Returns the definitions of a source's type and of all types in it; errors name the given parameter"""
Convert = Callable[[bytes, int], list[bytes]]
"""Converts the bytes of a message that arrived at a time [ns] to those of the messages for a pipeline, mostly of one"""
Take = Callable[[int, str, list[float]], list[bytes]]
"""Takes stamp [ns], frame and numbers of a message, and returns as `Convert`"""
ANY = "*"
"""Wildcard in the name of a joint, for the id of the followed body"""


class Body:
    """The body that is followed among those whose joints have names such as `r_knee_<id>`.

    The first body is followed as long as its samples come; then another one may take its place. Only stamps decide.
    """

    def __init__(self, parameters: Parameters | LoadParameters) -> None:
        """Follow the body whose id replaces `*` in the names of joints, until a gap of `pairing.max_gap`."""
        self._patterns = [
            joint.partition(ANY)[::2] for joint in parameters.joints().values() if ANY in joint
        ]
        self.has_id = bool(self._patterns)
        """Whether a name has such an id"""
        self._patience = round(parameters.pairing.max_gap * NANOSECONDS)
        self._id, self._last = "", 0

    def named(self, state: JointState) -> JointState:
        """Joint state of the body, with the names that the parameters give.

        Raises:
            RefusedSampleError: the message has none of the joints, or only those of other bodies.
        """
        if not self._patterns:
            return state
        (before, after), *_ = self._patterns
        found = [
            name[len(before) : len(name) - len(after)]
            for name in state.name
            if name.startswith(before)
            and name.endswith(after)
            and len(name) > len(before) + len(after)
        ]
        if not found:
            raise RefusedSampleError(
                "joint_missing",
                f"no joint {before}{ANY}{after}; there are {list_names(state.name)}",
            )
        if self._id not in found:
            if self._id and abs(state.stamp - self._last) <= self._patience:
                text = (
                    f"{before}{found[0]}{after} comes while {before}{self._id}{after} is followed"
                )
                raise RefusedSampleError("another_body", text)
            if len(found) > 1:
                raise RefusedSampleError(
                    "another_body", f"{len(found)} bodies at once: {list_names(found)}"
                )
            self._id = found[0]
        self._last = state.stamp
        given = {f"{start}{self._id}{end}": f"{start}{ANY}{end}" for start, end in self._patterns}
        return state._replace(name=tuple(given.get(name, name) for name in state.name))


class Converter:
    """Converter of the messages of a source; see `converters`."""

    def __init__(
        self,
        source: TopicSource,
        by: str,
        types: Types,
        joints: Sequence[str],
        body: Body,
        take: Take | None = None,
    ) -> None:
        """Prepare to read the messages of a source, which the parameter `by` describes.

        They give the angles of `joints` of a `body`, or, without joints, a force; or numbers that a function takes.

        Raises:
            UsageError: the type is not known, lacks a field or has no stamp, or the field is not a number.
        """
        self._source, self._by, self._joints, self._body = source, by, joints, body
        self._take = take
        self._store: Typestore | None = None
        self._stamped = ""
        if source.fields:
            self._store = types(source, by)
            for field in source.fields:
                check_path(self._store, source.type, field, by)
            kinds = {name: detail for name, (_, detail) in self._store.fielddefs[source.type][1]}
            heads = {"header": "std_msgs/msg/Header", "stamp": "builtin_interfaces/msg/Time"}
            self._stamped = next(
                (name for name, kind in heads.items() if kinds.get(name) == kind), ""
            )
            if not self._stamped and not source.on_arrival:
                raise UsageError(
                    f"parameter {by}: {source.type} has no header with a stamp: take a type that has one, or say "
                    f"'{ON_ARRIVAL}' behind the field, and the answers depend on when its messages arrive"
                )

    def __call__(self, data: bytes, arrived: int) -> list[bytes]:
        """Bytes of the JointState or WrenchStamped, or those of a refusal if the message cannot be converted."""
        try:
            return self._converted(data, arrived)
        except RefusedSampleError as refused:
            return [messages.refusal(refused)]
        except Exception as error:  # whatever broken bytes provoke
            text = (
                f"{self._source.topic}: {len(data)} bytes are not a {self._source.type}: {error}"
            )
            return [messages.refusal(RefusedSampleError("undecodable", text))]

    def _converted(self, data: bytes, arrived: int) -> list[bytes]:
        source = self._source
        messages.check_size(data, source.topic)
        if self._store:
            return self._from_fields(self._store.deserialize_cdr(data, source.type), arrived)
        if source.on_arrival:  # whatever the sender's stamp is
            data = data[: len(messages.HEADER)] + bytes(8) + data[messages.STAMP_END :]
        if source.type == DYNAMIC_JOINT_STATE_TYPE:
            data = messages.as_joint_state(data, self._joints)
        if self._joints:
            state = messages.JOINT_STATE.read_message(data, source.topic)[0]
            state = state._replace(stamp=arrived) if source.on_arrival else state
            return [messages.encode_joint_state(self._body.named(state))]
        wrench = messages.WRENCH.read_message(data, source.topic)[0]._replace(stamp=arrived)
        return [messages.encode_wrench_stamped(wrench)]

    def _from_fields(self, message: Any, arrived: int) -> list[bytes]:
        source = self._source
        stamp, frame_id = arrived, ""
        if self._stamped == "header" and source.on_arrival:
            frame_id = message.header.frame_id
        elif self._stamped == "header":
            stamp, frame_id = (
                messages.checked_time(message.header.stamp, source.topic),
                message.header.frame_id,
            )
        elif self._stamped and not source.on_arrival:
            stamp = messages.checked_time(message.stamp, source.topic)
        numbers = [number_at(message, field, source) for field in source.fields]
        if self._take:
            return self._take(stamp, frame_id, numbers)
        if self._joints:
            state = JointState(stamp, frame_id, tuple(self._joints), tuple(numbers), (), ())
            return [messages.encode_joint_state(state)]
        up = (
            -1.0 if self._by == Parameters.force_source else 1.0
        )  # a load compresses, the ground pushes
        if len(numbers) == 2:  # of a net load
            numbers = [0.0, -numbers[0], 0.0, 0.0, 0.0, numbers[1]]
        x, y, z, *torque = numbers if len(numbers) > 1 else (0.0, up * numbers[0], 0.0)
        moments = (torque[0], torque[1], torque[2]) if torque else (0.0, 0.0, 0.0)
        wrench = WrenchStamped(stamp, frame_id, (x, y, z), moments)
        return [messages.encode_wrench_stamped(wrench)]


def converters(
    parameters: Parameters | LoadParameters, types: Types, joined: OrientationJoin | None = None
) -> tuple[Convert | None, Convert | None, Convert | None]:
    """Converters of the angles (or the shank's orientations), the forces, and the thigh's orientations.

    They are None where messages need no conversion. `joined` joins the orientations; None: a new one.

    Raises:
        UsageError: see `Converter`.
    """
    angles, forces = parameters.inputs()
    joints, body = list(parameters.joints().values()), Body(parameters)
    thigh = parameters.thigh()
    of_thigh = of_shank = None
    if thigh and isinstance(parameters, Parameters):
        from .orientations import OrientationJoin

        both = joined or OrientationJoin(parameters)
        of_thigh = Converter(thigh, "orientations.thigh", types, joints, body, both.add_thigh)
        of_shank = Converter(angles, "orientations.shank", types, joints, body, both.add_shank)
    is_usual = angles == TopicSource(angles.topic, JOINT_STATE_TYPE, (), on_arrival=False)
    return (
        of_shank
        or (
            None
            if is_usual and not body.has_id
            else Converter(angles, "knee.source", types, joints, body)
        ),
        Converter(forces, parameters.force_source, types, (), body)
        if forces.fields or forces.on_arrival
        else None,
        of_thigh,
    )


def store_of(definition: MessageDefinition, type_name: str) -> Typestore:
    """Reader of messages of a type that a bag defines; see `types_in`."""
    store = typestore()
    if definition.format is not MessageDefinitionFormat.NONE:
        store = get_typestore(Stores.EMPTY)
        store.register(types_in(definition, type_name))
    if type_name not in store.fielddefs:
        raise KeyError(type_name)
    return store


def number_at(message: Any, field: MessageNumber, source: TopicSource) -> float:
    """Number that a field has in a message, in rad, m, N or N m.

    Raises:
        RefusedSampleError: the message has no such element.
    """
    value = message
    try:
        for step in field.path:
            value = value[step] if isinstance(step, int) else getattr(value, step)
    except IndexError:
        path = written(field)
        raise RefusedSampleError(
            "field_missing", f"{source.topic}: {path}: there are {len(value)} elements"
        ) from None
    return field.factor * float(value)


def written(field: MessageNumber) -> str:
    """Path of a field as in a parameter."""
    return "".join(
        f"[{step}]" if isinstance(step, int) else f".{step}" for step in field.path
    ).removeprefix(".")


def check_path(store: Typestore, type_name: str, field: MessageNumber, by: str) -> None:
    """Check that messages of a type have a number at the path of a field.

    Raises:
        UsageError: they do not; the error names the parameter `by`.
    """
    kind: Nodetype = Nodetype.NAME
    detail: Any = type_name
    for step in field.path:
        if isinstance(step, int):
            if kind not in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                raise UsageError(
                    f"parameter {by}: {written(field)}: [{step}] is not an element of a list in {type_name}"
                )
            kind, detail = detail[0]
            continue
        known = dict(store.fielddefs[detail][1]) if kind is Nodetype.NAME else {}
        if step not in known:
            has = f"; it has {list_names(list(known))}" if known else ""
            what = detail if kind is Nodetype.NAME else f"what comes before it in {type_name}"
            raise UsageError(
                f"parameter {by}: {written(field)}: {what} has no field {step!r}{has}"
            )
        kind, detail = known[step]
    if kind is not Nodetype.BASE or detail[0] not in (*FIXED, *BYTES):
        is_list = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
        hint = f": name an element, as {written(field)}[0]" if is_list else ""
        raise UsageError(f"parameter {by}: {written(field)} of {type_name} is not a number{hint}")

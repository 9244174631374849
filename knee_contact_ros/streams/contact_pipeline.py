"""From the messages of a knee's angle and load to contact answers, without ROS: the contact node and `solve` use it."""

from __future__ import annotations

import math
import struct
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from operator import add
from types import MappingProxyType
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.joint_reaction.compartments import LoadRule
from knee_contact_ros.model.knee import (
    LARGEST_ANGLE,
    LARGEST_HEIGHT,
    LARGEST_LOAD,
    KneeModel,
    degrees_hint,
)
from knee_contact_ros.model.types import (
    FLAT,
    ROW,
    WRENCH_BYTES,
    Bytes,
    Floats,
    Rows,
    Stamps,
    Status,
    answer_struct,
)
from knee_contact_ros.parameters.build import build_model, load_rule, retuned
from knee_contact_ros.parameters.files import (
    ParameterSource,
    curve_texts,
    lateral_texts,
    load_parameters,
)
from knee_contact_ros.parameters.schema import (
    KneeSection,
    Parameters,
    has_two_compartments,
    lateral_knee,
)
from knee_contact_ros.results import Results
from knee_contact_ros.streams.frames import ForceFrame, Transform, encode_transform
from knee_contact_ros.streams.messages import (
    HEADER,
    JointState,
    RefusedSampleError,
    WrenchStamped,
    checked_stamp,
    encode_answer,
    encode_answer_wrench,
    number_of,
)
from knee_contact_ros.streams.pairing import (
    TIME_RESET,
    AngleSample,
    LoadSample,
    PairedSample,
    Pipeline,
)
from knee_contact_ros.streams.topics import (
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    KNEE_CONTACT,
    KNEE_CONTACT_LATERAL,
    KNEE_CONTACT_WRENCH,
    LEG_URDF,
    NANOSECONDS,
    ROBOT_DESCRIPTION,
    SHANK,
    TF,
    Answer,
    Record,
    is_lateral,
)
from knee_contact_ros.streams.watch import Doubts, Split, doubts_about, parameter_doubts
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import DEFAULT_PARAMETERS, share_folder

DOUBTFUL_LOAD = int(
    Status.DOUBTFUL_LOAD
)  # a plain number: combining flags of an enumeration takes long
SIX = struct.Struct("<6d")
"""Force and torque in the bytes of a row"""
WRENCH_FIELDS = [f"contact_wrench_{part}_{axis}" for part in ("force", "torque") for axis in "xyz"]


def angle_sample(
    message: JointState,
    knee: KneeSection,
    height_prescribed: bool = False,
    data: bytes = b"",
    delay: int = 0,
) -> AngleSample:
    """Sample with the flexion angle of a JointState, without the offset, which may still change: sign x position.

    Args:
        message: The JointState.
        knee: Names, signs and offset of the joints.
        height_prescribed: Whether the femoral height is taken as well.
        data: Bytes in which the message is recorded.
        delay: Time [ns] by which the angle holds earlier than stamped.

    Raises:
        RefusedSampleError: a joint is missing, has no position, or its value is not finite or too large; or the stamp
            is not valid.
    """
    position = knee.flexion_sign * number_of(message, knee.joint_name, "position")
    angle = position + knee.flexion_offset
    if abs(angle) > LARGEST_ANGLE:
        text = f"joint_states: flexion angle of joint {knee.joint_name!r} is {angle:g} rad, beyond {LARGEST_ANGLE:g}"
        text += degrees_hint(angle)
        raise RefusedSampleError("out_of_range", text)
    height = number_of(message, knee.height_joint_name, "position") if height_prescribed else None
    if height is not None and abs(height) > LARGEST_HEIGHT:
        text = f"joint_states: height of joint {knee.height_joint_name!r} is {height:g} m, beyond {LARGEST_HEIGHT:g}"
        raise RefusedSampleError("out_of_range", text)
    return AngleSample(
        checked_stamp(message.stamp, "joint_states") - delay, position, data, height, delay
    )


def load_sample(
    message: WrenchStamped,
    by_moment: LoadRule | None = None,
    arrived: float = 0.0,
    data: bytes = b"",
) -> LoadSample:
    """Sample with the axial load L = -F_y and the frontal moment of a WrenchStamped on the tibia.

    If `torque.y` is NaN and `torque.z` is a number, the load is doubtful: the load node says so in this way. A sender
    that knows no torque may fill all of it with NaN.

    Args:
        message: The WrenchStamped.
        by_moment: Rule for the compartment's load if that depends on the moment; its result is checked too.
        arrived: Time of arrival by the caller's clock [s].
        data: Bytes in which the message is recorded.

    Raises:
        RefusedSampleError: the axial force, or a frontal moment that is needed, is not finite; the load is too large;
            or the stamp is not valid.
    """
    axial, moment = message.force[1], message.torque[0]
    if not math.isfinite(axial):
        raise RefusedSampleError("not_finite", f"joint_reaction_force: force.y is {axial}")
    if by_moment and not math.isfinite(moment):
        raise RefusedSampleError("not_finite", f"joint_reaction_force: torque.x is {moment}")
    if abs(axial) > LARGEST_LOAD:
        raise RefusedSampleError(
            "out_of_range",
            f"joint_reaction_force: force.y is {axial:g} N, beyond {LARGEST_LOAD:g}",
        )
    part = by_moment(-axial, moment, 0.0) if by_moment else 0.0
    if max(abs(part), abs(-axial - part)) > LARGEST_LOAD:
        raise RefusedSampleError(
            "out_of_range",
            f"joint_reaction_force: torque.x of {moment:g} N m makes a load of {part:g} N",
        )
    stamp = checked_stamp(message.stamp, "joint_reaction_force")
    doubtful = math.isnan(message.torque[1]) and math.isfinite(message.torque[2])
    return LoadSample(stamp, -axial, moment, message.frame_id, data, arrived, None, doubtful)


class ContactPipeline(Pipeline):
    """Pipeline of the contact node: samples, pairing and model."""

    def __init__(
        self,
        parameters: Parameters,
        *,
        compiled: bool,
        curves: Mapping[str, str] | None = None,
    ) -> None:
        """Build the model; see `build_model` for `curves`."""
        frame = ForceFrame(parameters.frame.tibia, JOINT_REACTION_FORCE)
        super().__init__(JOINT_REACTION_FORCE, parameters, frame)
        self.parameters = parameters
        self._texts = curve_texts(parameters, {}) if curves is None else curves
        self.compartments = compartments_of(parameters, self._texts)
        """The only compartment, or medial and lateral"""
        self.split = Split(parameters.body_weight)
        """Statistics of the medial share, where it varies"""
        self.leg = Leg()
        self.is_lost = False
        """Whether the first tick lies in the middle of an unknown motion"""
        self._divide(parameters)
        if compiled:
            self.compile()

    def compile(self) -> None:
        """Use the compiled model, if possible; to be called before the first sample."""
        for compartment in self.compartments:
            compartment.compile()

    @property
    def model(self) -> KneeModel:
        """Model of the medial compartment, or the only one."""
        return self.compartments[0].model

    @property
    def doubts(self) -> Doubts:
        """Implausible parameters and answers of the medial compartment, or the only one."""
        return self.compartments[0].doubts

    @property
    def doubts_about_parameters(self) -> list[str]:
        """Sentences about implausible parameters of either compartment, each once."""
        return list(
            dict.fromkeys(
                doubt for part in self.compartments for doubt in part.doubts.about_parameters
            )
        )

    def angle_sample(self, message: JointState, data: bytes) -> AngleSample:
        """Sample with the flexion angle; see `angle_sample`."""
        height = self.model.height_prescribed
        return angle_sample(
            message, self.parameters.knee, height, data, self.synchroniser.angle_delay
        )

    def load_sample(self, message: WrenchStamped, data: bytes, arrived: float) -> LoadSample:
        """Sample with the axial load; see `load_sample`."""
        sample = load_sample(message, self.by_moment, arrived, data)
        self.doubts.axes.add_force(*message.force)
        return sample

    def compute(self, pair: PairedSample) -> list[bytes]:
        """Compute a tick; return the answer of each compartment as the bytes of a `KneeContact`."""
        load, angle = pair.load, pair.angle + self.parameters.knee.flexion_offset
        medial = self.rule(load.axial, load.moment, angle)
        messages, status = [], pair.status
        if load.doubtful or (self.by_moment and self.by_moment.fails(load.axial, medial)):
            status |= DOUBTFUL_LOAD
        for compartment, part in zip(
            self.compartments, (medial, load.axial - medial), strict=False
        ):
            if pair.status & TIME_RESET:
                compartment.start_anew()
            compartment.advance(load.stamp, angle, part, pair.height, status)
            if self.is_lost:
                compartment.stream.mark_state_lost()
            messages.append(encode_answer(load.stamp, load.frame_id, compartment.row.tobytes()))
        self.ticks, self.is_lost = self.ticks + 1, False
        if self.varies:
            self.split.add(load.axial, medial, self.rule.beyond(load.axial, angle))
        return messages

    def answer(
        self, pair: PairedSample, messages: Sequence[bytes], latency: float = 0.0
    ) -> Answer:
        """Answer of the tick that was computed last: rows, their `messages`, and the inputs that led to them.

        `latency` [s] is the time from the arrival of the force to the publication, where it is measured.
        """
        load, rows = pair.load, []
        records: list[Record] = [
            (JOINT_STATES, angle.came_at, angle.data) for angle in pair.angles
        ]
        records.append((JOINT_REACTION_FORCE, load.stamp, load.data))
        for compartment, message in zip(self.compartments, messages, strict=True):
            compartment.stream.latency[0] = latency
            rows.append(compartment.row.tobytes())
            records.append((compartment.topic, load.stamp, message))
        records += self.leg.records(load.stamp, load.frame_id, rows[0])
        wrench = encode_answer_wrench(load.stamp, load.frame_id, summed_wrench(rows))
        records.append((KNEE_CONTACT_WRENCH, load.stamp, wrench))
        size = 0
        for _, _, data in records:
            size += len(data)
        return Answer(b"".join(rows), tuple(records), size)

    def check(self, parameters: Parameters) -> None:
        """Check that `retune` will accept these parameters; raises the reason if not, and changes nothing."""
        load_rule(parameters, self._texts)
        offset = parameters.knee.flexion_offset
        waiting = (*self.synchroniser.angles, *self.synchroniser.angle_time.pending)
        if any(abs(sample.angle + offset) > LARGEST_ANGLE for sample in waiting):
            text = f"with an angle that waits for its force, {offset:g} rad is beyond {LARGEST_ANGLE:g} rad"
            raise UsageError(f"parameter knee.flexion_offset: {text}")
        knees = (parameters, lateral_knee(parameters))
        for compartment, knee in zip(self.compartments, knees, strict=False):
            doubts_about(knee, retuned(compartment.model, knee))

    def retune(self, parameters: Parameters) -> None:
        """Continue with changed numbers among the parameters, between two ticks; `retuned` says which are used."""
        self.parameters = parameters
        self._divide(parameters)
        medial, *lateral = self.compartments
        medial.retune(parameters, -half_spacing(parameters))
        for compartment in lateral:
            compartment.retune(lateral_knee(parameters), half_spacing(parameters))

    def _divide(self, parameters: Parameters) -> None:
        """Set up the rule by which the medial load follows from the joint reaction."""
        self.rule = load_rule(parameters, self._texts)
        self.by_moment = self.rule if self.rule.by_moment else None
        self.varies = self.rule.varies


def load_model(
    source: ParameterSource = DEFAULT_PARAMETERS,
    *,
    compiled: bool | None = None,
    curves: Mapping[str, str] = MappingProxyType({}),
) -> KneeModel:
    """Build the model that a parameter file (or several, or mappings) describes. Needs no ROS.

    Without an argument it is the healthy knee. Names have the same meaning as on the command line: a file as given or
    one of the package's own, like `"osteoarthritis"`. Later ones override earlier ones:
    `["osteoarthritis", "mri_femur", {"femur.mass": 8.0}]`.

    The compiled model computes the same bits about a hundred times faster. It is compiled once for every kind of knee,
    in about 6 s, and kept; after that it loads in under a second. By default a run uses it if that is faster in total,
    and a stream uses it if it is already kept. `compiled` True means always, False never. If Numba cannot be used, a
    warning says so once, and the plain model computes.

    `curves` has the contents of files that parameters name, by parameter, instead of the files. Implausible parameters
    (a stiffness or a body weight that must be in other units) cause a warning.

    Raises:
        UsageError: a parameter file cannot be read, a parameter is unknown or not allowed (see `load_parameters`), or a
            profile or a table cannot be used.

    Example:
        >>> from knee_contact_ros import load_model
        >>> load_model(["osteoarthritis", {"femur.mass": 8.0}])
        <KneeModel: circle on plane, hinge, contact law in 2 layer(s), force drive>
    """
    parameters = load_parameters(source)
    plain = build_model(parameters, curves=curve_texts(parameters, curves))
    model = replace(plain, compiled=compiled, results=Results)
    for doubt in parameter_doubts(parameters, model):
        warnings.warn(doubt, stacklevel=2)
    return model


class Compartment:
    """Compartment of the knee that is computed tick by tick."""

    def __init__(self, topic: str, parameters: Parameters, model: KneeModel, z: float) -> None:
        """Make a compartment at rest.

        Args:
            topic: Topic of its answers.
            parameters: Parameters of the compartment, under the names of the medial one's.
            model: Model with these parameters.
            z: Place in the tibia frame [m]; 0 for the only compartment, as the model is planar.
        """
        self.topic, self.parameters, self.model, self._z = topic, parameters, model, z
        self.doubts = doubts_about(parameters, model)
        """Implausible parameters, and implausible ones among the answers added to it"""
        self.start_anew()

    def start_anew(self) -> None:
        """Restart from rest."""
        self.stream = self.model.stream()
        row = self.stream.answer
        self._point_z = row["contact_point"]["z"]
        force, torque = row["contact_wrench"]["force"], row["contact_wrench"]["torque"]
        self._force_x, self._force_y, self._torque_x, self._torque_y = (
            force["x"],
            force["y"],
            torque["x"],
            torque["y"],
        )

    def compile(self) -> None:
        """Use the compiled model; to be called before the first tick."""
        self.model = replace(self.model, compiled=True)
        self.start_anew()

    def retune(self, parameters: Parameters, z: float) -> None:
        """Continue with changed numbers among the parameters and another place [m], between two ticks."""
        turned = parameters.knee.flexion_offset != self.parameters.knee.flexion_offset
        self.parameters, self._z = parameters, z
        self.model = retuned(self.model, parameters)
        self.stream.continue_with(self.model)
        doubts = doubts_about(parameters, self.model)
        self.doubts.go_on_with(doubts)
        if turned:  # the angles before say nothing of those that come
            self.doubts.inputs = doubts.inputs

    @property
    def row(self) -> Rows:
        """Answer of the last tick, shape (1,); the next tick overwrites it."""
        return self.stream.answer

    def advance(
        self, stamp: int, angle: float, load: float, height: float | None, status: int
    ) -> None:
        """Compute a tick at a stamp [ns] into `row`, with further bits of `Status`; see also `Stream.advance`."""
        self.stream.advance(stamp, angle, load, height)
        if status:
            self.row["status"] |= status
        if self._z:
            self._point_z[0] = self._z
            self._torque_x[0] = -self._z * self._force_y[0]
            self._torque_y[0] = self._z * self._force_x[0]

    def advance_all(
        self,
        stamps: Stamps,
        angles: Floats,
        loads: Floats,
        heights: Floats | None,
        status: NDArray[Any],
    ) -> Rows:
        """Compute many ticks, with the same bits as `advance`. All arrays have shape (n,)."""
        rows = self.stream.advance_all(stamps, angles, loads, heights)
        rows["status"] |= status.astype(np.uint8)
        move_along_z(rows, self._z)
        return rows


def move_along_z(rows: Rows, z: float) -> None:
    """Move the answers of many ticks to a compartment at z [m] from the middle of the tibia."""
    if not z:
        return
    rows["contact_point"]["z"] = z
    force, torque = rows["contact_wrench"]["force"], rows["contact_wrench"]["torque"]
    torque["x"] = -z * force["y"]
    torque["y"] = z * force["x"]


def compartments_of(parameters: Parameters, texts: Mapping[str, str]) -> tuple[Compartment, ...]:
    """Make the only compartment of a knee, or the medial and the lateral one.

    `texts` has the contents of files by parameter.

    Raises:
        UsageError: a model cannot be built; see `build_model`.
    """
    z = half_spacing(parameters)
    first = Compartment(KNEE_CONTACT, parameters, build_model(parameters, curves=texts), -z)
    if not z:
        return (first,)
    own = lateral_knee(parameters)
    return first, Compartment(
        KNEE_CONTACT_LATERAL, own, build_model(own, curves=lateral_texts(texts)), z
    )


def half_spacing(parameters: Parameters) -> float:
    """Distance [m] of the compartments from the middle of the tibia; 0 if there is only one."""
    return 0.5 * parameters.load.compartment_spacing if has_two_compartments(parameters) else 0.0


def summed_wrench(rows: Sequence[bytes]) -> bytes:
    """Row of the first compartment with the sum of all contact wrenches, at the origin of the tibia frame."""
    first, *others = rows
    if not others:
        return first
    wrench = SIX.unpack_from(first, WRENCH_BYTES.start)
    for row in others:
        wrench = tuple(map(add, wrench, SIX.unpack_from(row, WRENCH_BYTES.start)))
    return first[: WRENCH_BYTES.start] + SIX.pack(*wrench) + first[WRENCH_BYTES.stop :]


def summed_wrenches(rows: Sequence[Rows]) -> Rows:
    """Rows of the first compartment with the sums of all contact wrenches, as `summed_wrench` makes them.

    `rows` has an array for each compartment, all of shape (n,).
    """
    first, *others = rows
    if not others:
        return first
    summed = np.frombuffer(bytearray(first.tobytes()), ROW)
    for more in others:
        for name in WRENCH_FIELDS:
            summed.view(FLAT)[name] += more.view(FLAT)[name]
    return summed


def answering(
    topic: str, parameters: Parameters, texts: Mapping[str, str]
) -> tuple[Parameters, Mapping[str, str]]:
    """Parameters, and contents of files by parameter, of the compartment that answers on a topic."""
    if is_lateral(topic):
        return lateral_knee(parameters), lateral_texts(texts)
    return parameters, texts


MOVED, DESCRIBED = NANOSECONDS // 50, 10 * NANOSECONDS
"""Periods [ns]: at the first tick of one the thigh is placed, and the leg described again, for snapshots and splits"""
QUOTE = {'"': "&quot;"}
SHOWN = answer_struct("flexion_angle", "femoral_height", "femoral_x")
"""Reader of the fields of an answer's row that give the pose of the thigh"""


class Leg:
    """Makes the messages about the leg, tick by tick or for many; they depend on stamps and answers alone.

    They are its description (URDF) and the pose of the thigh (tf2). The shank is in the frame of the forces, the tibia
    frame; the thigh is where the answers place the femur. So Rerun, RViz and Foxglove draw and move the leg of a
    recording without anything else.
    """

    def __init__(self) -> None:
        """Begin without ticks; the leg's file is read here, and at no tick."""
        self._last = -1
        _urdf()

    def records(self, stamp: int, frame_id: str, row: bytes) -> list[Record]:
        """Messages of a tick at a stamp [ns], of whose answer the bytes of the `row` are given."""
        before, self._last = self._last, stamp
        records: list[Record] = []
        if stamp // DESCRIBED != before // DESCRIBED:
            records.append((ROBOT_DESCRIPTION, stamp, description(frame_id)))
        if stamp // MOVED != before // MOVED:
            records.append((TF, stamp, pose(stamp, frame_id, row)))
        return records

    def messages(
        self, stamps: Stamps, frame_id: str, rows: Rows
    ) -> Iterator[tuple[str, NDArray[np.intp], Bytes]]:
        """Yield the topics of many ticks, shape (n,), with the numbers of the ticks and the messages of `records`."""
        before = np.append(self._last, stamps[:-1])
        self._last = int(stamps[-1])
        described, moved = (
            np.flatnonzero(stamps // each != before // each) for each in (DESCRIBED, MOVED)
        )
        texts = [description(frame_id)] * len(described)
        poses = [pose(int(stamps[i]), frame_id, rows[i : i + 1].tobytes()) for i in moved]
        for topic, ticks, data in ((ROBOT_DESCRIPTION, described, texts), (TF, moved, poses)):
            yield topic, ticks, np.array([np.frombuffer(one, np.uint8) for one in data])


@lru_cache(maxsize=1)
def _urdf() -> str:
    return (share_folder() / LEG_URDF).read_text(encoding="utf-8")


@lru_cache(maxsize=4)
def description(frame_id: str) -> bytes:
    """Bytes of a std_msgs/String with the URDF of a leg whose shank is `frame_id`, or `shank` if that is empty."""
    text = _urdf().replace(f'"{SHANK}', f'"{escape(frame_id or SHANK, QUOTE)}').encode() + b"\0"
    return HEADER + len(text).to_bytes(4, "little") + text


def pose(stamp: int, frame_id: str, row: bytes) -> bytes:
    """Bytes of a tf2_msgs/TFMessage with the pose of the thigh in `frame_id` at a stamp [ns]."""
    angle, height, x = SHOWN.unpack(row[: ROW.itemsize])
    turn, shank = (0.0, 0.0, math.sin(0.5 * angle), math.cos(0.5 * angle)), frame_id or SHANK
    return encode_transform(Transform(shank, f"{shank}/thigh", (x, height, 0.0), turn), stamp)

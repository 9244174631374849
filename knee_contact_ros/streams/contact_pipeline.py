"""From the messages of a knee's angle and load to contact answers, without ROS: the contact node and `solve` use it."""

import math
import struct
from collections.abc import Mapping
from itertools import takewhile
from typing import NamedTuple

import numpy as np

from ..joint_reaction.compartments import LoadRule
from ..model.knee import (
    LARGEST_ANGLE,
    LARGEST_HEIGHT,
    LARGEST_LOAD,
    KneeModel,
    degrees_hint,
)
from ..model.types import MESSAGE_BYTES, NANOSECOND, ROW, Status
from ..parameters.build import load_rule, retuned
from ..parameters.curves import curve_texts
from ..parameters.schema import KneeSection, Parameters, lateral_knee
from ..parameters.sections import rotation_numbers
from ..system.errors import UsageError
from .compartments import compartments_of, half_spacing, summed_wrench
from .frames import ForceFrame
from .messages import (
    JointState,
    RefusedSampleError,
    WrenchStamped,
    checked_stamp,
    header,
    number_of,
)
from .output import RunState
from .pairing import TIME_RESET, PairedSample
from .pipeline import Pipeline
from .timeline import AngleSample, LoadSample
from .topics import (
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    KNEE_CONTACT,
    KNEE_CONTACT_LATERAL,
    KNEE_CONTACT_WRENCH,
    Record,
)
from .watch import Doubts, Split, doubts_about

DOUBTFUL_LOAD = int(Status.DOUBTFUL_LOAD)
"""A plain number: combining flags of an enumeration takes long"""
CONTACT_TOPICS = (KNEE_CONTACT, KNEE_CONTACT_LATERAL)
"""Topics of the answers of the only or medial, and of the lateral compartment"""
TARE_TIME = 1.0
"""Time [s] over which the sensor's bias is measured"""
TARE_SAMPLES = 10
"""Smallest number of forces in that time"""
TARE_DEVIATION = 0.03
"""Largest standard deviation of these forces, as a fraction of body weight: noise, while a walking leg has 0.5"""
TARE_BIAS = 0.25
"""Largest bias that is measured, as a fraction of body weight: a leg that stands bears more"""
LATENCY = struct.Struct("<d")
"""The latency [s], with which the bytes of a row end"""
LATENCY_BEGIN = ROW.itemsize - LATENCY.size
"""Offset [B] of the latency in the bytes of a row"""


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
        finding = f"flexion angle of joint {knee.joint_name!r} is {angle:g} rad"
        text = f"joint_states: {finding}, beyond {LARGEST_ANGLE:g}{degrees_hint(angle)}"
        raise RefusedSampleError("out_of_range", text)
    height = None
    if height_prescribed:
        height = number_of(message, knee.height_joint_name, "position")
        if abs(height) > LARGEST_HEIGHT:
            finding = f"height of joint {knee.height_joint_name!r} is {height:g} m"
            text = f"joint_states: {finding}, beyond {LARGEST_HEIGHT:g}"
            raise RefusedSampleError("out_of_range", text)
    stamp = checked_stamp(message.stamp, "joint_states") - delay
    return AngleSample(stamp, position, data, height, delay)


def load_sample(
    message: WrenchStamped,
    by_moment: LoadRule | None = None,
    arrived: float = 0.0,
    data: bytes = b"",
    bias: float = 0.0,
) -> LoadSample:
    """Sample with the axial load L = -F_y and the frontal moment of a WrenchStamped on the tibia.

    If `torque.y` is NaN and `torque.z` is a number, the load is doubtful: the load node says so in this way. A sender
    that knows no torque may fill all of it with NaN.

    Args:
        message: The WrenchStamped.
        by_moment: Rule for the compartment's load if that depends on the moment; its result is checked too. The tick
            evaluates it again, since parameters may change while the sample waits for its angle.
        arrived: Time of arrival by the caller's clock [s].
        data: Bytes in which the message is recorded.
        bias: Load [N] that the sensor shows while nothing presses; the sample keeps it, since it may change too.

    Raises:
        RefusedSampleError: the axial force, or a frontal moment that is needed, is not finite; the load is too large;
            or the stamp is not valid.
    """
    force_y = message.force[1]
    moment = message.torque[0]
    if not math.isfinite(force_y):
        raise RefusedSampleError("not_finite", f"joint_reaction_force: force.y is {force_y}")
    if by_moment and not math.isfinite(moment):
        raise RefusedSampleError("not_finite", f"joint_reaction_force: torque.x is {moment}")
    axial = -force_y
    load = axial - bias
    if abs(load) > LARGEST_LOAD:
        text = f"joint_reaction_force: force.y is {force_y:g} N, beyond {LARGEST_LOAD:g}"
        raise RefusedSampleError("out_of_range", text)
    if by_moment:
        medial = by_moment(load, moment, 0.0)
        if max(abs(medial), abs(load - medial)) > LARGEST_LOAD:
            finding = f"torque.x of {moment:g} N m makes a load of {medial:g} N"
            raise RefusedSampleError("out_of_range", f"joint_reaction_force: {finding}")
    stamp = checked_stamp(message.stamp, "joint_reaction_force")
    is_doubtful = math.isnan(message.torque[1]) and math.isfinite(message.torque[2])
    return LoadSample(stamp, axial, moment, message.frame_id, data, arrived, None, is_doubtful)


class ContactAnswer(NamedTuple):
    """Contact at one tick, and the inputs that led to it."""

    pair: PairedSample
    """Load and angle, without their offsets"""
    angle: float
    """Flexion angle [rad] with `knee.flexion_offset`, as the rule saw it"""
    axial: float
    """Axial load [N] with `load.offset`, which the rule divided"""
    rows: tuple[bytes, ...]
    """Bytes of the `ROW` of each compartment, the medial one first"""
    messages: tuple[bytes, ...]
    """Bytes of the `KneeContact` of each compartment"""
    wrench: bytes
    """Bytes of the WrenchStamped with the sum of the contact forces on the tibia"""

    def records(self) -> tuple[Record, ...]:
        """Messages to record, the wrench last."""
        load = self.pair.load
        stamp = load.stamp
        return (
            *[(JOINT_STATES, angle.message_stamp, angle.data) for angle in self.pair.angles],
            (JOINT_REACTION_FORCE, stamp, load.data),
            *zip(CONTACT_TOPICS, (stamp, stamp), self.messages, strict=False),
            (KNEE_CONTACT_WRENCH, stamp, self.wrench),
        )

    def rows_with_latency(self, latency: float) -> bytes:
        """Join `rows`, with the time [s] from the arrival of the force to the publication."""
        number = LATENCY.pack(latency)
        return b"".join([row[:LATENCY_BEGIN] + number for row in self.rows])


class ContactPipeline(Pipeline[ContactAnswer]):
    """Pipeline of the contact node: samples, pairing and model."""

    def __init__(
        self,
        parameters: Parameters,
        *,
        compiled: bool,
        curves: Mapping[str, str] | None = None,
    ) -> None:
        """Build the model; see `build_model` for `curves`."""
        rotation = rotation_numbers(parameters.load.rotation)
        frame = ForceFrame(parameters.frame.tibia, JOINT_REACTION_FORCE, rotation)
        super().__init__(JOINT_REACTION_FORCE, parameters, frame)
        self.parameters = parameters
        self._texts = curve_texts(parameters, {}) if curves is None else curves
        self.compartments = compartments_of(parameters, self._texts)
        """The only compartment, or medial and lateral"""
        self._axes = self.doubts.axes
        self._height_prescribed = self.model.height_prescribed
        self.split = Split(parameters.body_weight)
        """Statistics of the medial share, where it varies"""
        self.is_lost = False
        """Whether the first tick lies in the middle of an unknown motion"""
        self._set_rule(parameters)
        if compiled:
            self.compile_model()

    def compile_model(self) -> None:
        """Use the compiled model, if possible; to be called before the first sample."""
        for compartment in self.compartments:
            compartment.compile_model()

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
        doubts = [doubt for part in self.compartments for doubt in part.doubts.about_parameters]
        return list(dict.fromkeys(doubts))

    def angle_sample(self, message: JointState, data: bytes) -> AngleSample:
        """Sample with the flexion angle; see the function `angle_sample`."""
        delay = self.synchroniser.angle_delay
        return angle_sample(message, self.parameters.knee, self._height_prescribed, data, delay)

    def load_sample(self, message: WrenchStamped, data: bytes, arrived: float) -> LoadSample:
        """Sample with the axial load; see the function `load_sample`."""
        sample = load_sample(message, self.by_moment, arrived, data, self.bias)
        self._axes.add_force(*message.force)
        return sample

    def answer_pair(self, pair: PairedSample) -> ContactAnswer:
        """Compute the contact of each compartment."""
        load = pair.load
        angle = pair.angle + self.parameters.knee.flexion_offset
        axial = load.axial - self.bias
        medial = self.rule(axial, load.moment, angle)
        status = pair.status
        if load.doubtful or (self.by_moment and self.by_moment.is_impossible(axial, medial)):
            status |= DOUBTFUL_LOAD
        rows = []
        parts = zip(self.compartments, (medial, axial - medial), strict=False)
        for compartment, part in parts:
            if status & TIME_RESET:
                compartment.restart()
            row = compartment.compute_row(
                load.stamp, angle, part, pair.height, status, self.is_lost
            )
            rows.append(row)
        self.is_lost = False
        if self.varies:
            self.split.add_sample(axial, medial, self.rule.is_beyond_table(axial, angle))
        head = header(load.stamp, load.frame_id)
        messages = tuple([head + row[MESSAGE_BYTES] for row in rows])
        wrench = head + summed_wrench(rows)
        return ContactAnswer(pair, angle, axial, tuple(rows), messages, wrench)

    def run_state(self) -> RunState | None:
        """Return what the next tick depends on, besides the samples that have not been answered yet.

        None if nothing has happened yet.
        """
        if not (self.ticks or self.synchroniser.will_restart):
            return None
        waiting = self.synchroniser.unpaired_angles
        end = waiting[0].stamp if waiting else math.inf
        used = takewhile(lambda one: one.stamp < end, self.synchroniser.angles)
        return RunState(
            self.synchroniser.last_pair,
            [one[:2] + one[3:5] for one in used],
            [compartment.stream.state() for compartment in self.compartments],
        )

    def resume_recording(self, ticks_before: int, state: RunState | None = None) -> None:
        """Expect the messages of a recording that begins after a number of ticks of the node, in a state.

        Its forces are in the tibia frame already. If ticks are missing before it, and the state is not known, its
        motion is unknown at first.

        Raises:
            ValueError: the state is not one of this pipeline.
        """
        self.frame.is_known = True
        self.synchroniser.expect_recording()
        self.is_lost = ticks_before > 0 and state is None
        if state is None:
            return
        angles = [AngleSample(stamp, angle, b"", *more) for stamp, angle, *more in state.angles]
        self.synchroniser.resume(angles, (), (), state.stamp)
        if state.stamp is None:  # the node was reset after its last tick
            self.reset()
            return
        for compartment, numbers in zip(self.compartments, state.numbers, strict=True):
            compartment.stream.resume(state.stamp, numbers)

    def measured_offset(self) -> float:
        """Offset [N] with which the mean axial load of the last second is 0: for a leg that hangs free.

        Raises:
            UsageError: there are too few forces, or they are none of a leg that hangs free.
        """
        stamps, forces = self.force_conflict.recent_samples(TARE_TIME)
        span = NANOSECOND * float(np.ptp(stamps)) if len(stamps) else 0.0
        topic, weight = self.sources[self.force_topic], self.parameters.body_weight
        if len(forces) < TARE_SAMPLES or span < 0.8 * TARE_TIME:
            text = f"{len(forces)} forces over {span:.2f} s came on {topic}"
            raise UsageError(f"{text}; a tare needs {TARE_SAMPLES} over {TARE_TIME:g} s")
        mean, deviation = float(np.mean(forces)), float(np.std(forces))
        text = f"the axial load was {mean:.1f} N +- {deviation:.1f} N over {span:.2f} s"
        if deviation > TARE_DEVIATION * weight or abs(mean) > TARE_BIAS * weight:
            allowed = f"{TARE_BIAS * weight:.0f} N +- {TARE_DEVIATION * weight:.0f} N"
            raise UsageError(
                f"{text}, and a leg that hangs free has at most {allowed}; otherwise set load.offset"
            )
        return -mean

    def check_retune(self, parameters: Parameters) -> None:
        """Check that `retune` will accept these parameters; raises the reason if not, and changes nothing."""
        load_rule(parameters, self._texts)
        offset = parameters.knee.flexion_offset
        waiting = (*self.synchroniser.angles, *self.synchroniser.angle_time.held_back)
        if any(abs(sample.angle + offset) > LARGEST_ANGLE for sample in waiting):
            text = f"with an angle that waits for its force, {offset:g} rad is beyond {LARGEST_ANGLE:g} rad"
            raise UsageError(f"parameter knee.flexion_offset: {text}")
        loads = (*self.synchroniser.waiting_loads, *self.synchroniser.load_time.held_back)
        offset = parameters.load.offset
        if any(abs(sample.axial + offset) > LARGEST_LOAD for sample in loads):
            text = (
                f"with a force that waits for its angle, {offset:g} N is beyond {LARGEST_LOAD:g} N"
            )
            raise UsageError(f"parameter load.offset: {text}")
        knees = (parameters, lateral_knee(parameters))
        for compartment, knee in zip(self.compartments, knees, strict=False):
            doubts_about(knee, retuned(compartment.model, knee))

    def retune(self, parameters: Parameters) -> None:
        """Continue with changed numbers among the parameters, between two ticks; `retuned` says which are used."""
        self.parameters = parameters
        self._set_rule(parameters)
        medial, *lateral = self.compartments
        medial.retune(parameters, -half_spacing(parameters))
        for compartment in lateral:
            compartment.retune(lateral_knee(parameters), half_spacing(parameters))

    def _set_rule(self, parameters: Parameters) -> None:
        """Set up the rule by which the medial load follows from the joint reaction."""
        self.rule = load_rule(parameters, self._texts)
        # Subtracted, and 0.0 without an offset: so a load of -0.0 keeps its bits.
        self.bias = 0.0 - parameters.load.offset
        self.by_moment = self.rule if self.rule.by_moment else None
        self.varies = self.rule.share_varies

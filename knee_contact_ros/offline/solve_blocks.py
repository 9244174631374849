"""Many samples through the pipeline at once, offline: the same bytes as one by one, in a tenth of the time.

A block is decoded, paired, computed and written as columns of numbers if its messages share their layouts, its samples
are in order, and none must be refused. Any other block is computed sample by sample, and the next block is tried again.
`Synchroniser.is_steady` and `resume` hand over the samples that wait between two blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bags.batch_writer import TopicMessages
from ..bags.leg import DrawnLeg
from ..model.knee import LARGEST_ANGLE, LARGEST_HEIGHT, LARGEST_LOAD
from ..model.types import ROW, Floats, Indices, Rows, Stamps
from ..streams.columns import (
    Block,
    Column,
    decode_all,
    encode_answer_wrenches,
    encode_answers,
)
from ..streams.compartments import summed_wrenches
from ..streams.contact_pipeline import (
    CONTACT_TOPICS,
    DOUBTFUL_LOAD,
    ContactAnswer,
    ContactPipeline,
)
from ..streams.holes import STEPS
from ..streams.messages import JOINT_STATE, LAST_STAMP, WRENCH
from ..streams.pairing import STALE_INPUT, Synchroniser
from ..streams.timeline import LONG_STEP, AngleSample, LoadSample, Timeline
from ..streams.topics import (
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    KNEE_CONTACT_WRENCH,
    NANOSECONDS,
)

MAX_EXACT_STEP = 2**53
"""Limit [ns] below which differences of stamps are exact as floating-point numbers"""


class AnswerBlock(NamedTuple):
    """Answers to a block of messages, and the inputs that led to them; arrays of shape (n,)."""

    rows: tuple[Rows, ...]
    """Answers of each compartment"""
    axial: Floats
    """Axial forces [N], as the rule that divides the load saw them"""
    moment: Floats
    """Frontal moments [N m]"""
    angle: Floats
    """Flexion angles [rad], with the offset"""

    @classmethod
    def of(cls, answers: Sequence[ContactAnswer]) -> AnswerBlock:
        """Make a block of single answers, at least one."""
        rows = np.frombuffer(b"".join([row for answer in answers for row in answer.rows]), ROW)
        compartments = len(answers[0].messages)
        return cls(
            tuple(rows[first::compartments] for first in range(compartments)),
            np.array([answer.axial for answer in answers]),
            np.array([answer.pair.load.moment for answer in answers]),
            np.array([answer.angle for answer in answers]),
        )


class _Samples(NamedTuple):
    """The samples of a block as columns, after those that were already waiting."""

    states: Block
    is_unpaired: NDArray[np.bool_]
    """Whether an angle is still to be recorded, for each angle"""
    stamps: Stamps
    """Stamps [ns] of the angles, minus `delay`"""
    delay: int
    """Delay of the angles `pairing.angle_delay` [ns]"""
    angles: Floats
    """Flexion angles [rad] without the offset"""
    heights: Floats | None
    """Femoral heights [m] with the displacement drive"""
    wrenches: Block
    axial: Floats
    moment: Floats
    doubtful: NDArray[np.bool_]

    def angle_sample(self, index: int) -> AngleSample:
        """Return the angle sample as the pipeline makes it of one message."""
        height = None if self.heights is None else float(self.heights[index])
        data = self.states.data[index].tobytes()
        angle = float(self.angles[index])
        return AngleSample(int(self.stamps[index]), angle, data, height, self.delay)

    def load_sample(self, index: int) -> LoadSample:
        """Load sample as the pipeline makes it of one message."""
        return LoadSample(
            int(self.wrenches.stamps[index]),
            float(self.axial[index]),
            float(self.moment[index]),
            self.wrenches.shape[0],
            self.wrenches.data[index].tobytes(),
            doubtful=bool(self.doubtful[index]),
        )


class _Pairs(NamedTuple):
    """Ticks for the first n of the loads of a block; all arrays but the last have shape (n,)."""

    angle: Floats
    """Flexion angles [rad] at the stamps of the loads, without the offset"""
    height: Floats | None
    """Femoral heights [m] at these stamps, with the displacement drive"""
    status: NDArray[np.int64]
    """Bits of `Status`"""
    tick_of_angle: Indices
    """For every angle, the first tick at or after its stamp, with which it is recorded; n if none yet"""


class BlockAnswers(NamedTuple):
    """Answers to a block, with what is recorded of it."""

    block: AnswerBlock
    samples: _Samples
    pairs: _Pairs

    def messages(self, leg: DrawnLeg) -> list[TopicMessages]:
        """Return the messages to record, inputs and outputs, with their places in the order of the recording."""
        samples = self.samples
        rows = self.block.rows
        number = len(self.block.angle)
        stamps = samples.wrenches.stamps[:number]
        frame_id = samples.wrenches.shape[0]
        taken = samples.is_unpaired & (self.pairs.tick_of_angle < number)
        # Places of a tick: its angles, the load, the answers, two of the leg, the wrench.
        each = len(rows) + 5
        place = each * np.arange(number)
        place_of_angle = each * self.pairs.tick_of_angle[taken]
        states = samples.states
        messages = [
            TopicMessages(JOINT_STATES, states.stamps[taken], states.data[taken], place_of_angle),
            TopicMessages(JOINT_REACTION_FORCE, stamps, samples.wrenches.data[:number], place + 1),
        ]
        for behind, answers in enumerate(rows):
            data = encode_answers(frame_id, stamps, answers)
            messages.append(
                TopicMessages(CONTACT_TOPICS[behind], stamps, data, place + 2 + behind)
            )
        for behind, (topic, ticks, data) in enumerate(leg.messages(stamps, frame_id, rows[0])):
            messages.append(
                TopicMessages(topic, stamps[ticks], data, place[ticks] + each - 3 + behind)
            )
        wrenches = encode_answer_wrenches(frame_id, stamps, summed_wrenches(rows))
        messages.append(TopicMessages(KNEE_CONTACT_WRENCH, stamps, wrenches, place + each - 1))
        return messages


def answer_block(
    pipeline: ContactPipeline, states: Column, forces: Column, streams: Indices
) -> BlockAnswers | None:
    """Compute the ticks of a block at once, from the messages of both topics.

    Afterwards `pipeline` is in the state that it would have after the same messages one by one.

    Args:
        pipeline: The pipeline, which may have taken messages before.
        states: The joint states, in the order of their arrival.
        forces: The forces, in the order of their arrival.
        streams: Order of both, shape (n,): 0 for a state, 1 for a force.

    Returns:
        The answers; None if the block has to be computed sample by sample: then `pipeline` is unchanged.
    """
    before = pipeline.synchroniser
    if not (before.is_steady and len(states) and len(forces)):
        return None
    pairing = pipeline.parameters.pairing
    max_gap = round(pairing.max_gap * NANOSECONDS)
    all_states, all_forces, is_unpaired = _with_waiting(before, states, forces)
    if max(len(all_states), len(all_forces)) > pairing.queue:
        return None
    samples = _samples(pipeline, all_states, all_forces, is_unpaired)
    if samples is None:
        return None
    turned, leads, farthest = _leads(before, samples, streams)
    new_angles = slice(-len(states), None)
    new_loads = slice(-len(forces), None)
    angle_steps = _steps(before.angle_time, samples.stamps[new_angles])
    load_steps = _steps(before.load_time, samples.wrenches.stamps[new_loads])
    if not (
        farthest <= max_gap
        and _all_continue(angle_steps, len(before.angle_time.steps), max_gap)
        and _all_continue(load_steps, len(before.load_time.steps), max_gap)
    ):
        return None
    pairs = _pairs(samples, before.last_pair, max_gap)
    if pairs is None or not len(pairs.angle):
        return None
    pipeline.frame.hold_frame(samples.wrenches.shape[0])
    pipeline.angle_conflict.add_samples(
        samples.states.stamps[new_angles], samples.angles[new_angles]
    )
    pipeline.force_conflict.add_samples(
        samples.wrenches.stamps[new_loads], samples.axial[new_loads]
    )
    block = _compute(pipeline, samples, pairs)
    before.angle_time.resume(int(samples.stamps[-1]), angle_steps[-STEPS:].tolist())
    before.load_time.resume(int(samples.wrenches.stamps[-1]), load_steps[-STEPS:].tolist())
    _resume(before, samples, pairs)
    before.clock_sets.add_leads(turned.tolist(), leads.tolist())
    before.load_came_last = bool(streams[-1])
    before.newest_angle = int(samples.states.stamps[-1])
    return BlockAnswers(block, samples, pairs)


def _leads(
    before: Synchroniser, samples: _Samples, streams: Indices
) -> tuple[Stamps, Stamps, int]:
    """Return stamps of loads after an angle, their leads over it, and the largest lead of either stream [ns]."""
    is_load = streams == 1
    loads = int(np.count_nonzero(is_load))
    stamps = np.empty(len(streams), np.int64)
    stamps[is_load] = samples.wrenches.stamps[len(samples.wrenches.stamps) - loads :]
    stamps[~is_load] = samples.states.stamps[len(samples.states.stamps) + loads - len(streams) :]
    last = before.newest_angle if is_load[0] else before.load_time.last
    turns = np.diff(is_load, prepend=before.load_came_last)
    turns[0] &= last is not None
    steps = np.diff(stamps, prepend=last or 0)
    of_load = turns & is_load
    return stamps[of_load], steps[of_load], int(np.abs(steps[turns]).max(initial=0))


def _with_waiting(
    before: Synchroniser, states: Column, forces: Column
) -> tuple[Column, Column, NDArray[np.bool_]]:
    """Put the messages of a block after waiting ones; return which of the angles must still be recorded."""
    waiting = {angle.stamp: angle.data for angle in (*before.unpaired_angles, *before.angles)}
    unpaired = {angle.stamp for angle in before.unpaired_angles}
    stamps = sorted(waiting)
    all_states = Column.together([Column.of([waiting[stamp] for stamp in stamps]), states])
    all_forces = Column.together([Column.of([load.data for load in before.waiting_loads]), forces])
    is_unpaired = [stamp in unpaired for stamp in stamps] + [True] * len(states)
    return all_states, all_forces, np.array(is_unpaired)


def _steps(time: Timeline[Any], stamps: Stamps) -> Stamps:
    """Return the steps [ns] of a stream: the last ones before its new stamps, the one to them, and those between."""
    new = np.diff(stamps) if time.last is None else np.diff(stamps, prepend=time.last)
    return np.concatenate([np.array(time.steps, np.int64), new])


def _all_continue(steps: Stamps, known: int, max_gap: int) -> bool:
    """Return whether a `Timeline` would accept all steps [ns] after the `known` ones: forward, and not too far."""
    if len(steps) <= known:
        return False
    recent = np.concatenate([np.zeros(STEPS, np.int64), steps[:-1]])
    windows = np.sort(np.lib.stride_tricks.sliding_window_view(recent, STEPS), axis=1)
    usual = np.where(windows[:, -2] > 0, windows[:, -2], windows[:, -1])
    continues = (steps > 0) & (steps <= np.where(usual > 0, LONG_STEP * usual, max_gap))
    return bool(continues[known:].all())


def _samples(
    pipeline: ContactPipeline, states: Column, forces: Column, is_unpaired: NDArray[np.bool_]
) -> _Samples | None:
    """Decode a block into columns of samples; None if a sample would be refused, or must be treated alone."""
    decoded = decode_all(JOINT_STATE, states)
    wrenches = decode_all(WRENCH, forces)
    if decoded is None or wrenches is None or not pipeline.frame.needs_no_turn(wrenches.shape[0]):
        return None
    knee = pipeline.parameters.knee
    position = _position(decoded, knee.joint_name)
    if position is None:
        return None
    angles = knee.flexion_sign * position
    axial = -wrenches.numbers["force"][:, 1]
    load = axial - pipeline.bias
    moment, about_y, about_z = wrenches.numbers["torque"].T
    limited = [
        (angles + knee.flexion_offset, LARGEST_ANGLE),
        (position, np.inf),
        (load, LARGEST_LOAD),
    ]
    heights = None
    if pipeline.model.height_prescribed:
        heights = _position(decoded, knee.height_joint_name)
        if heights is None:
            return None
        limited.append((heights, LARGEST_HEIGHT))
    if pipeline.by_moment:
        medial = pipeline.by_moment(load, moment, 0.0)
        with np.errstate(invalid="ignore"):  # infinite forces are refused below
            limited += [(medial, LARGEST_LOAD), (load - medial, LARGEST_LOAD)]
    for column, limit in limited:
        if not (np.isfinite(column) & (np.abs(column) <= limit)).all():
            return None
    for stamps in (decoded.stamps, wrenches.stamps):
        if not ((stamps >= 0) & (stamps <= LAST_STAMP)).all():
            return None
    delay = pipeline.synchroniser.angle_delay
    return _Samples(
        decoded,
        is_unpaired,
        decoded.stamps - delay,
        delay,
        angles,
        heights,
        wrenches,
        axial,
        np.ascontiguousarray(moment),
        np.isnan(about_y) & np.isfinite(about_z),
    )


def _position(states: Block, joint: str) -> Floats | None:
    """Return the positions of a joint, shape (n,); None if the joint states do not give them."""
    _, names, known, *_ = states.shape
    if joint not in names or len(names) != known:
        return None
    return np.ascontiguousarray(states.numbers["position"][:, names.index(joint)])


def _pairs(samples: _Samples, last: int | None, max_gap: int) -> _Pairs | None:
    """Pair loads with angles; the loads after the last angle have to wait.

    Args:
        samples: The samples.
        last: Stamp of the previous tick [ns]; None if there is none.
        max_gap: Largest gap [ns] that is not stale.

    Returns:
        The pairs; None if the stamps of a stream do not increase, or a load is before the first angle or the last tick.
    """
    angle_stamps = samples.stamps
    load_stamps = samples.wrenches.stamps
    if load_stamps[0] < angle_stamps[0] or (last is not None and load_stamps[0] <= last):
        return None
    for stamps in (angle_stamps, load_stamps):
        steps = np.diff(stamps)
        if (steps <= 0).any() or (steps >= MAX_EXACT_STEP).any():
            return None
    stamps = load_stamps[: np.searchsorted(load_stamps, angle_stamps[-1], "right")]
    before = np.searchsorted(angle_stamps, stamps, "right") - 1
    is_exact = angle_stamps[before] == stamps
    after = np.where(is_exact, before, before + 1)
    gap = angle_stamps[after] - angle_stamps[before]
    part = (stamps - angle_stamps[before]) / np.where(is_exact, 1, gap)

    def interpolate(values: Floats) -> Floats:
        between = values[before] + part * (values[after] - values[before])
        return np.where(is_exact, values[before], between)

    first = load_stamps[0] if last is None else last
    is_stale = (gap > max_gap) | (np.diff(stamps, prepend=first) > max_gap)
    return _Pairs(
        interpolate(samples.angles),
        None if samples.heights is None else interpolate(samples.heights),
        np.where(is_stale, STALE_INPUT, 0),
        np.searchsorted(stamps, angle_stamps, "left"),
    )


def _compute(pipeline: ContactPipeline, samples: _Samples, pairs: _Pairs) -> AnswerBlock:
    """Compute the contact of the loads that are paired with angles, as `ContactPipeline.answer_pair` does."""
    number = len(pairs.angle)
    axial = samples.axial[:number] - pipeline.bias
    moment = samples.moment[:number]
    angle = pairs.angle + pipeline.parameters.knee.flexion_offset
    medial = pipeline.rule(axial, moment, angle)
    doubtful = samples.doubtful[:number]
    if pipeline.by_moment:
        doubtful = doubtful | pipeline.by_moment.is_impossible(axial, medial)
    status = pairs.status | np.where(doubtful, DOUBTFUL_LOAD, 0).astype(pairs.status.dtype)
    stamps = samples.wrenches.stamps[:number]
    rows = tuple(
        compartment.compute_rows(stamps, angle, load, pairs.height, status)
        for compartment, load in zip(pipeline.compartments, (medial, axial - medial), strict=False)
    )
    pipeline.ticks += number
    pipeline.doubts.axes.add_forces(samples.wrenches.numbers["force"][:number])
    if pipeline.varies:
        pipeline.split.add_samples(axial, medial, pipeline.rule.is_beyond_table(axial, angle))
    return AnswerBlock(rows, axial, moment, angle)


def _resume(synchroniser: Synchroniser, samples: _Samples, pairs: _Pairs) -> None:
    """Put the synchroniser into the state that it would have after all samples one by one."""
    number = len(pairs.angle)
    angle_stamps = samples.stamps
    load_stamps = samples.wrenches.stamps
    last = int(load_stamps[number - 1])
    first = int(np.searchsorted(angle_stamps, last, "right")) - 1
    unpaired = np.flatnonzero(samples.is_unpaired & (pairs.tick_of_angle == number)).tolist()
    synchroniser.resume(
        map(samples.angle_sample, range(first, len(angle_stamps))),
        map(samples.angle_sample, unpaired),
        map(samples.load_sample, range(number, len(load_stamps))),
        last,
    )

"""Many samples through the pipeline at once, offline: the same bytes as one by one, in a tenth of the time.

A block is decoded, paired, computed and written as columns of numbers if its messages share their layouts, its samples
are in order, and none must be refused. Any other block is computed sample by sample, and the next block is tried again.
`Synchroniser.is_steady` and `go_on` hand over the samples that wait between two blocks.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.batch_writer import TopicMessages
from knee_contact_ros.model.knee import LARGEST_ANGLE, LARGEST_HEIGHT, LARGEST_LOAD
from knee_contact_ros.model.types import Floats, Rows, Stamps
from knee_contact_ros.streams.columns import (
    Block,
    Column,
    PairedSamples,
    all_go_on,
    decode_all,
    encode_answer_wrenches,
    encode_answers,
    pair,
)
from knee_contact_ros.streams.contact_pipeline import (
    DOUBTFUL_LOAD,
    ContactPipeline,
    summed_wrenches,
)
from knee_contact_ros.streams.messages import JOINT_STATE, LAST_STAMP, WRENCH
from knee_contact_ros.streams.pairing import STEPS, AngleSample, LoadSample, Synchroniser, Timeline
from knee_contact_ros.streams.topics import (
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    KNEE_CONTACT_WRENCH,
    NANOSECONDS,
)

Numbers = NDArray[np.intp]
Fresh = NDArray[np.bool_]
"""Whether an angle of a block is still to be recorded, for each angle, shape (n,)"""


Answers = tuple[tuple[Rows, ...], tuple[TopicMessages, ...]]
"""Answers to a block: for each compartment the rows, shape (n,), and the messages to record, inputs and outputs, with
their places in the order of the recording"""


class _Samples(NamedTuple):
    """The samples of a block as columns, after those that were already waiting."""

    states: Block
    stamps: Stamps
    """Stamps [ns] of the angles, minus `delay`"""
    delay: int
    """Delay of the angles `pairing.angle_delay` [ns]"""
    angles: Floats
    """Flexion angles [rad] without the offset"""
    heights: Floats | None
    wrenches: Block
    axial: Floats
    moment: Floats
    doubtful: NDArray[np.bool_]

    def angle(self, index: int) -> AngleSample:
        """Angle sample."""
        height = None if self.heights is None else float(self.heights[index])
        data = self.states.data[index].tobytes()
        return AngleSample(
            int(self.stamps[index]), float(self.angles[index]), data, height, self.delay
        )

    def load(self, index: int) -> LoadSample:
        """Load sample."""
        stamp, frame_id, data = (
            int(self.wrenches.stamps[index]),
            self.wrenches.shape[0],
            self.wrenches.data[index],
        )
        axial, moment, doubtful = (
            float(self.axial[index]),
            float(self.moment[index]),
            bool(self.doubtful[index]),
        )
        return LoadSample(stamp, axial, moment, frame_id, data.tobytes(), doubtful=doubtful)


def take(
    pipeline: ContactPipeline, states: Column, forces: Column, numbers: Numbers
) -> Answers | None:
    """Compute the ticks of a block at once, from the messages of both topics in the order in which they came.

    `numbers` has the order of both, shape (n,): 0 for a state, 1 for a force.

    Afterwards `pipeline` is in the state that it would have after the same messages one by one. Returns None if the
    block has to be computed sample by sample; `pipeline` is unchanged then.
    """
    before = pipeline.synchroniser
    if not (before.is_steady and len(states) and len(forces)):
        return None
    pairing = pipeline.parameters.pairing
    max_gap = round(pairing.max_gap * NANOSECONDS)
    all_states, all_forces, fresh = _with_held(before, states, forces)
    waits = max(len(all_states), len(all_forces))
    samples = _samples(all_states, all_forces, pipeline) if waits <= pairing.queue else None
    if samples is None or _apart(before, samples, numbers, max_gap):
        return None
    angle_steps = _steps(before.angle_time, samples.stamps[-len(states) :])
    load_steps = _steps(before.load_time, samples.wrenches.stamps[-len(forces) :])
    known = ((angle_steps, before.angle_time), (load_steps, before.load_time))
    if not all(all_go_on(steps, len(time.steps), max_gap) for steps, time in known):
        return None
    paired = pair(
        samples.stamps,
        samples.angles,
        samples.heights,
        samples.wrenches.stamps,
        before.last_pair,
        max_gap,
    )
    if paired is None or not len(paired.angle):
        return None
    pipeline.frame.hold(samples.wrenches.shape[0])
    pipeline.angles_seen.add_all(
        samples.states.stamps[-len(states) :], samples.angles[-len(states) :]
    )
    pipeline.forces_seen.add_all(
        samples.wrenches.stamps[-len(forces) :], samples.axial[-len(forces) :]
    )
    answers = _computed(pipeline, samples, paired, fresh)
    _hand_over(pipeline, samples, paired, fresh, (angle_steps, load_steps))
    return answers


def _apart(pairs: Synchroniser, samples: _Samples, numbers: Numbers, max_gap: int) -> bool:
    """Whether stamps differ from the other stream's last one by more than `max_gap` [ns]; see `Synchroniser`."""
    loads, (states, forces) = numbers == 1, (samples.states.stamps, samples.wrenches.stamps)
    stamps, count = np.empty(len(numbers), np.int64), int(np.count_nonzero(loads))
    stamps[loads], stamps[~loads] = (
        forces[len(forces) - count :],
        states[len(states) - len(loads) + count :],
    )
    turns, before = np.diff(loads, prepend=not loads[0]), pairs.load_time.last
    if loads[0]:
        before = (
            None if pairs.angle_time.last is None else pairs.angle_time.last + pairs.angle_delay
        )
    steps = np.diff(stamps, prepend=stamps[0] if before is None else before)
    return bool((turns & (np.abs(steps) > max_gap)).any())


def _with_held(
    before: Synchroniser, states: Column, forces: Column
) -> tuple[Column, Column, Fresh]:
    """Put the messages of a block after waiting ones; return which of the angles must still be recorded."""
    held = {angle.stamp: angle.data for angle in (*before.fresh, *before.angles)}
    untaken = {angle.stamp for angle in before.fresh}
    all_states = Column.together([Column.of([held[stamp] for stamp in sorted(held)]), states])
    all_forces = Column.together([Column.of([load.data for load in before.waiting]), forces])
    return (
        all_states,
        all_forces,
        np.array([stamp in untaken for stamp in sorted(held)] + [True] * len(states)),
    )


def _steps(time: Timeline[Any], stamps: Stamps) -> Stamps:
    """Return the steps [ns] of a stream: the last ones before its new stamps, the one to them, and those between."""
    new = np.diff(stamps) if time.last is None else np.diff(stamps, prepend=time.last)
    return np.concatenate([np.array(time.steps, np.int64), new])


def _samples(states: Column, forces: Column, pipeline: ContactPipeline) -> _Samples | None:
    """Decode a block into columns of samples; None if a sample would be refused, or must be treated alone."""
    decoded, wrenches = decode_all(JOINT_STATE, states), decode_all(WRENCH, forces)
    if decoded is None or wrenches is None or not pipeline.frame.goes_on(wrenches.shape[0]):
        return None
    knee = pipeline.parameters.knee
    position = _position(decoded, knee.joint_name)
    heights = (
        _position(decoded, knee.height_joint_name) if pipeline.model.height_prescribed else None
    )
    if position is None or (pipeline.model.height_prescribed and heights is None):
        return None
    angles = knee.flexion_sign * position
    axial, (moment, about_y, about_z) = (
        -wrenches.numbers["force"][:, 1],
        wrenches.numbers["torque"].T,
    )
    columns = [
        (angles + knee.flexion_offset, LARGEST_ANGLE),
        (position, np.inf),
        (axial, LARGEST_LOAD),
    ]
    if pipeline.by_moment:
        part = pipeline.by_moment(axial, moment, 0.0)
        with np.errstate(invalid="ignore"):  # infinite forces are refused below
            columns += [(part, LARGEST_LOAD), (axial - part, LARGEST_LOAD)]
    columns += [(heights, LARGEST_HEIGHT)] if heights is not None else []
    if not all(
        (np.isfinite(column) & (np.abs(column) <= limit)).all() for column, limit in columns
    ):
        return None
    if not all(
        ((stamps >= 0) & (stamps <= LAST_STAMP)).all()
        for stamps in (decoded.stamps, wrenches.stamps)
    ):
        return None
    delay, doubtful = pipeline.synchroniser.angle_delay, np.isnan(about_y) & np.isfinite(about_z)
    return _Samples(
        decoded, decoded.stamps - delay, delay, angles, heights, wrenches, axial, moment, doubtful
    )


def _position(states: Block, joint: str) -> Floats | None:
    """Return the positions of a joint, shape (n,); None if the joint states do not give them."""
    _, names, known, *_ = states.shape
    if joint not in names or len(names) != known:
        return None
    return np.ascontiguousarray(states.numbers["position"][:, names.index(joint)])


def _computed(
    pipeline: ContactPipeline, samples: _Samples, paired: PairedSamples, fresh: Fresh
) -> Answers:
    """Compute the loads that are paired with angles; return the answers, and the inputs and outputs to record."""
    number = len(paired.angle)
    stamps, frame_id = samples.wrenches.stamps[:number], samples.wrenches.shape[0]
    axial, angle = samples.axial[:number], paired.angle + pipeline.parameters.knee.flexion_offset
    medial = pipeline.rule(axial, samples.moment[:number], angle)
    doubtful = samples.doubtful[:number]
    if pipeline.by_moment:
        doubtful = doubtful | pipeline.by_moment.fails(axial, medial)
    status = paired.status | np.where(doubtful, DOUBTFUL_LOAD, 0).astype(paired.status.dtype)
    rows = tuple(
        compartment.advance_all(stamps, angle, loads, paired.height, status)
        for compartment, loads in zip(
            pipeline.compartments, (medial, axial - medial), strict=False
        )
    )
    pipeline.ticks += number
    pipeline.doubts.axes.add_forces(samples.wrenches.numbers["force"][:number])
    if pipeline.varies:
        pipeline.split.add_all(axial, medial, pipeline.rule.beyond(axial, angle))
    taken = fresh & (paired.tick_of_angle < number)
    states, each = samples.states, len(rows) + 5
    place = each * np.arange(number)
    answered = [
        TopicMessages(
            compartment.topic, stamps, encode_answers(frame_id, stamps, answers), place + behind
        )
        for behind, (compartment, answers) in enumerate(
            zip(pipeline.compartments, rows, strict=True), start=2
        )
    ]
    leg = [
        TopicMessages(topic, stamps[ticks], data, place[ticks] + each - 3 + behind)
        for behind, (topic, ticks, data) in enumerate(
            pipeline.leg.messages(stamps, frame_id, rows[0])
        )
    ]
    wrenches = encode_answer_wrenches(frame_id, stamps, summed_wrenches(rows))
    messages = (
        TopicMessages(
            JOINT_STATES,
            states.stamps[taken],
            states.data[taken],
            each * paired.tick_of_angle[taken],
        ),
        TopicMessages(JOINT_REACTION_FORCE, stamps, samples.wrenches.data[:number], place + 1),
        *answered,
        *leg,
        TopicMessages(KNEE_CONTACT_WRENCH, stamps, wrenches, place + each - 1),
    )
    return rows, messages


def _hand_over(
    pipeline: ContactPipeline,
    samples: _Samples,
    paired: PairedSamples,
    fresh: Fresh,
    steps: tuple[Stamps, Stamps],
) -> None:
    """Put the synchroniser into the state that it would have after all samples one by one."""
    number, synchroniser = len(paired.angle), pipeline.synchroniser
    angle_stamps, load_stamps = samples.stamps, samples.wrenches.stamps
    last = int(load_stamps[number - 1])
    first = int(np.searchsorted(angle_stamps, last, "right")) - 1
    untaken = np.flatnonzero(fresh & (paired.tick_of_angle == number)).tolist()
    synchroniser.angle_time.go_on(int(angle_stamps[-1]), steps[0][-STEPS:].tolist())
    synchroniser.load_time.go_on(int(load_stamps[-1]), steps[1][-STEPS:].tolist())
    angles, waiting = range(first, len(angle_stamps)), range(number, len(load_stamps))
    synchroniser.go_on(
        map(samples.angle, angles), map(samples.angle, untaken), map(samples.load, waiting), last
    )

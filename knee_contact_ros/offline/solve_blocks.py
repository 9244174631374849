"""Many samples through the pipeline at once, offline: the same bytes as one by one, in a tenth of the time.

A block whose messages share their layouts, with samples in order and none to refuse, is decoded, paired, computed and
written as columns of numbers. Anything else is left to the ordinary way, sample by sample, and the next block is tried
again: `Synchroniser.steady` and `go_on` hand over what waits between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.block_recorder import Messages
from knee_contact_ros.core.model import LARGEST_ANGLE, LARGEST_HEIGHT, LARGEST_LOAD
from knee_contact_ros.core.types import Rows
from knee_contact_ros.messages.answer_out import encode_answer_wrenches, encode_answers
from knee_contact_ros.messages.cdr import JOINT_STATE, SECOND, WRENCH, Block
from knee_contact_ros.messages.topics import JOINT_REACTION_FORCE, JOINT_STATES, KNEE_CONTACT, KNEE_CONTACT_WRENCH
from knee_contact_ros.parameters.compartments import BY_MOMENT, COMPARTMENTS
from knee_contact_ros.pipeline.pair_blocks import PairedSamples, Stamps, all_go_on, pair, steps_of
from knee_contact_ros.pipeline.pipeline import Pipeline
from knee_contact_ros.pipeline.samples import LAST_STAMP, AngleSample, LoadSample, angle_sample, load_sample
from knee_contact_ros.pipeline.synchronise import Steady
from knee_contact_ros.pipeline.timeline import STEPS

Floats = NDArray[np.float64]
Fresh = NDArray[np.bool_]
"""Of every angle of a block: whether it is still to be recorded"""


class Answers(NamedTuple):
    """The answers to a block."""

    rows: Rows
    """Shape (n,)"""
    messages: tuple[Messages, ...]
    """What is to be recorded"""


class _Received(NamedTuple):
    """Messages behind those that waited before them."""

    states: list[bytes]
    forces: list[bytes]


class _Samples(NamedTuple):
    """The samples in a block's messages."""

    states: Block
    angles: Floats
    heights: Floats | None
    wrenches: Block
    loads: Floats


def take(pipeline: Pipeline, states: Sequence[bytes], forces: Sequence[bytes]) -> Answers | None:
    """Take the messages of both topics, in the order in which they come; None: nothing was taken.

    What `pipeline` holds afterwards is what it would hold after all of them one by one.
    """
    steady = pipeline.synchroniser.steady()
    if steady is None or not (states and forces):
        return None
    pairing = pipeline.parameters.pairing
    max_gap = round(pairing.max_gap * SECOND)
    block, fresh = _with_held(steady, states, forces)
    samples = _samples(block, pipeline) if max(map(len, block)) <= pairing.queue else None
    if samples is None:
        return None
    angle_steps, load_steps = _steps(steady, samples)
    if not all_go_on(angle_steps, len(steady.angle_steps), max_gap):
        return None
    if not all_go_on(load_steps, len(steady.load_steps), max_gap):
        return None
    paired = pair(
        samples.states.stamps, samples.angles, samples.heights, samples.wrenches.stamps, steady.last_pair, max_gap
    )
    if paired is None or not len(paired.angle):
        return None
    pipeline.frame.hold(samples.wrenches.shape[0])
    answers = _computed(pipeline, samples, paired, fresh)
    _hand_over(pipeline, block, samples, paired, fresh, (angle_steps, load_steps))
    return answers


def _with_held(steady: Steady, states: Sequence[bytes], forces: Sequence[bytes]) -> tuple[_Received, Fresh]:
    """The messages behind those that wait; and which of the angles are still to be recorded."""
    held = {angle.stamp: angle.data for angle in (*steady.fresh, *steady.angles)}
    untaken = {angle.stamp for angle in steady.fresh}
    block = _Received(
        [*(held[stamp] for stamp in sorted(held)), *states],
        [*(load.data for load in steady.loads), *forces],
    )
    return block, np.array([stamp in untaken for stamp in sorted(held)] + [True] * len(states))


def _steps(steady: Steady, samples: _Samples) -> tuple[Stamps, Stamps]:
    """Steps [ns] of the angles and of the loads: the last ones before, and those on to and between the new samples."""
    held = {angle.stamp for angle in (*steady.fresh, *steady.angles)}
    angles, loads = samples.states.stamps[len(held) :], samples.wrenches.stamps[len(steady.loads) :]
    return (
        steps_of(angles, steady.last_angle, steady.angle_steps),
        steps_of(loads, steady.last_load, steady.load_steps),
    )


def _samples(block: _Received, pipeline: Pipeline) -> _Samples | None:
    """Columns of samples; None if one would be refused, or has to be looked at alone."""
    decoded, wrenches = JOINT_STATE.decode_all(block.states), WRENCH.decode_all(block.forces)
    if decoded is None or wrenches is None or not pipeline.frame.goes_on(wrenches.shape[0]):
        return None
    knee, load = pipeline.parameters.knee, pipeline.parameters.load
    position = _position(decoded, knee.joint_name)
    heights = _position(decoded, knee.height_joint_name) if pipeline.model.height_prescribed else None
    if position is None or (pipeline.model.height_prescribed and heights is None):
        return None
    angles = knee.flexion_sign * position + knee.flexion_offset
    axial, moment = wrenches.numbers["force"][:, 1], wrenches.numbers["torque"][:, 0]
    loads = COMPARTMENTS[load.compartment](axial, moment, load)
    columns = [(angles, LARGEST_ANGLE), (position, np.inf), (axial, LARGEST_LOAD), (loads, LARGEST_LOAD)]
    columns += [(heights, LARGEST_HEIGHT)] if heights is not None else []
    if not all((np.isfinite(column) & (np.abs(column) <= limit)).all() for column, limit in columns):
        return None
    if not all(((stamps >= 0) & (stamps <= LAST_STAMP)).all() for stamps in (decoded.stamps, wrenches.stamps)):
        return None
    return _Samples(decoded, angles, heights, wrenches, loads)


def _position(states: Block, joint: str) -> Floats | None:
    _, names, known, *_ = states.shape
    if joint not in names or names.index(joint) >= known:
        return None
    return np.ascontiguousarray(states.numbers["position"][:, names.index(joint)])


def _computed(pipeline: Pipeline, samples: _Samples, paired: PairedSamples, fresh: Fresh) -> Answers:
    """The answers to the loads that have found their angles, and what is to be recorded of inputs and answers."""
    number = len(paired.angle)
    stamps, frame_id = samples.wrenches.stamps[:number], samples.wrenches.shape[0]
    rows = pipeline.stream.advance_all(stamps, paired.angle, samples.loads[:number], paired.height)
    rows["status"] |= paired.status.astype(np.uint8)
    pipeline.ticks += number
    if pipeline.parameters.load.compartment in BY_MOMENT:
        pipeline.split.add_all(samples.wrenches.numbers["force"][:number, 1], samples.loads[:number])
    taken = fresh & (paired.tick_of_angle < number)
    states, place = samples.states, 4 * np.arange(number)
    messages = (
        Messages(JOINT_STATES, states.stamps[taken], states.data[taken], 4 * paired.tick_of_angle[taken]),
        Messages(JOINT_REACTION_FORCE, stamps, samples.wrenches.data[:number], place + 1),
        Messages(KNEE_CONTACT, stamps, encode_answers(frame_id, stamps, rows), place + 2),
        Messages(KNEE_CONTACT_WRENCH, stamps, encode_answer_wrenches(frame_id, stamps, rows), place + 3),
    )
    return Answers(rows, messages)


def _hand_over(
    pipeline: Pipeline,
    block: _Received,
    samples: _Samples,
    paired: PairedSamples,
    fresh: Fresh,
    steps: tuple[Stamps, Stamps],
) -> None:
    """Have the synchroniser hold what it would hold after all samples one by one."""
    number, (states, forces) = len(paired.angle), block
    angle_stamps, load_stamps = samples.states.stamps, samples.wrenches.stamps
    last = int(load_stamps[number - 1])
    first = int(np.searchsorted(angle_stamps, last, "right")) - 1
    knee, load, displacement = pipeline.parameters.knee, pipeline.parameters.load, pipeline.model.height_prescribed

    def angle(index: int) -> AngleSample:
        message, data = pipeline.decoder.joint_state(states[index])
        return angle_sample(message, knee, displacement, data)

    def force(index: int) -> LoadSample:
        message, data = pipeline.decoder.joint_reaction_force(forces[index])
        return load_sample(message, load, data=data)

    untaken = np.flatnonzero(fresh & (paired.tick_of_angle == number))
    pipeline.synchroniser.go_on(
        Steady(
            tuple(map(angle, range(first, len(states)))), tuple(map(angle, untaken.tolist())),
            tuple(map(force, range(number, len(forces)))), int(angle_stamps[-1]), int(load_stamps[-1]), last,
            tuple(steps[0][-STEPS:].tolist()), tuple(steps[1][-STEPS:].tolist()),
        )
    )  # fmt: skip

"""`knee-contact estimate-load`: joint reaction forces from a bag of a leg's sensors, without ROS."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.provenance import ORIGIN, provenance_record, stored_load, weight_of
from knee_contact_ros.bags.reader import OWN_NAMES, Names, refuse_input
from knee_contact_ros.bags.recorder import AnswerWriter, BagWriter
from knee_contact_ros.joint_reaction.estimator import Estimate
from knee_contact_ros.model.types import Status
from knee_contact_ros.offline.bag_inputs import BagInputs, check_joints, learn_transforms
from knee_contact_ros.offline.solve import mark_damage, parameters_for
from knee_contact_ros.parameters.schema import LoadParameters, PersonParameters
from knee_contact_ros.streams.frames import FORCE_TURNED
from knee_contact_ros.streams.load_stream import LoadStream
from knee_contact_ros.streams.output import LOAD_PROVENANCE
from knee_contact_ros.streams.topics import LOAD_RECORDED, NANOSECONDS, Answer
from knee_contact_ros.system.errors import UsageError, in_a_line

MESSAGES_PER_ADVANCE = 1000
"""Number of messages from one call of `advance` to the next"""


@dataclass
class LoadSummary:
    """Figures of all joint reactions that were estimated from a bag; memory grows by 16 B with each."""

    level: str
    """Name of the level of the estimator"""
    calibrated: bool
    """Whether the constants are fitted to the person"""
    peak: Estimate | None = None
    """Estimate with the largest axial force"""
    flagged: Counter[str] = field(default_factory=Counter)
    """Number of estimates by the name of a status bit that they have"""
    ticks_flagged: int = 0
    """Number of estimates that have any"""
    refused: Counter[str] = field(default_factory=Counter)
    """Number of refused samples by reason"""
    damage: list[str] = field(default_factory=list)
    """Damage of the bag, as sentences"""
    _stamps: array[int] = field(default_factory=lambda: array("q"))
    _axial: array[float] = field(default_factory=lambda: array("d"))

    def add(self, stamp: int, estimate: Estimate) -> None:
        """Add an estimate and its stamp [ns]."""
        self._stamps.append(stamp)
        self._axial.append(estimate.axial_force)
        if self.peak is None or estimate.axial_force > self.peak.axial_force:
            self.peak = estimate
        if estimate.status:
            self.ticks_flagged += 1
            self.flagged.update(bit.name or "" for bit in Status if estimate.status & bit)

    @property
    def stamps(self) -> NDArray[np.int64]:
        """Stamps of the estimates [ns], shape (n,)."""
        return np.array(self._stamps)

    @property
    def axial(self) -> NDArray[np.float64]:
        """Axial forces [N], compressive positive, shape (n,)."""
        return np.array(self._axial)

    @property
    def duration(self) -> float:
        """Time [s] from the first to the last estimate."""
        return (self._stamps[-1] - self._stamps[0]) / NANOSECONDS if self._stamps else 0.0


def load_parameters_for(
    bag: Path, sources: Sequence[Any], values: Mapping[str, Any], namespace: str = ""
) -> tuple[LoadParameters, str, list[str]]:
    """Parameters for a bag: given ones, else those of a recording of estimates, else the defaults.

    Returns:
        The parameters; what they are where no `sources` are given; and sentences of doubt about them.

    Raises:
        UsageError: parameters or the recording cannot be used; see `load_parameters` and `stored_load`.
    """
    stored = None if sources else stored_load(bag)
    first, changes = stored or ({}, 0)
    parameters = parameters_for(bag, [*sources, first, values], namespace, LoadParameters)
    fault = f"bag {bag}: parameters changed {changes} times in it; those of its beginning are used throughout"
    return parameters, f"those in {bag.name}" if stored else "the defaults", [fault] if changes else []


def estimate_load(
    bag: Path, parameters: LoadParameters, output: Path | None, advance: Callable[[int, int], None],
    overwrite: bool = False, names: Names = OWN_NAMES, keep: Callable[[LoadStream], object] | None = None,
) -> LoadSummary:  # fmt: skip
    """Estimate the joint reaction at every ground force of `bag`; write inputs and estimates to `output`, if given.

    The messages are those that the load node would publish, bit for bit.

    Args:
        bag: An .mcap file, a .db3 file or a rosbag2 folder with the inputs.
        parameters: Parameters of the load node.
        output: The .mcap file to write; None: only the summary is wanted.
        advance: Called now and then with the number of messages done, and of all messages.
        overwrite: Replace an existing output, once the new one is complete.
        names: Names of the inputs in the bag.
        keep: Called after every estimate with the pipeline, which has it and what was sensed.

    Raises:
        UsageError: the bag or the output cannot be used, or nothing could be estimated. No output is left then.
    """
    with ExitStack() as opened:
        if output:
            refuse_input(bag, output)
        inputs = opened.enter_context(BagInputs(bag, parameters, names))
        check_joints(inputs, parameters.joints())
        pipeline, recorder = LoadStream(parameters), None
        if parameters.frame.ground:
            learn_transforms(bag, pipeline.frame)
        if output:
            writer = opened.enter_context(BagWriter(output, overwrite=overwrite, alone=True))
            if weight_of(bag) or parameters.person != PersonParameters():
                weight = f"{parameters.person.constants.weight:.7g} N"
                writer.add_metadata(ORIGIN, {"source": "knee-contact estimate-load", "body_weight": weight})
            topics = {topic: f"/{topic}" for topic in LOAD_RECORDED}
            recorder = AnswerWriter(writer, provenance_record(parameters, source=bag), topics, LOAD_PROVENANCE)
        summary = LoadSummary(pipeline.level, parameters.calibrated)
        for answer in _answers(inputs, pipeline, advance):
            if recorder:
                _write(recorder, pipeline, answer)
            summary.add(pipeline.sensed.stamp, pipeline.estimate)
            if keep:
                keep(pipeline)
        summary.refused, summary.damage = pipeline.synchroniser.refused, list(inputs.reader.damage)
        if recorder:
            recorder.finish(pipeline.ending())
            mark_damage(recorder, bag, summary.damage)
        if summary.peak is None:
            reasons = ", ".join(f"{count} x {reason}" for reason, count in summary.refused.items())
            damage = f"; the bag is damaged: {in_a_line(summary.damage)}" if summary.damage else ""
            why = "; ".join(filter(None, (reasons, pipeline.last_refusal))) or "no angle and force at one time"
            raise UsageError(f"bag {bag}: no joint reaction could be estimated ({why}){damage}")
    return summary


def _write(recorder: AnswerWriter, pipeline: LoadStream, answer: Answer) -> None:
    if pipeline.frame.turn_note:
        recorder.note(FORCE_TURNED, pipeline.frame.take_turn_note())
    recorder.write(answer.records)


def _answers(inputs: BagInputs, pipeline: LoadStream, advance: Callable[[int, int], None]) -> Iterator[Answer]:
    for number, (which, data) in enumerate(inputs.messages(), start=1):
        yield from (pipeline.force if which else pipeline.joint_state)(data)
        if number % MESSAGES_PER_ADVANCE == 0:
            advance(number, inputs.reader.count)
    yield from pipeline.finish()
    advance(inputs.reader.count, inputs.reader.count)

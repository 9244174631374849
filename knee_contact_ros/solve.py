"""`knee-contact solve`: a bag through the pipeline as fast as the machine allows, without ROS."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from knee_contact_ros.errors import UsageError
from knee_contact_ros.parameters import Parameters
from knee_contact_ros.pipeline import Pipeline
from knee_contact_ros.record import BagWriter
from knee_contact_ros.record_answers import AnswerWriter
from knee_contact_ros.stream_in.bag import INPUT_TYPES, BagReader
from knee_contact_ros.stream_in.joints import check_joints
from knee_contact_ros.stream_in.names import OWN_NAMES, Names
from knee_contact_ros.summary import Summary
from knee_contact_ros.topics import JOINT_STATES

WORTH_COMPILING = 50_000
"""Messages of a bag from which on compiling the kernel takes less time than it saves"""


def solve(
    bag: Path,
    parameters: Parameters,
    output: Path,
    advance: Callable[[int, int], None],
    overwrite: bool = False,
    names: Names = OWN_NAMES,
) -> Summary:
    """Compute every tick of `bag` and write inputs and outputs to `output`.

    `advance` is called after every message with the number of messages done and in all. With `overwrite`, an existing
    output is replaced once the new one is complete. `names` are those of the inputs in the bag.

    Raises:
        UsageError: the bag or the output cannot be used, or no tick could be computed. `output` is then not there.
    """
    with ExitStack() as opened:
        reader = opened.enter_context(BagReader(bag, INPUT_TYPES, names))
        check_joints(reader, parameters)
        pipeline = Pipeline(parameters, compiled=reader.count >= WORTH_COMPILING)
        writer = opened.enter_context(BagWriter(output, overwrite=overwrite))
        recorder = AnswerWriter(writer)
        summary = Summary(parameters.body_weight)
        for done, (topic, _, data) in enumerate(reader.raw_messages(), start=1):
            feed = pipeline.joint_state if topic == f"/{JOINT_STATES}" else pipeline.joint_reaction_force
            for answer in feed(data):
                recorder.write(answer)
                summary.add(answer.stamp, answer.contact)
            advance(done, reader.count)
        for answer in pipeline.give_up():
            recorder.write(answer)
            summary.add(answer.stamp, answer.contact)
        recorder.finish(pipeline.ending())
        summary.refused = pipeline.synchroniser.refused
        if not summary.ticks:
            reasons = ", ".join(f"{count} x {reason}" for reason, count in summary.refused.items())
            raise UsageError(f"bag {bag}: no tick could be computed ({reasons}; {pipeline.last_refusal})")
    return summary

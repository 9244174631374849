"""`knee-contact estimate-load`: a bag of a leg's sensors to joint reaction forces, without ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path

from knee_contact_ros.bags.answer_recorder import AnswerWriter
from knee_contact_ros.bags.bag_files import in_a_line, refuse_input
from knee_contact_ros.bags.load_provenance import LOAD_PROVENANCE, load_provenance_record
from knee_contact_ros.bags.topic_names import OWN_NAMES, Names
from knee_contact_ros.bags.writer import BagWriter
from knee_contact_ros.joint_reaction.estimator import Estimate
from knee_contact_ros.messages.answer import Answer
from knee_contact_ros.messages.topics import GROUND_REACTION_FORCE, JOINT_STATES, LOAD_RECORDED
from knee_contact_ros.offline.bag_inputs import BagInputs, learn_transforms
from knee_contact_ros.offline.joints import check_joints
from knee_contact_ros.offline.load_summary import LoadSummary
from knee_contact_ros.offline.solve import SOURCE_DAMAGE
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.pipeline.frames import FORCE_TURNED
from knee_contact_ros.pipeline.load_pipeline import LoadPipeline
from knee_contact_ros.system.errors import UsageError

FEWEST_BETWEEN_NEWS = 1000
"""Messages from one call of `advance` to the next"""


def estimate_load(
    bag: Path, parameters: LoadParameters, output: Path | None, advance: Callable[[int, int], None],
    overwrite: bool = False, names: Names = OWN_NAMES, keep: Callable[[int, Estimate], object] | None = None,
) -> LoadSummary:  # fmt: skip
    """Estimate the joint reaction at every ground force of `bag`; write inputs and estimates to `output`, if given.

    The messages are those that the node would publish, bit for bit. `advance` is called now and then with the number of
    messages done and in all; `names` are those of the inputs in the bag; `keep` is given every estimate, and its stamp.

    Raises:
        UsageError: the bag or the output cannot be used, or nothing could be estimated. `output` is then not there.
    """
    with ExitStack() as opened:
        inputs = opened.enter_context(BagInputs(bag, JOINT_STATES, names, GROUND_REACTION_FORCE))
        if output:
            refuse_input(bag, output)
        check_joints(inputs, named_joints(parameters))
        pipeline = LoadPipeline(parameters)
        if parameters.frame.ground:
            learn_transforms(bag, pipeline.frame)
        recorder = None
        if output:
            writer = opened.enter_context(BagWriter(output, overwrite=overwrite, alone=True))
            topics = {topic: f"/{topic}" for topic in LOAD_RECORDED}
            recorder = AnswerWriter(writer, load_provenance_record(parameters, bag), topics, LOAD_PROVENANCE)
        summary = LoadSummary(pipeline.level, parameters.calibrated)
        takers = [summary.add, *([keep] if keep else [])]
        for number, message in enumerate(inputs.messages(), start=1):
            take = pipeline.joint_state if message.topic == f"/{JOINT_STATES}" else pipeline.force
            _keep(take(message.data), pipeline, recorder, takers)
            if number % FEWEST_BETWEEN_NEWS == 0:
                advance(number, inputs.reader.count)
        _keep(pipeline.finish(), pipeline, recorder, takers)
        advance(inputs.reader.count, inputs.reader.count)
        summary.refused, summary.damage = pipeline.synchroniser.refused, list(inputs.reader.damage)
        if recorder:
            recorder.finish(pipeline.ending())
            if summary.damage:
                faults = {"source": bag.name, "faults": "\n".join(summary.damage)}
                recorder.bag.add_metadata(SOURCE_DAMAGE, faults)
        if summary.peak is None:
            reasons = ", ".join(f"{count} x {reason}" for reason, count in summary.refused.items())
            told = f"; the bag is damaged: {in_a_line(summary.damage)}" if summary.damage else ""
            why = "; ".join(filter(None, (reasons, pipeline.last_refusal))) or "no angle and force at one time"
            raise UsageError(f"bag {bag}: no joint reaction could be estimated ({why}){told}")
    return summary


def named_joints(parameters: LoadParameters) -> dict[str, str]:
    """Joints that the parameters name, by these parameters."""
    joints = {"knee": parameters.knee, "ankle": parameters.ankle, "hip": parameters.hip}
    return {f"{name}.joint_name": joint.joint_name for name, joint in joints.items() if joint.joint_name}


def _keep(
    answers: Iterable[Answer], pipeline: LoadPipeline, recorder: AnswerWriter | None,
    takers: Sequence[Callable[[int, Estimate], object]],
) -> None:  # fmt: skip
    for answer in answers:
        if recorder:
            if pipeline.frame.turn_note:
                recorder.note(FORCE_TURNED, pipeline.frame.take_turn_note())
            recorder.write(answer.records)
        assert pipeline.estimate is not None  # noqa: S101  (there is an answer)
        for taker in takers:
            taker(answer.records[-1][1], pipeline.estimate)

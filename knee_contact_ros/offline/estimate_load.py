"""`knee-contact estimate-load`: joint reaction forces from a bag of a leg's sensors, without ROS."""

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from ..bags.bag import Bag
from ..bags.names import OWN_NAMES, Names
from ..bags.provenance import recorded_flags, stored_load
from ..joint_reaction.estimator import LoadEstimateFields
from ..model.inputs import InputCheck
from ..model.types import Status
from ..parameters.load_schema import LoadParameters, PersonSection
from ..streams.load_pipeline import LoadAnswer, LoadPipeline
from ..streams.output import LOAD_PROVENANCE
from ..streams.topics import LOAD_RECORDED
from ..system.progress import OnProgress, no_progress
from .bag_inputs import BagInputs
from .bag_parameters import parameters_for
from .output import nothing_computed, open_bag_output

ESTIMATE = np.dtype([("stamp", np.int64), *get_type_hints(LoadEstimateFields).items()])
"""Type of a stamp [ns] and an estimate as a row"""
MESSAGES_PER_ADVANCE = 1000
"""Number of messages between two calls of `advance`"""


class LoadSummary(NamedTuple):
    """All joint reactions that were estimated from a bag."""

    estimates: NDArray[Any]
    """Stamps [ns] and estimates, of type `ESTIMATE`, shape (n,)"""
    refused: Counter[str]
    """Number of refused samples by reason"""
    damage: list[str]
    """Damage of the bag, as sentences"""
    level: str
    """Name of the level of the estimator"""
    calibrated: bool
    """Whether the constants are fitted to the person"""
    implausible: list[str]
    """Sentences about what the importer doubted, about angles that no knee has, and about times"""

    @property
    def stamps(self) -> NDArray[np.int64]:
        """Stamps of the estimates [ns], shape (n,)."""
        return np.asarray(self.estimates["stamp"])

    @property
    def axial(self) -> NDArray[np.float64]:
        """Axial forces [N], compressive positive, shape (n,)."""
        return np.asarray(self.estimates["axial_force"])

    @property
    def peak(self) -> LoadEstimateFields:
        """Estimate with the largest axial force."""
        return LoadEstimateFields(*self.estimates[self.axial.argmax()].item()[1:])

    @property
    def flagged(self) -> Counter[str]:
        """Number of estimates by the name of a status bit that they have."""
        counts = {
            bit.name or "": int(np.count_nonzero(self.estimates["status"] & bit)) for bit in Status
        }
        return +Counter(counts)


def load_parameters_for(
    bag: Bag, sources: Sequence[Any], values: Mapping[str, Any], namespace: str = ""
) -> tuple[LoadParameters, str, list[str]]:
    """Return parameters for a bag: the given ones, else those that a recording of estimates holds, else the defaults.

    Returns:
        The parameters, a name for them if no `sources` are given, and sentences of doubt about them.

    Raises:
        UsageError: parameters or the recording cannot be used; see `load_parameters` and `stored_load`.
    """
    stored = None if sources else stored_load(bag)
    first, changes = stored or ({}, 0)
    parameters = parameters_for(bag, [*sources, first, values], namespace, LoadParameters)
    doubts = []
    if changes:
        doubts.append(
            f"bag {bag}: parameters changed {changes} times in it; those of its beginning are used throughout"
        )
    return parameters, f"those in {bag.path.name}" if stored else "the defaults", doubts


def estimate_load(
    bag: Bag,
    parameters: LoadParameters,
    output: Path | None,
    advance: OnProgress = no_progress,
    overwrite: bool = False,
    names: Names = OWN_NAMES,
    keep: Callable[[LoadAnswer], object] | None = None,
) -> LoadSummary:
    """Estimate the joint reaction at every ground force of `bag`; write inputs and estimates to `output`, if given.

    The messages are bit for bit those that the load node would publish.

    Args:
        bag: The bag with the inputs.
        parameters: Parameters of the load node.
        output: The .mcap file to write; None: only the summary is wanted.
        advance: Called now and then with the number of finished messages and of all messages.
        overwrite: Replace an existing output, once the new one is complete.
        names: Names of the inputs in the bag.
        keep: Called with every answer, which has the estimate and its inputs.

    Raises:
        UsageError: the bag or the output cannot be used, or nothing could be estimated. No output is left then.
    """
    inputs = BagInputs(bag, parameters, names)
    inputs.check_joints(parameters.joints())
    pipeline = LoadPipeline(parameters)
    damage = bag.damage
    person = parameters.person
    if parameters.frame.ground:
        inputs.learn_transforms(pipeline.frame)
    origin = {}
    if bag.body_weight or person != PersonSection():
        weight = f"{person.constants.weight:.7g} N"
        origin = {"source": "knee-contact estimate-load", "body_weight": weight}
    with open_bag_output(
        bag, output, overwrite, LOAD_RECORDED, parameters, {}, LOAD_PROVENANCE, origin
    ) as recorder:
        answers = _answers(inputs, pipeline, advance)
        recorded = recorder.record_answers(pipeline, answers, LoadAnswer.records)
        flexions = list[float]()
        estimates = np.fromiter(_rows(recorded, keep, flexions), ESTIMATE)
        recorder.write_ending(pipeline, bag, damage)
        if not len(estimates):
            raise nothing_computed(bag, "joint reaction could be estimated", pipeline, damage)
    seen = InputCheck(person.constants.weight, load_driven=False, names="knee.")
    seen.add_samples(estimates["stamp"], np.array(flexions), estimates["axial_force"])
    refused, level = pipeline.synchroniser.refused, pipeline.level
    doubts = [*bag.doubts, *seen.sentences, *pipeline.conventions.sentences]
    return LoadSummary(estimates, refused, damage, level, parameters.calibrated, doubts)


def _rows(
    answers: Iterable[LoadAnswer],
    keep: Callable[[LoadAnswer], object] | None,
    flexions: list[float],
) -> Iterator[tuple[Any, ...]]:
    """Yield the stamp and estimate of each answer, as `ESTIMATE`; its flexion angle [rad] is added to `flexions`."""
    for answer in answers:
        if keep:
            keep(answer)
        flexions.append(answer.sensed.joints.flexion)
        yield answer.sensed.stamp, *answer.estimate


def _answers(
    inputs: BagInputs, pipeline: LoadPipeline, advance: OnProgress
) -> Iterator[LoadAnswer]:
    """Yield the answers to all messages of a bag, one by one; `advance` is called after each block."""
    flags = deque(recorded_flags(inputs.bag, LOAD_PROVENANCE))

    def repeat_flags() -> None:
        while flags and pipeline.ticks >= flags[0].tick:
            pipeline.synchroniser.flag_from_now("recorded", flags.popleft().status)

    done = 0
    repeat_flags()
    for block in inputs.batches_of(MESSAGES_PER_ADVANCE):
        for answer in pipeline.push_messages(block):
            yield answer
            repeat_flags()
        done += len(block)
        advance(done, inputs.message_count)
    yield from pipeline.finish_streams()

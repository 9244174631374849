"""A bag through the stream as fast as the machine allows, without ROS: what `knee-contact solve` does."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, ValidationError

from knee_contact_ros.bags.bag import Bag, opened_bag
from knee_contact_ros.bags.bag_file import Batch
from knee_contact_ros.bags.batch_writer import write_messages
from knee_contact_ros.bags.names import OWN_NAMES, Names
from knee_contact_ros.bags.provenance import (
    PARAMETERS_CHANGED,
    RESET,
    TICK,
    Change,
    Provenance,
    change_record,
    provenance_record,
    read_provenance,
    with_values,
)
from knee_contact_ros.bags.recorder import AnswerWriter, BagWriter
from knee_contact_ros.joint_reaction.leg import GRAVITY
from knee_contact_ros.model.kernel import worth_compiling
from knee_contact_ros.model.types import ROW, Rows
from knee_contact_ros.offline.bag_inputs import BagInputs, check_joints, learn_transforms
from knee_contact_ros.offline.solve_blocks import take
from knee_contact_ros.offline.summary import Summary
from knee_contact_ros.parameters.files import (
    ParameterSource,
    all_values,
    curve_texts,
    dotted,
    first_error,
    load_parameters,
)
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.parameters.schema import Parameters, constants_of, has_two_compartments
from knee_contact_ros.parameters.sections import Section
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.frames import FORCE_TURNED
from knee_contact_ros.streams.output import PROVENANCE
from knee_contact_ros.streams.pairing import Pipeline
from knee_contact_ros.streams.topics import Answer, recorded_topics
from knee_contact_ros.streams.watch import held_sentence, unanswered_sentence
from knee_contact_ros.system.errors import UsageError, join_faults
from knee_contact_ros.system.files import DEFAULT_PARAMETERS, expand_user, find_file, read_mapping
from knee_contact_ros.system.output_files import check_not_input
from knee_contact_ros.system.progress import OnProgress, no_progress

SAME_WEIGHT = 0.01
"""Largest relative difference of body weights that count as equal"""
BLOCK = 8192
"""Number of messages in a block: a few MB, but enough that handling a block costs almost nothing"""
SOURCE_DAMAGE = "source_damage"
"""Name of the metadata record of an output that lists the damage of the bag it was computed from"""
MESSAGES_OF_A_TICK = 2
"""Number of input messages that a tick needs: an angle and a force"""


def solve(
    bag: Path | Bag,
    basis: Parameters | Provenance,
    output: Path | None,
    advance: OnProgress = no_progress,
    overwrite: bool = False,
    names: Names = OWN_NAMES,
    *,
    compiled: bool | None = None,
    keep: Callable[[Sequence[Rows]], object] = len,
    prepare: Callable[[ContactPipeline], object] = id,
    curves: Mapping[str, str] | None = None,
) -> Summary:
    """Compute every tick of `bag` and write inputs and outputs to `output`, if one is given.

    A damaged bag is computed as far as it can be read; the summary and a metadata record of the output list its damage.

    Args:
        bag: An .mcap file, a .db3 file or a rosbag2 folder with the inputs.
        basis: Parameters, or the provenance of a recording (`read_provenance`) that is computed again.
        output: The .mcap file to write; None: only the summary is wanted.
        advance: Called now and then with the number of finished messages and of all messages.
        overwrite: Replace an existing output, once the new one is complete.
        names: Names of the inputs in the bag.
        compiled: As for `load_model`.
        keep: Called with the answers of every block: an array for each compartment.
        prepare: Called with the pipeline before its first message.
        curves: Contents of the files that parameters name, by parameter; None: the files are read.

    Raises:
        UsageError: the bag or the output cannot be used, or no tick could be computed. No output is left then.
    """
    recording = basis if isinstance(basis, Provenance) else None
    parameters = parameters_in(basis)
    curves = texts_of(basis) if curves is None else curves
    with ExitStack() as opened:
        bag = opened.enter_context(opened_bag(bag))
        inputs = BagInputs(bag, parameters, names)
        total = inputs.reader.message_count
        check_joints(inputs, parameters.joints())
        pipeline = ContactPipeline(parameters, compiled=False, curves=curves)
        if recording:
            pipeline.frame.is_known, pipeline.is_lost = True, recording.ticks_before > 0
        elif parameters.frame.tibia:
            learn_transforms(bag, pipeline.frame)
        topics = recorded_topics(has_two_compartments(parameters))
        recorder = opened.enter_context(
            recording_of(bag, output, overwrite, topics, parameters, curves)
        )
        if worth_compiling(total // MESSAGES_OF_A_TICK) if compiled is None else compiled:
            pipeline.compile()
        prepare(pipeline)
        summary, *others = (
            Summary(parameters.body_weight, one.doubts) for one in pipeline.compartments
        )
        summary.lateral = others[0] if others else None
        thread, done = opened.enter_context(ThreadPoolExecutor(1)), 0
        run = Run(
            pipeline,
            recorder,
            (summary.add_each, keep),
            thread,
            deque(recording.changes if recording else ()),
        )
        for block in inputs.batches_of(BLOCK):
            run.take(block)
            done += len(block)
            advance(done, total)
        run.keep(pipeline.finish())
        summary.finish()
        summary.damage, summary.refused = bag.damage, pipeline.synchroniser.refused
        if recording:
            late = [
                "changes in the node may be applied too late, because ticks before them are missing"
            ]
            lost = late if bag.damage and recording.changes else []
            summary.damage = [*recording.damage, *bag.damage, *lost]
        finish(recorder, pipeline, bag, summary.damage)
        summary.split = pipeline.split if pipeline.varies else None
        summary.unanswered = unanswered_sentence(pipeline, inputs.force_count)
        seen = (
            pipeline.angles_seen.sentence(inputs.publishers(0), parameters.knee.joint_name),
            pipeline.forces_seen.sentence(inputs.publishers(1)),
            held_sentence(pipeline, summary.flagged["INPUT_HELD"]),
        )
        summary.publishers = list(filter(None, seen))
        if not summary.ticks:
            raise nothing_computed(bag, "tick could be computed", pipeline, summary.damage)
    return summary


@contextmanager
def recording_of(
    bag: Bag,
    output: Path | None,
    overwrite: bool,
    topics: Iterable[str],
    parameters: Parameters | LoadParameters,
    curves: Mapping[str, str] = {},
    provenance_name: str = PROVENANCE,
) -> Iterator[AnswerWriter | None]:
    """Open the output of a bag that is computed; it is removed if computing fails. None without an `output`.

    Raises:
        UsageError: the output is the bag, or cannot be written.
    """
    if output is None:
        yield None
        return
    check_not_input(output, bag.paths)
    with BagWriter(output, overwrite=overwrite, alone=True) as writer:
        record = provenance_record(parameters, curves, bag)
        yield AnswerWriter(
            writer, record, {topic: f"/{topic}" for topic in topics}, provenance_name
        )


def recorded(
    recorder: AnswerWriter | None, pipeline: Pipeline, answers: Iterable[Answer]
) -> Iterator[Answer]:
    """Record answers as they come, and a note when forces are turned; without a recorder pass answers on."""
    for answer in answers:
        if recorder and pipeline.frame.turn_note:
            recorder.write_note(FORCE_TURNED, pipeline.frame.take_turn_note())
        if recorder:
            recorder.write_answer(answer.records)
        yield answer


def finish(
    recorder: AnswerWriter | None, pipeline: Pipeline, bag: Bag, damage: Sequence[str]
) -> None:
    """Write what ends a recording: the remaining inputs, refused samples and the damage of the bag it comes from."""
    if recorder:
        recorder.write_ending(pipeline.ending())
        if damage:
            recorder.bag.add_metadata(
                SOURCE_DAMAGE, {"source": bag.path.name, "faults": "\n".join(damage)}
            )


def nothing_computed(bag: Bag, what: str, pipeline: Pipeline, damage: Sequence[str]) -> UsageError:
    """Error that a bag gave no `what`, with the reasons why samples were refused."""
    reasons = ", ".join(
        f"{count} x {reason}" for reason, count in pipeline.synchroniser.refused.items()
    )
    why = (
        "; ".join(filter(None, (reasons, pipeline.last_refusal)))
        or "no angle and force at one time"
    )
    damaged = f"; the bag is damaged: {join_faults(damage)}" if damage else ""
    return UsageError(f"bag {bag.path}: no {what} ({why}){damaged}")


def parameters_in(basis: Parameters | Provenance) -> Parameters:
    """Return the parameters that a bag is computed with: given ones, or those of a recording."""
    return basis.parameters if isinstance(basis, Provenance) else basis


def texts_of(basis: Parameters | Provenance) -> Mapping[str, str]:
    """Return the contents of the files that parameters name, by parameter.

    Raises:
        UsageError: a file cannot be read, or its contents are not in the recording.
    """
    return basis.file_contents() if isinstance(basis, Provenance) else curve_texts(basis, {})


@dataclass
class Run:
    """Pipeline that takes blocks of messages; its answers are recorded and passed on."""

    pipeline: ContactPipeline
    recorder: AnswerWriter | None
    """Writer of the recording; None: nothing is recorded"""
    takers: Sequence[Callable[[Sequence[Rows]], object]]
    """Functions that are called with the rows of answers, an array for each compartment"""
    thread: ThreadPoolExecutor
    """Thread that writes blocks that were computed at once; when `keep` returns, everything is written"""
    changes: deque[Change]
    """Resets and changed parameters of the node that made a recording, to repeat at the same ticks"""
    _writing: Future[None] | None = None

    def take(self, block: Batch) -> None:
        """Compute the ticks of a block of angles (number 0) and forces (number 1), at once if possible."""
        if self.pipeline.is_lost or self.changes or not self._take_at_once(block):
            takes = self.pipeline.joint_state, self.pipeline.force
            self.keep(answer for number, _, data in block for answer in takes[number](data))

    def keep(self, answers: Iterable[Answer]) -> None:
        """Record answers and pass on their rows; make the changes that are due between them."""
        rows = []
        self._wait()
        self._make_changes()
        for answer in recorded(self.recorder, self.pipeline, answers):
            rows.append(answer.row)
            self._make_changes()
        if rows:
            together, number = np.frombuffer(b"".join(rows), ROW), len(self.pipeline.compartments)
            self._pass_on([together[first::number] for first in range(number)])

    def _take_at_once(self, block: Batch) -> bool:
        answers = take(self.pipeline, block.messages_of(0), block.messages_of(1), block.numbers)
        if answers is None:
            return False
        rows, messages = answers
        if self.recorder:
            parts = [part._replace(topic=f"/{part.topic}") for part in messages]
            self._wait()
            self._writing = self.thread.submit(write_messages, self.recorder.bag, parts)
        self._pass_on(rows)
        return True

    def _wait(self) -> None:
        """Wait until the last block is written; an error of it is raised here."""
        writing, self._writing = self._writing, None
        if writing:
            writing.result()

    def _pass_on(self, rows: Sequence[Rows]) -> None:
        for taker in self.takers:
            taker(rows)

    def _note(self, name: str, values: dict[str, str]) -> None:
        if self.recorder:
            self.recorder.write_note(name, values)

    def _make_changes(self) -> None:
        """Make the changes whose tick has come, and record them.

        Raises:
            UsageError: this version of the package does not allow the changed parameters.
        """
        while self.changes and self.pipeline.ticks >= self.changes[0].tick:
            tick, values = self.changes.popleft()
            if values is None:
                self.pipeline.reset()
                self._note(RESET, {TICK: str(tick)})
                continue
            try:
                self.pipeline.retune(
                    load_parameters(all_values(self.pipeline.parameters) | values)
                )
            except UsageError as error:
                raise UsageError(
                    f"the recording has a change after {tick} ticks that cannot be made: {error}"
                ) from None
            self._note(PARAMETERS_CHANGED, change_record(tick, values))


FEMORAL_SHARE = 9.3014 / 75.16
"""Ratio of the masses of the femur's segment and the body in OpenSim's model gait2354, which scales both alike"""


def basis_of(
    bag: Path | Bag,
    params: ParameterSource | None,
    values: Mapping[str, Any],
    person: Subject | None,
    namespace: str = "",
) -> Parameters | Provenance:
    """Parameters to compute a bag with: the given ones, else those in a recording, else the healthy knee.

    `values`, by dotted names, override `params`, and `params` override the subject file of a `person`. Of parameter
    files, the sections for a node in `namespace` are used.

    Raises:
        UsageError: parameters or the recording cannot be used; see `load_parameters` and `read_provenance`.
    """
    stored = read_provenance(bag) if params is None and person is None else None
    if stored:
        return with_values(stored, values)
    if params is None:
        params = () if person else DEFAULT_PARAMETERS
    given = params if isinstance(params, Sequence) and not isinstance(params, str) else [params]
    sources = [*(person.sources() if person else ()), *given, values]
    parameters: Parameters = parameters_for(bag, sources, namespace)
    law, thickness = parameters.contact.law, person.content.thickness if person else None
    if person and thickness is not None and "layer_depth" not in constants_of(law):
        raise UsageError(
            f"subject file {person.path}: thickness: {thickness:g} is not used by contact.law {law}"
        )
    return parameters


def parameters_for(
    bag: Path | Bag, sources: Sequence[Any], namespace: str = "", schema: Any = Parameters
) -> Any:
    """Load parameters for a bag: the body weight that it was imported with is used, unless the sources set another one.

    Raises:
        UsageError: as for `load_parameters`.
    """
    with opened_bag(bag) as open_bag:
        weight = open_bag.body_weight
    return with_weight(sources, weight, namespace, schema)


def with_weight(
    sources: Sequence[Any], weight: float | None, namespace: str = "", schema: Any = Parameters
) -> Any:
    """Load parameters for a body weight [N], unless the sources set another one; see `parameters_for`."""
    parameters, default = (
        load_parameters(list(sources), schema, namespace),
        load_parameters([], schema),
    )
    name, per_newton = (
        ("person.mass", 1.0 / GRAVITY) if schema is LoadParameters else ("body_weight", 1.0)
    )
    said = any(isinstance(source, Mapping) and name in dotted(source) for source in sources)
    if weight is None or said or attrgetter(name)(parameters) != attrgetter(name)(default):
        return parameters
    return load_parameters([*sources, {name: weight * per_newton}], schema, namespace)


def weight_doubt(bag: Path | Bag, parameters: Parameters | LoadParameters) -> list[str]:
    """Sentence that a bag was imported with another body weight than the parameters have; empty list if not."""
    with opened_bag(bag) as open_bag:
        weight, path = open_bag.body_weight, open_bag.path
    mass = isinstance(parameters, LoadParameters)
    used = (
        parameters.person.mass * GRAVITY
        if isinstance(parameters, LoadParameters)
        else parameters.body_weight
    )
    if weight is None or abs(used - weight) <= SAME_WEIGHT * weight:
        return []
    said = f"person.mass {used / GRAVITY:.7g} kg" if mass else f"body_weight {used:.7g} N"
    return [f"{said} is used as you gave it, but bag {path} was imported with {weight:.7g} N"]


class SubjectFile(Section):
    """Content of a subject file: properties of a person's knee, and the gait to compute."""

    name: str = ""
    """Name of the person; it is not used"""
    mass: float = Field(ge=1.0, le=500.0)
    """Mass of the body [kg]"""
    parameters: list[str] = Field([DEFAULT_PARAMETERS], min_length=1)
    """Parameter files; a later one overrides earlier ones"""
    profile: str = ""
    """CSV file of the femoral profile, x and y [m]; empty for none"""
    tibial_profile: str = ""
    """CSV file of the tibial profile, x and y [m]; empty for none"""
    scale: float = Field(1.0, ge=0.2, le=5.0)
    """Factor by which this knee is larger than the given surfaces"""
    thickness: float | None = Field(None, gt=0.0, le=0.1)
    """Thickness of the cartilage [m], at which the bone's stiffness begins; None keeps the parameter"""
    joint: str = ""
    """Name of the knee's joint in joint_states; empty keeps the parameter"""
    bag: str = ""
    """Bag with the gait; empty for none"""


class Subject:
    """Subject of a subject file; the files that it names are in its folder, or among the package's own."""

    def __init__(self, path: Path) -> None:
        """Read a subject file.

        Raises:
            UsageError: it cannot be read, or has an entry that is not allowed.
        """
        self.path = path
        mapping = read_mapping(path, "subject file", "names to values")
        try:
            self.content = SubjectFile.model_validate(dict(mapping))
        except ValidationError as error:
            raise UsageError(f"subject file {path}: {first_error(error)}") from None

    @property
    def bag(self) -> Path | None:
        """Gait bag that the file names; None if it names none."""
        return self._file(self.content.bag) if self.content.bag else None

    def sources(self) -> list[Path | Mapping[str, Any]]:
        """Sources for `load_parameters`: the subject's parameter files, and its own values, which override them.

        Raises:
            UsageError: one of the parameter files cannot be used.
        """
        content, files = self.content, [self._file(name) for name in self.content.parameters]
        before = load_parameters(files)
        values: dict[str, Any] = {
            "body_weight": content.mass * GRAVITY,
            "femur.mass": content.mass * FEMORAL_SHARE,
        }
        if content.thickness is not None:
            values["contact.layer_depth"] = content.thickness
        if content.joint:
            values["knee.joint_name"] = content.joint
        surfaces = (
            ("femur", content.profile, before.femur),
            ("tibia", content.tibial_profile, before.tibia),
        )
        for bone, profile, surface in surfaces:
            if profile:
                values |= {
                    f"{bone}.geometry": "profile",
                    f"{bone}.profile": str(self._file(profile)),
                }
            if profile or surface.geometry == "profile":
                values[f"{bone}.scale"] = content.scale
            elif surface.geometry == "circle":
                values[f"{bone}.radius"] = surface.radius * content.scale
        return [*files, values]

    def _file(self, name: str) -> Path:
        path = expand_user(name)
        beside = self.path.parent / path
        return path if path.is_absolute() else beside if beside.exists() else find_file(name)

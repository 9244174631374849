"""A bag through the stream as fast as the machine allows, without ROS: what `knee-contact solve` does."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from knee_contact_ros.bags.bag import Bag, opened_bag
from knee_contact_ros.bags.bag_file import Batch
from knee_contact_ros.bags.batch_writer import write_messages
from knee_contact_ros.bags.leg import DrawnLeg
from knee_contact_ros.bags.names import OWN_NAMES, Names
from knee_contact_ros.bags.provenance import (
    PARAMETERS_CHANGED,
    RESET,
    TICK,
    Change,
    Provenance,
    change_record,
    provenance_record,
)
from knee_contact_ros.bags.recorder import AnswerWriter, BagWriter
from knee_contact_ros.offline.bag_inputs import BagInputs, check_joints, learn_transforms
from knee_contact_ros.offline.bag_parameters import file_contents, resolved_parameters
from knee_contact_ros.offline.solve_blocks import AnswerBlock, answer_block
from knee_contact_ros.offline.summary import Summary
from knee_contact_ros.parameters.files import (
    all_values,
    load_parameters,
)
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.parameters.schema import Parameters, has_two_compartments
from knee_contact_ros.streams.contact_pipeline import ContactAnswer, ContactPipeline
from knee_contact_ros.streams.frames import FORCE_TURNED
from knee_contact_ros.streams.output import PROVENANCE
from knee_contact_ros.streams.pipeline import AnswerT, Pipeline
from knee_contact_ros.streams.topics import Record, recorded_topics
from knee_contact_ros.streams.watch import held_sentence, unanswered_sentence
from knee_contact_ros.system.errors import UsageError, join_faults
from knee_contact_ros.system.output_files import check_not_input
from knee_contact_ros.system.progress import OnProgress, no_progress

BLOCK = 8192
"""Number of messages in a block: a few MB, but enough that handling a block costs almost nothing"""
SOURCE_DAMAGE = "source_damage"
"""Name of the metadata record of an output that lists the damage of the bag it was computed from"""


def solve(
    bag: Path | Bag,
    basis: Parameters | Provenance,
    output: Path | None,
    advance: OnProgress = no_progress,
    overwrite: bool = False,
    names: Names = OWN_NAMES,
    *,
    compiled: bool | None = None,
    keep: Callable[[AnswerBlock], object] | None = None,
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
        keep: Called with the answers to every block of messages.
        curves: Contents of the files that parameters name, by parameter; None: the files are read.

    Raises:
        UsageError: the bag or the output cannot be used, or no tick could be computed. No output is left then.
    """
    recording = basis if isinstance(basis, Provenance) else None
    parameters = resolved_parameters(basis)
    curves = file_contents(basis) if curves is None else curves
    with ExitStack() as opened:
        bag = opened.enter_context(opened_bag(bag))
        inputs = BagInputs(bag, parameters, names)
        total = inputs.reader.message_count
        check_joints(inputs, parameters.joints())
        pipeline = ContactPipeline(parameters, compiled=False, curves=curves)
        if recording:
            pipeline.resume_recording(recording.ticks_before)
        elif parameters.frame.tibia:
            learn_transforms(bag, pipeline.frame)
        topics = recorded_topics(has_two_compartments(parameters))
        recorder = opened.enter_context(
            recording_of(bag, output, overwrite, topics, parameters, curves)
        )
        if compiled is not False:
            pipeline.compile_model()
        summary, *others = (
            Summary(parameters.body_weight, one.doubts) for one in pipeline.compartments
        )
        summary.lateral = others[0] if others else None
        thread, done = opened.enter_context(ThreadPoolExecutor(1)), 0
        run = Run(
            pipeline,
            recorder,
            [summary.add_each, *([keep] if keep else [])],
            thread,
            deque(recording.changes if recording else ()),
        )
        for block in inputs.batches_of(BLOCK):
            run.take(block)
            done += len(block)
            advance(done, total)
        run.keep(pipeline.finish_streams())
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
            pipeline.angle_conflict.sentence(inputs.publishers(0), parameters.knee.joint_name),
            pipeline.force_conflict.sentence(inputs.publishers(1)),
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
    recorder: AnswerWriter | None,
    pipeline: Pipeline[AnswerT],
    answers: Iterable[AnswerT],
    records_of: Callable[[AnswerT], tuple[Record, ...]],
) -> Iterator[AnswerT]:
    """Record answers as they come, and a note when forces are turned; without a recorder pass answers on."""
    for answer in answers:
        if recorder and pipeline.frame.turn_note:
            recorder.write_note(FORCE_TURNED, pipeline.frame.take_turn_note())
        if recorder:
            recorder.write_answer(records_of(answer))
        yield answer


def finish(
    recorder: AnswerWriter | None, pipeline: Pipeline[Any], bag: Bag, damage: Sequence[str]
) -> None:
    """Write what ends a recording: the remaining inputs, refused samples and the damage of the bag it comes from."""
    if recorder:
        recorder.write_ending(pipeline.ending())
        if damage:
            recorder.bag.add_metadata(
                SOURCE_DAMAGE, {"source": bag.path.name, "faults": "\n".join(damage)}
            )


def nothing_computed(
    bag: Bag, what: str, pipeline: Pipeline[Any], damage: Sequence[str]
) -> UsageError:
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


@dataclass
class Run:
    """Pipeline that takes blocks of messages; its answers are recorded and passed on."""

    pipeline: ContactPipeline
    recorder: AnswerWriter | None
    """Writer of the recording; None: nothing is recorded"""
    takers: Sequence[Callable[[AnswerBlock], object]]
    """Functions that are called with blocks of answers"""
    thread: ThreadPoolExecutor
    """Thread that writes blocks that were computed at once; when `keep` returns, everything is written"""
    changes: deque[Change]
    """Resets and changed parameters of the node that made a recording, to repeat at the same ticks"""
    leg: DrawnLeg = field(default_factory=DrawnLeg)
    """Leg that is drawn in the recording"""
    _writing: Future[None] | None = None

    def take(self, block: Batch) -> None:
        """Compute the ticks of a block of angles (number 0) and forces (number 1), at once if possible."""
        if self.pipeline.is_lost or self.changes or not self._take_at_once(block):
            self.keep(self.pipeline.push_messages(block))

    def keep(self, answers: Iterator[ContactAnswer]) -> None:
        """Record answers and pass them on as a block; make the changes that are due between them."""
        kept = []
        self._wait()
        self._make_changes()
        for answer in recorded(self.recorder, self.pipeline, answers, self.leg.records_with_leg):
            kept.append(answer)
            self._make_changes()
        if kept:
            self._pass_on(AnswerBlock.of(kept))

    def _take_at_once(self, block: Batch) -> bool:
        answers = answer_block(
            self.pipeline, block.messages_of(0), block.messages_of(1), block.numbers
        )
        if answers is None:
            return False
        if self.recorder:
            messages = answers.messages(self.leg)
            parts = [part._replace(topic=f"/{part.topic}") for part in messages]
            self._wait()
            self._writing = self.thread.submit(write_messages, self.recorder.bag, parts)
        self._pass_on(answers.block)
        return True

    def _wait(self) -> None:
        """Wait until the last block is written; an error of it is raised here."""
        writing, self._writing = self._writing, None
        if writing:
            writing.result()

    def _pass_on(self, block: AnswerBlock) -> None:
        for taker in self.takers:
            taker(block)

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

"""A bag through the pipeline as fast as the machine allows, without ROS: what `knee-contact solve` does."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from operator import attrgetter
from pathlib import Path

from ..bags.bag import Bag
from ..bags.bag_file import Batch
from ..bags.batch_writer import write_messages
from ..bags.leg import DrawnLeg
from ..bags.names import OWN_NAMES, Names
from ..bags.provenance import (
    PARAMETERS_CHANGED,
    Change,
    Flags,
    Provenance,
    change_record,
    read_provenance,
    recorded_flags,
)
from ..model.ringing import Ringing
from ..parameters.files import all_values, load_parameters
from ..parameters.schema import Parameters, has_two_compartments
from ..streams.contact_pipeline import ContactAnswer, ContactPipeline
from ..streams.output import PROVENANCE, WAITING
from ..streams.topics import recorded_topics
from ..streams.watch import held_sentence, unanswered_sentence
from ..system.errors import UsageError
from ..system.progress import OnProgress, no_progress
from .bag_inputs import BagInputs
from .bag_parameters import file_contents, resolved_parameters
from .held_answers import HeldAnswers
from .output import BagOutput, nothing_computed, open_bag_output
from .solve_blocks import AnswerBlock, answer_block
from .summary import Summary

BATCH_SIZE = 8192
"""Number of messages in a batch: a few MB, but enough that handling a batch costs almost nothing"""
LATE_CHANGES = "changes in the node may be applied too late, because ticks before them are missing"


def solve(
    bag: Bag,
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
        bag: The bag with the inputs.
        basis: Parameters, or the provenance of a recording (`read_provenance`) that is computed again.
        output: The .mcap file to write; None: only the summary is wanted.
        advance: Called now and then with the number of finished messages and of all messages.
        overwrite: Replace an existing output, once the new one is complete.
        names: Names of the inputs in the bag.
        compiled: As for `load_model`.
        keep: Called with the answers to every batch of messages.
        curves: Contents of the files that parameters name, by parameter; None: the files are read.

    Raises:
        UsageError: the bag or the output cannot be used, or no tick could be computed. No output is left then.
    """
    recording = basis if isinstance(basis, Provenance) else None
    parameters = resolved_parameters(basis)
    if curves is None:
        curves = file_contents(basis)
    inputs = BagInputs(bag, parameters, names, bool(recording and recording.state))
    inputs.check_joints(parameters.joints())
    pipeline = ContactPipeline(parameters, compiled=False, curves=curves)
    if not recording and parameters.frame.tibia:
        inputs.learn_transforms(pipeline.frame)
    pipeline.doubts.about_import = bag.doubts
    topics = recorded_topics(has_two_compartments(parameters))
    total = inputs.message_count
    with (
        open_bag_output(bag, output, overwrite, topics, parameters, curves) as recorder,
        ThreadPoolExecutor(1) as thread,
    ):
        if compiled is not False:
            pipeline.compile_model()
        if recording:
            _resume(pipeline, recording)
        summary = _empty_summary(pipeline, rings=not (recording and recording.changes))
        held = HeldAnswers()
        takers: list[Callable[[AnswerBlock], object]] = [summary.add_block, held.add_block]
        if keep:
            takers.append(keep)
        changes: list[Change | Flags] = [
            *recorded_flags(bag),
            *(recording.changes if recording else ()),
        ]
        run = SolveRun(pipeline, recorder, takers, thread, changes)
        done = 0
        for batch in inputs.batches_of(BATCH_SIZE):
            run.solve_batch(batch)
            done += len(batch)
            advance(done, total)
        run.take_answers(pipeline.finish_streams())
        _complete_summary(summary, pipeline, inputs, recording)
        stored = read_provenance(bag) if recording else None
        if stored and recording:
            is_own = stored.parameters == recording.parameters
        else:
            is_own = bag.first_metadata(PROVENANCE) is None
        if is_own:
            summary.differing = held.difference(bag, names)
        recorder.write_ending(pipeline, bag, summary.damage)
        if not summary.ticks:
            raise nothing_computed(bag, "tick could be computed", pipeline, summary.damage)
    return summary


def _resume(pipeline: ContactPipeline, recording: Provenance) -> None:
    """Continue the run of a recording.

    Raises:
        UsageError: the state in the recording is damaged.
    """
    try:
        pipeline.resume_recording(recording.ticks_before, recording.state)
    except (TypeError, ValueError, IndexError) as error:
        raise UsageError(f"{recording.recording}: its state is damaged: {error}") from None


def _empty_summary(pipeline: ContactPipeline, rings: bool) -> Summary:
    """Return the summary of the medial (or only) compartment, with that of the lateral one, if there is one.

    `rings`: whether the ringing of the force is to be found, which needs the same parameters throughout.
    """
    weight = pipeline.parameters.body_weight
    summary, *others = (
        Summary(weight, each.doubts, Ringing(each.model) if rings else None)
        for each in pipeline.compartments
    )
    if others:
        summary.lateral = others[0]
    return summary


def _complete_summary(
    summary: Summary, pipeline: ContactPipeline, inputs: BagInputs, recording: Provenance | None
) -> None:
    """Add to the summary what is known after the last answers."""
    summary.complete()
    summary.damage = inputs.bag.damage
    if recording:
        late = [LATE_CHANGES] if inputs.bag.damage and recording.changes else []
        summary.damage = [*recording.damage, *inputs.bag.damage, *late]
    summary.refused = pipeline.synchroniser.refused
    if pipeline.varies:
        summary.split = pipeline.split
    has_angles = pipeline.synchroniser.angle_time.last is not None
    summary.unanswered = unanswered_sentence(pipeline, inputs.force_count, has_angles)
    has_fields = pipeline.parameters.inputs()[0].fields
    joint = "" if has_fields else pipeline.parameters.knee.joint_name
    angles, forces = inputs.publishers()
    sentences = (
        pipeline.angle_conflict.sentence(angles, joint),
        pipeline.force_conflict.sentence(forces),
        held_sentence(pipeline, summary.flagged["INPUT_HELD"]),
        pipeline.frame.doubt,
        inputs.orientation_doubt,
    )
    summary.publishers = [sentence for sentence in sentences if sentence]


class SolveRun:
    """Pipeline that solves batches of messages; its answers are recorded and passed on."""

    def __init__(
        self,
        pipeline: ContactPipeline,
        recorder: BagOutput,
        takers: list[Callable[[AnswerBlock], object]],
        thread: ThreadPoolExecutor,
        changes: Sequence[Change | Flags],
    ) -> None:
        """Begin with the first message.

        Args:
            pipeline: The pipeline.
            recorder: The recording.
            takers: Functions that are called with blocks of answers.
            thread: Thread that writes blocks; when `take_answers` returns, everything is written.
            changes: Resets, changed parameters and flags of a recording's node, to repeat at the same ticks.
        """
        self.pipeline = pipeline
        self._recorder = recorder
        self._takers = takers
        self._thread = thread
        self._changes = deque(sorted(changes, key=attrgetter("tick")))
        self._waiting = {  # number of angles that waited at resets, by the number of forces before
            one.tick: one.waiting
            for one in changes
            if isinstance(one, Change) and one.values is None
        }
        self._forces = self._angles = 0  # read so far, and after the last force
        self._leg = DrawnLeg()
        self._writing: Future[None] | None = None
        pipeline.synchroniser.on_unanswered = self._make_changes

    def solve_batch(self, batch: Batch) -> None:
        """Compute the ticks of a batch of angles (number 0) and forces (number 1), at once if possible."""
        if self.pipeline.is_lost or self._changes or not self._solve_at_once(batch):
            self.take_answers(self._answers(batch))

    def _answers(self, batch: Batch) -> Iterator[ContactAnswer]:
        """Yield the answers to a batch; where the node was reset, all that had come by then are answered first."""
        for message in batch:
            if self._waiting.get(self._forces) == self._angles:
                yield from self.pipeline.finish_streams()
            is_force = bool(message[0])
            self._forces += is_force
            self._angles = 0 if is_force else self._angles + 1
            yield from self.pipeline.push_messages((message,))

    def take_answers(self, answers: Iterator[ContactAnswer]) -> None:
        """Record answers and pass them on as a block; make the changes that are due between them."""
        taken = []
        self._wait_for_writing()
        self._make_changes()
        records_of = self._leg.records_with_leg
        for answer in self._recorder.record_answers(self.pipeline, answers, records_of):
            taken.append(answer)
            self._make_changes()
        if taken:
            self._pass_on(AnswerBlock.of(taken))

    def _solve_at_once(self, batch: Batch) -> bool:
        angles = batch.messages_of(0)
        forces = batch.messages_of(1)
        answers = answer_block(self.pipeline, angles, forces, batch.numbers)
        if answers is None:
            return False
        if writer := self._recorder.writer:
            messages = answers.messages(self._leg)
            named = [each._replace(topic=f"/{each.topic}") for each in messages]
            self._wait_for_writing()
            self._writing = self._thread.submit(write_messages, writer.bag, named)
        self._pass_on(answers.block)
        return True

    def _wait_for_writing(self) -> None:
        """Wait until the last block is written; an error of it is raised here."""
        writing = self._writing
        self._writing = None
        if writing:
            writing.result()

    def _pass_on(self, block: AnswerBlock) -> None:
        for taker in self._takers:
            taker(block)

    def _make_changes(self) -> None:
        """Make the changes whose tick has come, and record them.

        The node had an answer to every recorded force, also where offline no angle is before it.

        Raises:
            UsageError: this version of the package does not allow the changed parameters.
        """
        unanswered = self.pipeline.synchroniser.refused["no_angle_before"]
        while self._changes and self.pipeline.ticks + unanswered >= self._changes[0].tick:
            change = self._changes.popleft()
            if isinstance(change, Flags):
                self.pipeline.synchroniser.flag_from_now("recorded", change.status)
                continue
            tick, values, waiting = change
            if values is None:
                note = self.pipeline.reset()
                self._recorder.write_note(note.name, note.values | {WAITING: str(waiting)})
                continue
            try:
                changed = load_parameters(all_values(self.pipeline.parameters) | values)
                self.pipeline.retune(changed)
            except UsageError as error:
                raise UsageError(
                    f"the recording has a change after {tick} ticks that cannot be made: {error}"
                ) from None
            self._recorder.write_note(PARAMETERS_CHANGED, change_record(tick, values))

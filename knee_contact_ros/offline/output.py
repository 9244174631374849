"""The recording of what is computed from a bag, for `solve` and `estimate-load`."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..bags.bag import DOUBTS, GAIT_EVENTS, ORIGIN, Bag
from ..bags.provenance import provenance_record
from ..bags.recorder import AnswerWriter, BagWriter
from ..parameters.load_schema import LoadParameters
from ..parameters.schema import Parameters
from ..streams.frames import FORCE_TURNED
from ..streams.output import PROVENANCE
from ..streams.pipeline import AnswerT, Pipeline
from ..streams.topics import Record
from ..system.errors import UsageError, join_faults
from ..system.output_files import check_not_input

SOURCE_DAMAGE = "source_damage"
"""Name of the metadata record of an output that lists the damage of the bag it was computed from"""


class BagOutput:
    """Recording of answers; without a writer nothing is recorded."""

    def __init__(self, writer: AnswerWriter | None) -> None:
        self.writer = writer

    def write_note(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record after the answers so far."""
        if self.writer:
            self.writer.write_note(name, values)

    def write_notes(self, pipeline: Pipeline[Any]) -> None:
        """Write the notes of a pipeline that are not written yet."""
        while pipeline.notes:
            self.write_note(*pipeline.notes.pop(0))

    def record_answers(
        self,
        pipeline: Pipeline[AnswerT],
        answers: Iterable[AnswerT],
        records_of: Callable[[AnswerT], tuple[Record, ...]],
    ) -> Iterator[AnswerT]:
        """Record answers as they come, and a note when forces are turned; yield the answers."""
        for answer in answers:
            self.write_notes(pipeline)
            if self.writer:
                if pipeline.frame.turn_note:
                    self.write_note(FORCE_TURNED, pipeline.frame.take_turn_note())
                self.writer.write_answer(records_of(answer))
            yield answer

    def write_ending(self, pipeline: Pipeline[Any], bag: Bag, damage: Sequence[str]) -> None:
        """Write the remaining inputs, the refused samples, and the damage of the bag that was computed."""
        if self.writer:
            self.write_notes(pipeline)
            self.writer.write_ending(pipeline.ending())
            if damage:
                faults = {"source": bag.path.name, "faults": "\n".join(damage)}
                self.writer.bag.add_metadata(SOURCE_DAMAGE, faults)


@contextmanager
def open_bag_output(
    bag: Bag,
    path: Path | None,
    overwrite: bool,
    topics: Iterable[str],
    parameters: Parameters | LoadParameters,
    curves: Mapping[str, str] = {},
    provenance_name: str = PROVENANCE,
    origin: Mapping[str, str] = {},
) -> Iterator[BagOutput]:
    """Open the output of a bag that is computed; its file is removed if computing fails.

    `origin`, what the bag's importer doubted, and its gait events become its metadata record of that name.

    Raises:
        UsageError: the output is the bag, or cannot be written.
    """
    if path is None:
        yield BagOutput(None)
        return
    check_not_input(path, bag.paths)
    with BagWriter(path, overwrite=overwrite, alone=True) as writer:
        names = {topic: f"/{topic}" for topic in topics}
        record = provenance_record(parameters, curves, bag)
        output = BagOutput(AnswerWriter(writer, record, names, provenance_name))
        carried = {DOUBTS: "\n".join(bag.doubts), GAIT_EVENTS: bag.origin.get(GAIT_EVENTS, "")}
        if origin := {**origin, **{name: text for name, text in carried.items() if text}}:
            output.write_note(ORIGIN, origin)
        yield output


def nothing_computed(
    bag: Bag, what: str, pipeline: Pipeline[Any], damage: Sequence[str]
) -> UsageError:
    """Return the error that a bag gave no `what`, with the reasons why samples were refused."""
    reasons = [f"{count} x {reason}" for reason, count in pipeline.synchroniser.refused.items()]
    parts = [part for part in (", ".join(reasons), pipeline.last_refusal) if part]
    why = "; ".join(parts) or "no angle and force at one time"
    damaged = f"; the bag is damaged: {join_faults(damage)}" if damage else ""
    return UsageError(f"bag {bag}: no {what} ({why}){damaged}")

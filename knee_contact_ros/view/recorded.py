"""The knees in recordings: their outlines, and their answers as a scene takes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import NamedTuple

from knee_contact_ros.bags.provenance import Change, read_provenance
from knee_contact_ros.bags.recorded_answers import answer_blocks, answer_topics
from knee_contact_ros.messages.topics import KNEE, LATERAL, MEDIAL, compartment_name, is_lateral, knee_name
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.types import Rows
from knee_contact_ros.parameters.build import build_model
from knee_contact_ros.parameters.curves import curve_texts
from knee_contact_ros.parameters.lateral import answering
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.view.outlines import KneeOutlines, drawing_of
from knee_contact_ros.view.sagittal import Pictures

LONGEST_NAME = 80
"""Most characters of a knee's name"""


class RecordedKnee(NamedTuple):
    """A knee whose answers are in a recording."""

    recording: Path
    topic: str
    """Absolute name of the topic of its answers"""
    model: KneeModel
    """Model with its surfaces and their motion"""
    drawing: KneeOutlines
    """Outlines of the knee"""
    changes: tuple[Change, ...]
    """Resets and changed parameters of the node during the recording"""
    known: bool
    """Whether the recording holds its parameters; otherwise they were assumed"""


def recorded_knees(recordings: Mapping[Path, str], parameters: Parameters) -> list[RecordedKnee]:
    """Return all knees in several recordings, each with a name of its own.

    The values of `recordings` are names, used where topics do not name the knee; `parameters` are those of recordings
    that do not hold theirs.

    Raises:
        UsageError: a recording cannot be used or has no answers.
    """
    answered = []
    for path, name in recordings.items():
        topics = answer_topics(path)
        if not topics:
            raise UsageError(f"recording {path} has no answers (knee_contact_ros/msg/KneeContact)")
        answered += [(path, topic, name) for topic in topics]
    alone = len({(path, knee_name(topic)) for path, topic, _ in answered}) == 1
    places = {(path, topic) for path, topic, _ in answered}
    names = distinct([_name(path, topic, name, alone, places) for path, topic, name in answered])
    return [_knee(path, topic, name, parameters) for (path, topic, _), name in zip(answered, names, strict=True)]


def answers_of(knee: RecordedKnee, advance: Callable[[int, int], None]) -> Iterator[tuple[Sequence[Change], Rows]]:
    """Yield blocks of answers, each with the changes of the node right before it; for `advance` see `answer_blocks`."""
    pictures, waiting, done = Pictures(), list(knee.changes), 0
    for block in answer_blocks(knee.recording, knee.topic, advance):
        place(knee.model, block, pictures)
        begin = 0
        while begin < len(block):
            due = [change for change in waiting if change.tick <= done + begin]
            waiting = waiting[len(due) :]
            end = min(len(block), waiting[0].tick - done) if waiting else len(block)
            yield due, block[begin:end]
            begin = end
        done += len(block)


def place(model: KneeModel, answers: Rows, pictures: Pictures) -> None:
    """Add femoral x and normal to the answers that are drawn: messages do not hold them."""
    for i in pictures.choose(answers["stamp"]).tolist():
        angle, height = float(answers["flexion_angle"][i]), float(answers["femoral_height"][i])
        x, _ = model.pair.mechanism.translation(angle)
        closest = model.closest(angle, height)
        answers["femoral_x"][i], answers["normal_x"][i], answers["normal_y"][i] = x, closest.normal_x, closest.normal_y


def distinct(names: Sequence[str]) -> list[str]:
    """Make names distinct: those that occur several times get a number."""
    return [f"{name}_{names[: i + 1].count(name)}" if names.count(name) > 1 else name for i, name in enumerate(names)]


def _name(path: Path, topic: str, recording: str, alone: bool, places: Set[tuple[Path, str]]) -> str:
    """Return the name of a knee by its topic or its `recording`; `places` are the topics with answers of each path."""
    name = knee_name(topic)
    name = name.replace("/", "_") if name != KNEE or alone else recording
    if is_lateral(topic):
        name = compartment_name(name, LATERAL)
    elif (path, f"{topic}/{LATERAL}") in places:
        name = compartment_name(name, MEDIAL)
    return "".join(letter if letter.isprintable() else "_" for letter in name)[:LONGEST_NAME]


def _knee(path: Path, topic: str, name: str, parameters: Parameters) -> RecordedKnee:
    """Build a knee from the parameters in its recording, or from `parameters` if it holds none."""
    provenance = read_provenance(path)
    if provenance:
        parameters = provenance.parameters
    parameters, texts = answering(topic, parameters, provenance.texts() if provenance else curve_texts(parameters, {}))
    model = build_model(parameters, curves=texts)
    changes = provenance.changes if provenance else ()
    return RecordedKnee(
        path, topic, model, drawing_of(model, name, parameters.body_weight), changes, provenance is not None
    )

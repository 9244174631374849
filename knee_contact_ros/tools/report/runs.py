"""What a report is about: recordings with answers, and bags that are solved for it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from knee_contact_ros import __version__
from knee_contact_ros.bags.provenance import NOT_OF_THE_RESULT, Provenance, read_provenance, with_values
from knee_contact_ros.bags.recorded_answers import answer_blocks, answer_topics
from knee_contact_ros.bags.topic_names import OWN_NAMES, Names, names_in_bag
from knee_contact_ros.messages.topics import KNEE_CONTACT
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.offline.summary import read_refused
from knee_contact_ros.parameters.build import build_model
from knee_contact_ros.parameters.plausibility import Doubts, doubts_about
from knee_contact_ros.parameters.reading import flat_parameters, known_parameters, load_parameters
from knee_contact_ros.parameters.schema import Parameters, constants_of
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.report.gather import Gathered

Advance = Callable[[int, int], None]
Source = Path | dict[str, Any]
"""Where parameters come from: a file, or values by name"""
OWN_TOPIC = f"/{KNEE_CONTACT}"


class ReportOptions(NamedTuple):
    """What the command was asked for."""

    files: Sequence[Path]
    labels: Sequence[str]
    parameters: Sequence[Source]
    """For bags without answers, and for recordings without parameters; the later one wins"""
    parameters_given: bool
    """Whether they were given, and are not just the default"""
    compare: Sequence[Path]
    """Parameter files to compute every file again with, over its own parameters; none: it is not"""
    names: Names = OWN_NAMES


class Run(NamedTuple):
    """A series of answers, and how it came about."""

    name: str
    """Of the recording"""
    label: str
    """Of the run: the recording's name, and with what it was computed where that differs"""
    source: Path
    topic: str
    parameters: Parameters
    origin: str
    """A sentence: who computed it, with which parameters"""
    refused: Counter[str]
    """Refused samples by reason"""
    damage: Sequence[str]
    """What is wrong with the source, as sentences"""
    beside: int | None
    """Index of the run with whose inputs it was computed again; None: it is no comparison"""
    gathered: Gathered


def collect(asked: ReportOptions, work: Path, say: Callable[[str], Advance]) -> list[Run]:
    """The runs, each followed by its comparison; solves what has to be solved into files in `work`, and removes them.

    `say` gets a sentence on what is done next, and gives a function of (done, total).

    Raises:
        UsageError: a file or its parameters cannot be used.
    """
    runs: list[Run] = []
    recorded = {path: answer_topics(path) for path in asked.files}
    if asked.parameters_given and all(topics and _stored(path, asked) for path, topics in recorded.items()):
        raise UsageError("--params is for bags, and every FILE is a recording with its parameters; see --compare")
    for number, path in enumerate(asked.files):
        label = asked.labels[number] if asked.labels else path.stem
        several = len(recorded[path]) > 1
        own = [
            _recorded(path, topic, f"{label} {topic.strip('/')}" if several else label, asked, say)
            for topic in recorded[path]
        ]
        for run in own or [_solved(path, label, asked, work, say)]:
            runs.append(run)
            if asked.compare:
                runs.append(_compared(run, len(runs) - 1, asked, work, say))
    return _told_apart(runs)


def own_values(parameters: Parameters) -> list[tuple[str, Any, Any, str]]:
    """What matters for the answers: name, value, default and meaning.

    Of the contact law all constants that it uses; of the rest what differs from the defaults, and what the load is.
    """
    known, values = known_parameters(), flat_parameters(parameters)
    constants = {f"contact.{name}" for name in constants_of(parameters.contact.law)}
    shown = {"contact.law", "load.compartment", "body_weight", "femur.geometry", "tibia.geometry", *constants}
    shown |= {"load.share"} if parameters.load.compartment == "fixed_share" else set()
    return [
        (name, values[name], default, meaning)
        for name, (default, meaning, _) in known.items()
        if not name.startswith(NOT_OF_THE_RESULT) and (name in shown or values[name] != default)
    ]


def _recorded(path: Path, topic: str, label: str, asked: ReportOptions, say: Callable[[str], Advance]) -> Run:
    """A recording's answers on a topic, as they are."""
    provenance = _stored(path, asked)
    if provenance:
        parameters = provenance.parameters
        origin = f"Recorded with {provenance.package} and the parameters stored in it."
        if provenance.changes:
            origin += f" They changed, or the model was reset, {len(provenance.changes)} times meanwhile."
    else:
        parameters = load_parameters(list(asked.parameters))
        origin = f"Recorded without its parameters; {_spelled(asked.parameters)} is taken for body weight and law."
    doubts = _doubts(parameters, provenance)
    gathered = _gathered(path, topic, parameters, doubts, say(f"Reading {path.name}"))
    damage = provenance.damage if provenance else ()
    return Run(label, label, path, topic, parameters, origin, _refused(path), damage, None, gathered)


def _solved(path: Path, label: str, asked: ReportOptions, work: Path, say: Callable[[str], Advance]) -> Run:
    """A bag with inputs only."""
    parameters = load_parameters(list(asked.parameters))
    origin = f"Computed for this report by knee_contact_ros {__version__} with {_spelled(asked.parameters)}."
    run = _computed(path, parameters, asked.names, work, say)
    stems = [source.stem if isinstance(source, Path) else spelled(source) for source in asked.parameters]
    return run._replace(name=label, label=", ".join([label, *stems]) if asked.compare else label, origin=origin)


def _compared(run: Run, beside: int, asked: ReportOptions, work: Path, say: Callable[[str], Advance]) -> Run:
    """A run's inputs computed with other parameters."""
    before = flat_parameters(run.parameters)
    after = flat_parameters(load_parameters([before, *asked.compare]))
    stored = _stored(run.source, asked)
    how: Parameters | Provenance = load_parameters(after)
    if stored:  # it may hold the files that parameters name
        how = with_values(stored._replace(changes=()), {n: v for n, v in after.items() if v != before[n]})
    origin = (
        f"Computed for this report by knee_contact_ros {__version__}: the inputs of “{run.label}”, "
        f"with {_spelled(asked.compare)} over its parameters."
    )
    namespace = run.topic.removesuffix(OWN_TOPIC).strip("/")
    names = names_in_bag((), namespace) if namespace else asked.names
    computed = _computed(run.source, how, names, work, say)
    told = ", ".join([run.name, *(path.stem for path in asked.compare)])
    return computed._replace(name=run.name, label=told, topic=run.topic, origin=origin, beside=beside)


def _stored(path: Path, asked: ReportOptions) -> Provenance | None:
    """How a recording came about; not asked of a later part, whose first has the parameters, if some are given."""
    try:
        return read_provenance(path)
    except UsageError:
        if asked.parameters_given:
            return None
        raise


def _spelled(sources: Sequence[Source]) -> str:
    return ", ".join(source.name if isinstance(source, Path) else spelled(source) for source in sources)


def _refused(path: Path) -> Counter[str]:
    """As the recording tells, if it does."""
    try:
        return read_refused(path)
    except (OSError, ValueError):
        return Counter()


def _computed(path: Path, how: Parameters | Provenance, names: Names, work: Path, say: Callable[[str], Advance]) -> Run:
    recording, parameters = work / "solved.mcap", how.parameters if isinstance(how, Provenance) else how
    summary = solve(path, how, recording, say(f"Solving {path.name}"), overwrite=True, names=names)
    doubts = Doubts()
    doubts.go_on_with(summary.doubts)
    gathered = _gathered(recording, OWN_TOPIC, parameters, doubts, say(f"Reading what {path.name} gave"))
    recording.unlink()
    return Run("", "", path, OWN_TOPIC, parameters, "", summary.refused, tuple(summary.damage), None, gathered)


def _doubts(parameters: Parameters, provenance: Provenance | None) -> Doubts:
    """What makes no sense in a recording's parameters, as far as the files that they name are at hand."""
    try:
        return doubts_about(parameters, build_model(parameters, curves=provenance.texts() if provenance else None))
    except UsageError:
        return Doubts()


def _gathered(path: Path, topic: str, parameters: Parameters, doubts: Doubts, advance: Advance) -> Gathered:
    gathered = Gathered(parameters.body_weight, doubts)
    for block in answer_blocks(path, topic, advance):
        gathered.add(block)
    return gathered.finish()


def _told_apart(runs: list[Run]) -> list[Run]:
    """Labels that several runs have get a number."""
    counts = Counter(run.label for run in runs)
    seen: Counter[str] = Counter()
    told = []
    for run in runs:
        label = run.label
        if counts[label] > 1:
            seen[label] += 1
            label = f"{label} ({seen[label]})"
        told.append(run._replace(label=label, name=label if run.name == run.label else run.name))
    return told


def spelled(values: dict[str, Any]) -> str:
    """Values as on the command line."""
    return ", ".join(f"{name}:={value}" for name, value in values.items())

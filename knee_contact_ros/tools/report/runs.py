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
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.messages.topics import (
    KNEE,
    KNEE_CONTACT,
    KNEE_CONTACT_LATERAL,
    LATERAL,
    MEDIAL,
    is_lateral,
    knee_name,
)
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.offline.summary import read_refused
from knee_contact_ros.offline.uncertainty.propagation import Propagated
from knee_contact_ros.parameters.build import build_model
from knee_contact_ros.parameters.curves import curve_texts
from knee_contact_ros.parameters.lateral import answering
from knee_contact_ros.parameters.plausibility import Doubts, doubts_about
from knee_contact_ros.parameters.reading import flat_parameters, known_parameters, load_parameters
from knee_contact_ros.parameters.schema import Parameters, constants_of
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.report.comparison import Difference, Overlay, compared, differences, kept, named, overlay
from knee_contact_ros.tools.report.gather import Gathered

Advance = Callable[[int, int], None]
Source = Path | dict[str, Any]
"""Where parameters come from: a file, or values by name"""
SAME = "again"
"""A comparison that changes nothing"""


class ReportOptions(NamedTuple):
    """What the command was asked for."""

    files: Sequence[Path]
    labels: Sequence[str]
    parameters: Sequence[Source]
    """For bags without answers, and for recordings without parameters; the later one wins"""
    parameters_given: bool
    """Whether they were given, and are not just the default"""
    compare: Sequence[Path]
    """Parameter files whose contact law every file is computed again with; none: it is not"""
    names: Names = OWN_NAMES
    uncertainty: Path | None = None
    """File of standard deviations of inputs and parameters"""


class Run(NamedTuple):
    """A series of answers, and how it came about."""

    name: str
    """Of the recording"""
    label: str
    """Of the run: the recording's name, and what its contact law differs by from the one it is beside"""
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
    model: KneeModel | None = None
    """To draw the knee with; None: its parameters are not known, or files that they name are not at hand"""
    known: bool = True
    """Whether its parameters are its own, and not assumed"""
    differences: Sequence[Difference] = ()
    """Of a comparison: what its contact law differs by from that of the run it is beside"""
    kept: Sequence[str] = ()
    """Of a comparison: what it keeps of its run although its files say something else"""
    uncertain: Propagated | None = None
    """What is not known exactly makes of its depth and force, if that was asked for"""


def collect(asked: ReportOptions, work: Path, say: Callable[[str], Advance]) -> list[Run]:
    """The runs, each followed by its comparison; solves what has to be solved into files in `work`, and removes them.

    `say` gets a sentence on what is done next, and gives a function of (done, total).

    Raises:
        UsageError: a file or its parameters cannot be used.
    """
    own: list[Run] = []
    over = overlay(asked.compare) if asked.compare else None
    recorded = {path: answer_topics(path) for path in asked.files}
    if asked.parameters_given and all(topics and stored(path, asked) for path, topics in recorded.items()):
        raise UsageError("--params is for bags, and every FILE is a recording with its parameters; see --compare")
    for number, path in enumerate(asked.files):
        label = asked.labels[number] if asked.labels else path.stem
        several = len(recorded[path]) > 1
        found = [
            _recorded(path, topic, f"{label} {_which(topic, recorded[path])}" if several else label, asked, say)
            for topic in recorded[path]
        ]
        own += found or _solved(path, label, asked, work, say)
    own = _told_apart(own)  # before they are compared: two of a name differ by their laws' names at most
    if over is None:
        return own
    runs: list[Run] = []
    for run in own:
        other = _compared(run, len(runs), over, asked, work, say)
        names = [named(other.differences, after=after) for after in (False, True)]
        runs.append(run._replace(label=", ".join(filter(None, (run.label, names[0])))))
        runs.append(other._replace(label=f"{run.label}, {names[1] or SAME}"))
    return runs


def own_values(parameters: Parameters) -> list[tuple[str, Any, Any, str]]:
    """What matters for the answers: name, value, default and meaning.

    Of the contact law all constants that it uses; of the rest what differs from the defaults, and what the load is.
    """
    known, values = known_parameters(), flat_parameters(parameters)
    constants = {f"contact.{name}" for name in constants_of(parameters.contact.law)}
    shown = {"contact.law", "load.compartment", "body_weight", "femur.geometry", "tibia.geometry", *constants}
    shown |= {"contact.femoral_radius", "contact.tibial_radius"}
    shown |= set() if parameters.contact.law.startswith("two_layer") else {"contact.foundation_thickness"}
    shown |= {"load.share_file"} if parameters.load.rule == "measured_share" else set()
    shown |= {"load.share"} if parameters.load.rule == "fixed_share" else set()
    return [
        (name, values[name], default, meaning)
        for name, (default, meaning, _) in known.items()
        if name in values and not name.startswith(NOT_OF_THE_RESULT) and (name in shown or values[name] != default)
    ]


def _which(topic: str, topics: Sequence[str]) -> str:
    """What tells the answers on a topic from those on others of a recording: the topic, or the compartment's name."""
    if len({knee_name(other) for other in topics}) > 1:
        return topic.strip("/")
    return LATERAL if is_lateral(topic) else MEDIAL


def _recorded(path: Path, topic: str, label: str, asked: ReportOptions, say: Callable[[str], Advance]) -> Run:
    """A recording's answers on a topic, as they are."""
    provenance = stored(path, asked)
    if provenance:
        parameters = provenance.parameters
        origin = f"Recorded with {provenance.package} and the parameters stored in it."
        if provenance.changes:
            origin += f" They changed, or the model was reset, {len(provenance.changes)} times meanwhile."
    else:
        parameters = load_parameters(list(asked.parameters))
        origin = f"Recorded without its parameters; {_spelled(asked.parameters)} is taken for body weight and law."
    parameters, model = _model(topic, parameters, provenance)
    doubts = doubts_about(parameters, model) if model else Doubts()
    known = model if provenance and not provenance.changes else None
    gathered = _gathered(path, topic, parameters, doubts, known, say(f"Reading {path.name}"))
    if not provenance:
        return Run(label, label, path, topic, parameters, origin, _refused(path), (), None, gathered, known=False)
    return Run(label, label, path, topic, parameters, origin, _refused(path), provenance.damage, None, gathered, model)


def _solved(path: Path, label: str, asked: ReportOptions, work: Path, say: Callable[[str], Advance]) -> list[Run]:
    """A bag with inputs only; a run for each compartment."""
    parameters = load_parameters(list(asked.parameters))
    origin = f"Computed for this report by knee_contact_ros {__version__} with {_spelled(asked.parameters)}."
    runs = _computed(path, parameters, asked.names, work, say)
    labels = [f"{label} {name}" for name in (MEDIAL, LATERAL)] if len(runs) > 1 else [label]
    return [run._replace(name=name, label=name, origin=origin) for run, name in zip(runs, labels, strict=True)]


def _compared(
    run: Run, beside: int, over: Overlay, asked: ReportOptions, work: Path, say: Callable[[str], Advance]
) -> Run:
    """A run's inputs computed with another contact law; person, surfaces and solver stay."""
    recorded = stored(run.source, asked)
    if recorded:  # it may hold the files that parameters name
        how: Parameters | Provenance = with_values(recorded._replace(changes=()), over.taken)
    else:
        how = compared(load_parameters(list(asked.parameters)), over)
    origin = (
        f"Computed for this report by knee_contact_ros {__version__}: the inputs of “{run.name}” with its parameters, "
        f"but for the contact law of {_spelled(asked.compare)}."
    )
    knee = knee_name(run.topic)
    names = names_in_bag((), knee) if knee != KNEE else asked.names
    found = _computed(run.source, how, names, work, say)
    again = next(one for one in found if is_lateral(one.topic) == is_lateral(run.topic))
    return again._replace(
        name=run.name, topic=run.topic, origin=origin, beside=beside, kept=kept(run.parameters, over),
        differences=differences(run.parameters if run.known else None, again.parameters),
    )  # fmt: skip


def stored(path: Path, asked: ReportOptions) -> Provenance | None:
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


def _computed(
    path: Path, how: Parameters | Provenance, names: Names, work: Path, say: Callable[[str], Advance]
) -> list[Run]:
    """A bag computed; a run for each compartment, the medial one first."""
    recording, parameters = work / "solved.mcap", how.parameters if isinstance(how, Provenance) else how
    summary = solve(path, how, recording, say(f"Solving {path.name}"), overwrite=True, names=names)
    runs = []
    for topic, told in ((f"/{KNEE_CONTACT}", summary), (f"/{KNEE_CONTACT_LATERAL}", summary.lateral)):
        if told:
            doubts = Doubts()
            doubts.go_on_with(told.doubts)
            own, model = _model(topic, parameters, how if isinstance(how, Provenance) else None)
            gathered = _gathered(recording, topic, own, doubts, model, say(f"Reading what {path.name} gave"))
            damage = tuple(summary.damage)
            runs.append(Run("", "", path, topic, own, "", summary.refused, damage, None, gathered, model))
    recording.unlink()
    return runs


def _model(topic: str, parameters: Parameters, provenance: Provenance | None) -> tuple[Parameters, KneeModel | None]:
    """Parameters and model of the compartment that answers on a topic; the model if the files named are at hand."""
    try:
        texts = provenance.texts() if provenance else curve_texts(parameters, {})
        own, own_texts = answering(topic, parameters, texts)
        return own, build_model(own, curves=own_texts)
    except UsageError:
        return answering(topic, parameters, {})[0], None


def prescribed(parameters: Parameters) -> bool:
    """Whether the femoral height drives, and no load."""
    return parameters.drive == "displacement"


def _gathered(
    path: Path, topic: str, parameters: Parameters, doubts: Doubts, model: KneeModel | None, advance: Advance
) -> Gathered:
    gathered = Gathered(parameters.body_weight, doubts, model, prescribed(parameters))
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

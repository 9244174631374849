"""Runs of a report: recordings with answers, bags that are solved for it, and comparisons with other contact laws."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from knee_contact_ros import __version__
from knee_contact_ros.bags.provenance import NOT_OF_THE_RESULT, Provenance, read_provenance, with_values
from knee_contact_ros.bags.recorded_answers import answer_blocks, answer_topics
from knee_contact_ros.bags.topic_names import OWN_NAMES, Names, names_in_bag
from knee_contact_ros.lab.uncertainty import Propagated
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.offline.summary import read_refused
from knee_contact_ros.parameters.build import build_model
from knee_contact_ros.parameters.files import curve_texts, flat_parameters, known_parameters, load_parameters
from knee_contact_ros.parameters.schema import Parameters, constants_of
from knee_contact_ros.streams.contact_stream import answering
from knee_contact_ros.streams.topics import (
    KNEE,
    KNEE_CONTACT,
    KNEE_CONTACT_LATERAL,
    LATERAL,
    MEDIAL,
    is_lateral,
    knee_name,
)
from knee_contact_ros.streams.watch import Doubts, doubts_about
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.report.comparison import Difference, Overlay, compared, differences, kept, named, overlay
from knee_contact_ros.tools.report.gather import Gathered

Advance = Callable[[int, int], None]
Source = Path | dict[str, Any]
"""Source of parameters: a file, or values by name"""
SAME = "again"
"""Label of a comparison that changes nothing"""


class ReportOptions(NamedTuple):
    """Options of the command `report`."""

    files: Sequence[Path]
    """Recordings and bags"""
    labels: Sequence[str]
    """Names of the files, one each; empty: they are named by their file names"""
    parameters: Sequence[Source]
    """Parameters for bags without answers and for recordings without parameters; the last one that has a value wins"""
    parameters_given: bool
    """Whether the user gave these parameters, and they are not just the default"""
    compare: Sequence[Path]
    """Parameter files with whose contact law every file is computed again; empty: there is no comparison"""
    names: Names = OWN_NAMES
    """Names of topics in bags"""
    uncertainty: Path | None = None
    """File of standard deviations of inputs and parameters; None: no uncertainty is computed"""


class Run(NamedTuple):
    """Series of answers of a compartment, and how it was computed."""

    name: str
    """Name of the recording"""
    label: str
    """Label of the run: the recording's name, and how its contact law differs from that of the run beside it"""
    source: Path
    """Recording or bag"""
    topic: str
    """Topic of the answers"""
    parameters: Parameters
    origin: str
    """Sentence that says who computed the answers, with which parameters"""
    refused: Counter[str]
    """Number of refused samples by reason"""
    damage: Sequence[str]
    """Damage of the source, as sentences"""
    beside: int | None
    """Index of the run with whose inputs this comparison was computed; None: this run is no comparison"""
    gathered: Gathered
    model: KneeModel | None = None
    """Model to draw the knee with; None: its parameters are not known, or files that they name are missing"""
    known: bool = True
    """Whether the parameters are the recording's own, and not assumed"""
    differences: Sequence[Difference] = ()
    """Differences of a comparison's contact law from that of its run"""
    kept: Sequence[str] = ()
    """Parameters that a comparison keeps of its run although its files have other values, as texts"""
    uncertain: Propagated | None = None
    """Uncertainty of depth and force, if the options ask for it"""


def collect(options: ReportOptions, work: Path, say: Callable[[str], Advance]) -> list[Run]:
    """Gather the runs, each followed by its comparison; bags are solved into files in the folder `work`.

    `say` takes a sentence on what is done next, and returns a function that takes the progress (done, total).

    Raises:
        UsageError: a file or its parameters cannot be used.
    """
    own: list[Run] = []
    over = overlay(options.compare) if options.compare else None
    recorded = {path: answer_topics(path) for path in options.files}
    if options.parameters_given and all(topics and stored(path, options) for path, topics in recorded.items()):
        raise UsageError("--params is for bags, and every FILE is a recording with its parameters; see --compare")
    for number, path in enumerate(options.files):
        label = options.labels[number] if options.labels else path.stem
        several = len(recorded[path]) > 1
        runs = [
            _recorded(path, topic, f"{label} {_which(topic, recorded[path])}" if several else label, options, say)
            for topic in recorded[path]
        ]
        own += runs or _solved(path, label, options, work, say)
    own = _numbered(own)  # before they are compared: two of a name differ by their laws' names at most
    if over is None:
        return own
    runs = []
    for run in own:
        other = _compared(run, len(runs), over, options, work, say)
        names = [named(other.differences, after=after) for after in (False, True)]
        runs.append(run._replace(label=", ".join(filter(None, (run.label, names[0])))))
        runs.append(other._replace(label=f"{run.label}, {names[1] or SAME}"))
    return runs


def own_values(parameters: Parameters) -> list[tuple[str, Any, Any, str]]:
    """Parameters that matter for the answers, with name, value, default and meaning.

    These are all constants that the contact law uses, those that determine the load, and what differs from a default.
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
    """Distinguish the answers on a topic from those on others of a recording: by the topic, or by the compartment."""
    if len({knee_name(other) for other in topics}) > 1:
        return topic.strip("/")
    return LATERAL if is_lateral(topic) else MEDIAL


def _recorded(path: Path, topic: str, label: str, options: ReportOptions, say: Callable[[str], Advance]) -> Run:
    """Gather the answers on a topic of a recording, as they are."""
    provenance = stored(path, options)
    if provenance:
        parameters = provenance.parameters
        origin = f"Recorded with {provenance.package} and the parameters stored in it."
        if provenance.changes:
            origin += f" They changed, or the model was reset, {len(provenance.changes)} times meanwhile."
    else:
        parameters = load_parameters(list(options.parameters))
        origin = f"Recorded without its parameters; {_spelled(options.parameters)} is taken for body weight and law."
    parameters, model = _model(topic, parameters, provenance)
    doubts = doubts_about(parameters, model) if model else Doubts()
    known = model if provenance and not provenance.changes else None
    gathered = _gathered(path, topic, parameters, doubts, known, say(f"Reading {path.name}"))
    if not provenance:
        return Run(label, label, path, topic, parameters, origin, _refused(path), (), None, gathered, known=False)
    return Run(label, label, path, topic, parameters, origin, _refused(path), provenance.damage, None, gathered, model)


def _solved(path: Path, label: str, options: ReportOptions, work: Path, say: Callable[[str], Advance]) -> list[Run]:
    """Solve a bag that has inputs only; return a run for each compartment."""
    parameters = load_parameters(list(options.parameters))
    origin = f"Computed for this report by knee_contact_ros {__version__} with {_spelled(options.parameters)}."
    runs = _computed(path, parameters, options.names, work, say)
    labels = [f"{label} {name}" for name in (MEDIAL, LATERAL)] if len(runs) > 1 else [label]
    return [run._replace(name=name, label=name, origin=origin) for run, name in zip(runs, labels, strict=True)]


def _compared(
    run: Run, beside: int, over: Overlay, options: ReportOptions, work: Path, say: Callable[[str], Advance]
) -> Run:
    """Compute a run's inputs with another contact law; person, surfaces and solver stay the same."""
    recorded = stored(run.source, options)
    if recorded:  # it may hold the files that parameters name
        source: Parameters | Provenance = with_values(recorded._replace(changes=()), over.taken)
    else:
        source = compared(load_parameters(list(options.parameters)), over)
    origin = (
        f"Computed for this report by knee_contact_ros {__version__}: the inputs of “{run.name}” with its parameters, "
        f"but for the contact law of {_spelled(options.compare)}."
    )
    knee = knee_name(run.topic)
    names = names_in_bag((), knee) if knee != KNEE else options.names
    both = _computed(run.source, source, names, work, say)
    again = next(one for one in both if is_lateral(one.topic) == is_lateral(run.topic))
    return again._replace(
        name=run.name, topic=run.topic, origin=origin, beside=beside, kept=kept(run.parameters, over),
        differences=differences(run.parameters if run.known else None, again.parameters),
    )  # fmt: skip


def stored(path: Path, options: ReportOptions) -> Provenance | None:
    """Provenance of a recording; None for a later part, which has no parameters, if the user gave some."""
    try:
        return read_provenance(path)
    except UsageError:
        if options.parameters_given:
            return None
        raise


def _spelled(sources: Sequence[Source]) -> str:
    """Names of parameter files, and values as on the command line."""
    return ", ".join(
        source.name if isinstance(source, Path) else ", ".join(f"{name}:={value}" for name, value in source.items())
        for source in sources
    )


def _refused(path: Path) -> Counter[str]:
    """Number of refused samples by reason, as the recording has them; empty if it has none."""
    try:
        return read_refused(path)
    except (OSError, ValueError):
        return Counter()


def _computed(
    path: Path, source: Parameters | Provenance, names: Names, work: Path, say: Callable[[str], Advance]
) -> list[Run]:
    """Solve a bag by way of a file in `work`; return a run for each compartment, the medial one first."""
    provenance = source if isinstance(source, Provenance) else None
    recording, parameters = work / "solved.mcap", source.parameters if isinstance(source, Provenance) else source
    summary = solve(path, source, recording, say(f"Solving {path.name}"), overwrite=True, names=names)
    runs = []
    for topic, compartment in ((f"/{KNEE_CONTACT}", summary), (f"/{KNEE_CONTACT_LATERAL}", summary.lateral)):
        if compartment:
            doubts = Doubts()
            doubts.go_on_with(compartment.doubts)
            own, model = _model(topic, parameters, provenance)
            gathered = _gathered(recording, topic, own, doubts, model, say(f"Reading what {path.name} gave"))
            damage = tuple(summary.damage)
            runs.append(Run("", "", path, topic, own, "", summary.refused, damage, None, gathered, model))
    recording.unlink()
    return runs


def _model(topic: str, parameters: Parameters, provenance: Provenance | None) -> tuple[Parameters, KneeModel | None]:
    """Parameters and model of the compartment that answers on a topic; no model if files that they name are missing."""
    try:
        texts = provenance.texts() if provenance else curve_texts(parameters, {})
        own, own_texts = answering(topic, parameters, texts)
        return own, build_model(own, curves=own_texts)
    except UsageError:
        return answering(topic, parameters, {})[0], None


def prescribed(parameters: Parameters) -> bool:
    """Whether the femoral height is prescribed, and no load drives."""
    return parameters.drive == "displacement"


def _gathered(
    path: Path, topic: str, parameters: Parameters, doubts: Doubts, model: KneeModel | None, advance: Advance
) -> Gathered:
    gathered = Gathered(parameters.body_weight, doubts, model, prescribed(parameters))
    for block in answer_blocks(path, topic, advance):
        gathered.add(block)
    return gathered.finish()


def _numbered(runs: list[Run]) -> list[Run]:
    """Add a number to labels that several runs have; at this point a run's name is its label."""
    counts = Counter(run.label for run in runs)
    seen: Counter[str] = Counter()
    numbered = []
    for run in runs:
        seen[run.label] += 1
        label = f"{run.label} ({seen[run.label]})" if counts[run.label] > 1 else run.label
        numbered.append(run._replace(label=label, name=label))
    return numbered

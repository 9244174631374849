"""The runs of a report: recordings with answers, bags solved for it, and comparisons with other contact laws.

A bag is solved into a recording first, so all runs are read the same way.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ... import __version__
from ...bags.answers import answer_blocks, answer_topics
from ...bags.bag import Bag
from ...bags.names import OWN_NAMES, Names, names_in_bag
from ...bags.provenance import (
    NOT_OF_THE_RESULT,
    Provenance,
    read_provenance,
    with_values,
)
from ...model.knee import KneeModel
from ...model.mechanisms import MECHANISMS
from ...model.readouts import READOUTS_OF_LAW
from ...model.ringing import Ringing
from ...model.types import FLAT
from ...offline.bag_parameters import (
    file_contents,
    parameters_for,
    resolved_parameters,
    weight_doubt,
)
from ...offline.held_answers import doubt_of
from ...offline.solve import solve
from ...offline.summary import refused_samples
from ...parameters import files
from ...parameters.build import build_model, law_constants
from ...parameters.schema import Parameters
from ...parameters.subjects import Subject
from ...streams.compartments import compartment_of_topic
from ...streams.output import PROVENANCE
from ...streams.topics import (
    KNEE,
    KNEE_CONTACT,
    LATERAL,
    MEDIAL,
    is_lateral,
    knee_name,
)
from ...streams.watch import Doubts, doubts_about
from ...system.errors import UsageError
from ...system.files import check_distinct, parameter_file
from ...system.progress import Bar
from ...system.terminal import warn
from ..uncertainty import Propagated, read_uncertain_gait
from .gathered import ANSWER_FIELDS, Gathered

GivenParameters = Path | dict[str, Any]
"""Source of parameters: a file, or values by name"""
_COMPUTED = f"Computed for this report by knee_contact_ros {__version__}"
_LAW_SECTION = "contact."
"""Beginning of the names of parameters that a comparison changes"""
_YAML = (".yaml", ".yml")
"""Endings of the names of subject files"""
NO_VALUE = "–"
"""Text for a constant that a law does not have"""


class ReportOptions(NamedTuple):
    """Options of the command `report`."""

    files: Sequence[Path]
    """Recordings, bags, and subject files that name their bag"""
    labels: Sequence[str]
    """Names of the files, one each; empty: they are named by their file names"""
    parameters: Sequence[GivenParameters]
    """Parameters for bags without answers and recordings without parameters; later ones override earlier ones"""
    parameters_given: bool
    """Whether the user gave these parameters, as opposed to the default"""
    compare: Sequence[Path]
    """Parameter files whose contact law is used to compute every file again; empty: no comparison"""
    names: Names = OWN_NAMES
    """Names of topics in bags"""
    uncertainty: Path | None = None
    """File of standard deviations of inputs and parameters; None: no uncertainty is computed"""
    kind: str = "png"
    """Format of the figures' files"""


def comparison_values(paths: Sequence[Path]) -> dict[str, Any]:
    """Read the parameter files of a comparison: values by dotted name, later files overriding earlier ones.

    Raises:
        UsageError: a file cannot be used, is given twice, or sets no parameter of the contact law.
    """
    everything: dict[str, Any] = {}
    check_distinct(list(map(parameter_file, map(str, paths))), "--compare ")
    for path in paths:
        values = files.values_set_in(path)
        if not any(name.startswith(_LAW_SECTION) for name in values):
            raise UsageError(
                f"--compare {path}: sets no {_LAW_SECTION}* parameter, but a comparison changes only these; to compare "
                "something else, solve with each and report both recordings"
            )
        everything |= values
    return {name: value for name, value in everything.items() if name in files.known_parameters()}


def _kept_values(parameters: Parameters, compared: Mapping[str, Any]) -> list[str]:
    """List values that a run keeps although the comparison's files set others: `body_weight 931.6 (not 737)`."""
    own = files.all_values(parameters)
    return [
        f"{name} {value_text(own[name])} (not {value_text(value)})"
        for name, value in compared.items()
        if not name.startswith((_LAW_SECTION, *NOT_OF_THE_RESULT)) and own[name] != value
    ]


def value_text(value: Any) -> str:
    """Return the text of a parameter's value, with six significant digits."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    return NO_VALUE if value is None or value == "" else str(value)


def differences(
    several: Sequence[Parameters | None], join: str = ", ", labels: Sequence[str] = ()
) -> list[str]:
    """List differences between the parameters of several runs, a line for each name: `body_weight: 737.068, 931.6 N`.

    With the labels of the runs each value has its run's before it.

    Only constants that a contact law uses count. Parameters that are None are unknown. A lateral compartment is a run
    of its own, with its parameters under the medial names.
    """
    rows = [_values_in_use(each) if each else {} for each in several]
    names = dict.fromkeys(rows[0]) if rows else {}
    names |= dict.fromkeys(name for row in rows for name in row if _LAW_SECTION in name)
    lines = []
    for name in names:
        if any(row.get(name) != rows[0].get(name) for row in rows):
            # A recording without parameters leaves its values unknown.
            texts = [value_text(row.get(name)) if row else "not known" for row in rows]
            texts = [
                f"{label} {text}"
                for label, text in zip(labels or [""] * len(texts), texts, strict=True)
            ]
            unit = files.known_parameters()[name].unit.replace("exponent", "n")
            lines.append(f"{name}: {join.join(map(str.strip, texts))} {unit}".strip())
    return lines


def _values_in_use(parameters: Parameters) -> dict[str, Any]:
    """Return the parameters that the result depends on, by name."""
    law = parameters.contact
    left_out = (_LAW_SECTION, f"{LATERAL}.", *NOT_OF_THE_RESULT)
    values = {
        name: value
        for name, value in files.flat_parameters(parameters).items()
        if not name.startswith(left_out)
    }
    values[f"{_LAW_SECTION}law"] = law.law
    values |= {_LAW_SECTION + name: value for name, value in law_constants(law).items()}
    values[f"{_LAW_SECTION}allow_tension"] = law.allow_tension
    return values


class ReportRun(NamedTuple):
    """TimeSeries of answers of a compartment, and how it was computed."""

    name: str
    """Name of the recording"""
    label: str
    """Label of the run: the recording's name, or for a comparison the names of its parameter files"""
    source: Path
    """Recording or bag"""
    topic: str
    """Topic of the answers"""
    parameters: Parameters
    origin: str
    """Sentence on what computed the answers, with which parameters"""
    refused: Mapping[str, int]
    """Number of refused samples by reason"""
    damage: Sequence[str]
    """Damage of the source, as sentences"""
    gathered: Gathered
    model: KneeModel | None = None
    """Model to draw the knee with; None: its parameters are unknown, or files that they name are missing"""
    beside: int | None = None
    """Index of the run whose inputs this comparison uses; None: this run is not a comparison"""
    known: bool = True
    """Whether the parameters are the recording's own rather than assumed"""
    kept: Sequence[str] = ()
    """Parameters that a comparison takes from its run although its files set other values, as texts"""
    gait: str = ""
    """Name of the bag with the inputs of a recording; empty: it is the source, or not known"""
    ringing: Ringing | None = None
    """Ringing of the contact force; None: not known"""
    uncertain: Propagated | None = None
    """Uncertainty of depth and force, if requested"""

    @property
    def weight(self) -> float:
        """Body weight [N]."""
        return self.parameters.body_weight

    @property
    def has_bone(self) -> bool:
        """Whether the contact law has a second layer, the bone."""
        return self.parameters.contact.law.startswith("two_layer")

    @property
    def is_hinge(self) -> bool:
        """Whether the femur turns about a fixed axis, so that its sliding is that of the angle alone."""
        return MECHANISMS[self.parameters.translation.mechanism] is MECHANISMS["hinge"]

    @property
    def prescribed(self) -> bool:
        """Whether the femoral height is prescribed instead of the load."""
        return self.parameters.drive == "displacement"


def collect(options: ReportOptions, work: Path, bar: Bar) -> list[ReportRun]:
    """Gather the runs, each followed by its comparisons; bags are solved into files in the folder `work`.

    Raises:
        UsageError: a file or its parameters cannot be used.
    """
    compared = comparison_values(options.compare) if options.compare else {}
    people = {path: Subject(path) for path in options.files if path.suffix in _YAML}
    stems = list(options.labels) or [
        (people[path].content.name if path in people else "") or path.stem
        for path in options.files
    ]
    runs: list[ReportRun] = []
    with ExitStack() as opened:
        bags = {
            path: opened.enter_context(Bag(_gait_of(people[path]) if path in people else path))
            for path in options.files
        }
        topics = {path: answer_topics(bag) for path, bag in bags.items()}
        stored = {
            path: _provenance(bag, options) if topics[path] else None for path, bag in bags.items()
        }
        if options.parameters_given and all(stored.values()):
            raise UsageError(
                "--params is for bags, and every FILE is a recording with its parameters; see --compare"
            )
        for number, (path, stem) in enumerate(zip(options.files, stems, strict=True)):
            label = stem
            if stems.count(stem) > 1:
                label = f"{stem} ({stems[: number + 1].count(stem)})"
            bag = bags[path]
            own = [path] if path in people else []
            parameters = [*options.parameters, *own]
            assumed = parameters_for(bag, parameters)
            if own and stored[path]:
                raise UsageError(
                    f"subject file {path}: bag {bag.path} is a recording with its own parameters; give it as a FILE"
                )
            whole = options._replace(parameters=parameters)
            source = _Source(bag, label, topics[path], stored[path], assumed, whole, work, bar)
            for run, comparison in source.read_runs(compared):
                runs.append(run)
                if comparison:
                    runs.append(comparison._replace(beside=len(runs) - 1))
    return runs


def _gait_of(person: Subject) -> Path:
    """Return the bag that a subject file names.

    Raises:
        UsageError: it names none.
    """
    if person.bag is None:
        raise UsageError(f"subject file {person.path}: bag: is missing; a report needs the gait")
    return person.bag


class _Source(NamedTuple):
    """File of a report."""

    bag: Bag
    label: str
    topics: Sequence[str]
    """Topics of the answers in it; empty: it is a bag that must be solved"""
    stored: Provenance | None
    """How a recording was made, if it says so"""
    assumed: Parameters
    """Parameters for a file without its own"""
    options: ReportOptions
    work: Path
    """Folder for solved recordings"""
    bar: Bar

    def read_runs(
        self, compared: Mapping[str, Any]
    ) -> Iterator[tuple[ReportRun, ReportRun | None]]:
        """Read the runs of all knees in the file; each comes with its comparison, if there is one."""
        names_of_knees = sorted({knee_name(topic) for topic in self.topics}) or [KNEE]
        for knee in names_of_knees:
            topics = [topic for topic in self.topics if knee_name(topic) == knee]
            names = self.options.names if knee == KNEE else names_in_bag((), knee)
            runs = self._recorded(topics) if topics else self._solved_runs(names)
            uncertain: Sequence[Propagated | None] = [None, None]
            if self.options.uncertainty:
                self.bar.describe(f"Uncertainty of {self.bag.path.name}")
                gait = read_uncertain_gait(self.bag, self._basis, self.options.uncertainty, names)
                effects = gait.propagate(self.bar)
                uncertain = [effects.medial, effects.lateral]
            others = self._with_other_law(compared, names) if compared else []
            for run in runs:
                side = is_lateral(run.topic)
                name = self.label
                if len(names_of_knees) > 1:
                    name = f"{name} {run.topic.strip('/')}"
                elif max(len(runs), len(self.topics)) > 1:
                    name = f"{name} {LATERAL if side else MEDIAL}"
                named = run._replace(name=name, label=name, uncertain=uncertain[side])
                comparison = next(
                    (each for each in others if is_lateral(each.topic) == side), None
                )
                if comparison:
                    laws = " + ".join(each.name for each in self.options.compare)
                    comparison = comparison._replace(
                        name=name,
                        label=f"{name}, with {laws}",
                        topic=run.topic,
                        kept=_kept_values(run.parameters, compared),
                    )
                yield named, comparison

    @property
    def _basis(self) -> Parameters | Provenance:
        return self.stored or self.assumed

    def _recorded(self, topics: Sequence[str]) -> list[ReportRun]:
        """Read the answers of a recording."""
        self.bar.describe(f"Reading {self.bag.path.name}")
        if self.stored:
            origin = f"Recorded with {self.stored.package} and the parameters stored in it."
            if self.stored.changes:
                values = [each.values or {"a reset": ""} for each in self.stored.changes]
                what = [" ".join(map(str, one)).strip() for each in values for one in each.items()]
                origin += f" Meanwhile: {', '.join(dict.fromkeys(what))}."
        else:
            given = _source_names(self.options.parameters)
            origin = f"Recorded without its parameters; {given} is taken for body weight and law."
            if doubt := self._doubt(topics[0]):
                warn([doubt])
                origin += f" {doubt}."
        runs = [_read_run(self.bag, topic, self._basis, self.bar) for topic in topics]
        gait = str((self.bag.first_metadata(PROVENANCE) or {}).get("source", ""))
        return [run._replace(origin=origin, gait=gait) for run in runs]

    def _doubt(self, topic: str) -> str:
        """Sentence that the parameters are not those of the recorded answers."""
        own, texts = compartment_of_topic(topic, self.assumed, file_contents(self.assumed))
        return doubt_of(self.bag, topic, build_model(own, curves=texts))

    def _solved_runs(self, names: Names) -> list[ReportRun]:
        """Solve a bag."""
        given = _source_names(self.options.parameters)
        doubts = "".join(f" {each}." for each in weight_doubt(self.bag, self.assumed))
        return self._solve(self._basis, names, f"{_COMPUTED} with {given}.{doubts}")

    def _with_other_law(self, compared: Mapping[str, Any], names: Names) -> list[ReportRun]:
        """Compute the answers again with the contact law of the comparison's files."""
        law = {name: value for name, value in compared.items() if name.startswith(_LAW_SECTION)}
        basis: Parameters | Provenance
        if self.stored:
            basis = with_values(self.stored._replace(changes=()), law)
        else:
            basis = files.load_parameters([files.flat_parameters(self.assumed), law])
        inputs = f"the inputs of “{self.label}” with its parameters"
        given = _source_names(self.options.compare)
        origin = f"{_COMPUTED}: {inputs}, except for the contact law of {given}."
        return self._solve(basis, names, origin)

    def _solve(self, basis: Parameters | Provenance, names: Names, origin: str) -> list[ReportRun]:
        """Solve the file into a recording; return a run for each compartment, the medial one first."""
        self.bar.describe(f"Solving {self.bag.path.name}")
        recording = self.work / "solved.mcap"
        summary = solve(self.bag, basis, recording, self.bar, overwrite=True, names=names)
        topic = f"/{KNEE_CONTACT}"
        runs = []
        with Bag(recording) as solved:
            made = read_provenance(solved) or basis
            for suffix, each in (("", summary), (f"/{LATERAL}", summary.lateral)):
                if each:
                    run = _read_run(solved, topic + suffix, made, self.bar)
                    run.gathered.doubts.axes = each.doubts.axes
                    damage = tuple(summary.damage)
                    runs.append(run._replace(source=self.bag.path, origin=origin, damage=damage))
        recording.unlink()
        return runs


def _provenance(bag: Bag, options: ReportOptions) -> Provenance | None:
    """Return the provenance of a recording; None for a later part without parameters, if the user gave some."""
    try:
        return read_provenance(bag)
    except UsageError:
        if options.parameters_given:
            return None
        raise


def _source_names(sources: Sequence[GivenParameters]) -> str:
    """Return names of parameter files, and values as on the command line."""
    texts = []
    for source in sources:
        if isinstance(source, Path):
            texts.append(source.name)
        else:
            texts += [f"{name}:={value}" for name, value in source.items()]
    return ", ".join(texts)


def _read_run(bag: Bag, topic: str, basis: Parameters | Provenance, bar: Bar) -> ReportRun:
    """Read a recording's answers, with patch and pressure if one known model computed all of them."""
    stored = basis if isinstance(basis, Provenance) else None
    model: KneeModel | None = None
    try:
        own, texts = compartment_of_topic(topic, resolved_parameters(basis), file_contents(basis))
        model = build_model(own, curves=texts)
    except UsageError:  # a file that the parameters name is missing
        own, _ = compartment_of_topic(topic, resolved_parameters(basis), {})
    doubts = doubts_about(own, model, is_lateral(topic)) if model else Doubts()
    doubts.about_import = bag.doubts
    doubts.inputs.load_driven = own.drive != "displacement"
    has_readouts = stored and not stored.changes and model and model.patch
    ringing = Ringing(model) if model and stored and not stored.changes else None
    parts: dict[str, list[NDArray[Any]]] = {name: [] for name in ANSWER_FIELDS}
    for block in answer_blocks(bag, topic, bar):
        for name in ANSWER_FIELDS:
            parts[name].append(block.view(FLAT)[name].copy())
        if ringing:
            parts.setdefault("ringing", []).append(ringing.add_answers(block))
        if model and has_readouts:
            read = model.readouts(block)
            for name in READOUTS_OF_LAW:
                parts.setdefault(name, []).append(np.asarray(read[name]))
    columns = {name: np.concatenate(several) for name, several in parts.items()}
    gathered = Gathered(columns, own.body_weight, doubts, bag.gait_events)
    try:
        refused = refused_samples(bag)
    except ValueError:
        refused = Counter()
    return ReportRun(
        "",
        "",
        bag.path,
        topic,
        own,
        "",
        refused,
        stored.damage if stored else (),
        gathered,
        model if stored else None,
        known=stored is not None,
        ringing=ringing,
    )

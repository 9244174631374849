"""The runs of a report: recordings with answers, bags solved for it, and comparisons with other contact laws.

Of each run, what figures and tables need is gathered from all of its answers, which are held in memory meanwhile.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros import __version__
from knee_contact_ros.bags.provenance import NOT_OF_THE_RESULT, Provenance, read_provenance, with_values
from knee_contact_ros.bags.reader import OWN_NAMES, Names, answer_blocks, answer_topics, names_in_bag
from knee_contact_ros.lab.uncertainty import Propagated, deviations_of, given_in, propagated, read_deviations
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.readouts import SPREAD
from knee_contact_ros.model.types import FLAT, ContactState, Fidelity, Status
from knee_contact_ros.offline.solve import parameters_for, solve, weight_doubt
from knee_contact_ros.offline.summary import read_refused
from knee_contact_ros.parameters import files
from knee_contact_ros.parameters.build import build_model, material_stiffness
from knee_contact_ros.parameters.files import curve_texts
from knee_contact_ros.parameters.schema import Parameters, constants_of, has_both
from knee_contact_ros.streams.contact_stream import answering
from knee_contact_ros.streams.gait_events import GAP, HEEL_STRIKE, LOAD_PEAK, TOE_OFF, GaitEvent, GaitEvents
from knee_contact_ros.streams.strides import Span, at_stamps, cut, integral, loading_rate, sliding_distance, spans
from knee_contact_ros.streams.topics import KNEE, KNEE_CONTACT, LATERAL, MEDIAL, NANOSECONDS, is_lateral, knee_name
from knee_contact_ros.streams.watch import Doubts, doubts_about
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import parameter_file, refuse_twice
from knee_contact_ros.system.terminal import Bar

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
Advance = Callable[[int, int], None]
Source = Path | dict[str, Any]
"""Source of parameters: a file, or values by name"""
MM, MEGA = 1e3, 1e-6
PERCENT = np.arange(101.0)

"""Percent of the gait cycle at which curves are given, shape (101,)"""
CURVES = ("flexion_angle", "load", "contact_force", "penetration_depth", "contact_point_x", "bone_depth",
          "sliding_velocity", *SPREAD)  # fmt: skip
"""Fields of the answers, and readouts, that become curves over the gait cycle"""
FIELDS = (*CURVES[: -len(SPREAD)], "gap", "stamp", "error_estimate", "force_error_estimate", "femoral_height",
          "contact_state", "fidelity", "status", "evaluations")  # fmt: skip
"""Fields of the answers that are kept"""
MOMENT = ("load", "contact_force", "penetration_depth", "force_error_estimate", "error_estimate", "flexion_angle",
          "femoral_height")  # fmt: skip
"""Fields of the answers at a moment, in the order of the fields of `Moment`"""
LARGEST = {"load": "largest load", "contact_force": "largest contact force"}
"""Name of the moment at which a field is largest, by the field"""
NUMBERS = (
    "duration_s", "stance_percent", "sliding_distance_mm", "largest_sliding_velocity_mm_per_s",
    "largest_contact_force_N", "largest_penetration_depth_mm", "impulse_N_s", "stance_impulse_N_s",
    "loading_rate_N_per_s", "bone_contact_s", "lifted_off_s", "largest_patch_half_width_mm",
    "largest_mean_pressure_MPa", "largest_peak_pressure_MPa", "largest_cartilage_strain_percent",
)  # fmt: skip
"""Names of a cycle's characteristic values in strides.csv, with their units"""
FOR_PAGE = ("force_at_percent", "depth_at_percent", "bone_contact_percent")
"""Names of those that the page alone has: percent of the cycle"""
FIRST, SECOND = "first", "second"
BUCKETS, FIRST_WIDTH = 2000, 5_000_000
"""Most buckets of time in a course, more than a picture has pixels, and their least width [ns]"""
SECTION = "contact."
NONE, UNKNOWN = "–", "not told"
"""Texts for a constant that a law does not have, and for a value that is unknown as a recording has no parameters"""


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


class Moment(NamedTuple):
    """Gait event, or another moment, with the contact at it."""

    event: GaitEvent
    elapsed: float
    """Time [s] since the run's first tick, by the stamps; where these went back, as if the run had gone on at once"""
    load: float
    """Load [N], > 0 in compression"""
    contact_force: float
    """Contact force [N]"""
    penetration_depth: float
    """Penetration depth [m], >= 0 in overlap"""
    force_error: float
    """Estimated error of the contact force [N]; NaN if the recording has none"""
    depth_error: float
    """Estimated error of the penetration depth [m]"""
    flexion_angle: float
    """Flexion angle [rad], positive in flexion"""
    femoral_height: float
    """Height of the femur over the tibia [m]"""
    implausible: bool = False
    """Whether the answer is `IMPLAUSIBLE`"""
    cycle: int | None = None
    """Of a load peak, index of the gait cycle in which it lies; None: in no whole cycle"""
    percent: float | None = None
    """Of a load peak, percent of that cycle"""
    which: str = ""
    """`FIRST` or `SECOND` for the largest load peak in the first or second half of a stance; else empty"""


class Cycle(NamedTuple):
    """A gait cycle, from heel strike to heel strike."""

    span: Span
    curves: Floats
    """Values of `CURVES` at every percent, in SI units, shape (101, `CURVES`)"""
    numbers: dict[str, float]
    """Characteristic values by `NUMBERS` and `FOR_PAGE`; NaN: not known"""


class Gathered:
    """Totals, moments, gait cycles and the course over time of a run."""

    def __init__(
        self, columns: Mapping[str, NDArray[Any]], body_weight: float, doubts: Doubts, of_largest: str = "load"
    ) -> None:
        """Gather them from answers.

        Args:
            columns: fields of the answers, shape (n,), n >= 1 each: `FIELDS`, and `SPREAD` where the model is known.
            body_weight: body weight [N].
            doubts: doubts about the run's parameters, to which those about its answers are added.
            of_largest: field of which the largest value is looked for, one of `LARGEST`.
        """
        self.columns, self.body_weight, self.doubts, self.of_largest = columns, body_weight, doubts, of_largest
        self.reads_off = SPREAD[0] in columns
        """Whether patch and pressure of the contact are known"""
        stamps, status = columns["stamp"], columns["status"].astype(np.int64)
        doubts.add_all({**columns, "status": status})
        steps = np.diff(stamps, prepend=stamps[0])
        self.elapsed: Stamps = stamps - stamps[0] - np.cumsum(np.minimum(steps, 0))
        """Time [ns] since the first tick, see `Moment.elapsed`"""
        anew = (steps <= 0) | (steps > GAP) | ((status & Status.TIME_RESET) != 0)
        starts = [0, *(np.flatnonzero(anew[1:]) + 1).tolist()]
        """Beginnings of the parts without a gap and without a reset"""
        seconds = steps / NANOSECONDS
        seconds[starts] = 0.0
        self.ticks = len(stamps)
        self.time = float(seconds.sum())
        """Duration [s] without gaps"""
        self.flagged = Counter({bit.name or "": n for bit in Status if (n := int(np.count_nonzero(status & bit)))})
        """Number of ticks by the name of each status bit that they have"""
        self.flagged_otherwise = int(np.count_nonzero(status & ~int(Status.NOT_CONVERGED)))
        levels = zip(*np.unique(columns["fidelity"], return_counts=True), strict=True)
        self.levels = {Fidelity(int(level)).name.lower(): int(count) for level, count in levels}
        """Number of ticks by the model level that computed them"""
        apart = columns["contact_state"] == ContactState.SEPARATED
        groups = np.flatnonzero(np.diff(apart, prepend=~apart[:1]))
        self.bone_time = float(seconds[columns["contact_state"] == ContactState.BONE].sum())
        self.apart_time = float(seconds[apart].sum())
        self.longest_apart = float(np.add.reduceat(seconds, groups)[apart[groups]].max(initial=0.0))
        """Longest uninterrupted duration without contact [s]"""
        self.moments: list[Moment] = []
        self.cycles: list[Cycle] = []
        self.peaks: list[Moment] = []
        """Peaks of the load in stance, in the order of time"""
        self.strikes = 0
        """Number of heel strikes that another one followed, which is that of cycles if all of them were plausible"""
        for begin, end in zip(starts, [*starts[1:], len(stamps)], strict=True):
            self._walk(begin, end)
        self.moments.sort(key=lambda moment: moment.elapsed)
        wanted = np.nan_to_num(columns[of_largest], nan=-np.inf)
        at = int(wanted.argmax())
        self.largest = self._moment(GaitEvent(int(stamps[at]), LARGEST[of_largest], ""), at)
        """Moment at which the field `of_largest` is largest"""
        curves = np.array([cycle.curves for cycle in self.cycles]).reshape(-1, len(PERCENT), len(CURVES))
        self.mean: Floats = curves.mean(axis=0) if len(curves) else np.empty((0, len(CURVES)))
        """Mean curves over the cycles, shape (101, `CURVES`); without cycles empty"""
        self.deviation: Floats | None = curves.std(axis=0, ddof=1) if len(curves) > 1 else None
        """Sample standard deviation over the cycles (n - 1); None for a single cycle"""

    def course(self) -> tuple[int, Floats, dict[str, tuple[Floats, Floats]]]:
        """Return the course over time in buckets: their width [ns], their first times [s], smallest and largest values.

        The values are those of flexion angle, contact force and penetration depth.
        """
        width = FIRST_WIDTH
        while self.elapsed[-1] // width >= BUCKETS:
            width *= 2
        _, begins = np.unique(self.elapsed // width, return_index=True)
        ranges = {
            name: (np.minimum.reduceat(self.columns[name], begins), np.maximum.reduceat(self.columns[name], begins))
            for name in ("flexion_angle", "contact_force", "penetration_depth")
        }
        return width, self.elapsed[begins] / NANOSECONDS, ranges

    def _walk(self, begin: int, end: int) -> None:
        """Find events and cycles in the ticks from index `begin` to `end`, which have no gap."""
        part = slice(begin, end)
        stamps, finder = self.columns["stamp"][part], GaitEvents(self.body_weight)
        events = finder.add(stamps, self.columns["flexion_angle"][part], self.columns["load"][part]) + finder.finish()
        known = len(self.cycles)
        moments = [
            self._moment(event, begin + max(int(np.searchsorted(stamps, event.stamp, "right")) - 1, 0))
            for event in sorted(events, key=lambda event: event.stamp)
        ]
        self.moments += moments
        strikes, toe_offs = (
            sorted(event.stamp for event in events if event.kind == kind) for kind in (HEEL_STRIKE, TOE_OFF)
        )
        self.strikes += max(len(strikes) - 1, 0)
        for span in spans(strikes, toe_offs):
            if stamps[0] <= span.start:
                first = begin + int(np.searchsorted(stamps, span.start, "right")) - 1
                last = begin + int(np.searchsorted(stamps, span.end))
                self.cycles.append(_cycle(self.columns, slice(first, min(last + 1, end)), span))
        for peak in _peaks(moments, self.cycles[known:]):
            self.peaks.append(peak if peak.cycle is None else peak._replace(cycle=known + peak.cycle))

    def _moment(self, event: GaitEvent, at: int) -> Moment:
        """Return an event with the contact at the tick with index `at`."""
        elapsed = (int(self.elapsed[at]) + event.stamp - int(self.columns["stamp"][at])) / NANOSECONDS
        values: Any = (float(self.columns[name][at]) for name in MOMENT)
        implausible = bool(int(self.columns["status"][at]) & Status.IMPLAUSIBLE)
        return Moment(event, elapsed, *values)._replace(implausible=implausible)


def _cycle(columns: Mapping[str, NDArray[Any]], ticks: slice, span: Span) -> Cycle:
    """Bring the ticks of a cycle to percent, and compute its characteristic values."""
    stamps, unknown = columns["stamp"][ticks], np.full(len(columns["stamp"][ticks]), np.nan)
    values = np.column_stack(
        [*(columns[name][ticks] if name in columns else unknown for name in CURVES), columns["contact_state"][ticks]]
    )
    percents = span.start + np.round((span.end - span.start) * PERCENT / 100.0).astype(np.int64)
    curves = at_stamps(stamps, values, percents, 1)[:, :-1]  # the state is held between ticks
    time, cycle = cut(stamps, values, span.start, span.end, 1)
    stance_time, stance = cut(stamps, values, span.start, span.toe_off, 1)
    force, depth, sliding = (
        cycle[:, CURVES.index(name)] for name in ("contact_force", "penetration_depth", "sliding_velocity")
    )
    stance_force, state = stance[:, CURVES.index("contact_force")], cycle[:, -1]
    steps = np.diff(time)
    most = dict(zip(CURVES, cycle[:, :-1].max(axis=0).tolist(), strict=True))
    touching, bone = state != ContactState.SEPARATED, float(steps[state[1:] == ContactState.BONE].sum())
    numbers = (
        span.duration, span.stance, MM * sliding_distance(time, sliding, state),
        MM * float(np.abs(sliding[touching]).max(initial=0.0)), most["contact_force"], MM * most["penetration_depth"],
        integral(time, force), integral(stance_time, stance_force), loading_rate(stance_time, stance_force),
        bone, float(steps[~touching[1:]].sum()), MM * most["half_width"],
        MEGA * most["mean_pressure"], MEGA * most["peak_pressure"], 100.0 * most["strain"],
        *(100.0 * float(part) / span.duration for part in (time[force.argmax()], time[depth.argmax()], bone)),
    )  # fmt: skip
    return Cycle(span, curves, dict(zip(NUMBERS + FOR_PAGE, numbers, strict=True)))


def _peaks(moments: Sequence[Moment], cycles: Sequence[Cycle]) -> list[Moment]:
    """Return the load peaks with their cycles, and which of them are the first and the second of a stance."""
    starts = np.array([cycle.span.start for cycle in cycles], dtype=np.int64)
    peaks: list[Moment] = []
    largest: dict[tuple[int, str], int] = {}
    for moment in moments:
        peak, stamp = moment, moment.event.stamp
        if moment.event.kind != LOAD_PEAK:
            continue
        number = int(np.searchsorted(starts, stamp, "right")) - 1
        if number >= 0 and stamp < (span := cycles[number].span).end:
            peak = peak._replace(cycle=number, percent=span.percent(stamp))
            if stamp < span.toe_off:
                half = number, FIRST if 2 * stamp < span.start + span.toe_off else SECOND
                if half not in largest or peak.load > peaks[largest[half]].load:
                    largest[half] = len(peaks)
        peaks.append(peak)
    for (_, which), index in largest.items():
        peaks[index] = peaks[index]._replace(which=which)
    return peaks


def overlay(paths: Sequence[Path]) -> dict[str, Any]:
    """Read the parameter files of a comparison: their values by dotted name, of which the last one wins.

    Raises:
        UsageError: a file cannot be used, is given twice, or sets nothing of the contact law.
    """
    everything: dict[str, Any] = {}
    refuse_twice(list(map(parameter_file, map(str, paths))), "--compare ")
    for path in paths:
        values = files.values_set_in(path)
        if not any(name.startswith(SECTION) for name in values):
            raise UsageError(
                f"--compare {path}: sets no {SECTION}* parameter, and a comparison changes these alone; to compare "
                "something else, solve with each and report both recordings"
            )
        everything |= values
    return {name: value for name, value in everything.items() if name in files.known_parameters()}


def kept(parameters: Parameters, over: Mapping[str, Any]) -> list[str]:
    """List the values that a run keeps although the comparison's files have others: `body_weight 931.6 (not 737)`."""
    own = files.all_values(parameters)
    return [
        f"{name} {short(own[name])} (not {short(value)})"
        for name, value in over.items()
        if not name.startswith((SECTION, *NOT_OF_THE_RESULT)) and own[name] != value
    ]


def short(value: Any) -> str:
    """Text of a parameter's value, with six significant digits."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else NONE if value is None or value == "" else str(value)


def between(several: Sequence[Parameters | None], join: str = ", ") -> list[str]:
    """Differences of the parameters of several runs, a line for each name: `body_weight: 737.068, 931.6 N`.

    Of a contact law these are the constants that it uses. None: parameters that nobody knows. A lateral compartment is
    a run of its own, with its parameters under the names of the medial one's.
    """
    rows = []
    for each in several:
        row: dict[str, Any] = {}
        if each:
            law, left_out = each.contact, (SECTION, f"{LATERAL}.", *NOT_OF_THE_RESULT)
            row = {name: own for name, own in files.flat_parameters(each).items() if not name.startswith(left_out)}
            computed: Mapping[str, Any] = material_stiffness(law) if law.stiffness_from == "material" else {}
            used = {name: computed.get(name, getattr(law, name)) for name in constants_of(law.law)}
            used = {"law": law.law, **used, "allow_tension": law.allow_tension}
            row |= {SECTION + name: value for name, value in used.items()}
        rows.append(row)
    lines = []
    for name in dict.fromkeys(name for place, row in enumerate(rows) for name in row if not place or SECTION in name):
        if any(row.get(name) != rows[0].get(name) for row in rows):
            meaning = files.known_parameters()[name].description
            unit = f" {meaning[1 : meaning.index(']')].replace('exponent', 'n')}" if meaning.startswith("[") else ""
            lines.append(f"{name}: {join.join(short(row.get(name)) if row else UNKNOWN for row in rows)}{unit}")
    return lines


class Run(NamedTuple):
    """Series of answers of a compartment, and how it was computed."""

    name: str
    """Name of the recording"""
    label: str
    """Label of the run: the recording's name, and of a comparison the names of its parameter files"""
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
    gathered: Gathered
    model: KneeModel | None = None
    """Model to draw the knee with; None: its parameters are not known, or files that they name are missing"""
    beside: int | None = None
    """Index of the run with whose inputs this comparison was computed; None: this run is no comparison"""
    known: bool = True
    """Whether the parameters are the recording's own, and not assumed"""
    differences: Sequence[str] = ()
    """Differences of a comparison's contact law from that of its run, as texts"""
    kept: Sequence[str] = ()
    """Parameters that a comparison keeps of its run although its files have other values, as texts"""
    uncertain: Propagated | None = None
    """Uncertainty of depth and force, if the options ask for it"""


def collect(options: ReportOptions, work: Path, bar: Bar) -> list[Run]:
    """Gather the runs, each followed by its comparison; bags are solved into files in the folder `work`.

    Raises:
        UsageError: a file or its parameters cannot be used.
    """
    own: list[Run] = []
    over = overlay(options.compare) if options.compare else None
    recorded = {path: answer_topics(path) for path in options.files}
    if options.parameters_given and all(topics and _stored(path, options) for path, topics in recorded.items()):
        raise UsageError("--params is for bags, and every FILE is a recording with its parameters; see --compare")
    for number, path in enumerate(options.files):
        label = options.labels[number] if options.labels else path.stem
        for topic in recorded[path]:
            several = len(recorded[path]) > 1
            own.append(
                _recorded(path, topic, f"{label} {_which(topic, recorded[path])}" if several else label, options, bar)
            )
        own += [] if recorded[path] else _solved(path, label, options, work, bar)
    own = _numbered(own)
    if over is None:
        return own
    runs: list[Run] = []
    for run in own:
        runs += [run, _compared(run, len(runs), over, options, work, bar)]
    return runs


def prescribed(parameters: Parameters) -> bool:
    """Whether the femoral height is prescribed, and no load drives."""
    return parameters.drive == "displacement"


def _which(topic: str, topics: Sequence[str]) -> str:
    """Distinguish the answers on a topic from those on others of a recording: by the topic, or by the compartment."""
    if len({knee_name(other) for other in topics}) > 1:
        return topic.strip("/")
    return LATERAL if is_lateral(topic) else MEDIAL


def _recorded(path: Path, topic: str, label: str, options: ReportOptions, bar: Bar) -> Run:
    """Gather the answers on a topic of a recording, as they are."""
    provenance = _stored(path, options)
    if provenance:
        parameters = provenance.parameters
        origin = f"Recorded with {provenance.package} and the parameters stored in it."
        if provenance.changes:
            origin += f" They changed, or the model was reset, {len(provenance.changes)} times meanwhile."
    else:
        parameters = files.load_parameters(list(options.parameters))
        origin = f"Recorded without its parameters; {_spelled(options.parameters)} is taken for body weight and law."
    parameters, model = _model(topic, parameters, provenance)
    doubts = doubts_about(parameters, model) if model else Doubts()
    bar.describe(f"Reading {path.name}")
    reads_off = model if provenance and not provenance.changes else None
    gathered = _gathered(path, topic, parameters, doubts, reads_off, bar)
    try:
        refused = read_refused(path)
    except (OSError, ValueError):
        refused = Counter()
    damage, drawn = (provenance.damage, model) if provenance else ((), None)
    known = provenance is not None
    return Run(label, label, path, topic, parameters, origin, refused, damage, gathered, drawn, known=known)


def _solved(path: Path, label: str, options: ReportOptions, work: Path, bar: Bar) -> list[Run]:
    """Solve a bag that has inputs only; return a run for each compartment."""
    parameters = parameters_for(path, options.parameters)
    origin = f"Computed for this report by knee_contact_ros {__version__} with {_spelled(options.parameters)}."
    origin += "".join(f" {sentence}." for sentence in weight_doubt(path, parameters))
    runs = _computed(path, parameters, options.names, work, bar)
    labels = [f"{label} {name}" for name in (MEDIAL, LATERAL)] if len(runs) > 1 else [label]
    return [run._replace(name=name, label=name, origin=origin) for run, name in zip(runs, labels, strict=True)]


def _compared(run: Run, beside: int, over: Mapping[str, Any], options: ReportOptions, work: Path, bar: Bar) -> Run:
    """Compute a run's inputs with another contact law; person, surfaces and solver stay the same."""
    recorded, law = (
        _stored(run.source, options),
        {name: value for name, value in over.items() if name.startswith(SECTION)},
    )
    if recorded:  # it may hold the files that parameters name
        source: Parameters | Provenance = with_values(recorded._replace(changes=()), law)
    else:
        source = files.load_parameters([*options.parameters, law])
    origin = (
        f"Computed for this report by knee_contact_ros {__version__}: the inputs of “{run.name}” with its parameters, "
        f"but for the contact law of {_spelled(options.compare)}."
    )
    both = _computed(run.source, source, _names(run, options), work, bar)
    again = next(one for one in both if is_lateral(one.topic) == is_lateral(run.topic))
    return again._replace(
        name=run.name, label=f"{run.label}, {' + '.join(path.stem for path in options.compare)}", topic=run.topic,
        origin=origin, beside=beside, kept=kept(run.parameters, over),
        differences=between([run.parameters if run.known else None, again.parameters], " → "),
    )  # fmt: skip


def _names(run: Run, options: ReportOptions) -> Names:
    """Return the names of the inputs of a run's knee."""
    knee = knee_name(run.topic)
    return names_in_bag((), knee) if knee != KNEE else options.names


def _stored(path: Path, options: ReportOptions) -> Provenance | None:
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


def _computed(path: Path, source: Parameters | Provenance, names: Names, work: Path, bar: Bar) -> list[Run]:
    """Solve a bag by way of a file in `work`; return a run for each compartment, the medial one first."""
    provenance = source if isinstance(source, Provenance) else None
    recording, parameters = work / "solved.mcap", source.parameters if isinstance(source, Provenance) else source
    bar.describe(f"Solving {path.name}")
    summary = solve(path, source, recording, bar, overwrite=True, names=names)
    runs = []
    for topic, compartment in ((f"/{KNEE_CONTACT}", summary), (f"/{KNEE_CONTACT}/{LATERAL}", summary.lateral)):
        if compartment:
            doubts = Doubts()
            doubts.go_on_with(compartment.doubts)
            doubts.axes = compartment.doubts.axes
            own, model = _model(topic, parameters, provenance)
            bar.describe(f"Reading what {path.name} gave")
            gathered = _gathered(recording, topic, own, doubts, model, bar)
            runs.append(Run("", "", path, topic, own, "", summary.refused, tuple(summary.damage), gathered, model))
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


def _gathered(
    path: Path, topic: str, parameters: Parameters, doubts: Doubts, model: KneeModel | None, advance: Advance
) -> Gathered:
    """Read a recording's answers; patch and pressure are read off where `model` computed all of them."""
    parts, read_off = {name: list[NDArray[Any]]() for name in FIELDS}, model if model and model.patch else None
    for block in answer_blocks(path, topic, advance):
        for name in FIELDS:
            parts[name].append(block.view(FLAT)[name].copy())
        if read_off:
            read = read_off.readouts(block)
            for name in SPREAD:
                parts.setdefault(name, []).append(np.asarray(read[name]))
    columns = {name: np.concatenate(several) for name, several in parts.items()}
    of_largest = "contact_force" if prescribed(parameters) else "load"
    return Gathered(columns, parameters.body_weight, doubts, of_largest)


def _numbered(runs: list[Run]) -> list[Run]:
    """Add a number to labels that several runs have; at this point a run's name is its label."""
    counts, seen = Counter(run.label for run in runs), Counter[str]()
    numbered = []
    for run in runs:
        seen[run.label] += 1
        label = f"{run.label} ({seen[run.label]})" if counts[run.label] > 1 else run.label
        numbered.append(run._replace(label=label, name=label))
    return numbered


def with_uncertainty(runs: Sequence[Run], options: ReportOptions, bar: Bar) -> Sequence[Run]:
    """Add the uncertainty to each run, if the options ask for it; comparisons get none.

    Raises:
        UsageError: file, names or deviations cannot be used, or a recording's parameters changed while it was made.
    """
    if options.uncertainty is None:
        return runs
    read, completed = read_deviations(options.uncertainty), []
    for run in runs:
        if is_lateral(run.topic) and not has_both(run.parameters):
            raise UsageError(
                f"recording {run.source} has answers of the lateral compartment and does not tell its parameters; "
                f"load.compartment of --params is {run.parameters.load.compartment}, and must be both"
            )
    known: dict[tuple[Path, str], list[Propagated]] = {}
    for run in runs:
        knee = run.source, knee_name(run.topic)
        if run.beside is None and knee not in known:
            basis = _stored(run.source, options) or files.load_parameters(list(options.parameters))
            deviations = deviations_of(read, basis.parameters if isinstance(basis, Provenance) else basis)
            bar.describe(f"Solving {run.source.name}")
            given = given_in(run.source, basis, bar, _names(run, options), replays=2 * len(deviations))
            bar.describe(f"Uncertainty of {run.source.name}")
            known[knee] = [_by_stamp(one) for one in propagated(given, deviations, bar)]
        completed.append(run if run.beside is not None else run._replace(uncertain=known[knee][is_lateral(run.topic)]))
    return completed


def _by_stamp(of: Propagated) -> Propagated:
    """Sort by stamps, which is the order of the ticks in recordings and in the rest of the report."""
    order = np.argsort(of.rows["stamp"], kind="stable")
    return Propagated(of.rows[order], {one: (depth[order], force[order]) for one, (depth, force) in of.parts.items()})

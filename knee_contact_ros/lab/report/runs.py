"""The runs of a report: recordings with answers, bags solved for it, and comparisons with other contact laws.

A bag is solved into a recording first, so all runs are read the same way. While a run's data for figures and tables are
gathered, all of its answers are in memory.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from knee_contact_ros import __version__
from knee_contact_ros.bags.provenance import (
    NOT_OF_THE_RESULT,
    Provenance,
    read_provenance,
    with_values,
)
from knee_contact_ros.bags.reader import (
    OWN_NAMES,
    Names,
    answer_blocks,
    answer_topics,
    names_in_bag,
)
from knee_contact_ros.lab.uncertainty import Propagated, propagated
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.readouts import SPREAD
from knee_contact_ros.model.types import FLAT, MM, ContactState, Floats, Status
from knee_contact_ros.offline.solve import (
    parameters_for,
    parameters_in,
    solve,
    texts_of,
    weight_doubt,
)
from knee_contact_ros.offline.summary import read_refused
from knee_contact_ros.parameters import files
from knee_contact_ros.parameters.build import build_model, material_stiffness
from knee_contact_ros.parameters.schema import Parameters, constants_of
from knee_contact_ros.streams.contact_pipeline import answering
from knee_contact_ros.streams.gait_events import GAP, HEEL_STRIKE, LOAD_PEAK, TOE_OFF, GaitEvents
from knee_contact_ros.streams.strides import Span, at_stamps, cut, spans, stride_of
from knee_contact_ros.streams.topics import (
    KNEE,
    KNEE_CONTACT,
    LATERAL,
    MEDIAL,
    NANOSECONDS,
    is_lateral,
    knee_name,
)
from knee_contact_ros.streams.watch import Doubts, doubts_about
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import check_distinct, parameter_file
from knee_contact_ros.system.progress import Bar

Source = Path | dict[str, Any]
"""Source of parameters: a file, or values by name"""
MEGA = 1e-6
PERCENT = np.arange(101.0)
"""Places of the curves in the gait cycle [%], shape (101,)"""


class Quantity(NamedTuple):
    """Quantity of the tables over the gait cycle, and of a figure if it has one."""

    field: str
    """Name of the field of the answers, or of the readout"""
    factor: float | None
    """Factor from SI units to the unit of the tables; None: a force in body weights"""
    figure: str = ""
    """Name of the figure's file, without the suffix; empty: there is none"""
    title: str = ""
    unit: str = ""
    """Unit on the figure's axis"""

    def scaled(self, values: Any, weight: float) -> Any:
        """Values in the unit of the tables, for a body weight [N]."""
        return values / weight if self.factor is None else self.factor * values


CURVES = {
    "flexion_angle_deg": Quantity(
        "flexion_angle", math.degrees(1.0), "flexion", "Flexion angle", "°"
    ),
    "load_N": Quantity("load", 1.0),
    "load_BW": Quantity("load", None),
    "contact_force_N": Quantity("contact_force", 1.0),
    "contact_force_BW": Quantity("contact_force", None, "contact_force", "Contact force", "BW"),
    "penetration_depth_mm": Quantity("penetration_depth", MM, "depth", "Penetration depth", "mm"),
    "bone_depth_mm": Quantity("bone_depth", MM),
    "contact_point_x_mm": Quantity("contact_point_x", MM, "contact_point", "Contact point", "mm"),
    "sliding_velocity_mm_per_s": Quantity("sliding_velocity", MM),
    "patch_half_width_mm": Quantity(
        "half_width", MM, "patch_half_width", "Patch half-width", "mm"
    ),
    "mean_pressure_MPa": Quantity("mean_pressure", MEGA),
    "peak_pressure_MPa": Quantity(
        "peak_pressure", MEGA, "peak_pressure", "Peak contact pressure", "MPa"
    ),
    "cartilage_strain_percent": Quantity("strain", 100.0),
}
"""Curves over the gait cycle, by their names in cycles.csv"""
CURVED = list(dict.fromkeys(each.field for each in CURVES.values()))
FIELDS = [
    *(field for field in CURVED if field not in SPREAD),
    "gap",
    "stamp",
    "error_estimate",
    "force_error_estimate",
    "femoral_height",
    "contact_state",
    "fidelity",
    "status",
    "evaluations",
]
"""Fields of the answers that are kept"""
AT_EVENTS = ("load_N", "load_BW", "contact_force_N", "contact_force_BW", "penetration_depth_mm")
"""Quantities of `CURVES` that are listed at events"""
EVENT_COLUMNS = ("event", "stamp_s", "time_s", *AT_EVENTS, "text")
PEAK_COLUMNS = (
    "peak",
    "stamp_s",
    "time_s",
    "cycle",
    "gait_cycle_percent",
    *AT_EVENTS,
    "contact_force_error_N",
    "penetration_depth_error_mm",
)
"""Columns of events.csv and peaks.csv, after the run's label"""
FIRST, SECOND = "first", "second"
SECTION = "contact."
NONE, UNKNOWN = "–", "not told"
"""Texts for a constant that a law does not have, and for a value that a recording without parameters leaves unknown"""


class ReportOptions(NamedTuple):
    """Options of the command `report`."""

    files: Sequence[Path]
    """Recordings and bags"""
    labels: Sequence[str]
    """Names of the files, one each; empty: they are named by their file names"""
    parameters: Sequence[Source]
    """Parameters for bags without answers and recordings without parameters; later ones override earlier ones"""
    parameters_given: bool
    """Whether the user gave these parameters, as opposed to the default"""
    compare: Sequence[Path]
    """Parameter files whose contact law is used to compute every file again; empty: no comparison"""
    names: Names = OWN_NAMES
    """Names of topics in bags"""
    uncertainty: Path | None = None
    """File of standard deviations of inputs and parameters; None: no uncertainty is computed"""


class Gathered:
    """Totals, gait events, gait cycles and their curves of a run."""

    def __init__(
        self, columns: Mapping[str, NDArray[Any]], body_weight: float, doubts: Doubts
    ) -> None:
        """Gather them from answers.

        Args:
            columns: fields of the answers, shape (n,), n >= 1 each: `FIELDS`, and `SPREAD` where the model is known.
            body_weight: body weight [N].
            doubts: doubts about the run's parameters, to which those about its answers are added.
        """
        self.columns, self.doubts = (
            {**columns, "status": columns["status"].astype(np.int64)},
            doubts,
        )
        stamps, status = columns["stamp"], self.columns["status"]
        doubts.add_all(self.columns)
        steps = np.diff(stamps, prepend=stamps[0])
        self.elapsed = stamps - stamps[0] - np.cumsum(np.minimum(steps, 0))
        """Time [ns] since the first tick by the stamps; where these go back, the run continues without a pause"""
        anew = (steps <= 0) | (steps > GAP) | ((status & Status.TIME_RESET) != 0)
        anew[0] = True
        self.seconds, self.ticks = np.where(anew, 0.0, steps / NANOSECONDS), len(stamps)
        """Time [s] of each tick since the one before, without gaps; number of ticks"""
        self.spans: list[Span] = []
        """Whole gait cycles, from heel strike to heel strike"""
        self.strikes = 0
        """Number of heel strikes that another one follows: that of cycles, if all cycles are plausible"""
        cycles, events = list[tuple[dict[str, Any], Floats]](), list[dict[str, Any]]()
        for begin, end in pairwise([*np.flatnonzero(anew).tolist(), len(stamps)]):
            part = {name: column[begin:end] for name, column in self.columns.items()}
            finder, own = GaitEvents(body_weight), part["stamp"]
            found = sorted(finder.add(own, part["flexion_angle"], part["load"]) + finder.finish())
            strikes, toe_offs = (
                [each.stamp for each in found if each.kind == kind]
                for kind in (HEEL_STRIKE, TOE_OFF)
            )
            self.strikes += max(len(strikes) - 1, 0)
            whole = [span for span in spans(strikes, toe_offs) if own[0] <= span.start]
            cycles += [_cycle(part, span) for span in whole]
            for event in found:
                at = max(int(np.searchsorted(own, event.stamp, "right")) - 1, 0)
                time = (int(self.elapsed[begin + at]) + event.stamp - int(own[at])) / NANOSECONDS
                row = {
                    "event": event.kind,
                    "stamp_s": seconds(event.stamp),
                    "time_s": time,
                    "text": event.text,
                    "peak": "",
                    "tick": begin + at,
                    "status": part["status"][at],
                    **{
                        name: CURVES[name].scaled(part[CURVES[name].field][at], body_weight)
                        for name in AT_EVENTS
                    },
                    "contact_force_error_N": part["force_error_estimate"][at],
                    "penetration_depth_error_mm": MM * part["error_estimate"][at],
                }
                for number, span in enumerate(whole, start=len(self.spans) + 1):
                    if event.kind == LOAD_PEAK and span.start <= event.stamp < span.end:
                        row |= {"cycle": number, "gait_cycle_percent": span.percent(event.stamp)}
                        if event.stamp < span.toe_off:
                            row["peak"] = (
                                FIRST if 2 * event.stamp < span.start + span.toe_off else SECOND
                            )
                events.append(row)
            self.spans += whole
        names = dict.fromkeys((*EVENT_COLUMNS, *PEAK_COLUMNS, "tick", "status"))
        self.events = pd.DataFrame(events, columns=[*names]).sort_values(
            "time_s", kind="stable", ignore_index=True
        )
        """Gait events in the order of time, with the answers at them"""
        peaks = self.events[self.events["event"] == LOAD_PEAK]
        largest = peaks[peaks["peak"] != ""].groupby(["cycle", "peak"])["load_N"].idxmax()
        self.peaks = peaks.assign(peak=peaks["peak"].where(peaks.index.isin(largest), ""))
        """Peaks of the load; `peak` is `FIRST` or `SECOND` for the largest in the first or second half of a stance"""
        self.strides = pd.DataFrame([numbers for numbers, _ in cycles], columns=[*NUMBERS])
        self.strides.insert(0, "cycle", range(1, len(cycles) + 1))
        """Numbers of each cycle, `NUMBERS`, in the units of their names"""
        self.curves = dict(
            zip(
                CURVED,
                np.array([c for _, c in cycles]).reshape(-1, len(CURVED), 101).swapaxes(0, 1),
                strict=True,
            )
        )
        """Values of each of `CURVED` at every percent of every cycle, in SI units, shape (cycles, 101)"""

    @property
    def largest(self) -> int:
        """Tick of the largest load, or with prescribed femoral height of the largest contact force."""
        return int(np.nan_to_num(self.columns[self.driving], nan=-np.inf).argmax())

    @property
    def driving(self) -> str:
        """Field whose largest value is at `largest`."""
        return "load" if self.doubts.inputs.load_driven else "contact_force"


NUMBERS = (
    "heel_strike_s",
    "duration_s",
    "stance_percent",
    "sliding_distance_mm",
    "largest_sliding_velocity_mm_per_s",
    "largest_contact_force_N",
    "largest_penetration_depth_mm",
    "impulse_N_s",
    "stance_impulse_N_s",
    "loading_rate_N_per_s",
    "bone_contact_s",
    "lifted_off_s",
    "largest_patch_half_width_mm",
    "largest_mean_pressure_MPa",
    "largest_peak_pressure_MPa",
    "largest_cartilage_strain_percent",
)
"""Names of a cycle's characteristic values in strides.csv, with their units"""


def seconds(stamp: int) -> str:
    """Text of a stamp [ns] in seconds, with all its digits."""
    return f"{stamp // NANOSECONDS}.{stamp % NANOSECONDS:09d}"


def _cycle(columns: Mapping[str, NDArray[Any]], span: Span) -> tuple[dict[str, Any], Floats]:
    """Return a cycle's characteristic values, `NUMBERS`, NaN where unknown, and its curves, shape (`CURVED`, 101)."""
    first, last = np.searchsorted(columns["stamp"], (span.start, span.end))
    near = {name: column[max(first - 1, 0) : last + 1] for name, column in columns.items()}
    stamps, stride, unknown = (
        near["stamp"],
        stride_of(span, near),
        np.full(len(near["stamp"]), np.nan),
    )
    values = np.column_stack(
        [*(near.get(name, unknown) for name in CURVED), near["contact_state"]]
    )
    percents = span.start + np.round((span.end - span.start) * PERCENT / 100.0).astype(np.int64)
    time, cycle = cut(stamps, values, span.start, span.end)
    steps, state = np.diff(time), cycle[:, -1]
    most = dict(zip(CURVED, cycle[:, :-1].max(axis=0).tolist(), strict=True))
    speed = np.abs(cycle[:, CURVED.index("sliding_velocity")])[
        state != ContactState.SEPARATED
    ].max(initial=0.0)
    apart, bone = (
        float(steps[state[1:] == each].sum())
        for each in (ContactState.SEPARATED, ContactState.BONE)
    )
    numbers = (
        seconds(span.start),
        span.duration,
        span.stance,
        MM * stride.sliding_distance,
        MM * float(speed),
        stride.peak_force,
        MM * stride.peak_depth,
        stride.impulse,
        stride.stance_impulse,
        stride.loading_rate,
        bone,
        apart,
        MM * most["half_width"],
        MEGA * most["mean_pressure"],
        MEGA * most["peak_pressure"],
        100.0 * most["strain"],
    )
    return dict(zip(NUMBERS, numbers, strict=True)), at_stamps(stamps, values, percents)[:, :-1].T


def overlay(paths: Sequence[Path]) -> dict[str, Any]:
    """Read the parameter files of a comparison: values by dotted name, later files overriding earlier ones.

    Raises:
        UsageError: a file cannot be used, is given twice, or sets no parameter of the contact law.
    """
    everything: dict[str, Any] = {}
    check_distinct(list(map(parameter_file, map(str, paths))), "--compare ")
    for path in paths:
        values = files.values_set_in(path)
        if not any(name.startswith(SECTION) for name in values):
            raise UsageError(
                f"--compare {path}: sets no {SECTION}* parameter, but a comparison changes only these; to compare "
                "something else, solve with each and report both recordings"
            )
        everything |= values
    return {name: value for name, value in everything.items() if name in files.known_parameters()}


def kept(parameters: Parameters, over: Mapping[str, Any]) -> list[str]:
    """List values that a run keeps although the comparison's files set others: `body_weight 931.6 (not 737)`."""
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
    return (
        f"{value:.6g}"
        if isinstance(value, float)
        else NONE
        if value is None or value == ""
        else str(value)
    )


def between(several: Sequence[Parameters | None], join: str = ", ") -> list[str]:
    """Differences between the parameters of several runs, a line for each name: `body_weight: 737.068, 931.6 N`.

    Only constants that a contact law uses count. Parameters that are None are unknown. A lateral compartment is a run
    of its own, with its parameters under the medial names.
    """
    rows = []
    for each in several:
        row: dict[str, Any] = {}
        if each:
            law, left_out = each.contact, (SECTION, f"{LATERAL}.", *NOT_OF_THE_RESULT)
            row = {
                name: own
                for name, own in files.flat_parameters(each).items()
                if not name.startswith(left_out)
            }
            computed: Mapping[str, Any] = (
                material_stiffness(law) if law.stiffness_from == "material" else {}
            )
            used = {name: computed.get(name, getattr(law, name)) for name in constants_of(law.law)}
            used = {"law": law.law, **used, "allow_tension": law.allow_tension}
            row |= {SECTION + name: value for name, value in used.items()}
        rows.append(row)
    lines = []
    for name in dict.fromkeys(
        name for place, row in enumerate(rows) for name in row if not place or SECTION in name
    ):
        if any(row.get(name) != rows[0].get(name) for row in rows):
            unit = files.known_parameters()[name].unit.replace("exponent", "n")
            lines.append(
                f"{name}: {join.join(short(row.get(name)) if row else UNKNOWN for row in rows)} {unit}".strip()
            )
    return lines


class Run(NamedTuple):
    """Series of answers of a compartment, and how it was computed."""

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
    def prescribed(self) -> bool:
        """Whether the femoral height is prescribed instead of the load."""
        return self.parameters.drive == "displacement"


def collect(options: ReportOptions, work: Path, bar: Bar) -> list[Run]:
    """Gather the runs, each followed by its comparisons; bags are solved into files in the folder `work`.

    Raises:
        UsageError: a file or its parameters cannot be used.
    """
    over, runs = overlay(options.compare) if options.compare else {}, list[Run]()
    law = {name: value for name, value in over.items() if name.startswith(SECTION)}
    recorded = {path: answer_topics(path) for path in options.files}
    stored = {
        path: _stored(path, options) if topics else None for path, topics in recorded.items()
    }
    if options.parameters_given and all(stored.values()):
        raise UsageError(
            "--params is for bags, and every FILE is a recording with its parameters; see --compare"
        )
    stems = list(options.labels) or [path.stem for path in options.files]
    made, spelled = (
        f"Computed for this report by knee_contact_ros {__version__}",
        _spelled(options.parameters),
    )
    for number, (path, stem) in enumerate(zip(options.files, stems, strict=True)):
        label = f"{stem} ({stems[: number + 1].count(stem)})" if stems.count(stem) > 1 else stem
        own, assumed, several = (
            stored[path],
            parameters_for(path, options.parameters),
            recorded[path],
        )
        basis, knees = own or assumed, sorted({knee_name(topic) for topic in several})
        for knee in knees or [KNEE]:
            names = names_in_bag((), knee) if knee != KNEE else options.names
            if topics := [topic for topic in several if knee_name(topic) == knee]:
                bar.describe(f"Reading {path.name}")
                without = (
                    f"Recorded without its parameters; {spelled} is taken for body weight and law."
                )
                origin = _recorded_with(own) if own else without
                found = [
                    _read(path, topic, basis, bar)._replace(origin=origin) for topic in topics
                ]
            else:
                doubt = "".join(f" {sentence}." for sentence in weight_doubt(path, assumed))
                found = _solved(path, basis, names, f"{made} with {spelled}.{doubt}", work, bar)
            uncertain: Sequence[Propagated | None] = [None, None]
            if options.uncertainty:
                bar.describe(f"Uncertainty of {path.name}")
                effects = propagated(path, basis, options.uncertainty, names, bar)
                uncertain = [effects.medial, effects.lateral]
            other = list[Run]()
            if over:
                source = (
                    with_values(own._replace(changes=()), law)
                    if own
                    else files.load_parameters([files.flat_parameters(assumed), law])
                )
                origin = f"{made}: the inputs of “{label}” with its parameters, except for the contact law of "
                other = _solved(
                    path, source, names, f"{origin}{_spelled(options.compare)}.", work, bar
                )
            for run in found:
                side = is_lateral(run.topic)
                which = run.topic.strip("/") if len(knees) > 1 else LATERAL if side else MEDIAL
                name = f"{label} {which}" if max(len(found), len(several)) > 1 else label
                runs.append(run._replace(name=name, label=name, uncertain=uncertain[side]))
                for again in (one for one in other if is_lateral(one.topic) == side):
                    runs.append(
                        again._replace(
                            name=name,
                            label=f"{name}, {' + '.join(each.stem for each in options.compare)}",
                            topic=run.topic,
                            beside=len(runs) - 1,
                            kept=kept(run.parameters, over),
                        )
                    )
    return runs


def _stored(path: Path, options: ReportOptions) -> Provenance | None:
    """Provenance of a recording; None for a later part without parameters, if the user gave some."""
    try:
        return read_provenance(path)
    except UsageError:
        if options.parameters_given:
            return None
        raise


def _recorded_with(stored: Provenance) -> str:
    """Describe what a recording was made with."""
    changed = (
        f" They changed, or the model was reset, {len(stored.changes)} times meanwhile."
        * bool(stored.changes)
    )
    return f"Recorded with {stored.package} and the parameters stored in it.{changed}"


def _spelled(sources: Sequence[Source]) -> str:
    """Names of parameter files, and values as on the command line."""
    return ", ".join(
        source.name
        if isinstance(source, Path)
        else ", ".join(f"{name}:={value}" for name, value in source.items())
        for source in sources
    )


def _solved(
    path: Path, basis: Parameters | Provenance, names: Names, origin: str, work: Path, bar: Bar
) -> list[Run]:
    """Solve a bag into a recording in `work`; return a run for each compartment, the medial one first."""
    bar.describe(f"Solving {path.name}")
    recording = work / "solved.mcap"
    summary = solve(path, basis, recording, bar, overwrite=True, names=names)
    runs = []
    for topic, each in (
        (f"/{KNEE_CONTACT}", summary),
        (f"/{KNEE_CONTACT}/{LATERAL}", summary.lateral),
    ):
        if each:
            run = _read(recording, topic, read_provenance(recording) or basis, bar)
            run.gathered.doubts.axes = each.doubts.axes
            runs.append(run._replace(source=path, origin=origin, damage=tuple(summary.damage)))
    recording.unlink()
    return runs


def _read(path: Path, topic: str, basis: Parameters | Provenance, bar: Bar) -> Run:
    """Read a recording's answers, with patch and pressure if one known model computed all of them."""
    stored = basis if isinstance(basis, Provenance) else None
    try:
        own, texts = answering(topic, parameters_in(basis), texts_of(basis))
        model: KneeModel | None = build_model(own, curves=texts)
    except UsageError:  # a file that the parameters name is missing
        own, model = answering(topic, parameters_in(basis), {})[0], None
    doubts = doubts_about(own, model) if model else Doubts()
    doubts.inputs.load_driven = own.drive != "displacement"
    parts = {name: list[NDArray[Any]]() for name in FIELDS}
    for block in answer_blocks(path, topic, bar):
        for name in FIELDS:
            parts[name].append(block.view(FLAT)[name].copy())
        if stored and not stored.changes and model and model.patch:
            read = model.readouts(block)
            for name in SPREAD:
                parts.setdefault(name, []).append(np.asarray(read[name]))
    gathered = Gathered(
        {name: np.concatenate(several) for name, several in parts.items()}, own.body_weight, doubts
    )
    try:
        refused = read_refused(path)
    except (OSError, ValueError):
        refused = Counter()
    damage, drawn = (stored.damage, model) if stored else ((), None)
    return Run(
        "", "", path, topic, own, "", refused, damage, gathered, drawn, known=stored is not None
    )

"""Many knees through the same gait, in memory: their models, answers and outcomes, and the function `sweep`."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from knee_contact_ros.bags.provenance import Provenance, metadata_of
from knee_contact_ros.bags.reader import OWN_NAMES, Names, names_in_bag
from knee_contact_ros.joint_reaction.compartments import LoadRule
from knee_contact_ros.model.kernel import worth_compiling
from knee_contact_ros.model.knee import LARGEST_ANGLE, LARGEST_HEIGHT, LARGEST_LOAD, KneeModel
from knee_contact_ros.model.laws import ContactLaw
from knee_contact_ros.model.readouts import ContactPatch
from knee_contact_ros.model.surfaces import ContactPair
from knee_contact_ros.model.types import NANOSECOND, ROW, ContactState, Floats, Rows, Status
from knee_contact_ros.offline.notebooks import Name, in_python_words, warn_of
from knee_contact_ros.offline.solve import parameters_for, parameters_in, solve
from knee_contact_ros.parameters.build import build_model, contact_pair, load_rule
from knee_contact_ros.parameters.files import (
    ParameterSource,
    check_value,
    curve_files,
    dotted,
    known_parameters,
    lateral_texts,
    load_parameters,
    read_curve,
    variations_of,
)
from knee_contact_ros.parameters.schema import Parameters, has_two_compartments, lateral_knee
from knee_contact_ros.results import Records, no_such
from knee_contact_ros.streams.contact_pipeline import ContactPipeline, half_spacing, move_along_z
from knee_contact_ros.streams.gait_events import GAP
from knee_contact_ros.streams.output import PROVENANCE
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import DEFAULT_PARAMETERS, expand_user
from knee_contact_ros.system.progress import OnProgress, no_progress

if TYPE_CHECKING:
    import pandas as pd


OUTCOMES = {
    "peak_force": "N",
    "peak_depth": "m",
    "peak_pressure": "Pa",
    "peak_strain": "",
    "peak_loading_rate": "N/s",
    "impulse": "N s",
    "contact_time": "s",
    "bone_time": "s",
    "path_length": "m",
    "sliding_distance": "m",
    "error_bound": "m",
    "force_error_bound": "N",
    "not_converged": "",
    "implausible": "",
    "ticks": "",
    "evaluations": "",
}
"""SI units of all outcomes, in the order of the table's columns; docs/how-to/many-knees.md explains them. Pressure is
the static force over the patch (readouts); integrals are by the trapezoidal rule, without pauses longer than `GAP`"""
OF_A_RUN = np.dtype([(name, np.float64) for name in OUTCOMES])
"""Record of the outcomes of a run, with a field for each"""
LARGEST = {
    "peak_force": "contact_force",
    "peak_depth": "penetration_depth",
    "error_bound": "error_estimate",
    "force_error_bound": "force_error_estimate",
}
"""Outcomes that are the largest value of a field over all answers, with the field's name"""


def outcomes(
    answers: Rows, steps: Floats, laws: list[ContactLaw], patches: list[ContactPatch | None]
) -> NDArray[Any]:
    """Compute the outcomes of several runs.

    Args:
        answers: Answers of k runs, shape (k, n).
        steps: Time since the tick before [s], shape (n,); 0 where a run begins.
        laws: Contact law of each run.
        patches: Area over which the contact spreads in each run; None: pressure and strain are not known.

    Returns:
        Records of `OF_A_RUN`, shape (k,).
    """
    rows = np.zeros(len(answers), OF_A_RUN)
    steps = np.where(steps > GAP * NANOSECOND, 0.0, steps)  # nothing is known of a hole in a bag
    weights = 0.5 * (steps + np.append(steps[1:], 0.0))
    force, state, status = (
        np.ascontiguousarray(answers[name])
        for name in ("contact_force", "contact_state", "status")
    )
    touching = state != ContactState.SEPARATED
    for name, field in LARGEST.items():
        rows[name] = answers[field].max(axis=1)
    rows["impulse"], rows["contact_time"] = (
        _over_time(force, weights),
        _over_time(touching, weights),
    )
    rows["bone_time"] = _over_time(state == ContactState.BONE, weights)
    follows = steps[1:] > 0.0
    stays = touching[:, 1:] & touching[:, :-1] & follows
    point = answers["contact_point"]
    distance = np.hypot(np.diff(point["x"], axis=1), np.diff(point["y"], axis=1))
    rows["path_length"] = np.sum(distance, axis=1, where=stays)
    rows["sliding_distance"] = _over_time(np.abs(answers["sliding_velocity"]) * touching, weights)
    if follows.any():
        rates = np.diff(force, axis=1)[:, follows] / steps[1:][follows]
        rows["peak_loading_rate"] = np.maximum(rates.max(axis=1), 0.0)
    for name, bit in (
        ("not_converged", Status.NOT_CONVERGED),
        ("implausible", Status.IMPLAUSIBLE),
    ):
        rows[name] = np.count_nonzero(status & np.uint8(bit), axis=1)
    rows["ticks"], rows["evaluations"] = answers.shape[1], answers["evaluations"].sum(axis=1)
    rows["peak_pressure"] = [
        np.nan if patch is None else peak_pressure(law, patch, deepest)
        for law, patch, deepest in zip(laws, patches, rows["peak_depth"].tolist(), strict=True)
    ]
    thickness = np.array([np.nan if patch is None else patch.thickness for patch in patches])
    rows["peak_strain"] = answers["cartilage_depth"].max(axis=1) / thickness
    return rows


def _over_time(values: NDArray[Any], weights: Floats) -> Floats:
    """Integrate each run over time, shape (k,); the bits do not depend on the number of runs.

    With a matrix product (`@`) the last bits would depend on the number of rows.
    """
    integrals: Floats = np.sum(values * weights, axis=1)
    return integrals


def peak_pressure(law: ContactLaw, patch: ContactPatch, deepest: float) -> float:
    """Compute the largest pressure [Pa] of a run whose largest depth is `deepest` [m]; see `ContactPatch.readouts`.

    The ratio of force to depth is largest at an end of a layer, since the force is convex within a layer.
    """
    ends = [layer.begin for layer in law.layers if 0.0 < layer.begin < deepest]
    over = max(
        (law.static_force(depth) / depth for depth in (*ends, deepest) if depth > 0.0), default=0.0
    )
    return patch.spread.peak * over / (np.pi * patch.spread.area * patch.radius)


Values = Mapping[str, Any]
"""Values of the varied parameters of a case, by name"""
LATERAL = "lateral_"
"""Beginning of the names of the outcomes of the lateral compartment"""
KEPT = 64
"""Number of pairs of surfaces, and of series of loads, that are kept for later cases with the same ones"""
SECTIONS = (
    "load.",
    "femur.",
    "tibia.",
    "translation.",
    "contact.",
    "lateral.",
    "fidelity.",
    "body_weight",
)
"""Beginnings of the names of the parameters that a study may vary; the others say how a bag is read or recorded"""
TOGETHER = 16_384
"""Number of answers that a thread holds at a time: about 4 MB, which fit into a processor's cache"""


class Recording(NamedTuple):
    """Inputs of all ticks of a recording, arrays of shape (n,)."""

    stamps: NDArray[np.int64]
    """Stamps [ns]"""
    steps: Floats
    """Time since the tick before [s]; 0 where a run begins"""
    angles: Floats
    """Flexion angle [rad]"""
    axial: Floats
    """Axial joint reaction [N], positive in compression"""
    moment: Floats
    """Frontal moment [N m]"""
    heights: Floats
    """Prescribed femoral height [m]; NaN where it is not prescribed"""
    damage: tuple[str, ...] = ()
    """Parts of the recording that cannot be read, a sentence each"""
    doubts: tuple[str, ...] = ()
    """What is implausible in it, a sentence each"""
    share: float = 0.0
    """Fraction of the axial load that is added to the medial compartment's share"""

    @property
    def begins(self) -> list[int]:
        """Indices of the first tick of each run, followed by the number of ticks."""
        return [*np.flatnonzero(self.steps == 0.0).tolist(), len(self.steps)]


def read_recording(
    bag: Path,
    basis: Parameters | Provenance,
    texts: Mapping[str, str],
    names: Names = OWN_NAMES,
    advance: OnProgress = no_progress,
    *,
    compiled: bool | None = None,
) -> tuple[Recording, tuple[Rows, ...]]:
    """Read the inputs of all ticks from a bag.

    Args:
        bag: Path of the bag.
        basis: Parameters, or the provenance of a recording.
        texts: Contents of the files that the parameters name, by parameter.
        names: Names of the input topics.
        advance: As for `solve`.
        compiled: As for `solve`.

    Returns:
        The inputs, and the answers of each compartment, shape (n,): 300 B a tick.

    Raises:
        UsageError: the bag cannot be used, see `solve`.
    """
    inputs: list[tuple[Any, Any, Any]] = []
    blocks: list[Sequence[Rows]] = []

    def listen(stream: ContactPipeline) -> None:
        class Noting(LoadRule):
            def __call__(self, axial: Any, moment: Any, flexion: Any) -> Any:
                inputs.append((axial, moment, flexion))
                return super().__call__(axial, moment, flexion)

        stream.rule = Noting(**vars(stream.rule))

    summary = solve(
        bag,
        basis,
        None,
        advance,
        names=names,
        compiled=compiled,
        keep=blocks.append,
        prepare=listen,
        curves=texts,
    )
    columns = [[np.atleast_1d(one) for one in column] for column in zip(*inputs, strict=True)]
    axial, moment, angles = (
        np.ascontiguousarray(np.concatenate(column), dtype=float) for column in columns
    )
    rows = tuple(np.concatenate(parts) for parts in zip(*blocks, strict=True))
    stamps, height = rows[0]["stamp"].copy(), rows[0]["femoral_height"].copy()
    steps = np.diff(stamps, prepend=stamps[:1]) * NANOSECOND
    steps[(rows[0]["status"] & Status.TIME_RESET) != 0] = 0.0
    if parameters_in(basis).drive != "displacement":
        height[:] = np.nan
    doubts = tuple(filter(None, (*summary.warnings, summary.unanswered)))
    return Recording(
        stamps, steps, angles, axial, moment, height, tuple(summary.damage), doubts
    ), rows


def recorded_doubt(bag: Path) -> list[str]:
    """Sentence that a recording is computed with other parameters than its own; empty list if the bag is none."""
    own = PROVENANCE in dict(metadata_of(bag))
    return [
        f"it is a recording; without params its own parameters are not used, but {DEFAULT_PARAMETERS}"
    ] * own


class Side(NamedTuple):
    """A compartment of a knee: medial (or the only one), or lateral."""

    model: KneeModel
    loads: Floats
    """Compressive load of the compartment [N], shape (n,)"""
    z: float
    """Place in the tibia frame [m]"""


class Knees:
    """Makes the knees of one recording and one set of parameters, some of which vary."""

    def __init__(
        self, recording: Recording, parameters: Parameters, files: Mapping[str, str]
    ) -> None:
        """Set what all knees have in common; `files` has contents of files by name, other files are read.

        Raises:
            UsageError: an angle or a height is too large for a knee.
        """
        self.recording, self.parameters, self.files = recording, parameters, dict(files)
        _refuse_beyond("flexion angle", recording.angles, LARGEST_ANGLE, "rad")
        _refuse_beyond("femoral height", recording.heights, LARGEST_HEIGHT, "m")
        self.varied = variations_of(parameters)
        self._medial = lru_cache(KEPT)(self._made_medial)

    def sides(self, parameters: Parameters, *, compiled: bool = False) -> tuple[Side, ...]:
        """Make the compartments of a knee, compiled or not: the only one, or medial and lateral.

        Raises:
            UsageError: a surface or a law cannot be made, or a load is too large for a knee.
        """
        texts, z = file_texts(parameters, self.files), half_spacing(parameters)
        medial = self._medial(parameters.load, parameters.body_weight)
        parts = [(parameters, texts, medial, -z)]
        if has_two_compartments(parameters):
            parts.append(
                (lateral_knee(parameters), lateral_texts(texts), self.recording.axial - medial, z)
            )
        sides = []
        for own, files, loads, place in parts:
            pair = _surfaces(
                own.femur.model_copy(update={"mass": 1.0}),
                own.tibia,
                own.translation,
                *files.items(),
            )
            sides.append(
                Side(replace(build_model(own, pair=pair), compiled=compiled), loads, place)
            )
        return tuple(sides)

    def _made_medial(self, load: Any, body_weight: float) -> Floats:
        """Compute the loads of the medial compartment, or of the only one."""
        parameters = self.parameters.model_copy(update={"load": load, "body_weight": body_weight})
        recording = self.recording
        rule = load_rule(parameters, file_texts(parameters, self.files))
        if rule.by_moment and np.isnan(recording.moment).any():
            raise UsageError("gait: load rule moment_balance needs frontal_moment")
        loads = np.ascontiguousarray(
            rule(recording.axial, recording.moment, recording.angles), dtype=float
        )
        if recording.share:
            loads = loads + recording.share * recording.axial
        _refuse_beyond("load", loads, LARGEST_LOAD, "N")
        _refuse_beyond("load", recording.axial - loads, LARGEST_LOAD, "N")
        return loads


@lru_cache(KEPT)
def _surfaces(femur: Any, tibia: Any, translation: Any, *texts: tuple[str, str]) -> ContactPair:
    """Make surfaces and mechanism from sections of the parameters, and contents of files by parameter."""
    sections = {"femur": femur, "tibia": tibia, "translation": translation}
    return contact_pair(Parameters().model_copy(update=sections), dict(texts))


def file_texts(parameters: Parameters, files: dict[str, str]) -> dict[str, str]:
    """Return the contents of the files that the model of some parameters needs, by parameter.

    `files` has contents by the files' names; a file that is not in it is read once, and added.

    Raises:
        UsageError: a file cannot be read.
    """
    for parameter, name in curve_files(parameters).items():
        if name not in files:
            files[name] = read_curve(parameter, name)
    return {parameter: files[name] for parameter, name in curve_files(parameters).items()}


def _refuse_beyond(what: str, values: Floats, most: float, unit: str) -> None:
    """Refuse inputs that are too large, as `KneeModel.run` does."""
    beyond = values[np.abs(values) > most]
    if beyond.size:
        raise UsageError(f"{what} {beyond[0]:g} {unit} is not allowed; at most {most:g} {unit}")


def check_may_vary(names: Iterable[str]) -> None:
    """Refuse parameters that a study cannot vary; unknown ones are left to `check_value`.

    Raises:
        UsageError: a study cannot vary one of them.
    """
    for name in names:
        if name in known_parameters() and not name.startswith(SECTIONS):
            raise UsageError(f"{name} is not allowed; a parameter of {', '.join(SECTIONS)}")


class Computed(NamedTuple):
    """Results of k cases that were computed together."""

    parameters: list[Parameters | None]
    """All parameters of each case; None where a case failed"""
    failed: list[str]
    """Why a case has no outcomes; empty if it has them"""
    outcomes: list[NDArray[Any]]
    """Outcomes of the only or medial, and of the lateral compartment: records of `OF_A_RUN`, shape (k,), NaN where a
    case has none"""
    series: list[Rows]
    """Answers of each compartment, shape (k, n), zeros where a case has none; none unless they were requested"""
    seconds: float
    """Mean time [s] of a case"""

    def has(self, side: int) -> NDArray[np.bool_]:
        """Whether a case has answers of a compartment (0 or 1), shape (k,)."""
        known: NDArray[np.bool_] = np.isfinite(self.outcomes[side]["ticks"])
        return known


def compute(
    knees: Knees,
    cases: Sequence[Values],
    *,
    series: bool = False,
    threads: int = 1,
    compiled: bool,
) -> Computed:
    """Compute cases; the answers have the same bits as a run of each case alone.

    Args:
        knees: What the cases have in common.
        cases: Values of the varied parameters of each case.
        series: Whether to keep all answers.
        threads: Number of threads; 0: one for each processor.
        compiled: Whether to use the compiled model.
    """
    begun, recording = time.perf_counter(), knees.recording
    number, ticks = len(cases), len(recording.steps)
    parameters: list[Parameters | None] = [None] * number
    failed, runs = [""] * number, list[tuple[int, int, Side]]()
    for i, values in enumerate(cases):
        try:
            own = knees.varied(values)
            runs += [
                (i, place, side) for place, side in enumerate(knees.sides(own, compiled=compiled))
            ]
            parameters[i] = own
        except (UsageError, ValueError) as error:
            failed[i] = str(error)
    found = [np.full(number, np.nan, OF_A_RUN) for _ in range(2)]
    both = any(place for _, place, _ in runs)
    kept = [np.zeros((number, ticks), ROW) for _ in range(1 + both)] if series else []

    def some(first: int) -> None:
        part = runs[first : first + count]
        answers = _answers(recording, [side for *_, side in part])
        models = [side.model for *_, side in part]
        rows = outcomes(
            answers, recording.steps, [one.law for one in models], [one.patch for one in models]
        )
        for (i, place, side), row, answer in zip(part, rows, answers, strict=True):
            found[place][i] = row
            if kept:
                move_along_z(answer, side.z)
                kept[place][i] = answer

    for *_, side in runs[:1]:
        side.model.kernel()  # threads find it made
    count = max(1, TOGETHER // ticks)
    with ThreadPoolExecutor(threads or len(os.sched_getaffinity(0))) as pool:
        list(pool.map(some, range(0, len(runs), count)))
    return Computed(
        parameters, failed, found, kept, (time.perf_counter() - begun) / max(number, 1)
    )


def _answers(recording: Recording, sides: Sequence[Side]) -> Rows:
    """Compute k compartments through a recording, shape (k, n)."""
    answers = np.zeros((len(sides), len(recording.steps)), ROW)
    samples = np.column_stack(
        [recording.steps, recording.angles, np.zeros_like(recording.steps), recording.heights]
    )
    for side, own in zip(sides, answers, strict=True):
        samples[:, 2] = side.loads
        for begin, end in zip(recording.begins, recording.begins[1:], strict=False):
            side.model.compute(samples[begin:end], own[begin:end])
    answers["stamp"] = recording.stamps
    answers["status"][:, recording.begins[1:-1]] |= np.uint8(Status.TIME_RESET)
    return answers


@dataclass(frozen=True)
class Cohort:
    """Results of `sweep`: k cases, in the order of the values.

    Example:
        >>> from knee_contact_ros import sweep
        >>> cohort = sweep("bags/gait2354_right", {"contact.damping": [2e3, 5e3]})
        >>> cohort.to_pandas()[["contact.damping", "peak_force"]].round()
           contact.damping  peak_force
        0           2000.0      1614.0
        1           5000.0      1614.0
    """

    values: dict[str, NDArray[Any]]
    """Values of the varied parameters, by name, shape (k,)"""
    outcomes: np.recarray[Any, Any]
    """Outcomes of each case, shape (k,), by the names in docs/how-to/many-knees.md; NaN where the case failed"""
    lateral: np.recarray[Any, Any] | None
    """Outcomes of the lateral compartment, shape (k,); None unless both compartments are modelled"""
    failed: NDArray[Any]
    """Why a case has no outcomes, shape (k,); empty texts for the others"""
    series: NDArray[Any] | None = None
    """All answers of the only or the medial compartment, rows of `Contact`, shape (k, n); None unless requested"""
    lateral_series: NDArray[Any] | None = None
    """All answers of the lateral compartment, shape (k, n); None unless requested and both compartments are modelled

    A case without answers has zeros.
    """

    def __repr__(self) -> str:
        varied = ", ".join(
            f"{name} {np.min(own)} to {np.max(own)}" for name, own in self.values.items()
        )
        return f"<Cohort: {len(self.failed)} cases, {np.count_nonzero(self.failed)} failed; varied: {varied}>"

    def __getattr__(self, name: str) -> Any:
        raise no_such(self, name)

    def to_pandas(self) -> pd.DataFrame:
        """Return a data frame with a row for each case: values, outcomes, lateral outcomes and why it failed.

        Its `attrs["varied"]` are the names of the parameters that were varied, which are the first columns.
        """
        import pandas as pd

        columns: dict[str, Any] = dict(self.values)
        for prefix, rows in (("", self.outcomes), ("lateral_", self.lateral)):
            columns |= (
                {prefix + name: rows[name] for name in OF_A_RUN.names or ()}
                if rows is not None
                else {}
            )
        table = pd.DataFrame(columns | {"failed": self.failed})
        table.attrs["varied"] = list(self.values)
        return table


def sweep(
    gait: Name | Mapping[str, ArrayLike],
    values: Mapping[str, ArrayLike],
    params: ParameterSource = DEFAULT_PARAMETERS,
    *,
    remap: Mapping[str, str] | None = None,
    namespace: str = "",
    series: bool = False,
    threads: int = 0,
) -> Cohort:
    """Compute many knees through one gait; the answers have the same bits as a run of each knee alone.

    Args:
        gait: A bag; or arrays of shape (n,): `time` [s], increasing, `flexion_angle` [rad], and `axial_load` [N], which
            the parameters `load.*` divide between the compartments (with `frontal_moment` [N m] where they need it).
            The displacement drive needs `femoral_height` [m] instead of the load.
        values: Values of the varied parameters by name: arrays of shape (k,), or one value for all cases.
        params: The knee, as for `load_model`.
        remap: Other names of the input topics in a bag.
        namespace: Namespace of the input topics in a bag.
        series: Whether to keep all answers, 224 B a tick.
        threads: Number of threads; 0: one for each processor. Compiled code runs without Python's lock.

    An implausible or damaged bag causes warnings.

    Raises:
        UsageError: a parameter is unknown or may not be varied, arrays do not fit, or the bag cannot be used. Values
            that are allowed alone but not together are no error: the case fails.

    Example:
        >>> import numpy as np
        >>> from knee_contact_ros import sweep
        >>> time = np.linspace(0.0, 1.0, 101)
        >>> gait = {
        ...     "time": time,
        ...     "flexion_angle": 0.3 + 0.2 * np.sin(6.3 * time),
        ...     "axial_load": 1400.0 + 800.0 * np.sin(12.6 * time),
        ... }
        >>> cohort = sweep(gait, {"contact.stiffness": [4e7, 8e7, 16e7]})
        >>> (1e3 * cohort.outcomes.peak_depth).round(2)
        array([0.91, 0.57, 0.36])
    """
    with in_python_words():
        cases = _cases(values)
        files = dict[str, str]()
        if isinstance(gait, Mapping):
            parameters = load_parameters(params)
            recording = _recording(gait, parameters)
        else:
            sources = params if isinstance(params, (list, tuple)) else [params]
            parameters = parameters_for(expand_user(str(gait)), sources)
            names = names_in_bag(
                [f"{ours}:={theirs}" for ours, theirs in (remap or {}).items()], namespace
            )
            recording, _ = read_recording(
                expand_user(str(gait)), parameters, file_texts(parameters, files), names
            )
            own = recorded_doubt(expand_user(str(gait))) if params == DEFAULT_PARAMETERS else []
            warn_of(expand_user(str(gait)), "solved", [*own, *recording.doubts], recording.damage)
        knees = Knees(recording, parameters, files)
    compiled = worth_compiling(len(cases) * len(recording.steps))
    computed = compute(knees, cases, series=series, threads=threads, compiled=compiled)
    medial, lateral = (rows.view(Records) for rows in computed.outcomes)
    varied = {name: np.array([case[name] for case in cases]) for name in dotted(values)}
    both = computed.has(1).any()
    return Cohort(
        varied, medial, lateral if both else None, np.array(computed.failed), *computed.series
    )


def _cases(values: Mapping[str, ArrayLike]) -> list[dict[str, Any]]:
    """Return the values of each case by name; refuse arrays of different lengths, and values that are never allowed."""
    flat = {name: np.asarray(column) for name, column in dotted(values).items()}
    check_may_vary(flat)
    try:
        columns = [
            column.tolist() for column in np.broadcast_arrays(*flat.values(), np.zeros(1))[:-1]
        ]
        rows = [dict(zip(flat, row, strict=True)) for row in zip(*columns, strict=True)]
    except ValueError:
        rows = []
    if not rows or any(column.ndim > 1 for column in flat.values()):
        shapes = ", ".join(f"{name} {column.shape}" for name, column in flat.items()) or "none"
        raise UsageError(
            f"values: {shapes} is not allowed; arrays of one length, or single values"
        )
    for name, column in zip(flat, columns, strict=True):
        for value in set(column) if isinstance(column[0], str) else {min(column), max(column)}:
            check_value(name, value)
    return rows


def _recording(gait: Mapping[str, ArrayLike], parameters: Parameters) -> Recording:
    """Make a recording from arrays; refuse those that are missing for the parameters or do not fit."""
    known = ("time", "flexion_angle", "axial_load", "frontal_moment", "femoral_height")
    moved, by_moment = parameters.drive == "displacement", parameters.load.rule == "moment_balance"
    needed, allowed = (
        ((*known[:2], known[4]), known) if moved else (known[: 3 + by_moment], known[:4])
    )
    if not {*needed} <= set(gait) <= {*allowed}:
        told = f"these parameters need {', '.join(needed)} and allow {', '.join(allowed)}"
        raise UsageError(f"gait: {', '.join(gait) or 'nothing'} is not allowed; {told}")
    columns = {name: np.array(column, dtype=float) for name, column in gait.items()}
    time = columns["time"]
    if any(
        column.shape != time.shape or column.ndim != 1 for column in columns.values()
    ) or not len(time):
        raise UsageError("gait: the arrays must be one-dimensional and of equal length")
    if any(map(np.ma.is_masked, gait.values())) or not all(
        np.isfinite(column).all() for column in columns.values()
    ):
        raise UsageError("gait: the arrays must be finite, and not masked")
    stamps = np.rint(time / NANOSECOND).astype(np.int64)
    if (np.diff(stamps) <= 0).any():
        raise UsageError("gait: time must increase")
    default = dict.fromkeys(known[2:], np.full(len(time), 0.0 if moved else np.nan))
    inputs = [(default | columns)[name] for name in known[1:]]
    return Recording(stamps, np.diff(stamps, prepend=stamps[:1]) * NANOSECOND, *inputs)

"""Many knees through the same gait: models from parameter values, their answers and outcomes, and `sweep`."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from knee_contact_ros.bags.topic_names import OWN_NAMES, Names, names_in_bag
from knee_contact_ros.lab.uncertainty import Given, given_in
from knee_contact_ros.model.compiler import worth_compiling
from knee_contact_ros.model.knee import LARGEST_ANGLE, LARGEST_HEIGHT, LARGEST_LOAD, KneeModel
from knee_contact_ros.model.laws import ContactLaw
from knee_contact_ros.model.readouts import ContactPatch
from knee_contact_ros.model.surfaces import ContactPair
from knee_contact_ros.model.types import NANOSECOND, ROW, ContactState, Rows, Status
from knee_contact_ros.offline.notebooks import Name, in_python_words
from knee_contact_ros.parameters.build import build_model, contact_pair, load_rule
from knee_contact_ros.parameters.files import (
    Source,
    check_value,
    curve_files,
    dotted,
    known_parameters,
    lateral_texts,
    load_parameters,
    read_curve,
    variations_of,
)
from knee_contact_ros.parameters.schema import Parameters, has_both, lateral_knee
from knee_contact_ros.streams.contact_stream import half_spacing, move_along_z
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import DEFAULT_PARAMETERS, expanded

if TYPE_CHECKING:
    import pandas as pd


Floats = NDArray[np.float64]


class Outcome(NamedTuple):
    """Description of an outcome, which is a column of the table."""

    name: str
    """Name of the column"""
    unit: str
    """SI unit; empty for numbers of ticks and for ratios"""
    meaning: str
    """Definition, for people who read the table"""


OUTCOMES = (
    Outcome("peak_force", "N", "largest contact force"),
    Outcome("peak_depth", "m", "largest penetration depth"),
    Outcome("peak_pressure", "Pa", "largest pressure, that of the force at rest spread over the patch (readouts)"),
    Outcome("peak_strain", "", "largest nominal strain of the cartilage"),
    Outcome("peak_loading_rate", "N/s", "fastest rise of the contact force from tick to tick"),
    Outcome("impulse", "N s", "contact force over time, by trapezoids"),
    Outcome("contact_time", "s", "time in contact"),
    Outcome("bone_time", "s", "time in contact with the second layer"),
    Outcome("path_length", "m", "way of the contact point while in contact"),
    Outcome("sliding_distance", "m", "way that the femoral surface slides over the tibial one while in contact"),
    Outcome("error_bound", "m", "largest error estimate of the depth"),
    Outcome("force_error_bound", "N", "largest error estimate of the contact force"),
    Outcome("not_converged", "", "ticks that missed a tolerance"),
    Outcome("implausible", "", "ticks whose depth makes no sense"),
    Outcome("ticks", "", "answers in all"),
    Outcome("evaluations", "", "contact law evaluations in all"),
)
"""All outcomes, in the order of the table's columns"""
OF_A_RUN = np.dtype([(outcome.name, np.float64) for outcome in OUTCOMES])
"""Record of the outcomes of a run, with a field for each"""
LARGEST = {
    "peak_force": "contact_force", "peak_depth": "penetration_depth", "error_bound": "error_estimate",
    "force_error_bound": "force_error_estimate",
}  # fmt: skip
"""Outcomes that are the largest value of a field over all answers, with the field's name"""


def outcomes(answers: Rows, steps: Floats, laws: list[ContactLaw], patches: list[ContactPatch | None]) -> NDArray[Any]:
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
    weights = 0.5 * (steps + np.append(steps[1:], 0.0))
    force, state, status = (
        np.ascontiguousarray(answers[name]) for name in ("contact_force", "contact_state", "status")
    )  # fmt: skip
    touching = state != ContactState.SEPARATED
    for name, field in LARGEST.items():
        rows[name] = answers[field].max(axis=1)
    rows["impulse"], rows["contact_time"] = _over_time(force, weights), _over_time(touching, weights)
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
    for name, bit in (("not_converged", Status.NOT_CONVERGED), ("implausible", Status.IMPLAUSIBLE)):
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

    A product of matrix and vector (`@`) would have other last bits with other numbers of rows.
    """
    integrals: Floats = np.sum(values * weights, axis=1)
    return integrals


def peak_pressure(law: ContactLaw, patch: ContactPatch, deepest: float) -> float:
    """Compute the largest pressure [Pa] of a run whose largest depth is `deepest` [m]; see `ContactPatch.readouts`.

    The ratio of force to depth is largest at an end of a layer's range, since within a layer the force is convex.
    """
    ends = [layer.begin for layer in law.layers if 0.0 < layer.begin < deepest]
    over = max((law.static_force(depth) / depth for depth in (*ends, deepest) if depth > 0.0), default=0.0)
    return patch.spread.peak * over / (np.pi * patch.spread.area * patch.radius)


Values = Mapping[str, Any]
"""Values of the varied parameters of a case, by name"""
KEPT_SURFACES = 64
"""Number of pairs of surfaces, and of series of loads, that are kept for the next case that has the same ones"""
SECTIONS = ("load.", "femur.", "tibia.", "translation.", "contact.", "lateral.", "fidelity.", "body_weight")
"""Prefixes of the parameters that a study may vary; the others say how a bag is read or recorded"""


class Side(NamedTuple):
    """A compartment of a case: medial (or the only one), or lateral."""

    model: KneeModel
    loads: Floats
    """Compressive load of the compartment [N], shape (n,)"""


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
    """Prescribed femoral height [m]; not a number where it is not prescribed"""

    damage: tuple[str, ...] = ()
    """Parts of the recording that cannot be read, a sentence each"""

    @property
    def begins(self) -> list[int]:
        """Indices of the ticks with which runs begin, and at the end the number of ticks."""
        return [*np.flatnonzero(self.steps == 0.0).tolist(), len(self.steps)]


class Files:
    """Contents of the files that parameters name; each file is read once."""

    def __init__(self, known: Mapping[str, str] = MappingProxyType({})) -> None:
        """Begin with contents that are known already, by the files' names."""
        self.known = dict(known)

    def texts(self, parameters: Parameters) -> dict[str, str]:
        """Give the contents of the files that the model of some parameters needs, by parameter.

        Raises:
            UsageError: a file cannot be read.
        """
        texts = {}
        for parameter, name in curve_files(parameters).items():
            if name not in self.known:
                self.known[name] = read_curve(parameter, name)
            texts[parameter] = self.known[name]
        return texts


class Knees:
    """Makes the knees of one recording and one set of parameters, of which some are varied."""

    def __init__(self, recording: Recording, parameters: Parameters, files: Files) -> None:
        """Take what all knees have in common.

        Raises:
            UsageError: an angle or a height is too large for a knee.
        """
        self.recording, self.parameters, self.files = recording, parameters, files
        _refuse_beyond("flexion angle", recording.angles, LARGEST_ANGLE, "rad")
        _refuse_beyond("femoral height", recording.heights, LARGEST_HEIGHT, "m")
        self.varied = variations_of(parameters)
        self._surfaces = lru_cache(KEPT_SURFACES)(self._made_surfaces)
        self._medial = lru_cache(KEPT_SURFACES)(self._made_medial)

    def sides(self, parameters: Parameters, *, compiled: bool = False) -> tuple[Side, ...]:
        """Make the compartments of a knee, with compiled models or plain ones: the only one, or medial and lateral.

        Raises:
            UsageError: a surface or a law cannot be made, or a load is too large for a knee.
        """
        texts = self.files.texts(parameters)
        medial = self._medial(parameters.load, parameters.body_weight)
        parts = [(parameters, texts, medial)]
        if has_both(parameters):
            parts.append((lateral_knee(parameters), lateral_texts(texts), self.recording.axial - medial))
        return tuple(Side(replace(self._model(own, files), compiled=compiled), loads) for own, files, loads in parts)

    def _model(self, parameters: Parameters, texts: Mapping[str, str]) -> KneeModel:
        femur = parameters.femur.model_copy(update={"mass": 1.0})
        pair = self._surfaces(femur, parameters.tibia, parameters.translation, tuple(texts.items()))
        return build_model(parameters, pair=pair)

    def _made_surfaces(
        self, femur: Any, tibia: Any, translation: Any, texts: tuple[tuple[str, str], ...]
    ) -> ContactPair:
        parts = {"femur": femur, "tibia": tibia, "translation": translation}
        return contact_pair(self.parameters.model_copy(update=parts), dict(texts))

    def _made_medial(self, load: Any, body_weight: float) -> Floats:
        parameters = self.parameters.model_copy(update={"load": load, "body_weight": body_weight})
        recording = self.recording
        rule = load_rule(parameters, self.files.texts(parameters))
        loads = np.ascontiguousarray(rule(recording.axial, recording.moment, recording.angles), dtype=float)
        _refuse_beyond("load", loads, LARGEST_LOAD, "N")
        _refuse_beyond("load", recording.axial - loads, LARGEST_LOAD, "N")
        return loads


def _refuse_beyond(what: str, values: Floats, most: float, unit: str) -> None:
    """Refuse inputs that are too large, as `KneeModel.run` does."""
    beyond = values[np.abs(values) > most]
    if beyond.size:
        raise UsageError(f"{what} {beyond[0]:g} {unit} is not allowed; at most {most:g} {unit}")


def may_vary(name: str) -> bool:
    """Whether a study may vary the parameter of a name."""
    return name.startswith(SECTIONS)


def knees_in(bag: Path, parameters: Parameters, files: Files, names: Names = OWN_NAMES) -> Knees:
    """Read a bag, and make the knees that go through its gait.

    Args:
        bag: Path of the bag.
        parameters: Parameters before any value is varied.
        files: Contents of the files that the parameters name.
        names: Names of the input topics.

    Raises:
        UsageError: bag or parameters cannot be used.
    """
    texts = files.texts(parameters)
    given = given_in(bag, parameters, lambda _done, _total: None, names, replays=0, compiled=None, curves=texts)
    return Knees(_recording_of(given), parameters, files)


def _recording_of(given: Given) -> Recording:
    rows = given.rows[0]
    stamps, resets = rows["stamp"].copy(), (rows["status"] & Status.TIME_RESET) != 0
    steps = np.diff(stamps, prepend=stamps[:1]) * NANOSECOND
    steps[resets] = 0.0
    displaced = given.parameters.drive == "displacement"
    heights = rows["femoral_height"].copy() if displaced else np.full(len(rows), np.nan)
    angles, axial, moment = (np.ascontiguousarray(column, dtype=float) for column in given[3:6])
    return Recording(stamps, steps, angles, axial, moment, heights, given.damage)


def checked_names(names: list[str]) -> None:
    """Refuse parameters that a study cannot vary; unknown ones are left to `check_value`.

    Raises:
        UsageError: a study cannot vary one of them.
    """
    for name in names:
        if name in known_parameters() and not may_vary(name):
            raise UsageError(f"{name} is not allowed; a parameter of {', '.join(SECTIONS)}")


TOGETHER = 16_384
"""Number of answers that a thread holds at once: some 4 MB, which fit into processors' caches"""


class Computed(NamedTuple):
    """Result of a case."""

    parameters: Parameters | None
    """All parameters of the case; None if they are not allowed"""
    sides: tuple[NDArray[Any], ...]
    """Outcomes of each compartment, records of `OF_A_RUN` of shape ()"""
    series: tuple[Rows, ...]
    """Answers of each compartment, shape (n,), if they were requested"""
    failed: str
    """Why there are no outcomes; empty if there are"""
    seconds: float
    """Time [s] that the case took: that of all cases computed together, over their number"""


class _Run(NamedTuple):
    """A compartment of a case."""

    number: int
    """Number of the case"""
    side: Side
    z: float
    """Place of the compartment in the tibia frame [m]"""


def compute(
    knees: Knees, cases: Sequence[Values], *, series: bool = False, threads: int = 1, in_all: int = 0
) -> list[Computed]:
    """Compute cases; their answers are the same bits as those of a run of each.

    Args:
        knees: What the cases have in common.
        cases: Values of the varied parameters of each case.
        series: Whether to keep all answers.
        threads: Number of threads; 0: one for each processor.
        in_all: Number of cases of the whole study, by which it is decided whether compiling is worthwhile.

    Returns:
        The results, in the order of the cases.
    """
    begun = time.perf_counter()
    results, runs, ticks = list[Computed](), list[_Run](), len(knees.recording.steps)
    compiled = worth_compiling(max(in_all, len(cases)) * ticks)
    for number, values in enumerate(cases):
        try:
            parameters = knees.varied(values)
            z, sides = half_spacing(parameters), knees.sides(parameters, compiled=compiled)
        except (UsageError, ValueError) as error:
            results.append(Computed(None, (), (), str(error), 0.0))
            continue
        runs += [_Run(number, side, place) for side, place in zip(sides, (-z, z), strict=False)]
        results.append(Computed(parameters, (), (), "", 0.0))
    for run in runs[:1]:
        run.side.model.kernel()  # threads find it made
    count = max(1, TOGETHER // ticks)
    together = [runs[begin : begin + count] for begin in range(0, len(runs), count)]
    with ThreadPoolExecutor(threads or len(os.sched_getaffinity(0))) as pool:
        computed = pool.map(partial(_computed, knees.recording, series=series), together)
        for part, (rows, answers) in zip(together, computed, strict=True):
            for i, run in enumerate(part):
                one = results[run.number]
                kept = (*one.series, answers[i]) if series else ()
                results[run.number] = one._replace(sides=(*one.sides, rows[i]), series=kept)
    seconds = (time.perf_counter() - begun) / max(len(cases), 1)
    return [result._replace(seconds=seconds) for result in results]


def outcomes_of(computed: Sequence[Computed], side: int) -> NDArray[Any]:
    """Collect the outcomes of all cases in a compartment.

    Args:
        computed: Results of k cases.
        side: 0: the only or the medial compartment; 1: the lateral one.

    Returns:
        Records of `OF_A_RUN`, shape (k,); not a number where a case has no outcomes.
    """
    rows = np.full(len(computed), np.nan, OF_A_RUN)
    for i, one in enumerate(computed):
        if side < len(one.sides):
            rows[i] = one.sides[side]
    return rows


def _computed(recording: Recording, runs: Sequence[_Run], *, series: bool) -> tuple[NDArray[Any], Sequence[Rows]]:
    """Compute k runs; give their outcomes, shape (k,), and their answers, if they are to be kept."""
    answers = np.zeros((len(runs), len(recording.steps)), ROW)
    samples = np.column_stack([recording.steps, recording.angles, np.zeros_like(recording.steps), recording.heights])
    for run, own in zip(runs, answers, strict=True):
        samples[:, 2] = run.side.loads
        for begin, end in zip(recording.begins, recording.begins[1:], strict=False):
            run.side.model.compute(samples[begin:end], own[begin:end])
    answers["stamp"] = recording.stamps
    answers["status"][:, recording.begins[1:-1]] |= np.uint8(Status.TIME_RESET)
    models = [run.side.model for run in runs]
    rows = outcomes(answers, recording.steps, [model.law for model in models], [model.patch for model in models])
    for run, own in zip(runs, answers if series else (), strict=False):
        move_along_z(own, run.z)
    return rows, tuple(answers) if series else ()


@dataclass(frozen=True)
class Cohort:
    """Results of `sweep`: k cases, in the order of the values."""

    values: dict[str, NDArray[Any]]
    """Values of the varied parameters, by name, shape (k,)"""
    outcomes: np.recarray[Any, Any]
    """Outcomes of each case, shape (k,), by the names in docs/cohorts.md; not a number where the case failed"""
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

    def to_pandas(self) -> pd.DataFrame:
        """Give a data frame with a row for each case: values, outcomes, lateral outcomes and why it failed."""
        import pandas as pd

        columns: dict[str, Any] = dict(self.values)
        for prefix, rows in (("", self.outcomes), ("lateral_", self.lateral)):
            columns |= {prefix + name: rows[name] for name in OF_A_RUN.names or ()} if rows is not None else {}
        return pd.DataFrame(columns | {"failed": self.failed})


def sweep(
    gait: Name | Mapping[str, ArrayLike],
    values: Mapping[str, ArrayLike],
    params: Source = DEFAULT_PARAMETERS,
    *,
    remap: Mapping[str, str] | None = None,
    namespace: str = "",
    series: bool = False,
    threads: int = 0,
) -> Cohort:
    """Compute many knees through one gait; the answers are the same bits as those of a run of each knee.

    Args:
        gait: A bag; or arrays of shape (n,): `time` [s], increasing, `flexion_angle` [rad], and `axial_load` [N], of
            which the compartment bears its share as the parameters `load.*` say (with `frontal_moment` [N m] where
            they need it). With the displacement drive `femoral_height` [m] instead of the load.
        values: Values of the varied parameters by name: arrays of shape (k,), or one value for all cases.
        params: The knee, as for `load_model`.
        remap: Other names of the input topics in a bag.
        namespace: Namespace of the input topics in a bag.
        series: Whether to keep all answers, 330 B a tick.
        threads: Number of threads; 0: one for each processor. Compiled code runs without Python's lock.

    Raises:
        UsageError: a parameter is unknown or may not be varied, arrays do not fit, or the bag cannot be used. Values
            that are allowed alone but not together are no error: the case fails.
    """
    with in_python_words():
        cases = _cases(values)
        parameters = load_parameters(params)
        if isinstance(gait, Mapping):
            knees = Knees(_recording(gait), parameters, Files())
        else:
            names = names_in_bag([f"{ours}:={theirs}" for ours, theirs in (remap or {}).items()], namespace)
            knees = knees_in(expanded(str(gait)), parameters, Files(), names)
    computed = compute(knees, cases, series=series, threads=threads)
    sides = range(max([1, *(len(one.sides) for one in computed)]))
    medial, *lateral = (outcomes_of(computed, side).view(np.recarray) for side in sides)
    answers = [_series(computed, side, len(knees.recording.steps)) for side in sides if series]
    varied = {name: np.array([case[name] for case in cases]) for name in dotted(values)}
    failed = np.array([one.failed for one in computed])
    return Cohort(varied, medial, lateral[0] if lateral else None, failed, *answers)


def _series(computed: Sequence[Computed], side: int, number: int) -> NDArray[Any]:
    """Collect the answers of all cases in a compartment, shape (k, number); zeros where a case has none."""
    rows = np.zeros((len(computed), number), ROW)
    for own, one in zip(rows, computed, strict=True):
        if side < len(one.series):
            own[:] = one.series[side]
    return rows


def _cases(values: Mapping[str, ArrayLike]) -> list[dict[str, Any]]:
    """Give the values of each case by name; refuse arrays of different lengths, and values that are never allowed."""
    flat = {name: np.atleast_1d(np.asarray(column)) for name, column in dotted(values).items()}
    checked_names(list(flat))
    lengths = {len(column) for column in flat.values() if column.shape != (1,)} or {1}
    if len(lengths) > 1 or any(column.ndim != 1 for column in flat.values()) or not flat:
        shapes = ", ".join(f"{name} {column.shape}" for name, column in flat.items()) or "none"
        raise UsageError(f"values: {shapes} is not allowed; arrays of one length, or single values")
    (number,) = lengths
    columns = {name: np.broadcast_to(column, number).tolist() for name, column in flat.items()}
    for name, column in columns.items():
        ends = [min(column), max(column)] if column and not isinstance(column[0], str) else sorted(set(column))
        for value in ends:
            check_value(name, value)
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _recording(gait: Mapping[str, ArrayLike]) -> Recording:
    """Make a recording from arrays; refuse those that are missing or do not fit."""
    known = {"time", "flexion_angle", "axial_load", "frontal_moment", "femoral_height"}
    unknown = sorted(set(gait) - known)
    if unknown or not {"time", "flexion_angle"} <= set(gait):
        raise UsageError(f"gait: {', '.join(gait) or 'nothing'} is not allowed; time, flexion_angle, axial_load")
    columns = {name: np.array(column, dtype=float) for name, column in gait.items()}
    time = columns["time"]
    if any(column.shape != time.shape or column.ndim != 1 for column in columns.values()) or not len(time):
        raise UsageError("gait: the arrays must be one-dimensional and of equal length")
    if not all(np.isfinite(column).all() for column in columns.values()):
        raise UsageError("gait: the arrays must be finite")
    stamps = np.rint(time / NANOSECOND).astype(np.int64)
    if (np.diff(stamps) <= 0).any():
        raise UsageError("gait: time must increase")
    steps = np.diff(stamps, prepend=stamps[:1]) * NANOSECOND
    zeros, unknown_heights = np.zeros(len(time)), np.full(len(time), np.nan)
    return Recording(
        stamps, steps, columns["flexion_angle"], columns.get("axial_load", zeros),
        columns.get("frontal_moment", zeros), columns.get("femoral_height", unknown_heights),
    )  # fmt: skip


LATERAL = "lateral_"
"""Prefix of the columns with outcomes of the lateral compartment"""

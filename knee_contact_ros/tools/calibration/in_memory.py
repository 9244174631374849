"""`knee_contact_ros.calibrate`: parameters fitted to measurements, with their intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.bag_files import BAG_FILES
from knee_contact_ros.bags.topic_names import names_in_bag
from knee_contact_ros.messages.topics import JOINT_REACTION_FORCE, LOAD_INPUTS
from knee_contact_ros.offline.in_memory import Name, in_python_words
from knee_contact_ros.parameters.load_schema import LOAD_READING
from knee_contact_ros.parameters.reading import load_parameters
from knee_contact_ros.results import Results
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.resources import DEFAULT_PARAMETERS, expanded
from knee_contact_ros.system.terminal import progress
from knee_contact_ros.tools.calibration.contact_problem import problem_of
from knee_contact_ros.tools.calibration.contact_unknowns import fittable_of
from knee_contact_ros.tools.calibration.doubts import doubts
from knee_contact_ros.tools.calibration.fit import Minimum, fitted, settled
from knee_contact_ros.tools.calibration.identifiability import correlation, trades
from knee_contact_ros.tools.calibration.load_problem import fittable_in, load_problem_of
from knee_contact_ros.tools.calibration.losses import LINEAR, LOSSES
from knee_contact_ros.tools.calibration.measured import measured_from, read_measured
from knee_contact_ros.tools.calibration.problem import Data, Problem
from knee_contact_ros.tools.calibration.profile import BetterError, Interval, covariance, intervals
from knee_contact_ros.tools.calibration.reference import referenced
from knee_contact_ros.tools.calibration.unknowns import Free, Unknown, unknowns_of

Floats = NDArray[np.float64]
LEVEL = 0.95
"""Default probability of the intervals"""
STARTS = 4
"""Default number of starts"""
ROUNDS = 6
"""The largest number of times that the intervals are begun: each better fit found on the way begins them again"""
ROUGH = (
    "around the fit the misfit has many dents (a touch falls before a sample or after it): a better fit may lie near, "
    "and the intervals are rough"
)


@dataclass(frozen=True)
class Calibration:
    """Result of `calibrate`: p free parameters in the order in which they were given, fitted to n samples."""

    unknowns: tuple[Unknown, ...]
    """The free parameters: name, start, range and unit of each"""
    measured: Data
    """The measurements to which the parameters were fitted"""
    values: dict[str, float]
    """Fitted values, by name"""
    intervals: dict[str, Interval]
    """Intervals of the probability `level`, by name; empty if none were requested"""
    level: float
    """Probability of the intervals"""
    correlation: Floats
    """Correlations of the estimates (of their logarithms, where a parameter cannot be 0), shape (p, p)"""
    noise: dict[str, float]
    """Standard deviation of the noise of each measured column, given or estimated, in its unit"""
    given: frozenset[str]
    """Names of the columns whose noise was given"""
    rms: dict[str, float]
    """RMS of the residuals of each measured column, in its unit"""
    residuals: dict[str, Floats]
    """Answers of the model less measurements, by column, shape (n,); not a number where nothing was measured"""
    predicted: Results | dict[str, Floats]
    """Answers of the model with the fitted values, shape (n,); for a bag `time` [s] and `axial_force` [N] by name"""
    warnings: tuple[str, ...]
    """Doubts about the fit or its intervals, a sentence each"""
    loss: str
    """Name of the loss that was minimised"""
    remarks: tuple[str, ...] = ()
    """Further remarks on the fit, a line each"""
    also: dict[str, Any] = field(default_factory=dict)
    """Parameters that follow from the fit: for a bag `calibrated`, and `standard_deviation` in body weights"""

    def to_parameters(self) -> dict[str, Any]:
        """Give the fitted values, and those that follow, as parameters for `load_model` or `solve`, beside others."""
        return self.values | self.also

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value:.6g}" for name, value in self.values.items())
        doubted = f", {len(self.warnings)} warning(s)" if self.warnings else ""
        return f"<Calibration: {values}{doubted}>"


def calibrate(
    table: Name | Mapping[str, Any] | Any,
    params: Any = None,
    free: Free = (),
    values: Mapping[str, Any] | None = None,
    *,
    sigma: Mapping[str, float] | None = None,
    loss: str = LINEAR,
    level: float = LEVEL,
    with_intervals: bool = True,
    starts: int = STARTS,
    compiled: bool | None = None,
    remap: Mapping[str, str] | None = None,
    namespace: str = "",
) -> Calibration:
    """Fit parameters to what was measured.

    From a table, parameters of one compartment's model are fitted to a depth, force, gap or height; from a bag, a
    person's constants of the load estimate are fitted to the joint reaction. The method is bounded nonlinear least
    squares (SciPy's `least_squares`), with intervals by profile likelihood; docs/calibration.md says what they mean.
    While fitting, the model is solved to 1e-9 m or better, without a budget.

    Args:
        table: A CSV file, or columns by name (a mapping of arrays of shape (n,), a data frame): `time` [s],
            `flexion_angle` [rad], `load` [N] of the compartment (or `axial_load` [N], of which it bears `load.share`),
            with drive displacement `femoral_height` [m] and optionally the load; and what was measured:
            `penetration_depth` [m], `contact_force` [N], `gap` [m] and, with drive force, `femoral_height` [m]. A cell
            that is empty or not a number was not measured. Or a bag (an .mcap file, a .db3 file or a rosbag2 folder)
            with `/joint_states`, `/ground_reaction_force` and the measured `/joint_reaction_force`.
        params: The knee, as for `load_model`; for a bag, parameters of the load node. The fit starts from their values.
            None: the healthy knee; for a bag, the defaults.
        free: Names of real parameters of `femur`, `tibia`, `contact`, or `load.share`; for a bag, those of `person`; or
            a mapping of names to the ends of a range narrower than the parameter's own, or None.
        values: Values of single parameters, which win over `params`.
        sigma: Standard deviations of the columns' noise in their units, where known (for a bag that of `axial_force`);
            for other columns it is estimated from the residuals.
        loss: `linear` (least squares), or `soft_l1` or `huber`, which are less sensitive to outliers.
        level: Probability of the intervals.
        with_intervals: Whether to compute intervals; without them a fit takes a tenth of the time.
        starts: Number of starts of the search: the values of `params`, and others up to four times larger or smaller.
        compiled: As for `load_model`; by default where that is expected to be faster.
        remap: Other names of a bag's topics: `{"joint_reaction_force": "/implant/force"}`.
        namespace: Namespace of a bag's topics.

    Returns:
        Values, intervals, correlations, noise, residuals, the fitted model's answers, and warnings.

    Raises:
        UsageError: a file, column, topic, parameter or option cannot be used, or a parameter has no effect on what was
            measured.
    """
    with in_python_words():
        remaps = [f"{ours}:={theirs}" for ours, theirs in (remap or {}).items()]
        options = FitOptions(sigma or {}, loss, level, with_intervals, starts, remaps, namespace, compiled)
        return calibrated(table, params, free, values, options)


class FitOptions(NamedTuple):
    """Options of a fit, named as the arguments of `calibrate`."""

    sigma: Mapping[str, float]
    loss: str
    level: float
    with_intervals: bool
    starts: int
    remaps: Sequence[str]
    """Other names of a bag's topics, as joint_reaction_force:=/implant/force"""
    namespace: str
    compiled: bool | None = None


def calibrated(
    data: Name | Mapping[str, Any] | Any, params: Any, free: Free, values: Mapping[str, Any] | None, options: FitOptions
) -> Calibration:
    """Fit parameters as `calibrate` does, with errors that name the options of the command line."""
    _check_options(options)
    problem: Problem
    if is_bag(data):
        sources = [*_parts(params or ()), dict(values or {})]
        problem = _load_problem(Path(expanded(str(data))), sources, free, options)
    elif options.remaps or options.namespace:
        raise UsageError("--remap or --namespace: a table has columns, and no topics")
    else:
        sources = [*_parts(params or DEFAULT_PARAMETERS), dict(values or {})]
        problem = _contact_problem(data, sources, free, options.compiled)
    noise = _noise(options.sigma, problem.measured)
    with progress("Fitting") as advance:
        minimum = fitted(problem, options.loss, noise, options.starts, advance)
    bounds, rough = None, list[str]()
    if options.with_intervals:
        minimum, bounds, rough = _with_intervals(minimum, options.level)
    return _result(minimum, bounds, options.level, rough)


def is_bag(data: Any) -> bool:
    """Whether data is the name of a bag: that of a folder, or of a file with the suffix of one."""
    return isinstance(data, str | PathLike) and (
        Path(expanded(str(data))).is_dir() or any(end in BAG_FILES for end in Path(str(data)).suffixes)
    )


def _contact_problem(
    table: Name | Mapping[str, Any] | Any, params: list[Any], free: Free, compiled: bool | None
) -> Problem:
    parameters = load_parameters(params)
    measured = (
        read_measured(Path(expanded(str(table))), parameters.drive)
        if isinstance(table, str | PathLike)
        else measured_from(table, parameters.drive)
    )
    return problem_of(parameters, measured, unknowns_of(free, fittable_of(parameters, measured)), compiled)


def _load_problem(bag: Path, params: list[Any], free: Free, options: FitOptions) -> Problem:
    parameters = LOAD_READING.load(params)
    unknowns = unknowns_of(free, fittable_in(parameters))
    names = names_in_bag(options.remaps, options.namespace, (*LOAD_INPUTS, JOINT_REACTION_FORCE))
    with progress("Reading") as advance:
        measured = referenced(bag, parameters, names, advance)
    return load_problem_of(parameters, measured, unknowns)


def _with_intervals(minimum: Minimum, level: float) -> tuple[Minimum, list[Interval], list[str]]:
    """Compute the intervals of a fit; a better fit that is found on the way replaces it, and begins them again."""
    for _ in range(ROUNDS - 1):
        try:
            with progress("Intervals") as advance:
                return minimum, intervals(minimum, level, advance), []
        except BetterError as better:
            minimum = settled(replace(minimum, place=better.place))
    with progress("Intervals") as advance:
        return minimum, intervals(minimum, level, advance, ignore_better=True), [ROUGH]


def _result(minimum: Minimum, bounds: list[Interval] | None, level: float, rough: list[str]) -> Calibration:
    problem, measured = minimum.problem, minimum.problem.measured
    answers = problem.predicted(minimum.place)
    residuals = {name: answers[name] - column for name, column in measured.answers.items()}
    rms = {name: float(np.sqrt(np.nanmean(misfit**2))) for name, misfit in residuals.items()}
    deviations = np.sqrt(np.diag(covariance(minimum)))
    names = [unknown.name for unknown in problem.unknowns]
    return Calibration(
        problem.unknowns, measured, problem.values(minimum.place), dict(zip(names, bounds or (), strict=False)), level,
        correlation(minimum), dict(minimum.noise), minimum.given, rms, residuals, answers,
        (*rough, *trades(minimum, bounds), *doubts(minimum, bounds, level, deviations)), minimum.loss,
        tuple(problem.remarks(minimum.place)), problem.also(minimum.place),
    )  # fmt: skip


def _parts(params: Any) -> list[Any]:
    """Give parameters that may come from several sources as a list of these."""
    return list(params) if isinstance(params, list | tuple) else [params]


def _check_options(options: FitOptions) -> None:
    if options.loss not in LOSSES:
        raise UsageError(f"loss: {options.loss!r} is not allowed; one of {', '.join(LOSSES)}")
    if not 0.0 < options.level < 1.0:
        raise UsageError(f"level: {options.level!r} is not allowed; a probability between 0 and 1")
    if options.starts < 1:
        raise UsageError(f"starts: {options.starts!r} is not allowed; 1 or more")


def _noise(sigma: Mapping[str, float], measured: Data) -> dict[str, float]:
    """Check the standard deviations that are given; refuse bad numbers, and columns that were not measured."""
    for name, value in sigma.items():
        if name not in measured.answers:
            raise UsageError(f"--sigma {name}: it was not measured; measured are {', '.join(measured.answers)}")
        if not (isinstance(value, int | float | np.floating) and 0.0 < value < math.inf):
            raise UsageError(f"--sigma {name}: {value!r} is not allowed; a number > 0 in the column's unit")
    return {name: float(value) for name, value in sigma.items()}

"""`knee_contact_ros.calibrate`: the parameters that fit what was measured, with their intervals."""

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
"""Of an interval, unless another one is asked for"""
STARTS = 4
ROUNDS = 6
"""Of intervals, at most: each time a better fit is found on the way, they are begun anew"""
ROUGH = (
    "around the fit the misfit has many dents (a touch falls before a sample or after it): a better fit may lie near, "
    "and the intervals are rough"
)


@dataclass(frozen=True)
class Calibration:
    """What `calibrate` gives. Parameters are in the order in which they were asked for, p of them; n samples."""

    unknowns: tuple[Unknown, ...]
    """What was free: name, start, range and unit of each"""
    measured: Data
    """What it was fitted to"""
    values: dict[str, float]
    """Fitted, by name"""
    intervals: dict[str, Interval]
    """Of the level, by name; empty if none were asked for"""
    level: float
    correlation: Floats
    """Of the estimates (of logarithms, where a parameter cannot be 0), shape (p, p)"""
    noise: dict[str, float]
    """Standard deviation of each measured column, given or found, in its unit"""
    given: frozenset[str]
    """Columns whose noise was given"""
    rms: dict[str, float]
    """Of what is left of each measured column, in its unit"""
    residuals: dict[str, Floats]
    """What the model says less what was measured, shape (n,) each; not a number where nothing was"""
    predicted: Results | dict[str, Floats]
    """The model's answers with the fitted values, shape (n,); of a bag `time` [s] and `axial_force` [N] by name"""
    warnings: tuple[str, ...]
    """What speaks against the fit or its intervals, a sentence each"""
    loss: str
    remarks: tuple[str, ...] = ()
    """What else there is to say of the fit, a line each"""
    also: dict[str, Any] = field(default_factory=dict)
    """Parameters that follow from the fit: of a bag `calibrated`, and `standard_deviation` in body weights"""

    def to_parameters(self) -> dict[str, Any]:
        """The fitted values, and those that follow, as a mapping that `load_model` and `solve` take beside others."""
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

    Of a table, those of one compartment's model, to a depth, force, gap or height; of a bag, a person's constants of
    the load estimate, to the joint reaction. Bounded nonlinear least squares (SciPy's `least_squares`), and intervals
    by profile likelihood; docs/calibration.md says what they mean. While fitting, the model is solved to 1e-9 m or
    better, without a budget.

    Args:
        table: A CSV file, or columns by name (a mapping of arrays of shape (n,), a data frame): `time` [s],
            `flexion_angle` [rad], `load` [N] of the compartment (or `axial_load` [N], of which it bears `load.share`),
            with drive displacement `femoral_height` [m] and the load if you like; and what was measured:
            `penetration_depth` [m], `contact_force` [N], `gap` [m] and, with drive force, `femoral_height` [m]. A cell
            that is empty or not a number was not measured. Or a bag (an .mcap file, a .db3 file or a rosbag2 folder)
            with `/joint_states`, `/ground_reaction_force` and the measured `/joint_reaction_force`.
        params: The knee, as for `load_model`; of a bag those of the load node, likewise. The fit starts from its
            values. None: the healthy knee; of a bag the defaults.
        free: Names of real parameters of `femur`, `tibia`, `contact`, or `load.share`; of a bag those of `person`; or a
            mapping of names to the ends of a range narrower than the parameter's own, or None.
        values: Single parameters, over `params`.
        sigma: Standard deviations of the columns' noise in their units, where known (of a bag that of `axial_force`);
            each other column has that of what is left of it.
        loss: `linear` (least squares), or `soft_l1` or `huber`, which outliers move less.
        level: Probability of the intervals.
        with_intervals: Whether to find intervals; without, a fit takes a tenth of the time.
        starts: From how many places to search: the values of `params`, and others up to four times larger or smaller.
        compiled: As for `load_model`; by default where that is expected to be sooner.
        remap: Other names of a bag's topics: `{"joint_reaction_force": "/implant/force"}`.
        namespace: Take a bag's topics from /NAMESPACE/....

    Returns:
        Values, intervals, correlations, noise, residuals, the fitted model's answers, and warnings.

    Raises:
        UsageError: a file, column, topic, parameter or option cannot be used, or a parameter changes nothing of what
            was measured.
    """
    with in_python_words():
        remaps = [f"{ours}:={theirs}" for ours, theirs in (remap or {}).items()]
        fit = Fit(sigma or {}, loss, level, with_intervals, starts)
        return calibrated(table, params, free, values, fit, Topics(remaps, namespace), compiled)


class Fit(NamedTuple):
    """How to fit; see `calibrate`."""

    sigma: Mapping[str, float]
    loss: str
    level: float
    with_intervals: bool
    starts: int


class Topics(NamedTuple):
    """Where a bag's topics are, as the command is told."""

    remaps: Sequence[str] = ()
    namespace: str = ""


def calibrated(
    data: Name | Mapping[str, Any] | Any, params: Any, free: Free, values: Mapping[str, Any] | None, fit: Fit,
    topics: Topics, compiled: bool | None = None,
) -> Calibration:  # fmt: skip
    """The same for the command line: errors name its options."""
    _check_options(fit.loss, fit.level, fit.starts)
    problem: Problem
    if is_bag(data):
        problem = _load_problem(Path(expanded(str(data))), [*_parts(params or ()), dict(values or {})], free, topics)
    elif any(topics):
        raise UsageError("--remap or --namespace: a table has columns, and no topics")
    else:
        problem = _contact_problem(data, [*_parts(params or DEFAULT_PARAMETERS), dict(values or {})], free, compiled)
    noise = _noise(fit.sigma, problem.measured)
    with progress("Fitting") as advance:
        minimum = fitted(problem, fit.loss, noise, fit.starts, advance)
    found, rough = None, list[str]()
    if fit.with_intervals:
        minimum, found, rough = _with_intervals(minimum, fit.level)
    return _result(minimum, found, fit.level, rough)


def is_bag(data: Any) -> bool:
    """Whether that is the name of a bag: a folder, or a file that ends like one."""
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


def _load_problem(bag: Path, params: list[Any], free: Free, topics: Topics) -> Problem:
    parameters = LOAD_READING.load(params)
    unknowns = unknowns_of(free, fittable_in(parameters))
    names = names_in_bag(topics.remaps, topics.namespace, (*LOAD_INPUTS, JOINT_REACTION_FORCE))
    with progress("Reading") as advance:
        measured = referenced(bag, parameters, names, advance)
    return load_problem_of(parameters, measured, unknowns)


def _with_intervals(minimum: Minimum, level: float) -> tuple[Minimum, list[Interval], list[str]]:
    """The fit with its intervals; a better one that is found on the way takes its place."""
    for number in range(ROUNDS):
        last = number == ROUNDS - 1
        try:
            with progress("Intervals") as advance:
                return minimum, intervals(minimum, level, advance, go_on=last), [ROUGH] if last else []
        except BetterError as better:
            minimum = settled(_moved(minimum, better.place))
    raise AssertionError("the last round goes on")


def _moved(minimum: Minimum, place: Floats) -> Minimum:
    return replace(minimum, place=place)


def _result(minimum: Minimum, found: list[Interval] | None, level: float, rough: list[str]) -> Calibration:
    problem, measured = minimum.problem, minimum.problem.measured
    answers = problem.predicted(minimum.place)
    residuals = {name: answers[name] - column for name, column in measured.answers.items()}
    rms = {name: float(np.sqrt(np.nanmean(misfit**2))) for name, misfit in residuals.items()}
    deviations = np.sqrt(np.diag(covariance(minimum)))
    names = [unknown.name for unknown in problem.unknowns]
    return Calibration(
        problem.unknowns, measured, problem.values(minimum.place), dict(zip(names, found or (), strict=False)), level,
        correlation(minimum), dict(minimum.noise), minimum.given, rms, residuals, answers,
        (*rough, *trades(minimum, found), *doubts(minimum, found, level, deviations)), minimum.loss,
        tuple(problem.remarks(minimum.place)), problem.also(minimum.place),
    )  # fmt: skip


def _parts(params: Any) -> list[Any]:
    """A source as a list of its parts."""
    return list(params) if isinstance(params, list | tuple) else [params]


def _check_options(loss: str, level: float, starts: int) -> None:
    if loss not in LOSSES:
        raise UsageError(f"loss: {loss!r} is not allowed; one of {', '.join(LOSSES)}")
    if not 0.0 < level < 1.0:
        raise UsageError(f"level: {level!r} is not allowed; a probability between 0 and 1")
    if starts < 1:
        raise UsageError(f"starts: {starts!r} is not allowed; 1 or more")


def _noise(sigma: Mapping[str, float], measured: Data) -> dict[str, float]:
    """The standard deviations that are given.

    Raises:
        UsageError: one is none, or of a column that was not measured.
    """
    for name, value in sigma.items():
        if name not in measured.answers:
            raise UsageError(f"--sigma {name}: it was not measured; measured are {', '.join(measured.answers)}")
        if not (isinstance(value, int | float | np.floating) and 0.0 < value < math.inf):
            raise UsageError(f"--sigma {name}: {value!r} is not allowed; a number > 0 in the column's unit")
    return {name: float(value) for name, value in sigma.items()}

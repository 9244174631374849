"""`knee_contact_ros.calibrate`: parameters fitted to measurements, with their intervals.

The work of `knee-contact calibrate`: fit parameters to a table or a bag, and write them into a parameter file.

The table that `calibrate` prints.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from knee_contact_ros import __version__
from knee_contact_ros.bags.bag_files import BAG_FILES
from knee_contact_ros.bags.topic_names import names_in_bag
from knee_contact_ros.lab.calibrate.contact import ANSWERS, fittable_of, measured_from, problem_of, read_measured
from knee_contact_ros.lab.calibrate.fit import (
    LINEAR,
    LOSSES,
    BetterError,
    Data,
    Free,
    Interval,
    Minimum,
    Problem,
    Unknown,
    correlation,
    covariance,
    doubts,
    fitted,
    intervals,
    nested,
    settled,
    trades,
    unknowns_of,
)
from knee_contact_ros.lab.calibrate.load import AXIAL_FORCE, fittable_in, load_problem_of, referenced
from knee_contact_ros.model.types import Floats
from knee_contact_ros.offline.notebooks import Name, in_python_words
from knee_contact_ros.parameters.files import load_parameters, values_set_in
from knee_contact_ros.parameters.schema import LoadParameters, NodeSection, Parameters
from knee_contact_ros.results import Results
from knee_contact_ros.streams.topics import JOINT_REACTION_FORCE, LOAD_INPUTS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import DEFAULT_PARAMETERS, expanded
from knee_contact_ros.system.output_files import partial_name, refuse_existing, refuse_impossible, write_new
from knee_contact_ros.system.terminal import WIDTH, progress, say, shown, warn

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
    parameters = load_parameters(params, LoadParameters)
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


UNITS = ANSWERS | {AXIAL_FORCE: "N"}
"""Units of all columns that can be measured"""


class CalibrateOptions(NamedTuple):
    """Options of the command."""

    data: Path
    """The table or the bag"""
    params: Sequence[Path]
    """Parameter files; none: the healthy knee, or for a bag the load node's defaults"""
    values: Mapping[str, Any]
    """Values of single parameters, by name"""
    free: Sequence[str]
    """Names of the free parameters, also with ranges, as contact.damping=1000:20000"""
    sigma: Sequence[str]
    """Standard deviations of columns, as penetration_depth=1e-6"""
    loss: str
    level: float
    with_intervals: bool
    starts: int
    output: Path
    overwrite: bool = False
    remaps: Sequence[str] = ()
    """Other names of a bag's topics, as joint_reaction_force:=/implant/force"""
    namespace: str = ""
    """Namespace of a bag's topics"""


def run_calibrate(options: CalibrateOptions) -> Calibration:
    """Fit, and write the parameter file.

    Raises:
        UsageError: data, parameters, an option or the output cannot be used. Nothing is written then.
    """
    refuse_impossible(options.output)
    if not options.overwrite:
        refuse_existing(options.output)
    fit_options = FitOptions(
        _sigma(options.sigma), options.loss, options.level, options.with_intervals, options.starts, options.remaps,
        options.namespace,
    )  # fmt: skip
    calibration = calibrated(options.data, list(options.params), options.free, options.values, fit_options)
    partial = partial_name(options.output)
    try:
        write_new(partial, parameter_file(calibration, options).encode())
        partial.replace(options.output)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise UsageError(f"cannot write {options.output}: {error.strerror}") from None
    values_set_in(options.output, _schema(options))
    return calibration


def _schema(options: CalibrateOptions) -> type[NodeSection]:
    """Parameters of the node for which the file is."""
    return LoadParameters if is_bag(options.data) else Parameters


def parameter_file(calibration: Calibration, options: CalibrateOptions) -> str:
    """Write the parameter file as text: only the fitted values, and in comments where they come from."""
    files = ", ".join(path.name for path in options.params) or "the defaults"
    others = "".join(f", {name} {value}" for name, value in options.values.items())
    rms = [f"{name} {value:.4g} {UNITS[name]}" for name, value in calibration.rms.items()]
    comments = [
        f"Written by knee-contact calibrate {__version__}, loss {calibration.loss}; all other parameters: "
        f"{files}{others}.",
        f"Data: {options.data.name}, sha256 {calibration.measured.digest}.",
        f"RMS of what is left: {', '.join(rms)}.",
        *(f"{remark[0].upper()}{remark[1:]}." for remark in calibration.remarks),
        *(f"{name}: {interval_text(calibration, name)}." for name in calibration.intervals),
        *(f"Warning: {warning}." for warning in calibration.warnings),
    ]
    lines = [f"# {' '.join(comment.split())}" for comment in comments]
    lines += [f"/**/{_schema(options).node}:", "  ros__parameters:", *_entries(calibration.also, "    ")]
    for section, values in nested(calibration.values).items():
        lines += [f"    {section}:", *_entries(values, "      ")]
    return "\n".join(lines) + "\n"


def _entries(values: Mapping[str, Any], indent: str) -> list[str]:
    return [f"{indent}{name}: {'true' if value is True else f'{value:.9e}'}" for name, value in values.items()]


def interval_text(calibration: Calibration, name: str) -> str:
    """Write the interval of a parameter as text."""
    low, high, low_open, high_open = calibration.intervals[name]
    below = "not bounded below" if low_open else f"{low:.6g}"
    above = "not bounded above" if high_open else f"{high:.6g}"
    between = f"{below} to {above}" if not (low_open or high_open) else f"{below}, {above}"
    return f"{100.0 * calibration.level:g} % interval {between}"


def _sigma(texts: Sequence[str]) -> dict[str, float]:
    """Read standard deviations, by column."""
    deviations = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            deviations[name] = float(number)
        except ValueError:
            deviations[name] = math.nan
        if not 0.0 < deviations[name] < math.inf:
            raise UsageError(f"--sigma {text}: it must be COLUMN=NUMBER, the number > 0, as penetration_depth=1e-6")
    return deviations


def show_calibration(calibration: Calibration, output: Path) -> None:
    """Print the fitted values with their intervals, the residual of each column, the output file, and warnings."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("parameter [unit]", "start", "fitted", f"{100.0 * calibration.level:g} % interval"):
        table.add_column(heading.replace("[", r"\["), justify="right" if heading in ("start", "fitted") else "left")
    for unknown in calibration.unknowns:
        name = unknown.name + (f"\n  [{unknown.unit}]" if unknown.unit else "")
        value = calibration.values[unknown.name]
        numbers = (f"{unknown.start:.6g}", f"{value:.6g}", _interval_cell(calibration, unknown.name))
        table.add_row(escape(name), *map(shown, numbers))
    Console(width=WIDTH, emoji=False).print(table, highlight=False)
    for name, misfit in calibration.rms.items():
        known = "noise given" if name in calibration.given else "noise found"
        say(f"{name}: RMS {misfit:.4g} {UNITS[name]} left, {known} {calibration.noise[name]:.4g} {UNITS[name]}")
    for remark in calibration.remarks:
        say(remark)
    say("")
    say(f"Parameters: {output}")
    warn(calibration.warnings)


def _interval_cell(calibration: Calibration, name: str) -> str:
    """Return the interval of a parameter as text."""
    if name not in calibration.intervals:
        return "-"
    low, high, low_open, high_open = calibration.intervals[name]
    if low_open and high_open:
        return "not bounded"
    if low_open:
        return f"below {high:.6g}"
    return f"above {low:.6g}" if high_open else f"{low:.6g} to {high:.6g}"

"""`knee-contact calibrate` and `knee_contact_ros.calibrate`: parameters from measurements, with their intervals."""

import inspect
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ... import __version__
from ...bags.bag import Bag
from ...bags.folder import MAGICS, files_of
from ...bags.names import names_in_bag
from ...model.types import Floats
from ...offline.bag_parameters import parameters_for
from ...offline.notebooks import Name, in_python_words
from ...parameters.files import load_parameters, parameter_text
from ...parameters.load_schema import LoadParameters
from ...parameters.schema import Parameters
from ...results import Results, missing_attribute
from ...streams.topics import JOINT_REACTION_FORCE, LOAD_INPUTS
from ...system.arguments import checked
from ...system.errors import UsageError
from ...system.files import DEFAULT_PARAMETERS, expand_user, require, split_rule
from ...system.output_files import (
    PARTIAL,
    check_name_free,
    check_not_input,
    check_writable,
    write_complete,
)
from ...system.progress import progress
from ...system.terminal import as_json, print_json, safe_cell, say, show_table, warn
from . import contact_problem, load_problem, walk
from .fit import LINEAR, LOSSES, Data, Fit, FitProblem, find_fit
from .intervals import Interval, doubts, find_intervals
from .unknowns import Free, Unknown, unknowns_of

MEASURED_UNITS = contact_problem.ANSWER_UNITS | {
    load_problem.AXIAL_FORCE: "N",
    walk.FLEXION: "rad",
}
"""Units of all columns that can be measured"""
MAX_INTERVAL_ROUNDS = 3
"""Largest number of times that intervals are computed: again whenever a better fit is found meanwhile"""
ROUGH_INTERVALS = (
    "near the fit the misfit has several minima (a touch falls before a sample or after it): a better fit may exist, "
    "and the intervals are rough"
)


@dataclass(frozen=True)
class Calibration:
    """Result of `calibrate`: p free parameters in the order in which they were given, fitted to n samples.

    Example:
        >>> from knee_contact_ros import calibrate, load_model
        >>> time, angle, load = [0.0, 0.1, 0.2, 0.3], [0.3] * 4, [200.0, 500.0, 800.0, 300.0]
        >>> measured = load_model({"contact.stiffness": 9e7}).run(time, angle, load)
        >>> table = {"time": time, "flexion_angle": angle, "load": load}
        >>> table["penetration_depth"] = measured.penetration_depth
        >>> found = calibrate(table, free=["contact.stiffness"], with_intervals=False)
        >>> load_model(found.to_parameters())
        <KneeModel: circle on plane, hinge, contact law 9e+07 N/m^1.5, force drive>
    """

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
    """Answers of the model minus measurements, by column, shape (n,); NaN where nothing was measured; none for a walk
    without a joint reaction"""
    predicted: Results | dict[str, Floats]
    """Answers of the model with the fitted values, shape (n,); for a bag `time` [s] and `axial_force` [N] by name; none
    for a walk without a joint reaction"""
    warnings: tuple[str, ...]
    """Doubts about the fit or its intervals, a sentence each"""
    loss: str
    """Name of the loss that was minimised"""
    remarks: tuple[str, ...] = ()
    """Further remarks on the fit, a line each"""
    also: dict[str, Any] = field(default_factory=dict)
    """Parameters that follow from the fit: for a bag `calibrated`, and `standard_deviation` in body weights"""

    def to_parameters(self) -> dict[str, Any]:
        """Return the fitted values, and those that follow from them, as parameters for `load_model` or `solve`."""
        return self.values | self.also

    def __getattr__(self, name: str) -> Any:
        raise missing_attribute(self, name)

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value:.6g}" for name, value in self.values.items())
        doubted = f", {len(self.warnings)} warning(s)" if self.warnings else ""
        return f"<Calibration: {values}{doubted}>"


@in_python_words()
@checked
def calibrate(
    table: Name | Sequence[Name] | Mapping[str, Any] | Any,
    params: Any = None,
    free: Free = (),
    values: Mapping[str, Any] | None = None,
    *,
    sigma: Mapping[str, float] | None = None,
    loss: str = LINEAR,
    level: float = 0.95,
    with_intervals: bool = True,
    starts: int = 4,
    compiled: bool | None = None,
    remap: Mapping[str, str] | None = None,
    namespace: str = "",
) -> Calibration:
    """Fit parameters to measurements.

    From a table, parameters of one compartment's model are fitted to a depth, force, gap or height; from a bag, a
    person's constants of the load estimate are fitted to the joint reaction. The method is bounded nonlinear least
    squares (SciPy's `least_squares`), with intervals by profile likelihood (MINOS of iminuit);
    docs/how-to/uncertainty-and-calibration.md says what they mean.
    While fitting, the model is solved to 1e-9 m or better, without a budget.

    Args:
        table: A CSV file, or columns by name (a mapping of arrays of shape (n,), a data frame): `time` [s],
            `flexion_angle` [rad], `load` [N] of the compartment (or `axial_load` [N], of which it bears `load.share`),
            with drive displacement `femoral_height` [m] and optionally the load; and what was measured:
            `penetration_depth` [m], `contact_force` [N], `gap` [m] and, with drive force, `femoral_height` [m]. An
            empty cell or NaN means not measured. Or a bag (an .mcap file, a .db3 file or a rosbag2 folder)
            with `/joint_states`, `/ground_reaction_force` and the measured `/joint_reaction_force`; or a list of bags
            of one person; each is also left out in turn. For `knee.offset`, `pairing.angle_delay`, and with one of
            them `person.mass`, a bag of a walk needs no joint reaction: it is compared with how other people walk.
        params: The knee, as for `load_model`; for a bag, parameters of the load node. The fit starts from their values.
            None: the healthy knee; for a bag, the defaults.
        free: Names of real parameters of `femur`, `tibia`, `contact`, or `load.share`; for a bag, those of `person`; or
            a mapping of names to the ends of a range narrower than the parameter's own, or None.
        values: ParameterValues of single parameters, which override `params`.
        sigma: Standard deviations of the columns' noise in their units (for a bag of `axial_force`). Those of other
            columns are estimated from the residuals.
        loss: `linear` (least squares), or `soft_l1` or `huber`, which are less sensitive to outliers.
        level: Probability of the intervals.
        with_intervals: Whether to compute intervals; without them a fit takes a tenth of the time.
        starts: Number of starts of the search: the values of `params`, and others up to four times larger or smaller.
        compiled: As for `load_model`; by default where that is expected to be faster.
        remap: Other names of a bag's topics: `{"joint_reaction_force": "/implant/force"}`.
        namespace: Namespace of a bag's topics.

    Returns:
        ParameterValues, intervals, correlations, noise, residuals, the fitted model's answers, and warnings.

    Raises:
        UsageError: a file, column, topic, parameter or option cannot be used, or a parameter has no effect on what was
            measured.

    Example:
        >>> from knee_contact_ros import calibrate, load_model
        >>> time, angle, load = [0.0, 0.1, 0.2, 0.3], [0.3] * 4, [200.0, 500.0, 800.0, 300.0]
        >>> measured = load_model({"contact.stiffness": 9e7}).run(time, angle, load)
        >>> table = {"time": time, "flexion_angle": angle, "load": load}
        >>> table["penetration_depth"] = measured.penetration_depth
        >>> found = calibrate(table, free=["contact.stiffness"], with_intervals=False)
        >>> print(f"{found.values['contact.stiffness']:.3g}")
        9e+07
    """
    for name, value, allowed, words in (
        ("loss", loss, loss in LOSSES, f"one of {', '.join(LOSSES)}"),
        ("level", level, 0.0 < level < 1.0, "a probability between 0 and 1"),
        ("starts", starts, starts >= 1, "1 or more"),
    ):
        if not allowed:
            raise UsageError(f"{name}: {value!r} is not allowed; {words}")
    remaps = [f"{ours}:={theirs}" for ours, theirs in (remap or {}).items()]
    bags = bags_in(table)
    given = [free] if isinstance(free, str) else free
    if bags and {walk.ZERO, walk.CLOCK} & {str(each).partition("=")[0] for each in given}:
        return _of_walk(bags, params, free, values or {}, remaps, namespace, level)
    problem = _problem(table, params, free, values or {}, remaps, namespace, compiled)
    _check_data(problem, sigma or {})
    if with_intervals:
        require("calibrate", "iminuit")
    with progress("Fitting") as advance:
        fit = find_fit(problem, loss, sigma or {}, starts, advance)
    intervals = list[Interval]()
    warnings = []
    if with_intervals:
        fit, intervals, rough = _intervals(fit, level)
        warnings += [ROUGH_INTERVALS] if rough else []
    found = fit.values()
    answers = problem.predicted(found)
    measured = problem.measured
    residuals = {name: answers[name] - column for name, column in measured.answers.items()}
    with progress("Leaving one out") as advance:
        conclusions = problem.conclusions(
            found, lambda others: find_fit(others, loss, fit.noise, 1, advance).values()
        )
    return Calibration(
        problem.unknowns,
        measured,
        found,
        dict(zip(found, intervals, strict=False)),
        level,
        fit.correlation,
        dict(fit.noise),
        fit.given,
        {name: float(np.sqrt(np.nanmean(misfit**2))) for name, misfit in residuals.items()},
        residuals,
        answers,
        (*warnings, *doubts(fit, intervals, level), *conclusions.doubts),
        loss,
        tuple(conclusions.remarks),
        conclusions.parameters,
    )


def _check_data(problem: FitProblem, sigma: Mapping[str, float]) -> None:
    """Refuse too few values, wrong inputs or a wrong start, and noise that cannot be used."""
    measured = problem.measured
    unknowns = problem.unknowns
    if measured.number <= len(unknowns):
        raise UsageError(
            f"{measured.source}: {measured.number} values can be fitted, for {len(unknowns)} parameters; "
            "more are needed than parameters are free"
        )
    problem.predicted({unknown.name: unknown.start for unknown in unknowns})
    for name, deviation in sigma.items():
        if name not in measured.answers:
            raise UsageError(
                f"--sigma {name}: it was not measured; measured are {', '.join(measured.answers)}"
            )
        if not (isinstance(deviation, int | float | np.floating) and 0.0 < deviation < math.inf):
            raise UsageError(
                f"--sigma {name}={deviation}: it must be COLUMN=NUMBER, the number > 0 in its unit"
            )


def _intervals(fit: Fit, level: float) -> tuple[Fit, list[Interval], bool]:
    """Return a fit with its intervals, and whether they are rough; a better fit that is found meanwhile replaces it."""
    for _ in range(MAX_INTERVAL_ROUNDS):
        with progress("Intervals") as advance:
            found = find_intervals(fit, level, advance)
        if found.better is None:
            break
        fit = replace(fit, place=found.better).converged()
    return fit, found.intervals, found.failed or found.better is not None


def bags_in(data: Any) -> list[Path]:
    """Names of the bags, if the data are one or more bags (folders, or files with a bag's suffix); else empty.

    Raises:
        UsageError: there are several names, and one is not a bag's.
    """
    several = list(data) if isinstance(data, list | tuple) else [data]
    names = [Path(expand_user(str(each))) for each in several if isinstance(each, str | PathLike)]
    bags = [
        name
        for name in names
        if name.is_dir() or name.name.removesuffix(PARTIAL).endswith(tuple(MAGICS))
    ]
    if len(names) > 1 and len(bags) < len(names):
        other = next(name for name in names if name not in bags)
        raise UsageError(
            f"{other}: it is not a bag; several bags can be given, but only one table"
        )
    return bags


def _of_walk(
    bags: Sequence[Path],
    params: Any,
    free: Free,
    values: Mapping[str, Any],
    remaps: Sequence[str],
    namespace: str,
    level: float,
) -> Calibration:
    """Find what the sensors of a walk tell without a measured load."""
    parameters = _person(bags, params, values, namespace)
    source = f"a walk without a measured load, which {walk.ZERO} and {walk.CLOCK} are found in"
    unknowns = unknowns_of(free, walk.FOUND, parameters, source)
    names = names_in_bag(remaps, namespace, LOAD_INPUTS)
    with progress("Reading") as advance:
        found = walk.find_in_walk(bags, parameters, unknowns, names, level, advance)
    return Calibration(
        unknowns,
        found.measured,
        found.values,
        found.intervals,
        level,
        np.eye(len(unknowns)),
        found.rms,
        frozenset(),
        found.rms,
        {},
        {},
        tuple(found.doubts),
        LINEAR,
        tuple(found.remarks),
    )


def _sources(params: Any, values: Mapping[str, Any]) -> list[Any]:
    """Return what parameters are loaded from, in a list."""
    return [*(params if isinstance(params, list | tuple) else [params]), dict(values)]


def _person(
    bags: Sequence[Path], params: Any, values: Mapping[str, Any], namespace: str
) -> LoadParameters:
    """Return the parameters of the load node for bags of a person."""
    with Bag(bags[0]) as first:
        sources = _sources(params or (), values)
        person: LoadParameters = parameters_for(first, sources, namespace, LoadParameters)
    return person


def _problem(
    data: Any,
    params: Any,
    free: Free,
    values: Mapping[str, Any],
    remaps: Sequence[str],
    namespace: str,
    compiled: bool | None,
) -> FitProblem:
    """Read the data and the parameters from which a fit starts."""
    bags = bags_in(data)
    if bags:
        person = _person(bags, params, values, namespace)
        unknowns = unknowns_of(free, load_problem.FITTABLE, person, f"bag {bags[0]}")
        names = names_in_bag(remaps, namespace, (*LOAD_INPUTS, JOINT_REACTION_FORCE))
        with progress("Reading") as advance:
            return load_problem.make_load_problem(
                person, load_problem.read_referenced(bags, person, names, advance), unknowns
            )
    if remaps or namespace:
        raise UsageError("--remap or --namespace: a table has columns, and no topics")
    knee = load_parameters(_sources(params or DEFAULT_PARAMETERS, values))
    data = data[0] if isinstance(data, list | tuple) and len(data) == 1 else data
    if isinstance(data, str | PathLike):
        measured = contact_problem.read_measured(Path(expand_user(str(data))), knee.drive)
    else:
        measured = contact_problem.measured_from(data, knee.drive)
    unknowns = unknowns_of(free, contact_problem.fittable(), knee, measured.source)
    return contact_problem.make_contact_problem(knee, measured, unknowns, compiled)


def run_calibrate(
    data: Sequence[Path],
    params: Sequence[Path],
    values: Mapping[str, Any],
    sigma: Sequence[str],
    output: Path,
    overwrite: bool,
    *,
    remaps: Sequence[str],
    **options: Any,
) -> None:
    """Fit as `calibrate` does, write the parameter file, and print the result.

    Args:
        data: The table, or one or more bags.
        params: Parameter files; none: the healthy knee, or for a bag the load node's defaults.
        values: ParameterValues of single parameters, by name.
        sigma: Standard deviations of columns, like penetration_depth=1e-6.
        output: The parameter file.
        overwrite: Whether to replace it.
        remaps: Other names of a bag's topics, like joint_reaction_force:=/implant/force.
        options: Other arguments of `calibrate`; a free parameter may have a range, like contact.damping=1e3:2e4.

    Raises:
        UsageError: data, parameters, an option or the output cannot be used. Nothing is written then.
    """
    check_writable(output)
    check_not_input(output, [*params, *(file for each in data for file in files_of(each))])
    if not overwrite:
        check_name_free(output)
    in_words_of_options: Any = inspect.unwrap(calibrate)
    calibration: Calibration = in_words_of_options(
        list(data),
        list(params),
        values=values,
        sigma=dict(map(_deviation, sigma)),
        remap=dict(split_rule(rule, "--remap") for rule in remaps),
        **options,
    )
    write_complete({output: fitted_parameter_file(calibration, data, params, values).encode()})
    _show(calibration, output)
    warn(calibration.warnings)


def _deviation(text: str) -> tuple[str, float]:
    """Read the standard deviation of a column, with its name; NaN if the text is not a number."""
    name, _, number = text.partition("=")
    try:
        return name, float(number)
    except ValueError:
        return name, math.nan


def fitted_parameter_file(
    found: Calibration, data: Sequence[Path], params: Sequence[Path], values: Mapping[str, Any]
) -> str:
    """Write the parameter file as text: only the fitted values, with comments on their origin."""
    files = ", ".join(path.name for path in params) or "the defaults"
    others = "".join(f", {name} {value}" for name, value in values.items())
    rms = [f"{name} {value:.4g} {MEASURED_UNITS[name]}" for name, value in found.rms.items()]
    intervals_known = [
        f"{name}: {100.0 * found.level:g} % interval {each}"
        for name, each in found.intervals.items()
    ]
    comments = [
        f"Written by knee-contact calibrate {__version__}, loss {found.loss}; all other parameters: {files}{others}.",
        f"Data: {', '.join(path.name for path in data)}, sha256 {found.measured.digest}.",
        *([f"RMS of the residuals: {', '.join(rms)}."] if rms else []),
        *(f"{line[0].upper()}{line[1:]}." for line in (*found.remarks, *intervals_known)),
        *(f"Warning: {warning}." for warning in found.warnings),
    ]
    lines = [
        f"{name}: {'true' if value is True else f'{value:.9e}'}"
        for name, value in found.to_parameters().items()
    ]
    return parameter_text(LoadParameters if bags_in(list(data)) else Parameters, comments, lines)


def _show(found: Calibration, output: Path) -> None:
    """Print the fitted values with their intervals, the residual of each column, remarks, and the output file."""
    if as_json():
        kept = "values", "also", "intervals", "level", "noise", "rms", "remarks", "warnings"
        about = {name: getattr(found, name) for name in kept}
        print_json(**about, files={"Parameters": output})
        return
    rows = []
    for name, start, _, _, unit, _ in found.unknowns:
        interval = str(found.intervals.get(name, "-"))
        with_unit = f"{name}\n  {safe_cell(f'[{unit}]')}" if unit else name
        rows.append((with_unit, f"{start:.6g}", f"{found.values[name]:.6g}", interval))
    headings = ("parameter [unit]", "start", "fitted", f"{100.0 * found.level:g} % interval")
    show_table(headings, rows, right=headings[1:3])
    for name, misfit in found.rms.items():
        unit = MEASURED_UNITS[name]
        known = "given" if name in found.given else "estimated"
        say(f"{name}: RMS {misfit:.4g} {unit}; noise {known}: {found.noise[name]:.4g} {unit}")
    for line in (*found.remarks, "", f"Parameters: {output}"):
        say(line)

"""The problem of fitting a compartment's contact model to a table of measurements."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from knee_contact_ros.lab.calibrate.fit import Data, Problem, Unknown, Values
from knee_contact_ros.lab.gait_bag import digest
from knee_contact_ros.lab.tables import TableFormat, header_of, read_numbers
from knee_contact_ros.model.compiler import worth_compiling
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.types import Floats, Rows, Status, blank
from knee_contact_ros.parameters.build import build_model, retuned
from knee_contact_ros.parameters.files import (
    curve_texts,
    flat_parameters,
    known_parameters,
    load_parameters,
)
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.results import Results
from knee_contact_ros.system.errors import UsageError, meant

TIME, ANGLE, LOAD, AXIAL_LOAD, HEIGHT = "time", "flexion_angle", "load", "axial_load", "femoral_height"
ANSWERS: dict[str, str] = {"penetration_depth": "m", "contact_force": "N", "gap": "m", HEIGHT: "m"}
"""Columns to which the model is fitted, with their units; the height only where it is not prescribed"""
COLUMNS = (TIME, ANGLE, LOAD, AXIAL_LOAD, *ANSWERS)
SHARE = "load.share"
SECTIONS = ("femur.", "tibia.", "contact.")
FINE = 1e-9
"""Tolerance of the depth [m] while fitting: the model's error must be far below that of the measurement"""
RUNS = 300
"""Approximate number of runs of the model that a fit takes for each free parameter"""


@dataclass(frozen=True)
class Measured(Data):
    """Inputs and measured answers of a trial of n samples; for the answers' names see `ANSWERS`."""

    time: Floats
    """Time [s], shape (n,), increasing"""
    angle: Floats
    """Flexion angle [rad], shape (n,)"""
    load: Floats
    """Compressive load of the compartment, or axial load, [N], shape (n,)"""
    axial: bool
    """Whether the load is the axial joint reaction, of which the compartment bears `load.share`"""
    height: Floats | None
    """Prescribed femoral height [m], shape (n,); None with drive force"""

    def load_of(self, share: float) -> Floats:
        """Return the load of the compartment [N]: the `share` of an axial load, or the measured load itself."""
        return share * self.load if self.axial else self.load


def read_measured(path: Path, drive: str) -> Measured:
    """Read a trial from a text table, as `import-csv` does; an empty cell or nan means that nothing was measured.

    Columns are `time` [s], `flexion_angle` [rad], `load` or `axial_load` [N]
    or, with drive displacement, `femoral_height` [m]; and one or more of `ANSWERS`.

    Raises:
        UsageError: the file cannot be read or is not such a table, or values make no sense.
    """
    header = header_of(path, COLUMNS, TableFormat())
    for name in header.names:
        if header.names.count(name) > 1:
            raise UsageError(f"{path}: column {name or repr('')} is there twice")
    numbers, _, _ = read_numbers(header, range(len(header.names)), TableFormat())
    columns = dict(zip(header.names, numbers.T, strict=True))
    return replace(measured_from(columns, drive, str(path)), digest=digest(path))


def measured_from(table: Mapping[str, ArrayLike] | Any, drive: str, source: str = "table") -> Measured:
    """Make a trial from columns by name: a mapping of arrays of shape (n,), or a data frame; see `read_measured`.

    Args:
        table: The columns.
        drive: The parameter `drive`: force or displacement.
        source: Name of the table, for messages.

    Raises:
        UsageError: columns are missing, or values make no sense.
    """
    columns = {str(name): _column(table, name, source) for name in table}
    loads = [name for name in (LOAD, AXIAL_LOAD) if name in columns]
    if len(loads) == 2:
        raise UsageError(f"{source}: columns load and axial_load are both there; give the one that was measured")
    inputs = [TIME, ANGLE, *([HEIGHT] if drive == "displacement" else []), *loads]
    inputs += [LOAD] if drive != "displacement" and not loads else []
    for name in inputs:
        if name not in columns:
            raise UsageError(f"{source}: it has no column {name}, which drive {drive} needs; it has "
                             f"{', '.join(columns) or 'none'}")  # fmt: skip
    measurable = [name for name in ANSWERS if name not in inputs]
    answers = {name: columns[name] for name in measurable if name in columns}
    if not answers:
        raise UsageError(f"{source}: nothing is measured in it; one or more of the columns {', '.join(measurable)} "
                         "are needed")  # fmt: skip
    if len({len(column) for column in columns.values()}) > 1 or not len(columns[TIME]):
        raise UsageError(f"{source}: its columns must be equally long, with one sample or more")
    for name in (*inputs, *answers):
        column = columns[name]
        wrong = ~np.isfinite(column) if name in inputs else np.isinf(column)
        if wrong.any():
            what = "an input must be known at every sample" if name in inputs else "allowed are numbers and empty cells"
            where = f"column {name} is {column[wrong][0]:g} in row {int(wrong.argmax()) + 1}"
            raise UsageError(f"{source}: {where}; {what}")
        if np.isnan(column).all():
            raise UsageError(f"{source}: column {name} is empty; leave it out, or give what was measured")
    time = columns[TIME]
    if (back := np.diff(np.rint(time * 1e9)) <= 0.0).any():
        row = int(back.argmax()) + 2
        raise UsageError(f"{source}: column {TIME} must increase, by a nanosecond or more; row {row} does not")
    load = columns[loads[0]] if loads else np.zeros(len(time))
    height = columns[HEIGHT] if HEIGHT in inputs else None
    return Measured(source, "", answers, time, columns[ANGLE], load, loads == [AXIAL_LOAD], height)


def _column(table: Any, name: Any, source: str) -> Floats:
    """Copy a column as numbers."""
    if str(name) not in COLUMNS:
        raise UsageError(f"{source}: column {name or repr(name)} is not known; {meant(str(name), COLUMNS)}")
    try:
        column = np.array(table[name], dtype=np.float64)
    except (TypeError, ValueError):
        raise UsageError(f"{source}: column {name} must hold numbers") from None
    if column.ndim != 1:
        raise UsageError(f"{source}: column {name} has shape {column.shape}; allowed is (n,)")
    return column


def fittable() -> list[str]:
    """Names of the parameters that may be free; the fit refuses one that does not affect the model."""
    known = known_parameters()
    return [SHARE, *(name for name in known if name.startswith(SECTIONS) and isinstance(known[name].default, float))]


@dataclass(frozen=True)
class ContactProblem(Problem):
    """The problem of fitting the contact model of a compartment."""

    measured: Measured
    parameters: Parameters
    """All parameters at the start"""
    model: KneeModel
    """Model at the start"""
    texts: Mapping[str, str]
    """Contents of the files that parameters name, by parameter"""

    def answers(self, values: Values) -> Rows:
        """Compute the answers, shape (n,), without the checks of `KneeModel.run`; see `Problem.answers`.

        Values are within their ranges, and parameters are not checked again: that takes milliseconds.
        """
        changed = self.parameters
        for name, value in values.items():
            section, own = name.split(".")
            changed = changed.model_copy(update={section: getattr(changed, section).model_copy(update={own: value})})
        femur, tibia, trial = changed.femur, changed.tibia, self.measured
        if femur.geometry == tibia.geometry == "circle" and tibia.radius <= femur.radius:
            raise UsageError(f"tibia.radius: {tibia.radius:g} must exceed femur.radius, {femur.radius:g}")
        stamps = np.rint(trial.time * 1e9)
        durations = np.diff(stamps, prepend=stamps[:1]) * 1e-9
        height = np.full(len(stamps), math.nan) if trial.height is None else trial.height
        samples = np.column_stack([durations, trial.angle, trial.load_of(changed.load.share), height])
        answers = blank(len(samples))
        same_surfaces = (changed.femur.radius, changed.tibia) == (self.parameters.femur.radius, self.parameters.tibia)
        try:
            model = retuned(self.model, changed) if same_surfaces else self._made(changed)
            model.compute(samples, answers)
        except ValueError as error:
            raise UsageError(f"{trial.source}: {error}") from None
        return answers

    def _made(self, parameters: Parameters) -> KneeModel:
        return replace(build_model(parameters, curves=self.texts), compiled=self.model.compiled, results=Results)

    def predicted(self, values: Values) -> Results:
        """Compute the answers by a run of a model, after a check of all parameters; see `Problem.predicted`."""
        parameters = load_parameters(flat_parameters(self.parameters) | values)
        trial = self.measured
        try:
            series = self._made(parameters).run(
                trial.time, trial.angle, trial.load_of(parameters.load.share), trial.height
            )
        except ValueError as error:
            raise UsageError(f"{trial.source}: {error}") from None
        return series if isinstance(series, Results) else series.view(Results)

    def conclusions(
        self,
        values: Values,
        refit: Callable[[Problem], Values],  # noqa: ARG002
    ) -> tuple[list[str], dict[str, Any], list[str]]:
        """Report answers with a status that makes them unusable."""
        status = self.predicted(values)["status"]
        faults = {Status.NOT_CONVERGED: "missed their tolerance", Status.IMPLAUSIBLE: "are implausibly deep"}
        counts = {fault: int(np.count_nonzero(status & bit)) for bit, fault in faults.items()}
        return [], {}, [f"{count} of {len(status)} answers {fault}" for fault, count in counts.items() if count]


def problem_of(
    parameters: Parameters, measured: Measured, unknowns: tuple[Unknown, ...], compiled: bool | None
) -> ContactProblem:
    """Make the problem of fitting a compartment's contact model, with a tolerance of `FINE` or less.

    Args:
        parameters: All parameters at the start.
        measured: The trial.
        unknowns: The free parameters.
        compiled: Whether to use the compiled model; None: where that is expected to be faster.

    Raises:
        UsageError: the load is the axial one but the share is not fixed, or inputs are too large for a knee.
    """
    if measured.axial and parameters.load.rule != "fixed_share":
        raise UsageError(f"{measured.source}: column axial_load needs load.compartment fixed_share, not "
                         f"{parameters.load.rule}; give the compartment's own load as column load")  # fmt: skip
    tolerance = min(parameters.fidelity.tolerance, FINE)
    fidelity = parameters.fidelity.model_copy(update={"tolerance": tolerance, "budget": 0})
    exact = parameters.model_copy(update={"fidelity": fidelity})
    texts = curve_texts(exact, {})
    if compiled is None:
        compiled = worth_compiling(RUNS * len(unknowns) * len(measured.time))
    model = replace(build_model(exact, curves=texts), compiled=compiled, results=Results)
    return ContactProblem(measured, unknowns, exact, model, texts)

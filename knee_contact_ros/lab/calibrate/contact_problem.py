"""Fit the contact model of a compartment to a table of what was measured of it."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...model.arrays import InputError, plain_array
from ...model.knee import KneeModel
from ...model.types import Floats, Status
from ...parameters.build import build_model, contact_pair, retuned
from ...parameters.curves import curve_texts
from ...parameters.files import flat_parameters, known_parameters, load_parameters
from ...parameters.schema import Parameters
from ...results import Results
from ...system.errors import UsageError, suggest
from ..gait_bag import digest
from ..headers import TableFormat, header_of
from ..tables import read_numbers
from ..units import check_unit
from .fit import Conclusions, Data, FitProblem, ParameterValues
from .unknowns import Unknown

INPUT_UNITS = {"time": "s", "flexion_angle": "rad", "load": "N", "axial_load": "N"}
"""Columns of the inputs, with their units"""
ANSWER_UNITS: dict[str, str] = {
    "penetration_depth": "m",
    "contact_force": "N",
    "gap": "m",
    "femoral_height": "m",
}
"""Columns to which the model is fitted, with their units; with drive displacement the height is an input"""
UNITS = INPUT_UNITS | ANSWER_UNITS
FIT_TOLERANCE = 1e-9
"""Tolerance of the depth [m] while fitting: the model's error must be far below that of the measurement"""


@dataclass(frozen=True)
class Measured(Data):
    """Inputs and measured answers of a trial of n samples; for the answers' names see `ANSWER_UNITS`."""

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
    or, with drive displacement, `femoral_height` [m]; and one or more of `ANSWER_UNITS`.

    Raises:
        UsageError: the file cannot be read or is not such a table, or values make no sense.
    """
    header = header_of(path, UNITS, TableFormat())
    places = [header.place(name) for name in header.names]
    numbers, stated_units, _ = read_numbers(header, places, TableFormat())
    measured = measured_from(dict(zip(header.names, numbers.T, strict=True)), drive, str(path))
    for place, name in enumerate(header.names):
        stated = stated_units.get(place, "")
        for note in check_unit(path, name, stated, UNITS[name], "it must be in", cure=""):
            warnings.warn(note, stacklevel=2)
    return replace(measured, digest=digest(path))


def measured_from(
    table: Mapping[str, ArrayLike] | Any, drive: str, source: str = "table"
) -> Measured:
    """Make a trial from columns by name: a mapping of arrays of shape (n,), or a data frame; see `read_measured`.

    Args:
        table: The columns.
        drive: The parameter `drive`: force or displacement.
        source: Name of the table, for messages.

    Raises:
        UsageError: columns are missing, or values make no sense.
    """
    if not (isinstance(table, Mapping) or hasattr(table, "columns")):
        raise UsageError(f"{source}: needed are a file, bags, or columns by name")
    columns = {str(name): _column(table, name, source) for name in table}
    loads = [name for name in ("load", "axial_load") if name in columns]
    if len(loads) == 2:
        raise UsageError(
            f"{source}: columns load and axial_load are both there; give the one that was measured"
        )
    if drive == "displacement":
        inputs = ["time", "flexion_angle", "femoral_height", *loads]
    else:
        inputs = ["time", "flexion_angle", *(loads or ["load"])]
    for name in inputs:
        if name not in columns:
            raise UsageError(
                f"{source}: it has no column {name}, which drive {drive} needs; it has "
                f"{', '.join(columns) or 'none'}"
            )
    measurable = [name for name in ANSWER_UNITS if name not in inputs]
    answers = {name: columns[name] for name in measurable if name in columns}
    if not answers:
        raise UsageError(
            f"{source}: nothing is measured in it; one or more of the columns {', '.join(measurable)} "
            "are needed"
        )
    _check_columns(columns, inputs, answers, source)
    return Measured(
        source,
        "",
        answers,
        columns["time"],
        columns["flexion_angle"],
        columns[loads[0]] if loads else np.zeros(len(columns["time"])),
        loads == ["axial_load"],
        columns["femoral_height"] if drive == "displacement" else None,
    )


def _check_columns(
    columns: Mapping[str, Floats],
    inputs: Sequence[str],
    answers: Mapping[str, Floats],
    source: str,
) -> None:
    """Refuse columns that do not fit, values that make no sense, and times that do not increase."""
    time = columns["time"]
    if len({len(column) for column in columns.values()}) > 1 or not len(time):
        raise UsageError(f"{source}: its columns must be equally long, with one sample or more")
    for name in inputs:
        fault = "an input must be known at every sample"
        _check_values(
            f"{source}: column {name}", columns[name], ~np.isfinite(columns[name]), fault
        )
    for name, column in answers.items():
        fault = "allowed are numbers and empty cells"
        _check_values(f"{source}: column {name}", column, np.isinf(column), fault)
        if np.isnan(column).all():
            raise UsageError(
                f"{source}: column {name} is empty; leave it out, or give what was measured"
            )
    if (back := np.diff(np.rint(time * 1e9)) <= 0.0).any():
        row = int(back.argmax()) + 2
        raise UsageError(
            f"{source}: column time must increase, by a nanosecond or more; row {row} does not"
        )


def _check_values(where: str, column: Floats, wrong: NDArray[np.bool_], fault: str) -> None:
    """Refuse the first wrong value of a column."""
    if wrong.any():
        row = int(wrong.argmax())
        raise UsageError(f"{where} is {column[row]:g} in row {row + 1}; {fault}")


def _column(table: Any, name: Any, source: str) -> Floats:
    """Copy a column as numbers."""
    if str(name) not in UNITS:
        raise UsageError(
            f"{source}: column {name or repr(name)} is not known; {suggest(str(name), [*UNITS])}"
        )
    try:
        return plain_array(f"column {name}", table[name]).copy()
    except InputError as error:
        raise UsageError(f"{source}: {error}") from None


def fittable() -> list[str]:
    """Names of the parameters that may be free; the fit refuses one that does not affect the model."""
    known = known_parameters()
    sections = ("femur.", "tibia.", "contact.")
    real = [name for name in known if isinstance(known[name].default, float)]
    return ["load.share", *(name for name in real if name.startswith(sections))]


@dataclass(frozen=True)
class ContactProblem(FitProblem):
    """The problem of fitting the contact model of a compartment."""

    measured: Measured
    parameters: Parameters
    """All parameters at the start"""
    model: KneeModel
    """Model at the start"""
    texts: Mapping[str, str]
    """Contents of the files that parameters name, by parameter"""

    def answers(self, values: ParameterValues) -> Results:
        """Compute the answers, shape (n,); see `FitProblem.answers`.

        ParameterValues are within their ranges, and parameters are not checked again: that takes milliseconds.
        """
        changed = self.parameters
        for name, value in values.items():
            section, own = name.split(".")
            changed = changed.model_copy(
                update={section: getattr(changed, section).model_copy(update={own: value})}
            )
        femur, tibia = changed.femur, changed.tibia
        if femur.geometry == tibia.geometry == "circle" and tibia.radius <= femur.radius:
            raise UsageError(
                f"tibia.radius: {tibia.radius:g} must exceed femur.radius, {femur.radius:g}"
            )
        with warnings.catch_warnings():
            # `predicted` has warned of implausible inputs.
            warnings.simplefilter("ignore")
            return self._run(changed)

    def _run(self, parameters: Parameters) -> Results:
        """Run a model with other parameters; its surfaces are made again only if they change."""
        trial = self.measured
        start = self.parameters
        same_surfaces = (
            parameters.femur.radius == start.femur.radius and parameters.tibia == start.tibia
        )
        try:
            pair = self.model.pair if same_surfaces else contact_pair(parameters, self.texts)
            model = retuned(replace(self.model, pair=pair), parameters)
            results = model.run(
                trial.time, trial.angle, trial.load_of(parameters.load.share), trial.height
            )
        except ValueError as error:
            raise UsageError(f"{trial.source}: {error}") from None
        return results.view(Results)

    def predicted(self, values: ParameterValues) -> Results:
        """Compute the answers after a check of all parameters; see `FitProblem.predicted`."""
        return self._run(load_parameters(flat_parameters(self.parameters) | values))

    def conclusions(
        self,
        values: ParameterValues,
        refit: Callable[[FitProblem], ParameterValues],  # noqa: ARG002
    ) -> Conclusions:
        """Report answers with a status that makes them unusable."""
        status = self.predicted(values)["status"]
        doubts = []
        for bit, fault in (
            (Status.NOT_CONVERGED, "missed their tolerance"),
            (Status.IMPLAUSIBLE, "are implausibly deep"),
        ):
            if count := int(np.count_nonzero(status & bit)):
                doubts.append(f"{count} of {len(status)} answers {fault}")
        return Conclusions([], {}, doubts)


def make_contact_problem(
    parameters: Parameters,
    measured: Measured,
    unknowns: tuple[Unknown, ...],
    compiled: bool | None,
) -> ContactProblem:
    """Make the problem of fitting a compartment's contact model, with a tolerance of `FIT_TOLERANCE` or less.

    Args:
        parameters: All parameters at the start.
        measured: The trial.
        unknowns: The free parameters.
        compiled: Whether to use the compiled model; None: where that is expected to be faster.

    Raises:
        UsageError: the load is the axial one but the share is not fixed, or inputs are too large for a knee.
    """
    if measured.axial and parameters.load.rule != "fixed_share":
        raise UsageError(
            f"{measured.source}: column axial_load needs load.compartment fixed_share, not "
            f"{parameters.load.rule}; give the compartment's own load as column load"
        )
    tolerance = min(parameters.fidelity.tolerance, FIT_TOLERANCE)
    fidelity = parameters.fidelity.model_copy(update={"tolerance": tolerance, "budget": 0})
    exact = parameters.model_copy(update={"fidelity": fidelity})
    texts = curve_texts(exact, {})
    model = replace(build_model(exact, curves=texts), compiled=compiled, results=Results)
    return ContactProblem(measured, unknowns, exact, model, texts)

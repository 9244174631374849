"""Tables of measurements: inputs over time, and the depth, force, gap or height to which parameters are fitted.

The parameters of the contact model that can be fitted.

The problem of fitting the contact model of a compartment to what was measured of it.
"""

from __future__ import annotations

import difflib
import hashlib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from knee_contact_ros.lab.calibrate.fit import STEP, Fittable, Problem, Unknown, nested
from knee_contact_ros.model.compiler import worth_compiling
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.types import Floats, Rows, Status, blank
from knee_contact_ros.parameters.build import build_model, retuned
from knee_contact_ros.parameters.files import (
    all_values,
    curve_texts,
    flat_parameters,
    known_parameters,
    load_parameters,
)
from knee_contact_ros.parameters.schema import LoadParameters, Parameters, constants_of
from knee_contact_ros.results import Results
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import read_regular

LARGEST_FILE = 2**28
"""Largest size [B] of a file"""
TIME, ANGLE, LOAD, AXIAL_LOAD, HEIGHT = "time", "flexion_angle", "load", "axial_load", "femoral_height"
ANSWERS = {"penetration_depth": "m", "contact_force": "N", "gap": "m", HEIGHT: "m"}
"""Columns to which the model is fitted, with their units; the height only where it is not prescribed"""
COLUMNS = (TIME, ANGLE, LOAD, AXIAL_LOAD, *ANSWERS)
COMMENT = "#"


class Measured(NamedTuple):
    """Inputs and measured answers of a trial of n samples."""

    source: str
    """Name of the file or table, for messages"""
    digest: str
    """SHA-256 of the file; empty for a table in memory"""
    time: Floats
    """Time [s], shape (n,), increasing"""
    angle: Floats
    """Flexion angle [rad], shape (n,)"""
    load: Floats
    """Compressive load of the compartment, or the axial one, [N], shape (n,)"""
    axial: bool
    """Whether the load is the axial joint reaction, of which the compartment bears `load.share`"""
    height: Floats | None
    """Prescribed femoral height [m], shape (n,); None with drive force"""
    answers: dict[str, Floats]
    """Measured columns by name, see `ANSWERS`, shape (n,) each; not a number where nothing was measured"""

    @property
    def number(self) -> int:
        """Number of measured values."""
        return sum(int(np.isfinite(column).sum()) for column in self.answers.values())

    def load_of(self, share: float) -> Floats:
        """Give the load of the compartment [N], which bears a `share` of an axial load."""
        return share * self.load if self.axial else self.load


def read_measured(path: Path, drive: str) -> Measured:
    """Read a trial from a CSV file: names in the first line, an empty cell (or nan) where nothing was measured.

    Lines that begin with `#` are ignored. Columns are `time` [s], `flexion_angle` [rad], `load` or `axial_load` [N]
    or, with drive displacement, `femoral_height` [m]; and one or more of `ANSWERS`.

    Raises:
        UsageError: the file cannot be read or is no such table, or values make no sense.
    """
    try:
        content = read_regular(path, LARGEST_FILE)
        text = content.decode("utf-8-sig")
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"cannot read {path}: it is not a text file in UTF-8") from None
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(COMMENT)]
    names = [name.strip() for name in lines[0].split(",")] if lines else []
    doubled = [name for place, name in enumerate(names) if name in names[:place]]
    if doubled:
        raise UsageError(f"{path}: column {doubled[0] or repr('')} is there twice")
    _check_names(names, str(path))
    rows = np.array([_row(line, len(names), number, path) for number, line in enumerate(lines[1:], start=1)])
    columns = {name: rows[:, place] if len(rows) else rows for place, name in enumerate(names)}
    return measured_from(columns, drive, str(path))._replace(digest=hashlib.sha256(content).hexdigest())


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
    _check_names(columns, source)
    prescribed = drive == "displacement"
    loads = [name for name in (LOAD, AXIAL_LOAD) if name in columns]
    if len(loads) == 2:
        raise UsageError(f"{source}: columns load and axial_load are both there; give the one that was measured")
    needed = [TIME, ANGLE, *([HEIGHT] if prescribed else [] if loads else [LOAD])]
    for name in needed:
        if name not in columns:
            present = ", ".join(columns) or "none"
            raise UsageError(f"{source}: it has no column {name}, which drive {drive} needs; it has {present}")
    answers = {name: columns[name] for name in ANSWERS if name in columns and name not in needed}
    if not answers:
        known = ", ".join(name for name in ANSWERS if name not in needed)
        raise UsageError(f"{source}: nothing is measured in it; one or more of the columns {known} are needed")
    if len({len(column) for column in columns.values()}) > 1 or not len(columns[TIME]):
        raise UsageError(f"{source}: its columns must be equally long, with one sample or more")
    for name in {*needed, *loads}:
        _check_finite(columns[name], name, source, all_of_them=True)
    for name, column in answers.items():
        _check_finite(column, name, source, all_of_them=False)
    time = columns[TIME]
    if not (np.diff(np.rint(time * 1e9)) > 0.0).all():
        row = int(np.argmin(np.diff(np.rint(time * 1e9)) > 0.0)) + 2
        raise UsageError(f"{source}: column {TIME} must increase, by a nanosecond or more; row {row} does not")
    load = columns[loads[0]] if loads else np.zeros(len(time))
    height = columns[HEIGHT] if prescribed else None
    return Measured(source, "", time, columns[ANGLE], load, loads == [AXIAL_LOAD], height, answers)


def _column(table: Any, name: str, source: str) -> Floats:
    """Copy a column as numbers."""
    try:
        column = np.array(table[name], dtype=np.float64)
    except (TypeError, ValueError):
        raise UsageError(f"{source}: column {name} must hold numbers") from None
    if column.ndim != 1:
        raise UsageError(f"{source}: column {name} has shape {column.shape}; allowed is (n,)")
    return column


def _row(line: str, columns: int, number: int, path: Path) -> list[float]:
    """Read the numbers of a line; an empty cell is not a number."""
    try:
        cells = [float(cell) if cell.strip() else math.nan for cell in line.split(",")]
    except ValueError:
        cells = []
    if len(cells) != columns:
        raise UsageError(f"{path}: row {number} does not hold {columns} numbers or empty cells: {line[:60]}")
    return cells


def _check_names(names: Iterable[str], source: str) -> None:
    for name in names:
        if name not in COLUMNS:
            near = difflib.get_close_matches(name, COLUMNS, n=1, cutoff=0.6)
            hint = f"did you mean {near[0]}?" if near else f"allowed are {', '.join(COLUMNS)}"
            raise UsageError(f"{source}: column {name or repr(name)} is not known; {hint}")


def _check_finite(column: Floats, name: str, source: str, *, all_of_them: bool) -> None:
    """Refuse an input that is missing or infinite anywhere, and an answer that is infinite or missing everywhere."""
    wrong = ~np.isfinite(column) if all_of_them else np.isinf(column)
    if wrong.any():
        what = "an input must be known at every sample" if all_of_them else "allowed are numbers and empty cells"
        raise UsageError(f"{source}: column {name} is {column[wrong][0]:g} in row {int(wrong.argmax()) + 1}; {what}")
    if np.isnan(column).all():
        raise UsageError(f"{source}: column {name} is empty; leave it out, or give what was measured")


SHARE = "load.share"
SECTIONS = ("femur.", "tibia.", "contact.")
RADII = ("femoral_radius", "tibial_radius")
ELASTIC = {"stiffness": ("youngs_modulus", "poissons_ratio"), "stiffness_2": ("youngs_modulus_2", "poissons_ratio_2")}
"""Parameters from which a stiffness is computed where `contact.stiffness_from` is material"""


def fittable_of(parameters: Parameters, measured: Measured) -> Fittable:
    """Give the parameters that can be fitted to a trial: real ones on which the model of the compartment depends."""
    used, known = _used_parameters(parameters, measured), known_parameters()

    def why_not(name: str) -> str:
        if name == SHARE:
            return f"{measured.source} has no column axial_load, of which it is the share"
        if name not in known and name in known_parameters(LoadParameters):
            return f"it is one of the load node, which is fitted to a bag; to a table {', '.join(used)} are"
        if name not in known or not name.startswith(SECTIONS):
            return ""
        if not isinstance(known[name].default, float):
            return f"it is no real number; allowed are {', '.join(used)}"
        model = f"law {parameters.contact.law}, femur {parameters.femur.geometry}, tibia {parameters.tibia.geometry}"
        if parameters.contact.stiffness_from == "material":
            model += ", stiffness from material"
        return f"nothing depends on it ({model}, drive {parameters.drive}); allowed are {', '.join(used)}"

    return Fittable(used, known, all_values(parameters), "contact.stiffness", why_not)


def _used_parameters(parameters: Parameters, measured: Measured) -> list[str]:
    contact, femur, tibia = parameters.contact, parameters.femur, parameters.tibia
    names = [name for name in constants_of(contact.law) if isinstance(getattr(contact, name), float)]
    if contact.stiffness_from == "material" and "stiffness" in names:
        elastic = [name for stiffness, made_of in ELASTIC.items() if stiffness in names for name in made_of]
        names = [name for name in names if name not in (*ELASTIC, "exponent")] + [*elastic, *RADII]
    used = [f"contact.{name}" for name in dict.fromkeys(names)]
    if measured.height is None:
        used.append("femur.mass")
    used.append("femur.radius" if femur.geometry == "circle" else "femur.scale")
    used += {"plane": ["tibia.slope"], "circle": ["tibia.radius"], "profile": ["tibia.scale"]}.get(tibia.geometry, [])
    return [*used, *([SHARE] if measured.axial else [])]


FINE = 1e-9
"""Tolerance of the depth [m] while fitting: the model's error must be far below that of the measurement"""
RUNS = 300
"""Approximate number of runs of the model that a fit takes for each free parameter"""


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

    def answers(self, place: Floats) -> Rows:
        """Compute the answers, shape (n,), without the checks of `KneeModel.run`; see `Problem.answers`."""
        values = self.values(place)
        parameters = _with(self.parameters, values)
        trial, height = self.measured, self.measured.height
        if height is None:
            height = np.full(len(trial.time), math.nan)
        stamps = np.rint(trial.time * 1e9)
        durations = np.diff(stamps, prepend=stamps[:1]) * 1e-9
        samples = np.column_stack([durations, trial.angle, trial.load_of(parameters.load.share), height])
        answers = blank(len(samples))
        try:
            self._model(parameters, values).compute(samples, answers)
        except ValueError as error:
            raise UsageError(f"{trial.source}: {error}") from None
        return answers

    def predicted(self, place: Floats) -> Results:
        """Compute the answers by a run of a model; see `Problem.predicted`."""
        parameters = checked(self.parameters, self.values(place))
        trial = self.measured
        try:
            model = self._made(parameters)
            series = model.run(trial.time, trial.angle, trial.load_of(parameters.load.share), trial.height)
        except ValueError as error:
            raise UsageError(f"{trial.source}: {error}") from None
        return series.view(Results) if not isinstance(series, Results) else series

    def doubts(self, place: Floats) -> list[str]:
        """Report answers with a status that makes them unusable, and landings at which a measured force leaps."""
        return [*self._unusable(place), *self._leaps(place)]

    def _unusable(self, place: Floats) -> list[str]:
        status = self.answers(place)["status"]
        sentences = []
        for bit, fault in (
            (Status.NOT_CONVERGED, "missed their tolerance"),
            (Status.IMPLAUSIBLE, "are implausibly deep"),
        ):
            if count := int(np.count_nonzero(status & bit)):
                sentences.append(f"{count} of {len(status)} answers {fault}")
        return sentences

    def _leaps(self, place: Floats) -> list[str]:
        """Report landings among samples of the force, under a contact law whose force leaps at touch."""
        forces = self.measured.answers.get("contact_force")
        if forces is None:
            return []
        force, _, _ = self.model.law.layers[0].force_at(0.0, 1.0, 1.0)
        apart = np.asarray(self.predicted(place)["gap"]) > 0.0
        landings = int((apart[:-1] & ~apart[1:] & np.isfinite(forces[1:])).sum())
        if force <= 0.0 or not landings:
            return []
        return [f"contact_force: it leaps at touch under this law, in {landings} landing(s), and a sample falls before "
                "or after it: the misfit jumps, and the intervals are rough; leave these samples empty"]  # fmt: skip

    def _model(self, parameters: Parameters, values: Mapping[str, float]) -> KneeModel:
        """Make the model of some parameters; surfaces are made again only if a parameter of theirs is free."""
        if any(name.startswith(("femur.", "tibia.")) and name != "femur.mass" for name in values):
            return self._made(parameters)
        return retuned(self.model, parameters)

    def _made(self, parameters: Parameters) -> KneeModel:
        model = build_model(parameters, curves=self.texts)
        return replace(model, compiled=self.model.compiled, results=Results)


def problem_of(
    parameters: Parameters, measured: Measured, unknowns: tuple[Unknown, ...], compiled: bool | None
) -> ContactProblem:
    """Make the problem of fitting a compartment's contact model, with a tolerance that is small enough.

    Args:
        parameters: All parameters at the start.
        measured: The trial.
        unknowns: The free parameters.
        compiled: Whether to use the compiled model; None: where that is expected to be faster.

    Raises:
        UsageError: the load is the axial one and no fixed share is modelled, inputs are too large for a knee, or there
            are not more measurements than free parameters.
    """
    if measured.axial and parameters.load.rule != "fixed_share":
        raise UsageError(f"{measured.source}: column axial_load needs load.compartment fixed_share, not "
                         f"{parameters.load.rule}; give the compartment's own load as column load")  # fmt: skip
    if measured.number <= len(unknowns):
        raise UsageError(f"{measured.source}: {measured.number} values are measured, for {len(unknowns)} parameters; "
                         "more are needed than parameters are free")  # fmt: skip
    fidelity = parameters.fidelity.model_copy(
        update={"tolerance": min(parameters.fidelity.tolerance, FINE), "budget": 0}
    )
    exact = parameters.model_copy(update={"fidelity": fidelity})
    texts = curve_texts(exact, {})
    runs = RUNS * len(unknowns) * len(measured.time)
    compiles = worth_compiling(runs) if compiled is None else compiled
    model = replace(build_model(exact, curves=texts), compiled=compiles, results=Results)
    steps = np.full(len(unknowns), STEP)
    problem = ContactProblem(measured, unknowns, steps, exact, model, texts)
    problem.predicted(problem.start)  # raises an error for wrong inputs or a wrong start
    return problem


def checked(parameters: Parameters, values: Mapping[str, float]) -> Parameters:
    """Give parameters with other values, after checking all of them.

    Raises:
        UsageError: a value is not allowed, alone or together with others.
    """
    return load_parameters(flat_parameters(parameters) | dict(values))


def _with(parameters: Parameters, values: Mapping[str, float]) -> Parameters:
    """Give parameters with other values within their ranges, which are not checked again: that takes milliseconds."""
    sections = {name: getattr(parameters, name).model_copy(update=section) for name, section in nested(values).items()}
    changed = parameters.model_copy(update=sections)
    femur, tibia, contact = changed.femur, changed.tibia, changed.contact
    if femur.geometry == tibia.geometry == "circle" and tibia.radius <= femur.radius:
        raise UsageError(f"tibia.radius: {tibia.radius:g} must exceed femur.radius, {femur.radius:g}")
    if contact.law == "elastic_foundation" and contact.tibial_radius <= contact.femoral_radius:
        raise UsageError(f"contact.tibial_radius: {contact.tibial_radius:g} must exceed contact.femoral_radius")
    return changed

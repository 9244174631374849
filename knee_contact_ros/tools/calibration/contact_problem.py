"""The problem of fitting the contact model of a compartment to what was measured of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.compiler import worth_compiling
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.types import Rows, Status, blank
from knee_contact_ros.parameters.build import build_model, retuned
from knee_contact_ros.parameters.curves import curve_texts
from knee_contact_ros.parameters.reading import flat_parameters, load_parameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.results import Results
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.calibration.measured import Measured
from knee_contact_ros.tools.calibration.problem import STEP, Problem
from knee_contact_ros.tools.calibration.unknowns import Unknown, nested

Floats = NDArray[np.float64]
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

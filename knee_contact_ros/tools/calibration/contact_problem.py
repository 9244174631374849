"""The contact model of a compartment, held against what was measured of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.compiled.choice import forced, worth_compiling
from knee_contact_ros.core.model import PLAIN, KneeModel
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.core.ticks import MEMORY
from knee_contact_ros.core.types import Rows, Status, blank
from knee_contact_ros.parameters.build import build_model, untried_law
from knee_contact_ros.parameters.curves import curve_texts
from knee_contact_ros.parameters.reading import flat_parameters, load_parameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.results import Results
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.calibration.measured import Measured
from knee_contact_ros.tools.calibration.problem import STEP, Problem
from knee_contact_ros.tools.calibration.unknowns import Unknown

Floats = NDArray[np.float64]
FINE = 1e-9
"""Wanted error of the depth [m] while fitting: what the model errs by must be far below what was measured"""
RUNS = 300
"""That a fit takes, about"""


@dataclass(frozen=True)
class ContactProblem(Problem):
    """A knee's model, what is free of it, and what it is held against."""

    measured: Measured
    parameters: Parameters
    model: KneeModel
    """At the start"""
    scene: Scene
    """Of the model"""
    texts: Mapping[str, str]
    """Contents of files by parameter"""

    def answers(self, place: Floats) -> Rows:
        """What the model says there, shape (n,): the kernel's answers, without what `KneeModel.run` checks and adds.

        Raises:
            UsageError: parameters make no model.
        """
        values = self.values(place)
        parameters = _with(self.parameters, values)
        given, share = self.measured, parameters.load.share if self.measured.axial else 1.0
        height = np.full(len(given.time), math.nan) if given.height is None else given.height
        durations = np.diff(np.rint(given.time * 1e9), prepend=np.rint(given.time[0] * 1e9)) * 1e-9
        answers = blank(len(given.time))
        try:
            scene = self._scene(parameters, values)
        except ValueError as error:
            raise UsageError(f"{given.source}: {error}") from None
        self.model.kernel.run(scene, np.zeros(1, MEMORY), durations, given.angle, share * given.load, height, answers)
        return answers

    def predicted(self, place: Floats) -> Results:
        """The same by a whole model, with all there is to results.

        Raises:
            UsageError: parameters make no model, or inputs are none of a knee.
        """
        values = self.values(place)
        parameters = checked(self.parameters, values)
        given, share = self.measured, parameters.load.share if self.measured.axial else 1.0
        try:
            model = replace(build_model(parameters, curves=self.texts), kernel=self.model.kernel, results=Results)
            series = model.run(given.time, given.angle, share * given.load, given.height)
        except ValueError as error:
            raise UsageError(f"{given.source}: {error}") from None
        return series.view(Results) if not isinstance(series, Results) else series

    def doubts(self, place: Floats) -> list[str]:
        """Ticks that the model itself does not vouch for, and landings at which a measured force leaps."""
        return [*self._unusable(place), *self._leaps(place)]

    def _unusable(self, place: Floats) -> list[str]:
        status = self.answers(place)["status"]
        told = []
        for bit, what in (
            (Status.NOT_CONVERGED, "missed their tolerance"),
            (Status.IMPLAUSIBLE, "are implausibly deep"),
        ):
            if count := int(np.count_nonzero(status & bit)):
                told.append(f"{count} of {len(status)} answers {what}")
        return told

    def _leaps(self, place: Floats) -> list[str]:
        """Landings under a law whose force leaps at touch, among samples of the force."""
        forces = self.measured.answers.get("contact_force")
        if forces is None:
            return []
        force, _, _ = self.scene.modes.law.layers[0].formula.force_at(0.0, 1.0, 1.0)
        apart = np.asarray(self.predicted(place)["gap"]) > 0.0
        landings = int((apart[:-1] & ~apart[1:] & np.isfinite(forces[1:])).sum())
        if force <= 0.0 or not landings:
            return []
        return [f"contact_force: it leaps at touch under this law, in {landings} landing(s), and a sample falls before "
                "or after it: the misfit jumps, and the intervals are rough; leave these samples empty"]  # fmt: skip

    def _scene(self, parameters: Parameters, values: Mapping[str, float]) -> Scene:
        """What the kernel is given: other numbers, and surfaces made anew if one of them is free."""
        if any(name.startswith(("femur.", "tibia.")) and name != "femur.mass" for name in values):
            return build_model(parameters, curves=self.texts).scene
        return self.scene._replace(modes=untried_law(parameters.contact), mass=parameters.femur.mass)


def problem_of(
    parameters: Parameters, measured: Measured, unknowns: tuple[Unknown, ...], compiled: bool | None
) -> ContactProblem:
    """A problem with a model that is exact enough, compiled where that pays or is asked for.

    Raises:
        UsageError: the load is the axial one and no fixed share is modelled, inputs are none of a knee, or there are
            fewer measurements than parameters.
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
    model = replace(build_model(exact, curves=texts), results=Results)
    runs = RUNS * len(unknowns) * len(measured.time)
    if compiled or (compiled is None and worth_compiling(model.scene, runs)):
        model = forced(model)
    else:
        model = replace(model, kernel=PLAIN)
    steps = np.full(len(unknowns), STEP)
    problem = ContactProblem(measured, unknowns, steps, exact, model, model.scene, texts)
    problem.predicted(problem.start)  # what is wrong with inputs or start is said
    return problem


def checked(parameters: Parameters, values: Mapping[str, float]) -> Parameters:
    """Parameters with other values, all of them checked.

    Raises:
        UsageError: they are not allowed with each other.
    """
    return load_parameters(flat_parameters(parameters) | dict(values))


def _with(parameters: Parameters, values: Mapping[str, float]) -> Parameters:
    """Parameters with other values within their ranges, which are not checked again: that takes milliseconds."""
    sections: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        section, inner = name.split(".")
        sections.setdefault(section, {})[inner] = value
    found = parameters.model_copy(
        update={name: getattr(parameters, name).model_copy(update=inner) for name, inner in sections.items()}
    )
    femur, tibia, contact = found.femur, found.tibia, found.contact
    if femur.geometry == tibia.geometry == "circle" and tibia.radius <= femur.radius:
        raise UsageError(f"tibia.radius: {tibia.radius:g} must exceed femur.radius, {femur.radius:g}")
    if contact.law == "elastic_foundation" and contact.tibial_radius <= contact.femoral_radius:
        raise UsageError(f"contact.tibial_radius: {contact.tibial_radius:g} must exceed contact.femoral_radius")
    return found

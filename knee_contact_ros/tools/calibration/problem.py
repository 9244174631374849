"""The residuals of a choice of parameters: what the model says less what was measured, in units of the noise."""

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
from knee_contact_ros.core.types import Rows, blank
from knee_contact_ros.parameters.build import build_model, untried_law
from knee_contact_ros.parameters.curves import curve_texts
from knee_contact_ros.parameters.reading import flat_parameters, load_parameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.results import Results
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.calibration.measured import Measured
from knee_contact_ros.tools.calibration.unknowns import Unknown

Floats = NDArray[np.float64]
Noise = Mapping[str, float]
"""Standard deviation of each measured column, in its unit"""
FINE = 1e-9
"""Wanted error of the depth [m] while fitting: what the model errs by must be far below what was measured"""
STEP, LEAST_STEP, PART = 1e-3, 1e-7, 0.5
"""Of a difference quotient, in coordinates: a part in a thousand at first, and later so much of what the data resolve
where that is less: an impact may meet a sample or not within a thousandth"""
FAR = 1e8
"""Residual where parameters make no model"""
RUNS = 300
"""That a fit takes, about"""


@dataclass(frozen=True)
class Problem:
    """A model, what is free of it, and what it is held against."""

    parameters: Parameters
    measured: Measured
    unknowns: tuple[Unknown, ...]
    model: KneeModel
    """At the start"""
    scene: Scene
    """Of the model"""
    texts: Mapping[str, str]
    """Contents of files by parameter"""
    steps: Floats
    """Of difference quotients, in coordinates, shape (p,)"""

    @property
    def start(self) -> Floats:
        """Coordinates to start from, shape (p,)."""
        return np.array([unknown.coordinate(unknown.start) for unknown in self.unknowns])

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Ends of the coordinates, shape (p,) each."""
        low, high = zip(*(unknown.bounds for unknown in self.unknowns), strict=True)
        return np.array(low), np.array(high)

    def values(self, place: Floats) -> dict[str, float]:
        """Parameters at a place, coordinates of shape (p,)."""
        return {unknown.name: unknown.value(float(each)) for unknown, each in zip(self.unknowns, place, strict=True)}

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

    def misfits(self, place: Floats) -> dict[str, Floats]:
        """Answers less measurements in their unit, of each column where it was measured.

        Raises:
            UsageError: as `answers`.
        """
        answers, measured = self.answers(place), self.measured.answers
        return {name: (answers[name] - column)[np.isfinite(column)] for name, column in measured.items()}

    def residuals(self, place: Floats, noise: Noise) -> Floats:
        """The same in units of the noise, one column after another; `FAR` where there is no model."""
        try:
            return self.scaled(self.misfits(place), noise)
        except UsageError:
            return np.full(self.measured.number, FAR)

    def scaled(self, misfits: Mapping[str, Floats], noise: Noise) -> Floats:
        """Misfits in units of the noise, one column after another."""
        return np.concatenate([misfits[name] / noise[name] for name in misfits])

    def jacobian(self, place: Floats, noise: Noise, which: Floats | None = None) -> Floats:
        """Slopes of the residuals over the coordinates `which` (all of them by default), by central differences."""
        low, high = self.bounds
        columns = []
        for each in range(len(place)) if which is None else which:
            index, sides = int(each), []
            step = float(self.steps[index])
            for end in (max(place[index] - step, low[index]), min(place[index] + step, high[index])):
                moved = place.copy()
                moved[index] = end
                sides.append((end, self.residuals(moved, noise)))
            (before, below), (behind, above) = [
                side if abs(side[1][0]) < FAR else (place[index], self.residuals(place, noise)) for side in sides
            ]
            columns.append((above - below) / (behind - before) if behind > before else np.zeros_like(above))
        return np.stack(columns, axis=1)

    def with_steps_for(self, place: Floats, noise: Noise) -> Problem:
        """The same with steps that fit what the data resolve around a place."""
        sizes = np.linalg.norm(self.jacobian(place, noise), axis=0)
        return replace(self, steps=np.clip(PART / np.maximum(sizes, 1.0), LEAST_STEP, STEP))

    def _scene(self, parameters: Parameters, values: Mapping[str, float]) -> Scene:
        """What the kernel is given: other numbers, and surfaces made anew if one of them is free."""
        if any(name.startswith(("femur.", "tibia.")) and name != "femur.mass" for name in values):
            return build_model(parameters, curves=self.texts).scene
        return self.scene._replace(modes=untried_law(parameters.contact), mass=parameters.femur.mass)


def problem_of(
    parameters: Parameters, measured: Measured, unknowns: tuple[Unknown, ...], compiled: bool | None
) -> Problem:
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
    problem = Problem(exact, measured, unknowns, model, model.scene, texts, np.full(len(unknowns), STEP))
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

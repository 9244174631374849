"""The problem of fitting a person's constants of the load estimate to a measured joint reaction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.joint_reaction.estimator import LEVELS, EstimationLevel
from knee_contact_ros.joint_reaction.leg import NetMoments, leg_of
from knee_contact_ros.joint_reaction.muscles import Person, reaction_of
from knee_contact_ros.messages.stamps import NANOSECONDS
from knee_contact_ros.parameters.declared import all_values
from knee_contact_ros.parameters.load_schema import LOAD_READING, LoadParameters
from knee_contact_ros.parameters.reading import known_parameters
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.calibration.problem import STEP, Problem
from knee_contact_ros.tools.calibration.reference import AXIAL_FORCE, Referenced
from knee_contact_ros.tools.calibration.unknowns import Fittable, Unknown

Floats = NDArray[np.float64]
SECTION = "person."
BODY = ("person.mass", "person.height")
"""Parameters on which the net moments depend"""
LEAST_DEVIATION, LARGEST_DEVIATION = 0.01, 10.0
"""Range of the parameter `standard_deviation` [body weights]"""

OTHER_TRIALS = (
    "standard_deviation is the RMS of what is left of these data; in another trial of the same person it was up to 1.4 "
    "times as large (docs/calibration.md)"
)


@dataclass(frozen=True)
class LoadProblem(Problem):
    """The problem of fitting the constants of a person."""

    measured: Referenced
    parameters: LoadParameters
    """All parameters at the start"""
    level: EstimationLevel
    nets: tuple[NetMoments, ...]
    """Net moments at the n samples; empty where mass or height is free"""

    def answers(self, place: Floats) -> dict[str, Floats]:
        """Compute the estimate `axial_force` [N] at every sample, shape (n,), with the bits of the estimator."""
        person = self.person(place)
        nets = self.nets or net_moments_of(self.level, person, self.measured)
        both = zip(self.measured.samples, nets, strict=True)
        axial = [reaction_of(person, each.joints, net, each.ground.force[1]).axial for each, net in both]
        return {AXIAL_FORCE: np.array(axial)}

    def predicted(self, place: Floats) -> dict[str, Floats]:
        """Give the answers, with the samples' stamps as `time` [s]."""
        return {"time": np.array([each.stamp / NANOSECONDS for each in self.measured.samples]), **self.answers(place)}

    def doubts(self, place: Floats) -> list[str]:  # noqa: ARG002
        """Report what makes no sense in the bag."""
        return list(self.measured.doubts)

    def remarks(self, place: Floats) -> list[str]:
        """Give the RMS residual in body weights, the correlation with the reference, and counts of samples."""
        reference, answer = self.measured.answers[AXIAL_FORCE], self.answers(place)[AXIAL_FORCE]
        known, left_out = np.isfinite(reference), self.measured.left_out
        correlation = _correlation(reference[known], answer[known])
        alike = f", r {correlation:.3f}" if np.isfinite(correlation) else ""
        counts = [f"{count} {reason}" for reason, count in left_out.items() if count or "refused" not in reason]
        return [
            f"that is {self.relative_rms(place):.3f} body weights{alike}, level {self.parameters.chosen_level}",
            f"samples: {self.measured.number} fitted; left out: {', '.join(counts)}",
            OTHER_TRIALS,
        ]

    def also(self, place: Floats) -> dict[str, Any]:
        """Give `calibrated`, and `standard_deviation` in body weights: the RMS residual, within its range."""
        size = min(max(self.relative_rms(place), LEAST_DEVIATION), LARGEST_DEVIATION)
        return {"calibrated": True, "standard_deviation": size}

    def relative_rms(self, place: Floats) -> float:
        """Compute the RMS of the residuals in body weights."""
        misfit = self.misfits(place)[AXIAL_FORCE]
        return float(np.sqrt(np.mean(misfit**2)) / self.person(place).weight)

    def person(self, place: Floats) -> Person:
        """Give the constants of the person at a place."""
        values = {name.removeprefix(SECTION): value for name, value in self.values(place).items()}
        return self.parameters.person.constants._replace(**values)


def load_problem_of(parameters: LoadParameters, measured: Referenced, unknowns: tuple[Unknown, ...]) -> LoadProblem:
    """Make the problem, and compute once what does not depend on free parameters.

    Raises:
        UsageError: there are not more samples than free parameters.
    """
    if measured.number <= len(unknowns):
        raise UsageError(f"bag {measured.source}: {measured.number} samples can be fitted, for {len(unknowns)} "
                         "parameters; more are needed than parameters are free")  # fmt: skip
    level = LEVELS[parameters.chosen_level]
    nets: tuple[NetMoments, ...] = ()
    if not any(unknown.name in BODY for unknown in unknowns):
        nets = net_moments_of(level, parameters.person.constants, measured)
    return LoadProblem(measured, unknowns, np.full(len(unknowns), STEP), parameters, level, nets)


def net_moments_of(level: EstimationLevel, person: Person, measured: Referenced) -> tuple[NetMoments, ...]:
    """Compute the net moments at knee and ankle of a person at every sample."""
    leg = leg_of(person.mass, person.height)
    return tuple(level.dynamics(leg, each.joints, each.motion, each.ground) for each in measured.samples)


def fittable_in(parameters: LoadParameters) -> Fittable:
    """Give the parameters that can be fitted: the constants of the person."""
    known = LOAD_READING.known()
    names = [name for name in known if name.startswith(SECTION)]

    def why_not(name: str) -> str:
        if name not in known and name in known_parameters():
            return f"it is one of the contact, which is fitted to a table; to a bag {', '.join(names)} are"
        return f"it is none of a person; allowed are {', '.join(names)}" if name in known else ""

    return Fittable(names, known, all_values(parameters), "person.moment_arm_scale", why_not)


def _correlation(one: Floats, other: Floats) -> float:
    """Compute the correlation of two columns; not a number if one of them is constant."""
    one, other = one - one.mean(), other - other.mean()
    size = float(np.sqrt((one**2).sum() * (other**2).sum()))
    return float((one * other).sum()) / size if size > 0.0 else float("nan")

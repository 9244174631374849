"""Outcomes of a run: one row of numbers, computed from all of its ticks."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.laws import ContactLaw
from knee_contact_ros.model.readouts import ContactPatch
from knee_contact_ros.model.types import ContactState, Rows, Status

Floats = NDArray[np.float64]


class Outcome(NamedTuple):
    """Description of an outcome, which is a column of the table."""

    name: str
    """Name of the column"""
    unit: str
    """SI unit; empty for numbers of ticks and for ratios"""
    meaning: str
    """Definition, for people who read the table"""


OUTCOMES = (
    Outcome("peak_force", "N", "largest contact force"),
    Outcome("peak_depth", "m", "largest penetration depth"),
    Outcome("peak_pressure", "Pa", "largest pressure, that of the force at rest spread over the patch (readouts)"),
    Outcome("peak_strain", "", "largest nominal strain of the cartilage"),
    Outcome("peak_loading_rate", "N/s", "fastest rise of the contact force from tick to tick"),
    Outcome("impulse", "N s", "contact force over time, by trapezoids"),
    Outcome("contact_time", "s", "time in contact"),
    Outcome("bone_time", "s", "time in contact with the second layer"),
    Outcome("path_length", "m", "way of the contact point while in contact"),
    Outcome("sliding_distance", "m", "way that the femoral surface slides over the tibial one while in contact"),
    Outcome("error_bound", "m", "largest error estimate of the depth"),
    Outcome("force_error_bound", "N", "largest error estimate of the contact force"),
    Outcome("not_converged", "", "ticks that missed a tolerance"),
    Outcome("implausible", "", "ticks whose depth makes no sense"),
    Outcome("ticks", "", "answers in all"),
    Outcome("evaluations", "", "contact law evaluations in all"),
)
"""All outcomes, in the order of the table's columns"""
OF_A_RUN = np.dtype([(outcome.name, np.float64) for outcome in OUTCOMES])
"""Record of the outcomes of a run, with a field for each"""
LARGEST = {
    "peak_force": "contact_force", "peak_depth": "penetration_depth", "error_bound": "error_estimate",
    "force_error_bound": "force_error_estimate",
}  # fmt: skip
"""Outcomes that are the largest value of a field over all answers, with the field's name"""


def outcomes(answers: Rows, steps: Floats, laws: list[ContactLaw], patches: list[ContactPatch | None]) -> NDArray[Any]:
    """Compute the outcomes of several runs.

    Args:
        answers: Answers of k runs, shape (k, n).
        steps: Time since the tick before [s], shape (n,); 0 where a run begins.
        laws: Contact law of each run.
        patches: Area over which the contact spreads in each run; None: pressure and strain are not known.

    Returns:
        Records of `OF_A_RUN`, shape (k,).
    """
    rows = np.zeros(len(answers), OF_A_RUN)
    weights = 0.5 * (steps + np.append(steps[1:], 0.0))
    force, state, status = (
        np.ascontiguousarray(answers[name]) for name in ("contact_force", "contact_state", "status")
    )  # fmt: skip
    touching = state != ContactState.SEPARATED
    for name, field in LARGEST.items():
        rows[name] = answers[field].max(axis=1)
    rows["impulse"], rows["contact_time"] = _over_time(force, weights), _over_time(touching, weights)
    rows["bone_time"] = _over_time(state == ContactState.BONE, weights)
    follows = steps[1:] > 0.0
    stays = touching[:, 1:] & touching[:, :-1] & follows
    point = answers["contact_point"]
    distance = np.hypot(np.diff(point["x"], axis=1), np.diff(point["y"], axis=1))
    rows["path_length"] = np.sum(distance, axis=1, where=stays)
    rows["sliding_distance"] = _over_time(np.abs(answers["sliding_velocity"]) * touching, weights)
    if follows.any():
        rates = np.diff(force, axis=1)[:, follows] / steps[1:][follows]
        rows["peak_loading_rate"] = np.maximum(rates.max(axis=1), 0.0)
    for name, bit in (("not_converged", Status.NOT_CONVERGED), ("implausible", Status.IMPLAUSIBLE)):
        rows[name] = np.count_nonzero(status & np.uint8(bit), axis=1)
    rows["ticks"], rows["evaluations"] = answers.shape[1], answers["evaluations"].sum(axis=1)
    rows["peak_pressure"] = [
        np.nan if patch is None else peak_pressure(law, patch, deepest)
        for law, patch, deepest in zip(laws, patches, rows["peak_depth"].tolist(), strict=True)
    ]
    thickness = np.array([np.nan if patch is None else patch.thickness for patch in patches])
    rows["peak_strain"] = answers["cartilage_depth"].max(axis=1) / thickness
    return rows


def _over_time(values: NDArray[Any], weights: Floats) -> Floats:
    """Integrate each run over time, shape (k,); the bits do not depend on the number of runs.

    A product of matrix and vector (`@`) would have other last bits with other numbers of rows.
    """
    integrals: Floats = np.sum(values * weights, axis=1)
    return integrals


def peak_pressure(law: ContactLaw, patch: ContactPatch, deepest: float) -> float:
    """Compute the largest pressure [Pa] of a run whose largest depth is `deepest` [m]; see `ContactPatch.readouts`.

    The ratio of force to depth is largest at an end of a layer's range, since within a layer the force is convex.
    """
    ends = [layer.begin for layer in law.layers if 0.0 < layer.begin < deepest]
    over = max((law.static_force(depth) / depth for depth in (*ends, deepest) if depth > 0.0), default=0.0)
    return patch.spread.peak * over / (np.pi * patch.spread.area * patch.radius)

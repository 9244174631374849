"""Outcomes of a knee in a gait: peaks, impulses, times and distances, from its answers."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.laws import ContactLaw
from ..model.readouts import ContactPatch
from ..model.types import NANOSECOND, ContactState, Floats, Rows, Status
from ..parameters.files import known_parameters
from ..streams.gait_events import GAP

LATERAL_OUTCOME = "lateral_"
"""Beginning of the names of the outcomes of the lateral compartment"""
OUTCOMES = {
    "peak_force": "N",
    "peak_depth": "m",
    "peak_pressure": "Pa",
    "peak_strain": "",
    "peak_loading_rate": "N/s",
    "ringing": "N",
    "impulse": "N s",
    "contact_time": "s",
    "bone_time": "s",
    "path_length": "m",
    "sliding_distance": "m",
    "error_bound": "m",
    "force_error_bound": "N",
    "not_converged": "",
    "implausible": "",
    "ticks": "",
    "evaluations": "",
}
"""SI units of all outcomes, in the order of the table's columns; docs/how-to/many-knees.md explains them. Pressure is
the static force over the patch (readouts); integrals are by the trapezoidal rule, without pauses longer than `GAP`"""


def units_of(names: Iterable[str]) -> dict[str, str]:
    """Return the SI units of parameters and outcomes by name, of those that have one."""
    known = {name: each.unit for name, each in known_parameters().items()} | OUTCOMES
    units = {name: known.get(name.removeprefix(LATERAL_OUTCOME), "") for name in names}
    return {name: unit for name, unit in units.items() if unit}


OUTCOME_RECORD = np.dtype([(name, np.float64) for name in OUTCOMES])
"""Record of the outcomes of a run, with a field for each"""
LARGEST_FIELDS = {
    "peak_force": "contact_force",
    "peak_depth": "penetration_depth",
    "error_bound": "error_estimate",
    "force_error_bound": "force_error_estimate",
}
"""Outcomes that are the largest value of a field over all answers, with the field's name"""


def outcomes_of(
    answers: Rows, steps: Floats, laws: list[ContactLaw], patches: list[ContactPatch | None]
) -> NDArray[Any]:
    """Compute the outcomes of several runs.

    Args:
        answers: Answers of k runs, shape (k, n).
        steps: Time since the tick before [s], shape (n,); 0 where a run begins.
        laws: Contact law of each run.
        patches: Area over which the contact spreads in each run; None: pressure and strain are not known.

    Returns:
        Records of `OUTCOME_RECORD`, shape (k,).
    """
    rows = np.zeros(len(answers), OUTCOME_RECORD)
    # Nothing is known of a hole in a bag.
    steps = np.where(steps > GAP * NANOSECOND, 0.0, steps)
    weights = 0.5 * (steps + np.append(steps[1:], 0.0))
    force, state, status = (
        np.ascontiguousarray(answers[name])
        for name in ("contact_force", "contact_state", "status")
    )
    touching = state != ContactState.SEPARATED
    for name, field in LARGEST_FIELDS.items():
        rows[name] = answers[field].max(axis=1)
    rows["impulse"] = _over_time(force, weights)
    rows["contact_time"] = _over_time(touching, weights)
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
    for name, bit in (
        ("not_converged", Status.NOT_CONVERGED),
        ("implausible", Status.IMPLAUSIBLE),
    ):
        rows[name] = np.count_nonzero(status & np.uint8(bit), axis=1)
    rows["ticks"] = answers.shape[1]
    rows["evaluations"] = answers["evaluations"].sum(axis=1)
    rows["peak_pressure"] = [
        np.nan if patch is None else peak_pressure(law, patch, deepest)
        for law, patch, deepest in zip(laws, patches, rows["peak_depth"].tolist(), strict=True)
    ]
    thickness = np.array([np.nan if patch is None else patch.thickness for patch in patches])
    rows["peak_strain"] = answers["cartilage_depth"].max(axis=1) / thickness
    return rows


def _over_time(values: NDArray[Any], weights: Floats) -> Floats:
    """Integrate each run over time, shape (k,); the bits do not depend on the number of runs.

    With a matrix product (`@`) the last bits would depend on the number of rows.
    """
    integrals: Floats = np.sum(values * weights, axis=1)
    return integrals


def peak_pressure(law: ContactLaw, patch: ContactPatch, deepest: float) -> float:
    """Compute the largest pressure [Pa] of a run whose largest depth is `deepest` [m]; see `ContactPatch.readouts`.

    The ratio of force to depth is largest at an end of a layer, since the force is convex within a layer.
    """
    ends = [layer.begin for layer in law.layers if 0.0 < layer.begin < deepest]
    over = max(
        (law.static_force(depth) / depth for depth in (*ends, deepest) if depth > 0.0), default=0.0
    )
    return patch.spread.peak * over / (np.pi * patch.spread.area * patch.radius)

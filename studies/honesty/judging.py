"""Judge the error estimates of one run, tick by tick."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.types import Status
from studies.reference import Solution

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
KNOWN = 0.02
"""A tick counts where the reference is known to this part of the model's error"""
LEAST_ERROR = 1e-12
"""Error of the depth [m] below which it is rounding"""
LEAST_FORCE_ERROR, LEAST_FORCE_SHARE = 1e-7, 1e-10
"""Error of the force below which it is rounding: [N], and as a part of the run's largest load"""


class Verdict(NamedTuple):
    """Judgement of one quantity of a run, an entry per tick each."""

    error: Floats
    """Error against the reference; nan where the reference gave up"""
    bound: Floats
    """Bound of the reference's own error"""
    estimate: Floats
    known: Flags
    """Whether the reference is good enough to judge this tick"""
    large: Flags
    """Known errors that are above rounding"""
    covered: Flags
    """Known errors that are within their estimates or below rounding"""
    wrong: Flags
    """Ticks said to be within the tolerance that are known not to be, or whose estimate is not finite"""
    ratio: Floats
    """Ratio of estimate to error where `large`, else nan"""


class Judged(NamedTuple):
    """Judgement of a run."""

    depth: Verdict
    force: Verdict | None
    """Judgement of the force; None if the model gives no estimate of it"""
    said_right: Flags
    """Ticks whose status has no NOT_CONVERGED"""
    falsely: Flags
    """Ticks not said right that are known to be"""
    claimed: Flags
    """Ticks said right although their own estimate is beyond the tolerance, or not finite"""
    apart: Flags
    """Ticks that are apart according to the reference"""
    fidelity: NDArray[np.int_]
    """Level that computed the tick"""
    evaluations: NDArray[np.int_]


def judge(
    series: np.recarray[Any, Any], truth: Solution, tolerance: float, force_tolerance: float = 0.0
) -> Judged:
    """Judge a run by the reference's solution of the same scene, tolerances in [m] and [N] (0: none was asked for)."""
    right = series.status & Status.NOT_CONVERGED == 0
    signed = series.penetration_depth - series.gap
    depth = _verdict(
        signed,
        truth.depth,
        truth.depth_bound,
        series.error_estimate,
        LEAST_ERROR,
        right,
        tolerance,
    )
    claimed = right & ~(series.error_estimate <= tolerance)
    falsely = ~right & depth.known & (depth.error <= tolerance)
    force = None
    if "force_error_estimate" in (series.dtype.names or ()):
        least = max(LEAST_FORCE_ERROR, LEAST_FORCE_SHARE * float(np.max(np.abs(series.load))))
        asked = force_tolerance if force_tolerance > 0.0 else np.inf
        estimate = series.force_error_estimate
        force = _verdict(
            series.contact_force, truth.force, truth.force_bound, estimate, least, right, asked
        )
        claimed |= right & ~((estimate <= asked) & np.isfinite(estimate))
        falsely &= force.known & (force.error <= asked)
    return Judged(
        depth,
        force,
        right,
        falsely,
        claimed,
        truth.depth < 0.0,
        series.fidelity.astype(int),
        series.evaluations.astype(int),
    )


def _verdict(
    ours: Floats,
    exact: Floats,
    bound: Floats,
    estimate: Floats,
    least: float,
    right: Flags,
    tolerance: float,
) -> Verdict:
    error = np.abs(ours - exact)
    with np.errstate(invalid="ignore", divide="ignore"):
        # an answer that is not a number is as wrong as can be wherever the reference has one
        error = np.where(np.isfinite(exact) & ~np.isfinite(ours), np.inf, error)
        known = bound < KNOWN * np.maximum(error, least)
        large = known & (error > least)
        covered = known & (~large | (error <= estimate + bound))
        wrong = right & (
            (known & (error > tolerance + bound)) | ~np.isfinite(estimate) | ~np.isfinite(ours)
        )
        ratio = np.where(large, estimate / error, np.nan)
    return Verdict(error, bound, estimate, known, large, covered, wrong, ratio)

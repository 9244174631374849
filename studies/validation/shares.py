"""Medial shares of the load, fitted to the forces in an instrumented knee, and the file of the shipped share.

The fits minimise the error of the force, not of the share, so a share counts by the square of its load. Every trial
has the same weight, however long it is, as its strides are similar. The curve a x / sqrt(1 + x^2), x = load / b, rises
with the load and saturates; its constants are the share a at large loads and the load b. The table over flexion and
load is bounded linear least squares with a penalty on differences between neighbours (P-splines of first order: Eilers
& Marx 1996, Statistical Science 11:89-121).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear

from knee_contact_ros.joint_reaction.compartments import ShareTable
from knee_contact_ros.parameters.curves import SHARE_COLUMNS

Floats = NDArray[np.float64]
FLEXION = (-10.0, 0.0, 10.0, 20.0, 40.0, 70.0, 100.0, 130.0)
"""Flexion [deg] of the table's rows, as far as there are data: denser where the knee is in stance"""
LOAD = (0.0, 0.6, 1.2, 1.8, 2.4, 3.0, 3.6, 4.2, 4.8)
"""Axial load [body weights] of the table's columns, as far as there are data"""
CURVE_FLEXION = (-0.5, 2.7)
"""Flexion [rad] of a written curve's two rows"""
CURVE_LOAD = np.round(np.arange(61) * 0.1, 1)
"""Loads [body weights] at which a curve is written"""
LOAD_BOUNDS = (0.05, 5.0)
"""Range of the load b [body weights]; at its ends the share is constant, or linear in the load"""
OUTLIER = 0.1
"""Error of the medial force [body weights] beyond which a sample counts less in the fit of the spacing"""


class Trial(NamedTuple):
    """Measurements of a trial, shape (n,) each."""

    flexion: Floats
    """Flexion angle [rad]"""
    load: Floats
    """Axial force [body weights], positive in compression"""
    medial: Floats
    """Medial force [body weights], positive in compression"""
    moment: Floats
    """Frontal moment [m times the body weight], as torque.x of the joint reaction; NaN where it is not known"""


class Curve(NamedTuple):
    """A share that rises with the load and saturates."""

    share: float
    """Medial share of a large load"""
    load: float
    """Load [body weights] at which the share is 0.71 times `share`"""

    def at(self, load: Floats) -> Floats:
        """Return the shares at loads [body weights]."""
        ratio = np.maximum(load, 0.0) / self.load
        return np.asarray(self.share * ratio / np.sqrt(1.0 + ratio * ratio))

    @property
    def table(self) -> ShareTable:
        """The curve as a table that is constant along flexion."""
        return ShareTable(np.array(CURVE_FLEXION), CURVE_LOAD, np.stack([self.at(CURVE_LOAD)] * 2))


def fit_table(trials: Sequence[Trial], smoothing: float) -> ShareTable:
    """Fit the table to some trials; its rows and columns are the standard ones that the data cover.

    Args:
        trials: The trials.
        smoothing: Penalty [BW^2] for a step of 1 between neighbours, relative to the mean square error of the force.
    """
    flexion = _covered(np.radians(FLEXION), np.concatenate([trial.flexion for trial in trials]))
    load = _covered(np.array(LOAD), np.concatenate([trial.load for trial in trials]))
    rows, wanted = [], []
    for trial in trials:
        weight = 1.0 / np.sqrt(len(trial.load) * len(trials))
        along, up = _hats(flexion, trial.flexion), _hats(load, trial.load)
        each = (along[:, :, None] * up[:, None, :]).reshape(len(trial.load), -1)
        rows.append(each * (weight * trial.load)[:, None])
        wanted.append(weight * trial.medial)
    down, across = (np.diff(np.eye(len(places)), axis=0) for places in (flexion, load))
    steps = np.vstack((np.kron(down, np.eye(len(load))), np.kron(np.eye(len(flexion)), across)))
    system = np.vstack((*rows, np.sqrt(smoothing) * steps))
    target = np.concatenate((*wanted, np.zeros(len(steps))))
    solution = lsq_linear(system, target, (0.0, 1.0), method="bvls")
    share = np.clip(solution.x, 0.0, 1.0).reshape(len(flexion), len(load))
    return ShareTable(flexion, load, share)


def _covered(places: Floats, values: Floats) -> Floats:
    """Select increasing places from the one nearest the smallest value to the one nearest the largest; two at least."""
    nearest = np.abs(values[[values.argmin(), values.argmax()], None] - places).argmin(axis=1)
    first = min(int(nearest[0]), len(places) - 2)
    return places[first : max(int(nearest[1]), first + 1) + 1]


def _hats(places: Floats, values: Floats) -> Floats:
    """Return weights of linear interpolation between places, constant beyond them; shape (values, places)."""
    return np.array([np.interp(values, places, unit) for unit in np.eye(len(places))]).T


def fit_curve(trials: Sequence[Trial], weights: Sequence[float] | None = None) -> Curve:
    """Fit the curve to some trials with `weights`, or with one weight each."""
    parts = np.sqrt(np.ones(len(trials)) if weights is None else np.asarray(weights))

    def misfit(constants: Floats) -> Floats:
        curve = Curve(*constants)
        each = [
            part / np.sqrt(len(trial.load)) * (curve.at(trial.load) * trial.load - trial.medial)
            for part, trial in zip(parts, trials, strict=True)
        ]
        return np.concatenate(each)

    bounds = ((0.0, LOAD_BOUNDS[0]), (1.0, LOAD_BOUNDS[1]))
    found = least_squares(misfit, (0.6, 0.5), bounds=bounds)
    return Curve(*found.x.tolist())


def constant(trials: Sequence[Trial]) -> float:
    """Return the constant share that fits the medial forces best; all trials have the same weight."""
    above = sum(float((trial.medial * trial.load).mean()) for trial in trials)
    return above / sum(float((trial.load**2).mean()) for trial in trials)


def spacing(trials: Sequence[Trial]) -> float:
    """Return the distance [m] between the compartments that fits the frontal moments best; NaN if none are known.

    The medial force is half of the load less the moment over the spacing. Spikes of moments, where feet change plates,
    count little (a loss that is linear beyond `OUTLIER`).
    """
    known = [np.isfinite(trial.moment) for trial in trials]
    counts = [int(seen.sum()) for seen in known]
    if not all(counts):
        return math.nan
    mean = sum(counts) / len(counts)

    def misfit(inverse: Floats) -> Floats:
        each = [
            (0.5 * trial.load - trial.moment * inverse - trial.medial)[seen]
            * math.sqrt(mean / count)
            for trial, seen, count in zip(trials, known, counts, strict=True)
        ]
        return np.concatenate(each)

    found = least_squares(misfit, 15.0, loss="soft_l1", f_scale=OUTLIER)
    return 1.0 / float(found.x[0])


def share_csv(table: ShareTable, notes: Sequence[str]) -> str:
    """Text of a CSV file for `load.share_file`, with `notes` as comments; four digits of a share are 0.1 N."""
    rows = [
        f"{angle:.6f},{load:g},{share:.4f}"
        for angle, shares in zip(table.flexion, table.share, strict=True)
        for load, share in zip(table.load, shares, strict=True)
    ]
    lines = [
        "# Medial share of the axial knee load over flexion [rad] and axial load [BW]; between the points bilinear,",
        "# beyond them as at the edge. For load.compartment: measured_share (load.share_file).",
        *(f"# {note}" for note in notes),
        ",".join(SHARE_COLUMNS),
    ]
    return "\n".join([*lines, *rows]) + "\n"

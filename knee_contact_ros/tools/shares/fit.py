"""Fit the table of medial shares that leaves the smallest errors of the medial force [N], with smoothing.

The force and not the share is fitted, so that a share counts by the square of the load that it divides. Every trial has
the same weight, however long it is, as its strides are much alike. Differences between neighbours in the table are
penalised (P-splines of first order: Eilers & Marx 1996, Statistical Science 11:89-121), so that a point without data
gets the values of its neighbours; and shares are bounded. The method is linear least squares with bounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from knee_contact_ros.parameters.measured_share import MeasuredShare, ShareTable
from knee_contact_ros.tools.shares.trials import Trial

Floats = NDArray[np.float64]
SMOOTHING = 1e-3
"""Penalty [BW^2] of a step of 1 between neighbours, relative to the mean square error of the medial force"""
FLEXION = (-10.0, 0.0, 10.0, 20.0, 40.0, 70.0, 100.0, 130.0)
"""Flexion [deg] of the table's rows, as far as there are data: denser where the knee is in stance"""
LOAD = (0.0, 0.6, 1.2, 1.8, 2.4, 3.0, 3.6, 4.2, 4.8)
"""Axial load [body weights] of the table's columns, as far as there are data"""


class Errors(NamedTuple):
    """RMS errors of the medial force [N] in a trial, by several rules for the share."""

    trial: str
    """Name of the trial"""
    samples: int
    """Number of samples"""
    body_weight: float
    """Body weight [N]"""
    half: float
    """Error with a share of one half"""
    constant: float
    """Error with the best constant share of the other trials; not a number if there are none"""
    left_out: float
    """Error with the table that is fitted to the other trials; not a number if there are none"""
    fitted: float
    """Error with the table that is fitted to all trials"""


def grid(trials: Sequence[Trial]) -> tuple[Floats, Floats]:
    """Give flexion [rad] and load [BW] of the table: the standard points between those nearest to the data's ends."""
    flexion = np.concatenate([trial.flexion for trial in trials])
    load = np.concatenate([trial.load for trial in trials])
    return _within(np.radians(FLEXION), flexion), _within(np.array(LOAD), load)


def _within(places: Floats, values: Floats) -> Floats:
    """Select from increasing places those between the ones nearest to the least and the largest value; two at least."""
    nearest = np.abs(values[[values.argmin(), values.argmax()], None] - places).argmin(axis=1)
    first = min(int(nearest[0]), len(places) - 2)
    return places[first : max(int(nearest[1]), first + 1) + 1]


def fit(
    trials: Sequence[Trial], smoothing: float = SMOOTHING, places: tuple[Floats, Floats] | None = None
) -> ShareTable:
    """Fit the table to some trials.

    Args:
        trials: The trials.
        smoothing: Penalty, see `SMOOTHING`.
        places: Flexion [rad] and load [BW] of the table; None: see `grid`.
    """
    flexion, load = places or grid(trials)
    rows, wanted = [], []
    for trial in trials:
        weight = 1.0 / np.sqrt(len(trial.load) * len(trials))
        along, up = _hats(flexion, trial.flexion), _hats(load, trial.load)
        each = (along[:, :, None] * up[:, None, :]).reshape(len(trial.load), -1)
        rows.append(each * (weight * trial.load)[:, None])
        wanted.append(weight * trial.medial)
    steps = np.sqrt(smoothing) * _steps(len(flexion), len(load))
    system, right = np.vstack((*rows, steps)), np.concatenate((*wanted, np.zeros(len(steps))))
    solution = lsq_linear(system, right, (0.0, 1.0), method="bvls")
    return ShareTable(flexion, load, np.clip(solution.x, 0.0, 1.0).reshape(len(flexion), len(load)))


def _hats(places: Floats, values: Floats) -> Floats:
    """Give the weights of places in linear interpolation at values, constant at the ends; shape (values, places)."""
    return np.array([np.interp(values, places, unit) for unit in np.eye(len(places))]).T


def _steps(rows: int, columns: int) -> Floats:
    """Give the matrix that turns the values of a table into the differences between neighbours."""
    down, across = (np.diff(np.eye(number), axis=0) for number in (rows, columns))
    return np.vstack((np.kron(down, np.eye(columns)), np.kron(np.eye(rows), across)))


def constant(trials: Sequence[Trial]) -> float:
    """Give the constant share that fits the medial forces best, where all trials have the same weight."""
    above = sum(float((trial.medial * trial.load).mean()) for trial in trials)
    return above / sum(float((trial.load**2).mean()) for trial in trials)


def error(trial: Trial, table: ShareTable) -> float:
    """Compute the RMS error [N] of the medial force in a trial with a table."""
    share = MeasuredShare(table, 1.0).share(trial.load, trial.flexion)
    return _rms(trial, share)


def errors(trials: Sequence[Trial], smoothing: float, table: ShareTable) -> list[Errors]:
    """Compute the errors in every trial, with what is fitted to the other trials, and with the `table` for all."""
    rows = []
    for place, trial in enumerate(trials):
        others = [*trials[:place], *trials[place + 1 :]]
        best = _rms(trial, constant(others)) if others else np.nan
        left_out = error(trial, fit(others, smoothing)) if others else np.nan
        half, fitted = _rms(trial, 0.5), error(trial, table)
        rows.append(Errors(trial.name, len(trial.load), trial.body_weight, half, best, left_out, fitted))
    return rows


def _rms(trial: Trial, share: Floats | float) -> float:
    return float(trial.body_weight * np.sqrt(np.mean((share * trial.load - trial.medial) ** 2)))

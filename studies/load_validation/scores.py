"""Scores of an estimate against its reference."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from studies.load_validation.walks import Flags, Floats, Walk

HALVES = ("first", "second")
LANDING = 0.1
"""Part of a stance, at its beginning, without peaks: the force still falls from the heel strike's own peak"""
MIDDLE = 0.5


class Score(NamedTuple):
    """Errors over the samples that are used, in body weights."""

    rms: float
    r: float
    mean: float
    stance: float
    """RMS error while the foot is on the ground"""
    swing: float
    """RMS error while it is not"""


class Peak(NamedTuple):
    """Largest force in a half of a stance."""

    half: str
    measured: float
    """Measured force [N]"""
    error: float
    """Error as a part of the measured force"""
    late: float
    """Time [s] by which it comes after the measured peak"""
    place: int
    """Index of the sample of the measured peak"""


def rms(error: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(error**2)))


def score(walk: Walk, force: Floats) -> Score:
    """Scores of an axial force [N], shape (n,), for a walk."""
    error = (force - walk.reference) / walk.weight
    used, stance = walk.used, walk.stance
    return Score(
        rms(error[used]), float(np.corrcoef(force[used], walk.reference[used])[0, 1]), float(error[used].mean()),
        rms(error[used & stance]), rms(error[used & ~stance]),
    )  # fmt: skip


def peaks(walk: Walk, force: Floats) -> list[Peak]:
    """Largest forces of both halves of every stance that is used as a whole."""
    found = []
    for first, last in walk.steps():
        begin, end = walk.time[first], walk.time[last]
        edges = [begin + part * (end - begin) for part in (LANDING, MIDDLE, 1.0)]
        for half, since, until in zip(HALVES, edges[:-1], edges[1:], strict=True):
            part = np.flatnonzero((walk.time >= since) & (walk.time < until))
            ours, theirs = int(part[force[part].argmax()]), int(part[walk.reference[part].argmax()])
            measured = float(walk.reference[theirs])
            late = float(walk.time[ours] - walk.time[theirs])
            found.append(Peak(half, measured, float(force[ours]) / measured - 1.0, late, theirs))
    return found


def covered(walk: Walk, force: Floats, deviation: Floats, within: Flags) -> tuple[float, float]:
    """Parts of the used samples `within`, shape (n,), whose error is below one and two standard deviations [N]."""
    off = (np.abs(force - walk.reference) / deviation)[walk.used & within]
    return float(np.mean(off < 1.0)), float(np.mean(off < 2.0))

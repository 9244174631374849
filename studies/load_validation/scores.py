"""How far an estimate is off its reference."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from studies.load_validation.walks import Flags, Floats, Walk

HALVES = ("first", "second")
LANDING = 0.1
"""Of a stance, at its beginning, where no peak is looked for: the force still falls from the heel strike's own peak"""
MIDDLE = 0.5


class Score(NamedTuple):
    """Over the samples that are used; of forces, in body weights."""

    rms: float
    r: float
    mean: float
    stance: float
    """RMS while the foot is on the ground"""
    swing: float
    """RMS while it is not"""


class Peak(NamedTuple):
    """The largest force in a half of a stance."""

    half: str
    measured: float
    """[N]"""
    error: float
    """As part of it"""
    late: float
    """[s] by which it comes after the measured one"""
    place: int
    """The sample of the measured one"""


def rms(error: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(error**2)))


def score(walk: Walk, force: Floats) -> Score:
    """Of an axial force [N], shape (n,)."""
    error = (force - walk.reference) / walk.weight
    used, stance = walk.used, walk.stance
    return Score(
        rms(error[used]), float(np.corrcoef(force[used], walk.reference[used])[0, 1]), float(error[used].mean()),
        rms(error[used & stance]), rms(error[used & ~stance]),
    )  # fmt: skip


def peaks(walk: Walk, force: Floats) -> list[Peak]:
    """Both halves' largest forces, in every stance that is used as a whole."""
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

"""Movements that are made up after published curves, and whether those without measured constants are marked.

Each is a flexion [deg] and a vertical ground force [body weights] over a cycle, of points that are joined smoothly:
walking (Winter 2009), running (Novacheck 1998, doi:10.1016/S0966-6362(97)00038-6), stairs (Riener et al. 2002,
doi:10.1016/S0966-6362(01)00162-X), sit to stand (Kralj et al. 1990, doi:10.1016/0021-9290(90)90005-N) and squats
(Kutzner et al. 2010, doi:10.1016/j.jbiomech.2010.03.046), by peaks and course, not digitised.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator

from knee_contact_ros.joint_reaction.walking import Movement
from studies.validation.data import SECOND, Flags, Floats

STEP = 0.01
"""Time [s] between samples"""
BOUTS, PERSONS, LONGEST = 12, 40, 25.0
"""Number of bouts of a mixture, of mixtures, and the longest bout [s]"""


class Cycle(NamedTuple):
    """A movement: points of time (parts of a cycle), flexion [deg] and vertical force of one foot [body weights]."""

    known: bool
    """Whether constants were measured for it"""
    duration: float
    """Duration of a cycle [s]"""
    points: tuple[tuple[float, float, float], ...]


CYCLES = {
    "walking": Cycle(
        True,
        1.1,
        (
            (0.0, 5, 0.1),
            (0.05, 10, 0.6),
            (0.14, 18, 1.1),
            (0.3, 8, 0.75),
            (0.47, 7, 1.1),
            (0.55, 18, 0.7),
            (0.62, 38, 0.0),
            (0.73, 62, 0.0),
            (0.88, 25, 0.0),
            (1.0, 5, 0.1),
        ),
    ),
    "standing": Cycle(True, 2.0, ((0.0, 3, 0.5), (0.5, 5, 0.55), (1.0, 3, 0.5))),
    "running": Cycle(
        False,
        0.72,
        (
            (0.0, 14, 0.1),
            (0.05, 25, 1.5),
            (0.17, 44, 2.5),
            (0.33, 20, 0.8),
            (0.38, 18, 0.0),
            (0.68, 95, 0.0),
            (0.92, 22, 0.0),
            (1.0, 14, 0.1),
        ),
    ),
    "stairs up": Cycle(
        False,
        1.4,
        (
            (0.0, 63, 0.1),
            (0.06, 63, 0.5),
            (0.17, 55, 1.05),
            (0.35, 20, 0.8),
            (0.5, 9, 1.1),
            (0.6, 15, 0.5),
            (0.65, 35, 0.0),
            (0.82, 92, 0.0),
            (1.0, 63, 0.1),
        ),
    ),
    "stairs down": Cycle(
        False,
        1.25,
        (
            (0.0, 12, 0.1),
            (0.06, 15, 0.9),
            (0.14, 22, 1.4),
            (0.35, 28, 0.85),
            (0.5, 55, 0.95),
            (0.6, 82, 0.4),
            (0.66, 90, 0.0),
            (0.85, 40, 0.0),
            (1.0, 12, 0.1),
        ),
    ),
    "sit to stand": Cycle(
        False,
        4.0,
        (
            (0.0, 92, 0.12),
            (0.2, 92, 0.15),
            (0.3, 88, 0.6),
            (0.45, 45, 0.55),
            (0.55, 5, 0.5),
            (0.7, 5, 0.5),
            (0.82, 50, 0.48),
            (0.93, 90, 0.4),
            (1.0, 92, 0.12),
        ),
    ),
    "squats": Cycle(
        False,
        3.0,
        (
            (0.0, 5, 0.5),
            (0.2, 40, 0.47),
            (0.4, 95, 0.55),
            (0.6, 95, 0.53),
            (0.8, 40, 0.5),
            (1.0, 5, 0.5),
        ),
    ),
}


def made(name: str, seconds: float, random: np.random.Generator) -> tuple[Floats, Floats]:
    """Flexion [rad] and ground force [body weights] of a bout, shape (n,) each, of a person drawn at random."""
    cycle = CYCLES[name]
    phase, flexion, force = np.array(cycle.points).T
    number = int(seconds / STEP)
    paces = cycle.duration * random.uniform(0.85, 1.2)
    place = (np.arange(number) * STEP / paces + random.uniform()) % 1.0
    bent = PchipInterpolator(phase, flexion)(place) * random.normal(1.0, 0.07) + random.normal(
        0.0, 4.0
    )
    bears = PchipInterpolator(phase, force)(place) * random.normal(1.0, 0.05) + random.normal(
        0.0, 0.01, number
    )
    return np.radians(bent + random.normal(0.0, 0.5, number)), np.asarray(bears)


def marked(flexion: Floats, force: Floats) -> Flags:
    """Samples that the load node marks, shape (n,)."""
    movement, stamps = (
        Movement(1.0),
        np.rint(np.arange(len(flexion)) * STEP * SECOND).astype(np.int64),
    )
    rows = zip(stamps.tolist(), flexion.tolist(), force.tolist(), strict=True)
    return np.array([movement.is_other(*row) for row in rows])


def scores() -> tuple[dict[str, float], float]:
    """Part of the samples of each movement that are marked, and the F1 score, over mixtures."""
    random, names = np.random.default_rng(48), list(CYCLES)
    hits: dict[str, list[Flags]] = {name: [] for name in names}
    for _ in range(PERSONS):
        bouts = [
            (names[which], random.uniform(5.0, LONGEST))
            for which in random.integers(0, len(names), BOUTS)
        ]
        parts = [made(name, seconds, random) for name, seconds in bouts]
        found, begin = marked(*(np.concatenate(column) for column in zip(*parts, strict=True))), 0
        for (name, _), (flexion, _) in zip(bouts, parts, strict=True):
            hits[name].append(found[begin : begin + len(flexion)])
            begin += len(flexion)
    together = {name: np.concatenate(each) for name, each in hits.items()}
    right = sum(int(together[name].sum()) for name in names if not CYCLES[name].known)
    wrong = sum(int(together[name].sum()) for name in names if CYCLES[name].known)
    missed = sum(int((~together[name]).sum()) for name in names if not CYCLES[name].known)
    return {name: float(each.mean()) for name, each in together.items()}, 2 * right / (
        2 * right + wrong + missed
    )

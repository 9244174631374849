"""One motion, its ticks cut into 1, 4 and 64 parts: the exact solution is the same, so the answers must agree.

Next to no load, slow ticks, fast turns: what a flight meets between two looks must be found however far they lie apart.
Half of the motions change the knee on their way, by one of the changes that a live knee may have. There is no
reference here: the run that is cut into most parts stands for it, and its own estimate counts as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.knee import KneeModel, Stream
from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.model.mechanisms import hinge, translation_table
from knee_contact_ros.model.profiles import Circle, Profile
from knee_contact_ros.model.surfaces import ContactPair, Cup, Plane, Plateau, TibialSurface
from knee_contact_ros.model.ticks import QUASI_STATIC
from knee_contact_ros.model.types import Rows, Status
from studies.choosing.surfaces import read_points
from studies.honesty.judging import Judged, Verdict
from studies.honesty.scenes import arguments
from studies.honesty.study import Row, row
from studies.reference import LAWS

Floats = NDArray[Any]
Random = np.random.Generator
CONFIG = Path(__file__).parents[2] / "config"
TICKS, PARTS = 20, (1, 4, 64)
SURFACES = (
    "circle on plane",
    "circle in cup",
    "condyle on plane",
    "condyle in cup",
    "dents on slope",
    "dents in cup",
    "condyle on plateau",
    "dents on plateau",
)
CHANGES = ("none", "none", "none", "law", "mass", "tolerance", "level", "mechanism", "share")
TOLERANCE, LEAST = 1e-6, 1e-12
"""Tolerance of the depth [m]; difference of depths [m] that is rounding"""
BUDGETS = (1000,) * 49 + (20_000,)
"""Budgets of a tick: nearly all motions need less than the least, and a few would need minutes without it"""
MOST_LOST = 4
"""Number of ticks in a row after which a motion ends if neither of the coarser cuts is right in them"""
ROCKING = 0.5
"""Part of the motions that rock to and fro across the place where the femur reaches lowest: a touch between any two"""


@cache
def pair(name: str, moves: bool) -> ContactPair:
    """Build a contact pair, on a hinge or on a mechanism that moves by 12 mm/rad."""
    femur, _, tibia = name.replace(" in ", " on ").partition(" on ")
    points = read_points(CONFIG / "femur_medial.csv")
    if femur == "dents":
        points = points + np.random.default_rng(5).normal(0.0, 1e-4, points.shape)
    tibiae: dict[str, TibialSurface] = {"plane": Plane(), "slope": Plane(-0.1), "cup": Cup(0.095)}
    if tibia == "plateau":
        tibiae[tibia] = Plateau(*read_points(CONFIG / "tibia_medial.csv"))
    mechanism = translation_table([0.0, 1.0], [0.0, 0.012]) if moves else hinge()
    return ContactPair(
        Circle(0.034) if femur == "circle" else Profile(*points), tibiae[tibia], mechanism
    )


@cache
def summits(name: str) -> Floats:
    """Flexion angles [rad] at which a femur that is held reaches deepest, or one within a range of them."""
    angles = np.linspace(0.0, 1.4, 281)
    depth = np.array([pair(name, False).closest(angle, 0.04).depth for angle in angles.tolist()])
    tops = 1 + np.flatnonzero((depth[1:-1] > depth[:-2]) & (depth[1:-1] > depth[2:]))
    return angles[tops] if len(tops) else angles[140:141]


def rows(seed: int) -> Iterator[Row]:
    """Run a motion in all its cuts, and compare them."""
    random = np.random.default_rng((seed, 51))
    surfaces, change = str(random.choice(SURFACES)), str(random.choice(CHANGES))
    law = str(random.choice(list(LAWS)))
    tick = (
        float(np.round(10 ** random.uniform(-4.0, -0.7), 6)) // 64e-9 * 64e-9
    )  # parts have whole nanoseconds, too
    angle = np.clip(
        0.5 + np.cumsum(10 ** random.uniform(-3.0, -0.3) * random.uniform(-1.0, 1.0, TICKS)),
        0.0,
        1.4,
    )
    load = 10 ** random.uniform(-3.0, 2.5) * np.abs(random.normal(1.0, 0.5, TICKS))
    load[random.random(TICKS) < random.choice([0.0, 0.3])] *= -0.02
    if random.random() < ROCKING:
        swing = 10 ** random.uniform(-3.0, -0.5) * random.uniform(0.8, 1.2, TICKS)
        angle = random.choice(summits(surfaces)) + swing * (-1.0) ** np.arange(TICKS)
        load = np.full(TICKS, 10 ** random.uniform(-5.0, 0.5))
    before = KneeModel(
        pair(surfaces, False),
        CONTACT_LAWS[law](**arguments(random, law)),
        10 ** random.uniform(-2, 1),
        TOLERANCE,
        budget=BUDGETS[seed % len(BUDGETS)],
        compiled=True,
    )
    after, at = changed(random, before, change, surfaces), TICKS // 2
    if change == "share":
        load[at:] *= 0.6
    *runs, best = answers(before, after, at, [tick * np.arange(1, TICKS + 1), angle, load])
    tolerance = np.repeat([before.tolerance, after.tolerance], [at, TICKS - at])[: len(best)]
    for parts, series in zip(PARTS[:-1], runs, strict=True):
        name = f"{surfaces}, {law}, {change}, in {parts} parts"
        yield row(
            (surfaces, f"change: {change}", f"{parts} parts"),
            name,
            series,
            compared(series, best, tolerance),
        )


def changed(random: Random, knee: KneeModel, change: str, surfaces: str) -> KneeModel:
    """Change a knee in one way."""
    law = str(random.choice(list(LAWS)))
    return {
        "law": replace(knee, law=CONTACT_LAWS[law](**arguments(random, law))),
        "mass": replace(knee, mass=knee.mass * 10 ** random.uniform(-0.5, 0.5)),
        "tolerance": replace(knee, tolerance=1e-8),
        "level": replace(knee, level=QUASI_STATIC),
        "mechanism": replace(knee, pair=pair(surfaces, True)),
    }.get(change, knee)


def answers(
    before: KneeModel, after: KneeModel, at: int, samples: list[Floats]
) -> list[np.recarray[Any, Any]]:
    """Answers at the ticks of a motion in all its cuts, whose knee changes before one of its ticks.

    It ends where the finest cut is not right any more, so that nothing can be judged, or the others have not been.
    """
    streams, found = [Stream(before) for _ in PARTS], [list[Rows]() for _ in PARTS]
    cuts = [
        [
            np.interp(np.arange(TICKS * parts - parts + 1) / parts, np.arange(TICKS), one)
            for one in samples
        ]
        for parts in PARTS
    ]
    for now in range(TICKS):
        for parts, (time, angle, load), stream, kept in zip(
            PARTS, cuts, streams, found, strict=True
        ):
            if now == at:
                stream.continue_with(after)
            here = slice(max(now * parts - parts + 1, 0), now * parts + 1)
            stamps = np.rint(1e9 * time[here]).astype(np.int64)
            kept.append(stream.advance_all(stamps, angle[here], load[here], None)[-1:])
        lost = [
            all(one["status"][0] & Status.NOT_CONVERGED for one in kept[-MOST_LOST:])
            for kept in found
        ]
        if found[-1][-1]["status"][0] & Status.NOT_CONVERGED or (
            all(lost[:-1]) and now >= MOST_LOST
        ):
            break
    return [np.concatenate(kept).view(np.recarray) for kept in found]


def compared(
    series: np.recarray[Any, Any], best: np.recarray[Any, Any], tolerance: Floats
) -> Judged:
    """Judge a run by another one of the same motion: both estimates together must cover what they differ by."""
    ours, exact = (one.penetration_depth - one.gap for one in (series, best))
    right = series.status & Status.NOT_CONVERGED == 0
    known, error = right & (best.status & Status.NOT_CONVERGED == 0), np.abs(ours - exact)
    bound = series.error_estimate + best.error_estimate
    large = known & (error > LEAST)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = Verdict(
            error,
            best.error_estimate,
            bound,
            known,
            large,
            known & (error <= bound + LEAST),
            known & ~(error <= 2.0 * tolerance),
            bound / error,
        )
    none = np.zeros_like(right)  # what the other run cannot answer either is not known
    return Judged(
        depth, None, right, none, ~right, exact < 0.0, series.fidelity, series.evaluations
    )

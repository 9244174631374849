"""A budget is a bound, and what is lost by it is told: loads that pull, on both knees, and femurs that turn."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from studies.honesty.judging import judge
from studies.honesty.ours import model
from studies.honesty.scenes import ARTHRITIC, FEMUR, HEALTHY, Scene, draw, shipped
from studies.honesty.study import Row, row
from studies.honesty.truth import reference

BUDGETS = (100, 200, 400, 1000)
PULLS = (1.02, 1.1, 1.2, 1.4, 1.7, 2.0)
"""Ratios of the load's swing to its mean; above 1 the load pulls at times"""
MEANS = (300.0, 1000.0, 2000.0)
"""Mean loads [N]"""
FREQUENCIES = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Frequencies [Hz]"""
CASES = list(itertools.product((HEALTHY, ARTHRITIC), PULLS, MEANS, FREQUENCIES))
TOLERANCE, TICKS, STEPS = 1e-6, 1500, 10
"""Tolerance [m]; number of ticks, each of 1 ms; and of ticks in which an angle is held every other half"""
COUNT = len(CASES) + 360


def pulled(number: int) -> Scene:
    """A shipped knee under a load that pulls: mean (1 + pull sin 2πft) N."""
    family, pull, mean, frequency = CASES[number]
    law, arguments = shipped(family)
    time = np.rint(np.arange(TICKS) * 1e6) * 1e-9
    load = mean * (1.0 + pull * np.sin(math.tau * frequency * time))
    return Scene(
        number,
        family,
        law,
        arguments,
        FEMUR,
        (0.034, 0.034),
        0.0,
        False,
        "",
        time,
        np.zeros(TICKS),
        load,
    )


def turned(seed: int) -> Scene:
    """A random knee whose surface turns from tick to tick, and kicks a femur that next to nothing presses."""
    scene, random = draw(seed), np.random.default_rng((seed, 22))
    tick, first = np.arange(len(scene.time)), scene.angle[0]
    wander = first + 0.06 * random.random() * np.cumsum(random.choice([-1.0, 0.0, 1.0], len(tick)))
    sway = first - 0.05 * np.cos(random.uniform(0.2, 2.0) * tick)
    stop = scene.angle[np.where(tick % STEPS < STEPS // 2, tick, np.maximum(tick - STEPS // 2, 0))]
    still = np.full(len(tick), 10 ** random.uniform(-1.0, 3.0))
    ends = np.where(tick < len(tick) // 2, still, random.choice([-1e-8, 1e-8, 0.0, -5.0]))
    angle, load = (wander, sway, stop)[seed % 3], (still, ends, scene.load)[random.integers(3)]
    return scene._replace(family="turning", angle=angle, load=load)


def rows(seed: int) -> Iterator[Row]:
    """Run one of the scenes with all budgets; the first 180 numbers of a seed are the loads that pull."""
    number = seed % 1_000_000
    scene = pulled(number) if number < len(CASES) else turned(seed)
    truth = reference(scene)
    for budget in BUDGETS:
        series = model(scene, "dynamic", TOLERANCE, budget)
        yield row(
            (f"{scene.family}, {budget}",),
            f"budget {budget}",
            series,
            judge(series, truth, TOLERANCE),
        )

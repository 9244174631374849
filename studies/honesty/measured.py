"""How honest the estimates are on measured condyles: noisy points and loads, encoder spikes, uneven stamps, budgets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.model.mechanisms import hinge
from knee_contact_ros.model.profiles import Profile
from knee_contact_ros.model.surfaces import ContactPair, Plane
from knee_contact_ros.model.ticks import LEVELS
from studies.choosing.surfaces import read_points
from studies.honesty.dented import condyle, solve
from studies.honesty.judging import judge
from studies.honesty.loads import STRIDE, bag
from studies.honesty.scenes import ARTHRITIC, FEMUR, HEALTHY, KNEE, shipped
from studies.honesty.study import Row, row
from studies.reference import LAWS, Solution

Floats = NDArray[np.float64]
Random = np.random.Generator
CONFIG = Path(__file__).parents[2] / "config"
TICKS = 200
TOLERANCES = (1e-4, 1e-6, 1e-8)
"""[m]"""
DENTS = (0.0, 1e-5, 5e-5, 2e-4)
"""Noise of the femur's points [m]"""
BUDGETS = (20.0, 2e4)
"""Range of the budgets, of which decades are equally likely"""


class Scene(NamedTuple):
    """A measured knee in numbers; a seed is enough to repeat it."""

    seed: int
    law: str
    arguments: dict[str, Any]
    mass: float
    dents: float
    points: Floats
    """Points of the femur [m], shape (2, n)"""
    time: Floats
    angle: Floats
    load: Floats


def draw(seed: int) -> Scene:
    """Draw the scene of a seed."""
    random = np.random.default_rng((seed, 45))

    def varied(value: float) -> float:
        return float(value * random.uniform(0.7, 1.3))

    law, constants = shipped(str(random.choice([HEALTHY, ARTHRITIC])))
    if random.random() < 0.25:
        law = "hunt_crossley"
        constants = {**KNEE, "restitution": 0.5, "least_impact_speed": 0.1}
        del constants["damping"]
    fixed = ("exponent", "damp_first_layer")
    arguments = {
        name: value if name in fixed else varied(value) for name, value in constants.items()
    }
    points, dents = (
        read_points(CONFIG / str(random.choice(["femur_medial.csv", "femur_lateral.csv"]))),
        DENTS[seed % 4],
    )
    points = points + random.normal(0.0, 1.0, points.shape) * dents
    return Scene(seed, law, arguments, varied(FEMUR), dents, points, *_series(random))


def _series(random: Random) -> tuple[Floats, Floats, Floats]:
    """Times, angles and loads of noisy gait: stamps of 100 Hz to 10 kHz in one run, and spikes of the encoder."""
    durations = 10 ** np.clip(
        random.uniform(-4.0, -2.0) + np.cumsum(random.normal(0.0, 0.3, TICKS)), -4.0, -2.0
    )
    if random.random() < 0.5:
        durations = 10 ** random.uniform(-4.0, -2.0, TICKS)
    time = np.rint(np.cumsum(durations) * 1e9) * 1e-9
    stamps, angle, load = bag("right" if random.random() < 0.5 else "left")
    phase = 0.62 + np.mod(time + random.uniform(0.0, STRIDE), STRIDE)
    angles, loads = np.interp(phase, stamps, angle), np.interp(phase, stamps, load)
    angles += random.choice([0.0, 1e-4, 1e-3]) * random.standard_normal(TICKS)
    spikes = random.random(TICKS) < random.choice([0.0, 0.02])
    angles += spikes * random.choice([-0.3, 0.05, 0.3], TICKS)
    loads += random.choice([0.0, 10.0, 100.0]) * random.standard_normal(TICKS)
    return time, angles, loads - random.choice([0.0, 100.0, 250.0])


def knee(scene: Scene) -> KneeModel:
    """Compiled model of a scene, without a budget."""
    pair = ContactPair(Profile(*scene.points), Plane(0.0), hinge())
    return KneeModel(
        pair, CONTACT_LAWS[scene.law](**scene.arguments), scene.mass, budget=0, compiled=True
    )


@lru_cache(maxsize=16)
def truth(seed: int) -> Solution | None:
    """Solution of the reference for the scene of a seed; None if there is none."""
    scene = draw(seed)
    law = LAWS[scene.law](**scene.arguments)
    try:
        return solve(condyle(scene.points), law, scene.mass, scene.time, scene.angle, scene.load)
    except RuntimeError:
        return None


def rows(seed: int) -> Iterator[Row]:
    """Judge a measured knee at both levels and all tolerances, and with eight budgets."""
    scene, random = draw(seed), np.random.default_rng((seed, 46))
    model, exact = knee(scene), truth(seed)
    if exact is None:
        return
    settings: list[tuple[str, float, dict[str, Any]]] = [
        (f"{level}, {tolerance:g} m", tolerance, {"level": LEVELS[level]})
        for level in ("quasi_static", "dynamic")
        for tolerance in TOLERANCES
    ]
    for _ in range(8):
        budget = int(10 ** random.uniform(*np.log10(BUDGETS)))
        name = next(f"budget below {end}" for end in (100, 1000, 100_000) if budget < end)
        settings.append((name, float(random.choice(TOLERANCES)), {"budget": budget}))
    for name, tolerance, values in settings:
        series = replace(model, tolerance=tolerance, **values).run(
            scene.time, scene.angle, scene.load
        )
        yield row(
            (name, f"dents of {scene.dents:g} m"), name, series, judge(series, exact, tolerance)
        )

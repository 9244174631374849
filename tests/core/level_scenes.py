"""Scenes on which the levels are held against each other; all parameters lie in the ranges of `parameters.py`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.contact_pairs import ContactPair, OnPlane, in_circle, on_profile
from knee_contact_ros.core.geometries import Circle
from knee_contact_ros.core.mechanisms import Hinge, Mechanism, Table
from knee_contact_ros.core.model import KneeModel
from studies.gait import gait
from tests.core.surfaces import ellipse
from tests.helpers.scenes import MASS, RADIUS, law, model, quick

Series = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Time [s], flexion angle [rad], load [N]"""
FINEST = 1e-11
"""Tolerance [m] of the dynamic run that stands for the exact solution"""


class LevelScene(NamedTuple):
    """A knee and what it goes through."""

    name: str
    law: ContactLaw
    series: Series
    mass: float = MASS
    pair: ContactPair = OnPlane(Circle(RADIUS))
    mechanism: Mechanism = Hinge()
    smooth: bool = False
    """Whether the load never jumps and never lets the contact go"""

    def model(self, level: str, tolerance: float) -> KneeModel:
        """The knee at a level."""
        return model(
            self.law, tolerance, mass=self.mass, pair=self.pair, mechanism=self.mechanism, level=level, budget=20_000
        )


def walking(count: int = 161, tick: float = 5e-3) -> Series:
    """Two humps of load over a stance, as in gait, and the knee bends meanwhile."""
    time = tick * np.arange(count)
    phase = math.tau * time / 0.8
    return time, 0.3 - 0.25 * np.cos(phase), 700.0 - 350.0 * np.cos(phase) - 250.0 * np.cos(3.0 * phase)


def hopping(count: int = 161, tick: float = 2e-3) -> Series:
    """Let go of twice, for 2 cm each time at most, and landed on."""
    time = tick * np.arange(count)
    return time, 0.4 + 0.2 * np.sin(8.0 * time), 400.0 + 500.0 * np.cos(math.tau * time / 0.16)


def stepping(count: int = 121, tick: float = 5e-3) -> Series:
    """Loads that jump from one tick to the next and are held."""
    time = tick * np.arange(count)
    return time, 0.3 + 0.0 * time, np.array([800.0, 2000.0, 100.0, 1200.0])[(np.arange(count) // 25) % 4]


@cache
def scenes() -> tuple[LevelScene, ...]:
    """All scenes."""
    kelvin_voigt = law("kelvin_voigt")
    hill = np.linspace(-0.04, 0.04, 41)
    forwards = Table([0.0, 1.0], [0.0, 0.008])
    right = tuple(column[:200] for column in gait("right"))
    return (
        LevelScene("gait", kelvin_voigt, right, smooth=True),
        LevelScene("gait in ticks of 0.5 ms", kelvin_voigt, walking(401, 5e-4), smooth=True),
        LevelScene("walking, ellipse", kelvin_voigt, walking(), pair=OnPlane(ellipse(160)), smooth=True),
        LevelScene("walking, 1 g", kelvin_voigt, walking(), mass=1e-3, smooth=True),
        LevelScene("walking, 0.1 g", kelvin_voigt, walking(), mass=1e-4, smooth=True),
        LevelScene("walking, 200 kg", kelvin_voigt, walking(), mass=200.0, smooth=True),
        LevelScene("walking, 1 t", kelvin_voigt, walking(), mass=1e3, smooth=True),
        LevelScene("walking, C 1e6", law("kelvin_voigt", damping=1e6), walking(), smooth=True),
        LevelScene("walking, C 30, 10 g", law("kelvin_voigt", damping=30.0), walking(), mass=1e-2, smooth=True),
        LevelScene("walking, Hertz", law("hertz"), walking(), smooth=True),
        LevelScene("walking, Hertz, 10 g", law("hertz"), walking(161, 1e-3), mass=1e-2, smooth=True),
        LevelScene("walking, elastic foundation", law("elastic_foundation"), walking(), smooth=True),
        LevelScene("walking, two layers", law("two_layer_viscoelastic", layer_depth=3e-4), walking()),
        LevelScene(
            "walking, two layers damped", law("two_layer_viscoelastic", layer_depth=3e-4, damp_first_layer=True),
            walking(),
        ),
        LevelScene("walking, two layers elastic", law("two_layer_elastic", layer_depth=3e-4), walking()),
        LevelScene("walking, Flores", law("flores"), walking(), smooth=True),
        LevelScene(
            "walking, ellipse in a circle, carried forwards", kelvin_voigt, walking(),
            pair=in_circle(ellipse(160), 0.095), mechanism=forwards, smooth=True,
        ),
        LevelScene(
            "walking, circle on a hill, C 1e5, 0.1 kg", law("kelvin_voigt", damping=1e5), walking(), mass=0.1,
            pair=on_profile(Circle(RADIUS), hill, -4.0 * hill**2), mechanism=forwards, smooth=True,
        ),
        LevelScene("hopping", kelvin_voigt, hopping()),
        LevelScene("hopping, Gonthier", law("gonthier"), hopping()),
        LevelScene("hopping, 0.1 kg, two layers", law("two_layer_viscoelastic"), hopping(), mass=0.1),
        LevelScene("stepping", kelvin_voigt, stepping()),
        LevelScene("stepping, 1 g", kelvin_voigt, stepping(), mass=1e-3),
        LevelScene("stepping, C 1e6, 1 kg", law("kelvin_voigt", damping=1e6), stepping(), mass=1.0),
        *random_scenes(10),
    )  # fmt: skip


def random_scenes(count: int) -> Iterator[LevelScene]:
    """Kelvin-Voigt or two-layer knees from anywhere in the ranges that knees may be in, and beyond."""
    for seed in range(count):
        rng = np.random.default_rng((20, seed))
        arguments = {
            "stiffness": 10.0 ** rng.uniform(6.5, 9.5), "exponent": rng.uniform(1.0, 2.0),
            "damping": 10.0 ** rng.uniform(2.0, 6.0),
        }  # fmt: skip
        name = ("kelvin_voigt", "two_layer_viscoelastic")[int(rng.integers(2))]
        if name != "kelvin_voigt":
            arguments |= {"layer_depth": 10.0 ** rng.uniform(-4.5, -3.0), "damp_first_layer": bool(rng.integers(2))}
        time = 10.0 ** rng.uniform(-3.7, -2.0) * np.arange(121)
        waves = [(rng.uniform(1.0, 10.0), rng.uniform(0.0, math.tau), rng.uniform(0.0, 400.0)) for _ in range(3)]
        load = rng.uniform(100.0, 1500.0) + sum(
            size * np.sin(math.tau * rate * time + phase) for rate, phase, size in waves
        )
        angle = 0.5 + 0.4 * np.sin(math.tau * rng.uniform(0.3, 1.5) * time)
        pair = (OnPlane(Circle(RADIUS)), OnPlane(ellipse(160)), in_circle(Circle(RADIUS), 0.095))[int(rng.integers(3))]
        yield LevelScene(
            f"random {seed}",
            law(name, **arguments),
            (time, angle, load),
            mass=10.0 ** rng.uniform(-3.0, 2.0),
            pair=pair,
        )


@cache
def exact(index: int) -> np.recarray[Any, Any]:
    """The dynamic run that stands for the exact solution of a scene."""
    scene = scenes()[index]
    return quick(scene.model("dynamic", FINEST)).run(*scene.series)


@cache
def answers(index: int, level: str, tolerance: float) -> np.recarray[Any, Any]:
    """The answers of a level."""
    scene = scenes()[index]
    return quick(scene.model(level, tolerance)).run(*scene.series)

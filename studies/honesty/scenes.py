"""Random scenes: any law over wide ranges, and knees that a person may have. A seed is enough to repeat one."""

from __future__ import annotations

import hashlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from studies.honesty.loads import ANGLES, GAITS, LOADS, swing
from studies.reference import LAWS

Floats = NDArray[np.float64]
Random = np.random.Generator
TICKS = 300
WIDE, HEALTHY, ARTHRITIC = "wide", "healthy", "osteoarthritis"
FAMILIES = (WIDE, HEALTHY, ARTHRITIC)
DEEP = 5e-4
"""Depth [m] at which laws of different exponents are as stiff as each other"""
KNEE = {"stiffness": 7.905694e7, "exponent": 1.5, "damping": 5000.0}
LAYERS = {"layer_depth": 5e-4, "stiffness_2": 3.112e9}
FEMUR = 9.3014
"""Mass of the femur [kg]; the constants are those of config/healthy.yaml and config/osteoarthritis_as_printed.yaml"""


class Scene(NamedTuple):
    """A knee with its angles and loads, in plain data."""

    seed: int
    family: str
    law: str
    arguments: dict[str, Any]
    mass: float
    half_axes: tuple[float, float]
    slope: float
    allow_tension: bool
    loads: str
    """Name of the function that drew the load"""
    time: Floats
    angle: Floats
    load: Floats

    def content(self) -> str:
        """Digest of all that a solution depends on."""
        numbers = (
            self.law,
            sorted(self.arguments.items()),
            self.mass,
            self.half_axes,
            self.slope,
            self.allow_tension,
        )
        digest = hashlib.sha256(repr(numbers).encode())
        for column in (self.time, self.angle, self.load):
            digest.update(np.ascontiguousarray(column).tobytes())
        return digest.hexdigest()[:24]


def draw(seed: int, ticks: int = TICKS) -> Scene:
    """Draw the scene of a seed: two in three from wide ranges, the others plausible knees."""
    random = np.random.default_rng((seed, 16))
    family = str(random.choice(FAMILIES, p=(0.68, 0.16, 0.16)))
    return (
        _wide(random, seed, ticks) if family == WIDE else _plausible(random, seed, family, ticks)
    )


def _decades(random: Random, low: float, high: float) -> float:
    return float(10 ** random.uniform(low, high))


def _times(random: Random, tick: float, ticks: int) -> Floats:
    """Stamps [s] of ticks around a duration, in whole nanoseconds: half of the series irregular."""
    uneven = random.choice([0.0, 0.0, 0.1, 0.5, 0.9])
    durations = np.clip(tick * (1.0 + uneven * random.uniform(-1.0, 1.0, ticks)), 1e-4, 1e-2)
    return np.asarray(np.rint(np.cumsum(durations) * 1e9) * 1e-9, dtype=np.float64)


def _wide(random: Random, seed: int, ticks: int) -> Scene:
    law = str(random.choice(list(LAWS)))
    loads = str(random.choice(list(LOADS)))
    mean = _decades(random, 1.0, 3.3)
    tick = _decades(random, -3.7, -2.0)
    if loads in GAITS:
        tick = _decades(random, -3.0, -2.2)
    time = _times(random, tick, ticks)
    load = LOADS[loads](random, time, mean)
    round_ = random.random() < 0.4
    axes = (
        (0.034, 0.034)
        if round_
        else (float(random.uniform(0.02, 0.05)), float(random.uniform(0.02, 0.05)))
    )
    angle = ANGLES[int(random.integers(len(ANGLES)))](random, time)
    slope = 0.0 if random.random() < 0.4 else float(random.uniform(-0.3, 0.3))
    constants = arguments(random, law)
    tension = bool(random.random() < 0.15)
    mass = _decades(random, -3.7, 1.48)
    return Scene(seed, WIDE, law, constants, mass, axes, slope, tension, loads, time, angle, load)


def arguments(random: Random, law: str) -> dict[str, Any]:
    """Constants of a law from wide ranges."""
    if law == "elastic_foundation":
        radius = float(random.uniform(0.02, 0.04))
        return {
            "youngs_modulus": _decades(random, 6.0, 8.5),
            "poissons_ratio": float(random.uniform(0.05, 0.48)),
            "foundation_thickness": float(random.uniform(1e-3, 8e-3)),
            "femoral_radius": radius,
            "tibial_radius": radius * float(random.uniform(1.1, 5.0)),
        }
    exponent = float(random.choice([1.5, 1.5, 1.5, 1.0, 2.0, 3.0, *random.uniform(1.0, 3.0, 4)]))
    stiffness = _decades(random, 6.0, 11.0) * DEEP ** (1.5 - exponent)
    damping = 0.0 if random.random() < 0.05 else _decades(random, 1.0, 5.5)
    spring = {"stiffness": stiffness, "exponent": exponent}
    layers = {
        "layer_depth": _decades(random, -4.5, -3.0),
        "stiffness_2": stiffness * _decades(random, 0.0, 2.0),
    }
    impact = {
        "restitution": float(random.uniform(0.05, 1.0)),
        "least_impact_speed": _decades(random, -3.0, 0.0),
    }
    return spring | {
        "hertz": {},
        "kelvin_voigt": {"damping": damping},
        "two_layer_elastic": layers,
        "two_layer_viscoelastic": layers
        | {"damping": damping, "damp_first_layer": bool(random.random() < 0.5)},
    }.get(law, impact)


def shipped(family: str) -> tuple[str, dict[str, Any]]:
    """Contact law and arguments of a shipped knee."""
    if family == HEALTHY:
        return "kelvin_voigt", dict(KNEE)
    return "two_layer_viscoelastic", {**KNEE, **LAYERS, "damp_first_layer": False}


def _plausible(random: Random, seed: int, family: str, ticks: int) -> Scene:
    """Draw a shipped knee with constants varied by up to 30 %, in gait, gait with lift-offs, or running."""

    def varied(value: float) -> float:
        return float(value * random.uniform(0.7, 1.3))

    law, constants = shipped(family)
    fixed = ("exponent", "damp_first_layer")
    arguments = {
        name: value if name in fixed else varied(value) for name, value in constants.items()
    }
    loads = str(random.choice(GAITS))
    time = _times(random, _decades(random, -3.0, -2.3), ticks)
    load = LOADS[loads](random, time, 0.0)
    axes = (
        (0.034, 0.034) if random.random() < 0.4 else (0.034, float(random.uniform(0.026, 0.036)))
    )
    angle = swing(random, time)
    return Scene(
        seed, family, law, arguments, varied(FEMUR), axes, 0.0, False, loads, time, angle, load
    )

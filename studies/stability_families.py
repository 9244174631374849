"""Families of scenes for `studies.stability`: grids over the ranges, and scenes from anywhere in them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator

import numpy as np

from knee_contact_ros.model.laws import CONTACT_LAWS
from studies.stability_scenes import DEGENERATE, Scene, arguments_of

LAWS = tuple(CONTACT_LAWS)
DAMPED = ("kelvin_voigt", "two_layer_viscoelastic", "hunt_crossley", "gonthier")
STIFFNESS, DAMPING, MASS = (1e3, 1e13), (1.0, 1e7), (1e-4, 1e3)
EXPONENT, TICK, LOAD = (1.0, 3.0), (1e-5, 0.1), (-5e3, 2e4)
SPEED, LAYER, ANGLE, TOLERANCE = (0.01, 5.0), (1e-6, 5e-3), (-0.2, 1.6), (1e-9, 1e-5)
"""Ranges of the parameters, in SI units; damping may also be 0"""
FEMURS = ("circle", "mri", "ellipse", *DEGENERATE)
STEPS = (0.0, 800.0, 800.0, 2500.0, -300.0, -300.0, 1500.0, 1500.0)
"""Loads [N] of most scenes: each is held for a tick wherever energy is to be balanced"""
UPRIGHT = (0.3,) * len(STEPS)
Uniform = Callable[[float, float], float]
"""Draws a number between two: by NumPy in the study, by hypothesis in the tests"""


def times(tick: float, count: int = len(STEPS)) -> tuple[float, ...]:
    """Times [s] of a number of equal ticks."""
    return tuple(i * tick for i in range(count))


def grid() -> Iterator[Scene]:
    """Scenes of every combination of stiffness, damping, mass, exponent and tick, by Kelvin-Voigt and one other law."""
    others = np.random.default_rng(0).permutation(np.resize([law for law in LAWS if law != "kelvin_voigt"], 432))
    axes = ((1e3, 1e6, 1e9, 1e13), (0.0, 5e3, 1e7), (1e-4, 1.0, 1e3), (1.0, 1.5, 3.0), (1e-5, 1e-3, 1e-2, 0.1))
    for i, (stiffness, damping, mass, exponent, tick) in enumerate(itertools.product(*axes)):
        for law in ("kelvin_voigt", str(others[i])):
            yield Scene(law, arguments_of(law, stiffness, exponent, damping), mass, 1e-7, times(tick), UPRIGHT, STEPS)


def layers() -> Iterator[Scene]:
    """Scenes with layers of 1 µm to 5 mm over a softer, an equal and a far stiffer one."""
    depths, ratios = (1e-6, 1e-5, 1e-4, 1e-3, 5e-3), (1e-2, 1.0, 40.0, 1e4)
    for depth, ratio, damping, law in itertools.product(depths, ratios, (0.0, 5e3), ("elastic", "viscoelastic")):
        if law == "viscoelastic" or damping == 0.0:
            arguments = arguments_of(f"two_layer_{law}", 7.9e7, 1.5, damping, depth, ratio)
            yield Scene(f"two_layer_{law}", arguments, 9.3, 1e-7, times(5e-3), UPRIGHT, STEPS)


def impacts() -> Iterator[Scene]:
    """Scenes of a femur thrown onto the plateau, without and with a load, by every law."""
    for law, speed, mass, load in itertools.product(LAWS, (0.01, 0.1, 1.0, 5.0), (0.01, 9.3), (0.0, 500.0)):
        arguments = arguments_of(law, 7.9e7, 1.5, 5e3)
        yield Scene(law, arguments, mass, 1e-7, times(2e-3), UPRIGHT, (load,) * 8, thrown=speed)


def load_steps() -> Iterator[Scene]:
    """Scenes of loads that step between -5 and 20 kN from one tick to the next."""
    series = (
        (0.0, 2e4, 2e4, -5e3, -5e3, 2e4, 2e4, 0.0), (2e4, 2e4, 0.0, 0.0, 2e4, -5e3, 2e4, 2e4),
        (-5e3, -5e3, 2e4, 2e4, -5e3, 2e4, -5e3, 2e4),
    )  # fmt: skip
    for law, load, tick, mass in itertools.product(LAWS, series, (1e-3, 1e-2), (0.1, 9.3)):
        yield Scene(law, arguments_of(law, 7.9e7, 1.5, 5e3), mass, 1e-7, times(tick), UPRIGHT, load)


def flexion_jumps(femurs: tuple[str, ...] = ("mri", "ellipse")) -> Iterator[Scene]:
    """Scenes in which the angle jumps by up to 1.8 rad in a tick, at up to 1800 rad/s."""
    angles = (0.0, 0.0, 1.6, 1.6, -0.2, 0.8, 0.8, 0.1)
    loads = ((600.0,) * 8, (600.0, 600.0, -200.0, 900.0, 900.0, 0.0, 0.0, 2000.0))
    for law, femur, load, tick in itertools.product(LAWS, femurs, loads, (1e-3, 1e-2, 0.1)):
        yield Scene(law, arguments_of(law, 7.9e7, 1.5, 5e3), 9.3, 1e-7, times(tick), angles, load, femur)


def degenerate() -> Iterator[Scene]:
    """Scenes of femoral profiles that no knee has, turned by jumps and slowly."""
    for scene in flexion_jumps(DEGENERATE):
        if scene.law in DAMPED and (scene.load[2] > 0.0 or scene.time[1] < 0.1):
            slowly = tuple(0.02 * i for i in range(len(scene.time)))
            yield scene._replace(angle=slowly) if scene.time[1] == 1e-2 else scene


def curved_tibiae() -> Iterator[Scene]:
    """Scenes of flexion jumps and load steps on a concave circle and on a measured plateau."""
    surfaces = {("circle", "circle"): LAWS, ("circle", "mri"): LAWS, ("mri", "circle"): DAMPED}
    for scene in flexion_jumps(("circle",)):
        for (femur, tibia), laws in surfaces.items():
            if scene.law in laws and scene.time[1] < 0.1:
                yield scene._replace(femur=femur, tibia=tibia)
        if scene.law in DAMPED and scene.time[1] == 1e-2:
            slowly = tuple(0.02 * i for i in range(len(scene.time)))
            yield scene._replace(femur="raw", tibia="circle", angle=slowly)


def random_scene(uniform: Uniform, femurs: tuple[str, ...] = FEMURS, ticks: int = 8) -> Scene:
    """A random scene of the ranges: decades are equally likely, loads and angles are held or step."""

    def decades(ends: tuple[float, float]) -> float:
        return math.pow(10.0, uniform(*(math.log10(end) for end in ends)))

    def choice(names: tuple[str, ...]) -> str:
        return names[min(int(uniform(0.0, len(names))), len(names) - 1)]

    def steps(ends: tuple[float, float]) -> tuple[float, ...]:
        values = [uniform(*ends)]
        while len(values) < ticks:
            values.append(uniform(*ends) if uniform(0.0, 1.0) < 0.4 else values[-1])
        return tuple(values)

    law = choice(LAWS)
    damping = decades(DAMPING) if uniform(0.0, 1.0) < 0.8 else 0.0
    ratio = decades((1e-3, 1e3))
    arguments = arguments_of(law, decades(STIFFNESS), uniform(*EXPONENT), damping, decades(LAYER), ratio)
    thrown = decades(SPEED) if uniform(0.0, 1.0) < 0.3 else 0.0
    return Scene(
        law, arguments, decades(MASS), decades(TOLERANCE), times(decades(TICK), ticks),
        steps(ANGLE), steps(LOAD), choice(femurs), thrown,
    )  # fmt: skip


def random_scenes(seed: int, count: int) -> list[Scene]:
    """A number of random scenes; each has a generator of its own, so that its number is enough to repeat it."""
    return [random_scene(np.random.default_rng((seed, i)).uniform) for i in range(count)]


def reference_scenes(seed: int, count: int) -> list[Scene]:
    """Random scenes that the reference can solve: closed-form femora from a static start, in short ticks."""
    found = []
    for i in range(count):
        scene = random_scene(np.random.default_rng((seed, i, 1)).uniform, ("circle", "closed ellipse"), 6)
        shorter = min(1.0, 5e-3 / scene.time[1])
        found.append(scene._replace(thrown=0.0, time=tuple(time * shorter for time in scene.time)))
    return found

"""Knees and inputs at the extremes, at random."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model import run_state
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import CONTACT_LAWS, ContactLaw
from knee_contact_ros.model.mechanisms import hinge, parallel_mechanism
from knee_contact_ros.model.profiles import Circle, Profile
from knee_contact_ros.model.surfaces import ContactPair, Cup, Plane, Plateau
from knee_contact_ros.model.ticks import LEVELS
from knee_contact_ros.model.types import NANOSECOND, Fidelity, blank_answers
from knee_contact_ros.parameters.schema import Parameters, constants_of
from studies.ellipse import Ellipse, SmoothFemur

RADIUS = 0.034
HALF_AXES = (0.034, 0.028)
BUDGET = 5_000
"""Evaluations of the contact law that a tick may cost"""
CONFIG = Path(__file__).parent.parent / "config"
DEFAULTS = Parameters().contact
MRI, PLATEAU = CONFIG / "femur_medial.csv", CONFIG / "tibia_medial.csv"


class Scene(NamedTuple):
    """A knee, its angles and loads, in numbers and names only, so that a failure can be printed and repeated."""

    law: str
    arguments: dict[str, float]
    mass: float
    tolerance: float
    time: tuple[float, ...]
    angle: tuple[float, ...]
    load: tuple[float, ...]
    femur: str = "circle"
    thrown: float = 0.0
    """Speed [m/s] at which the femur starts towards the plateau (see `start_gap`); 0: the static start"""
    tibia: str = "plane"
    """Name of the tibial surface; on a curved one the parallel mechanism carries the femur along"""

    @property
    def start_gap(self) -> float:
        """Gap [m] at a thrown start, such that the impact falls into the first tick."""
        return 1e-6 + 0.3 * self.thrown * (self.time[1] - self.time[0])


def arguments_of(
    law: str,
    stiffness: float,
    exponent: float,
    damping: float,
    layer: float = 1e-4,
    ratio: float = 40.0,
) -> dict[str, float]:
    """Arguments of a law from the numbers that are varied.

    Damping [N s/m] turns into a restitution where a law asks for one: from 1 at 0 to 0.02 at 1e7. The elastic
    foundation (exponent 2) gets the modulus that gives `stiffness`.
    """
    if law == "elastic_foundation":
        # K = π M R / t, and with these numbers M = 1.872 E and R = 53 mm
        unit = CONTACT_LAWS[law](**_foundation(1.0)).static_force(1.0)
        return _foundation(stiffness / unit)
    given = {
        "stiffness": stiffness,
        "exponent": exponent,
        "damping": damping,
        "layer_depth": layer,
        "stiffness_2": stiffness * ratio,
        "damp_first_layer": bool(exponent < 2.0),
        "restitution": 1.0 - 0.14 * math.log10(1.0 + damping),
        "least_impact_speed": 0.01,
    }
    return {name: given.get(name, getattr(DEFAULTS, name)) for name in constants_of(law)}


def _foundation(modulus: float) -> dict[str, float]:
    return {
        "youngs_modulus": modulus,
        "poissons_ratio": 0.38,
        "foundation_thickness": 4.4e-3,
        "femoral_radius": 0.034,
        "tibial_radius": 0.095,
    }


def _points(path: Path) -> NDArray[np.float64]:
    """Columns x, y of a shipped profile, shape (2, n) [m]."""
    header = path.read_text(encoding="utf-8").splitlines().index("x,y") + 1
    return np.loadtxt(path, delimiter=",", skiprows=header).T


@lru_cache
def femur(name: str) -> Circle | Profile | SmoothFemur:
    """Femoral surface by its name; all but the circles and ellipses are profiles of measured or made-up points."""
    around = np.linspace(-math.pi - 0.9, 0.9, 160)
    noise = np.random.default_rng(1).normal(0.0, 2e-4, (2, 160))
    a, b = HALF_AXES
    x, y = a * np.cos(around), b * np.sin(around)
    few = np.linspace(-math.pi, 0.0, 4)
    along = np.linspace(-0.03, 0.03, 40)
    profiles: dict[str, Callable[[], Any]] = {
        "mri": lambda: _points(MRI),
        "ellipse": lambda: (x, y),
        "4 points": lambda: (a * np.cos(few), b * np.sin(few)),
        "zigzag": lambda: (x, y + 5e-4 * (-1.0) ** np.arange(160)),
        "nearly straight": lambda: (along, -0.03 + 1e-9 * (along / 0.03) ** 2),
        "repeated points": lambda: (np.repeat(x, 3), np.repeat(y, 3)),
        "raw": lambda: (x + noise[0], y + noise[1]),
    }
    if name == "circle":
        return Circle(RADIUS)
    return (
        SmoothFemur(closed_form=Ellipse(a, b).support)
        if name == "closed ellipse"
        else Profile(*profiles[name]())
    )


DEGENERATE = ("4 points", "zigzag", "nearly straight", "repeated points", "raw")


@lru_cache
def pair(femoral: str, tibial: str) -> ContactPair:
    """Contact pair of a femur on a plane; or on a concave circle or the measured plateau, by the parallel mechanism."""
    if tibial == "plane":
        return ContactPair(femur(femoral), Plane(0.0), hinge())
    tibia = Cup(0.095) if tibial == "circle" else Plateau(*_points(PLATEAU))
    return ContactPair(femur(femoral), tibia, parallel_mechanism())


def law_of(scene: Scene) -> ContactLaw:
    """Contact law of a scene."""
    return CONTACT_LAWS[scene.law](**scene.arguments)


def knee(
    scene: Scene,
    tolerance: float,
    budget: int,
    height_prescribed: bool = False,
    level: str = "dynamic",
    quick: bool = False,
) -> KneeModel:
    """Model of a scene; `quick` compiles it, which is quicker where many runs share a kind of scene."""
    return KneeModel(
        pair=pair(scene.femur, scene.tibia),
        law=law_of(scene),
        mass=scene.mass,
        tolerance=tolerance,
        budget=budget,
        height_prescribed=height_prescribed,
        level=LEVELS[level],
        compiled=quick,
    )


def run(
    scene: Scene,
    tolerance: float | None = None,
    budget: int = BUDGET,
    level: str = "dynamic",
    quick: bool = False,
) -> np.recarray[Any, Any]:
    """Answers of the model to a scene, one per tick."""
    model = knee(scene, tolerance or scene.tolerance, budget, level=level, quick=quick)
    if not scene.thrown:
        return model.run(scene.time, scene.angle, scene.load)
    height = model.pair.closest(scene.angle[0], 0.0).depth + scene.start_gap  # of a level plane
    state = np.zeros(run_state.STATE_SIZE)
    state[[run_state.AT_BEGUN, run_state.AT_ANGLE, run_state.AT_LOAD]] = (
        1.0,
        scene.angle[0],
        scene.load[0],
    )
    state[[run_state.AT_HEIGHT, run_state.AT_VELOCITY]] = height, -scene.thrown
    state[[run_state.AT_TRY_STEP, run_state.AT_IMPACT_SPEED]] = math.inf, math.nan
    answers = blank_answers(len(scene.time))
    start = answers[:1]
    start["flexion_angle"], start["load"], start["fidelity"] = (
        scene.angle[0],
        scene.load[0],
        Fidelity.DYNAMIC,
    )
    start["gap"], start["penetration_rate"], start["femoral_height"] = (
        scene.start_gap,
        scene.thrown,
        height,
    )
    times = np.rint(np.array(scene.time) / NANOSECOND) * NANOSECOND
    columns = np.diff(times), scene.angle[1:], scene.load[1:], np.full(len(times) - 1, math.nan)
    model.compute(np.column_stack(columns), answers[1:], state)
    series: np.recarray[Any, Any] = answers.view(np.recarray)
    return series


LAWS = tuple(CONTACT_LAWS)
STIFFNESS, DAMPING, MASS = (1e3, 1e13), (1.0, 1e7), (1e-4, 1e3)
EXPONENT, TICK, LOAD = (1.0, 3.0), (1e-5, 0.1), (-5e3, 2e4)
SPEED, LAYER, ANGLE, TOLERANCE = (0.01, 5.0), (1e-6, 5e-3), (-0.2, 1.6), (1e-9, 1e-5)
"""Ranges of the parameters, in SI units; damping may also be 0"""
FEMURS = ("circle", "mri", "ellipse", *DEGENERATE)
Uniform = Callable[[float, float], float]
"""Draws a number between two: by NumPy in the study, by hypothesis in the tests"""


def times(tick: float, count: int) -> tuple[float, ...]:
    """Times [s] of a number of equal ticks."""
    return tuple(i * tick for i in range(count))


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
    arguments = arguments_of(
        law, decades(STIFFNESS), uniform(*EXPONENT), damping, decades(LAYER), ratio
    )
    thrown = decades(SPEED) if uniform(0.0, 1.0) < 0.3 else 0.0
    return Scene(
        law,
        arguments,
        decades(MASS),
        decades(TOLERANCE),
        times(decades(TICK), ticks),
        steps(ANGLE),
        steps(LOAD),
        choice(femurs),
        thrown,
    )


def random_scenes(seed: int, count: int) -> list[Scene]:
    """A number of random scenes; each has a generator of its own, so that its number is enough to repeat it."""
    return [random_scene(np.random.default_rng((seed, i)).uniform) for i in range(count)]


def reference_scenes(seed: int, count: int) -> list[Scene]:
    """Random scenes that the reference can solve: closed-form femora from a static start, in short ticks."""
    found = []
    for i in range(count):
        scene = random_scene(
            np.random.default_rng((seed, i, 1)).uniform, ("circle", "closed ellipse"), 6
        )
        shorter = min(1.0, 5e-3 / scene.time[1])
        found.append(scene._replace(thrown=0.0, time=tuple(time * shorter for time in scene.time)))
    return found

"""How honest the estimates are after live changes of law, constants, mass, tolerance, level and budget.

The reference (`studies/reference`) goes on from its own state with the changed knee, and nothing is taken to be at
rest. Every run of the model goes through the same changes by `Stream.continue_with`.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.knee import Stream
from studies.honesty.judging import judge
from studies.honesty.ours import knee
from studies.honesty.scenes import ARTHRITIC, HEALTHY, WIDE, Scene, arguments, draw, shipped
from studies.honesty.study import Row, row
from studies.honesty.truth import knee_of
from studies.reference import LAWS, Knee, Reference, Solution

Random = np.random.Generator
SEGMENTS, TICKS = 5, 40
"""Number of segments of a run, between which it is changed, and of ticks in each"""
STILL = 0.2
"""Part of the scenes whose load and angle are held in the ticks around every change, so that it comes at rest"""
LEAST_RATE = 1e-6
"""Rate of the depth [m/s] below which a contact is called at rest"""
WHAT = (
    "law",
    "stiffness",
    "damping",
    "exponent",
    "layer_depth",
    "mass",
    "tolerance",
    "level",
    "everything",
)
DECADES = {"stiffness": 0.5, "damping": 0.5, "exponent": 0.05, "layer_depth": 0.2, "mass": 0.5}
"""Decimal logarithms of the largest factors"""
BUDGETS = (20.0, 500.0)
"""Range of the budgets, of which decades are equally likely"""


class Setting(NamedTuple):
    """A knee as it is between two changes."""

    what: str
    """Name of the change before it; empty at the beginning"""
    scene: Scene
    level: str
    tolerance: float


class Mode(ctypes.Structure):
    """`Mode` of `studies/reference/knee.h`."""

    _fields_ = (
        ("layer", ctypes.c_int),
        ("pressing", ctypes.c_int),
        ("impact", ctypes.c_longdouble),
        ("on", ctypes.c_int),
    )


class State(ctypes.Structure):
    """The beginning of `State` of `studies/reference/run.c`."""

    _fields_ = (
        ("depth", ctypes.c_longdouble),
        ("velocity", ctypes.c_longdouble),
        ("angle", ctypes.c_longdouble),
        ("load", ctypes.c_longdouble),
        ("implicit_duration", ctypes.c_longdouble),
        ("first_duration", ctypes.c_longdouble),
        ("mode", Mode),
    )


class ChangedReference(Reference):
    """The reference, whose knee changes between two ticks."""

    def go_on_with(self, changed: Knee) -> None:
        """Go on from the present state with another law or mass; whether it presses is found at the next tick."""
        other = Reference(changed)
        for mine, theirs in ((self._fine, other._fine), (self._coarse, other._coarse)):
            mine._constants = theirs._constants
            state = State.from_address((ctypes.addressof(mine._state) + 15) // 16 * 16)
            if state.mode.layer >= 0:
                state.mode.layer = int(0.0 <= changed.law.layer_depth < state.depth)
                state.mode.on = 0


def plan(seed: int) -> list[Setting]:
    """Draw a scene and its changes; the inputs are those of the first setting throughout."""
    random, scene = np.random.default_rng((seed, 47)), draw(seed, SEGMENTS * TICKS)
    if random.random() < STILL:
        near = np.arange(SEGMENTS * TICKS) // TICKS * TICKS
        scene = scene._replace(
            load=np.abs(scene.load[near]) + 1.0, angle=scene.angle[np.zeros_like(near)]
        )
    settings = [
        Setting(
            "",
            scene,
            str(random.choice(["dynamic", "quasi_static"])),
            float(10 ** random.uniform(-8, -4)),
        )
    ]
    while len(settings) < SEGMENTS:
        what = str(random.choice(WHAT))
        settings.append(
            changed(random, settings[-1], WHAT[:-1] if what == WHAT[-1] else (what,))._replace(
                what=what
            )
        )
    return settings


def changed(random: Random, setting: Setting, parts: tuple[str, ...]) -> Setting:
    """Change parts of a setting; what a law does not have is its stiffness."""
    scene, level, tolerance = setting.scene, setting.level, setting.tolerance
    for part in parts:
        if part == "tolerance":
            tolerance = float(10 ** random.uniform(-8.0, -4.0))
        elif part == "level":
            level = "dynamic" if level == "quasi_static" else "quasi_static"
        elif part == "law" and scene.family == WIDE:
            law = str(random.choice(list(LAWS)))
            scene = scene._replace(law=law, arguments=arguments(random, law))
        elif part == "law":
            family = ARTHRITIC if scene.law == shipped(HEALTHY)[0] else HEALTHY
            law, constants = shipped(family)
            scene = scene._replace(law=law, arguments=constants)
        else:
            size = 10 ** random.uniform(-DECADES[part], DECADES[part])
            if part == "mass":
                scene = scene._replace(mass=float(scene.mass * size))
                continue
            names = [name for name in (part, f"{part}_2") if name in scene.arguments]
            names = names or [
                name for name in ("stiffness", "youngs_modulus") if name in scene.arguments
            ]
            new = {name: float(scene.arguments[name] * size) for name in names}
            if "exponent" in new:
                new["exponent"] = min(max(new["exponent"], 1.0), 3.0)
            scene = scene._replace(arguments={**scene.arguments, **new})
    return setting._replace(scene=scene, level=level, tolerance=tolerance)


def place(now: int) -> slice:
    """Ticks of a segment."""
    return slice(now * TICKS, (now + 1) * TICKS)


def truth_of(settings: list[Setting]) -> list[Solution]:
    """Solve the segments of a plan."""
    first, found = settings[0].scene, list[Solution]()
    reference = ChangedReference(knee_of(first))
    for now, setting in enumerate(settings):
        if now:
            reference.go_on_with(knee_of(setting.scene))
        found.append(
            reference.take(first.time[place(now)], first.angle[place(now)], first.load[place(now)])
        )
    return found


def answers_of(settings: list[Setting], budget: int) -> Iterator[np.recarray[Any, Any]]:
    """Run the model through a plan, and yield the answers of every segment."""
    first, stream = settings[0].scene, None
    stamps: NDArray[np.int64] = np.rint(first.time * 1e9).astype(np.int64)
    for now, setting in enumerate(settings):
        model = knee(setting.scene, setting.level, setting.tolerance, budget)
        if stream is None:
            stream = Stream(model)
        else:
            stream.continue_with(model)
        here = place(now)
        yield stream.advance_all(stamps[here], first.angle[here], first.load[here], None).view(
            np.recarray
        )


def state_before(now: int, truth: list[Solution]) -> str:
    """Name the state of the contact when a segment begins."""
    last = truth[now - 1]
    if not np.isfinite(last.depth[-1]):
        return "unknown"
    if last.depth[-1] < 0.0:
        return "in flight"
    return "at rest" if abs(last.rate[-1]) < LEAST_RATE else "in contact"


def rows(seed: int) -> Iterator[Row]:
    """Judge all segments of a plan, without a budget and with one."""
    settings, random = plan(seed), np.random.default_rng((seed, 48))
    truth = truth_of(settings)
    for budget in (0, int(10 ** random.uniform(*np.log10(BUDGETS)))):
        for now, series in enumerate(answers_of(settings, budget)):
            setting, state = (
                settings[now],
                state_before(now, truth) if now else "before any change",
            )
            name = f"segment {now}, {setting.what}, {setting.level}, {setting.scene.law}, {setting.tolerance:.1e} m"
            groups = (
                "a budget" if budget else "no budget",
                state,
                f"change: {setting.what or 'none'}",
                setting.level,
            )
            yield row(
                groups, f"{name}, {budget}", series, judge(series, truth[now], setting.tolerance)
            )

"""OK means right, for hours: long runs of both shipped knees and of nearly undamped ones, against the reference."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from studies.honesty.judging import judge
from studies.honesty.loads import STRIDE, bag
from studies.honesty.ours import knee
from studies.honesty.scenes import ARTHRITIC, FEMUR, HEALTHY, KNEE, Scene, shipped
from studies.honesty.study import Row, row
from studies.honesty.truth import knee_of
from studies.reference import Reference

Floats = NDArray[np.float64]
Random = np.random.Generator
Drive = Callable[[Random, Floats], tuple[Floats, Floats]]
"""Flexion angles [rad] and loads [N] as a function of times [s], shape (n,) each"""
HOUR = 3600.0
TOLERANCE = 1e-6
CHUNK = 50_000
"""Number of ticks that are compared at a time"""


class LongRun(NamedTuple):
    """A knee, and the angles and loads that drive it."""

    name: str
    law: str
    arguments: dict[str, Any]
    hours: float
    rate: float
    """Number of ticks per second"""
    drive: Drive


def walking(_random: Random, time: Floats) -> tuple[Floats, Floats]:
    """The recorded gait, stride after stride, of slowly changing strength."""
    stamps, angle, load = bag("right")
    phase = 0.62 + np.mod(time, STRIDE)
    strength = 1.0 + 0.2 * np.sin(math.tau * time / 97.0) + 0.1 * np.sin(math.tau * time / 13.7)
    return np.interp(phase, stamps, angle), strength * np.interp(phase, stamps, load)


def lifting_off(random: Random, time: Floats) -> tuple[Floats, Floats]:
    """The recorded gait less 150 N, so that the knee lifts off in swing."""
    angle, load = walking(random, time)
    return angle, load - 150.0


def running(random: Random, time: Floats) -> tuple[Floats, Floats]:
    """Strides of 0.7 s: half sines of 0.26 s, up to three body weights' share, and no load or a slight pull between."""
    stride = np.floor(time / 0.7).astype(int)
    peak = random.uniform(1000.0, 1500.0, int(stride[-1]) + 1)[stride]
    aerial = random.choice([0.0, -5.0, -20.0], int(stride[-1]) + 1)[stride]
    phase = np.mod(time, 0.7)
    load = np.where(phase < 0.26, peak * np.sin(math.pi * np.minimum(phase / 0.26, 1.0)), aerial)
    return 0.5 + 0.4 * np.sin(math.tau * time / 0.7), load


def held_in_swing(random: Random, time: Floats) -> tuple[Floats, Floats]:
    """The recorded gait less 150 N, with muscles that press between the strides by 5 to 80 N: lift-offs of 0.1 mm."""
    angle, load = running(random, time)
    stride = np.floor(time / 0.7).astype(int)
    return angle, np.maximum(
        load, random.choice([5.0, 10.0, 20.0, 40.0, 80.0], int(stride[-1]) + 1)[stride]
    )


def wandering(random: Random, time: Floats) -> tuple[Floats, Floats]:
    """A load that wanders about 400 N within some 0.1 s, and pulls at times."""
    step = float(time[1] - time[0])
    keep = math.exp(-step / 0.1)
    noise = random.standard_normal(len(time)) * math.sqrt(1.0 - keep * keep)
    return 0.4 + 0.3 * np.sin(3.0 * time), 400.0 + 300.0 * lfilter([1.0], [1.0, -keep], noise)


def shaken(_random: Random, time: Floats) -> tuple[Floats, Floats]:
    """Four swings a second that pull at their end: the scene of a known failure, of which 20 s were enough."""
    return np.zeros(len(time)), 300.0 + 350.0 * np.cos(8.0 * math.pi * time)


def thrown(_random: Random, time: Floats) -> tuple[Floats, Floats]:
    """A knee that is released for 20 ms every ten seconds, and pressed by 200 N: it bounces until it rests."""
    return np.full(len(time), 0.3), np.where(np.mod(time, 10.0) < 0.02, -100.0, 200.0)


def long_runs() -> Iterator[LongRun]:
    """List all runs."""
    soft = KNEE | {"damping": 20.0}
    impact = {
        "stiffness": KNEE["stiffness"],
        "exponent": 1.5,
        "restitution": 0.97,
        "least_impact_speed": 0.1,
    }
    for family in (HEALTHY, ARTHRITIC):
        law, arguments = shipped(family)
        yield LongRun(f"{family}, gait", law, arguments, 1.0, 200.0, walking)
        yield LongRun(f"{family}, gait with lift-offs", law, arguments, 1.0, 200.0, lifting_off)
        yield LongRun(f"{family}, gait with lift-offs", law, arguments, 0.5, 1000.0, lifting_off)
        yield LongRun(f"{family}, running", law, arguments, 1.0, 200.0, running)
        yield LongRun(f"{family}, running", law, arguments, 0.5, 1000.0, running)
        yield LongRun(
            f"{family}, running, held in swing", law, arguments, 0.5, 200.0, held_in_swing
        )
        yield LongRun(
            f"{family}, running, held in swing", law, arguments, 0.25, 1000.0, held_in_swing
        )
        yield LongRun(f"{family}, wandering load", law, arguments, 0.5, 500.0, wandering)
        yield LongRun(f"{family}, shaken", law, arguments, 0.5, 1000.0, shaken)
        yield LongRun(f"{family}, thrown", law, arguments, 0.25, 1000.0, thrown)
    yield LongRun("Kelvin-Voigt, 20 N s/m, thrown", "kelvin_voigt", soft, 0.25, 1000.0, thrown)
    yield LongRun("Hunt-Crossley, e = 0.97, thrown", "hunt_crossley", impact, 0.25, 1000.0, thrown)
    yield LongRun(
        "Hertz, gait",
        "hertz",
        {key: KNEE[key] for key in ("stiffness", "exponent")},
        0.25,
        200.0,
        walking,
    )
    yield LongRun(
        "Hertz, thrown",
        "hertz",
        {key: KNEE[key] for key in ("stiffness", "exponent")},
        0.1,
        1000.0,
        thrown,
    )


def scene_of(run: LongRun, part: float, seed: int) -> Scene:
    """Scene of a part of a run's duration."""
    count = max(int(run.hours * HOUR * run.rate * part), 2000)
    time = np.rint(np.arange(count) * (1e9 / run.rate)) * 1e-9
    angle, load = run.drive(np.random.default_rng((seed, 17)), time)
    return Scene(
        seed,
        run.name,
        run.law,
        run.arguments,
        FEMUR,
        (0.034, 0.030),
        0.0,
        False,
        "",
        time,
        angle,
        load,
    )


COUNT = len(list(long_runs()))


def rows(seed: int, part: float = 1.0) -> Iterator[Row]:
    """Compare a run, or a part of its duration, chunk by chunk, from the static start on without a break."""
    number = seed % 1_000_000
    run = list(long_runs())[number]
    scene = scene_of(run, part, seed)
    truth, stream = Reference(knee_of(scene)), knee(scene, "dynamic", TOLERANCE).stream()
    stamps = np.rint(scene.time * 1e9).astype(np.int64)
    for begin in range(0, len(stamps), CHUNK):
        here = slice(begin, begin + CHUNK)
        series = stream.advance_all(stamps[here], scene.angle[here], scene.load[here], None).view(
            np.recarray
        )
        judged = judge(
            series, truth.take(scene.time[here], scene.angle[here], scene.load[here]), TOLERANCE
        )
        yield row(
            (f"{run.name}, {run.rate:g} Hz",), f"from {scene.time[begin]:g} s", series, judged
        )

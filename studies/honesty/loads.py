"""Loads and flexion angles over time that drive random scenes and long runs."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.gait import BODY_WEIGHT, gait

Floats = NDArray[np.float64]
Random = np.random.Generator
STRIDE = 1.235
"""Duration [s] of a stride in the bags, from heel strike to heel strike"""


def press(random: Random, time: Floats, mean: float) -> Floats:
    """A load [N] that oscillates and never pulls, shape (n,)."""
    depth, frequency = random.uniform(0.0, 0.95), 10 ** random.uniform(-0.5, 1.5)
    return mean * (1.0 + depth * np.sin(math.tau * (frequency * time + random.random())))


def pull(random: Random, time: Floats, mean: float) -> Floats:
    """A load [N] that pulls the knee apart at times, shape (n,)."""
    depth, frequency = random.uniform(1.02, 2.0), 10 ** random.uniform(-0.5, 1.5)
    return mean * (1.0 + depth * np.sin(math.tau * (frequency * time + random.random())))


def walk(random: Random, time: Floats, mean: float) -> Floats:
    """A load [N] that is a random walk, shape (n,)."""
    return mean * (1.0 + random.uniform(0.01, 0.2) * np.cumsum(random.standard_normal(len(time))))


def steps(random: Random, time: Floats, mean: float) -> Floats:
    """A load [N] that is held and jumps from one tick to the next, at times negative or 0, shape (n,)."""
    values = random.choice([0.0, -0.3, 0.2, 0.5, 1.0, 1.5, 3.0], len(time)) * mean
    held = np.maximum.accumulate(
        np.where(random.random(len(time)) < 0.08, np.arange(len(time)), 0)
    )
    return np.asarray(values[held], dtype=np.float64)


def noise(random: Random, time: Floats, mean: float) -> Floats:
    """A load [N] that is drawn anew at every tick, shape (n,)."""
    return mean * (1.0 + random.uniform(0.1, 1.5) * random.standard_normal(len(time)))


def running(random: Random, time: Floats, _mean: float) -> Floats:
    """A load [N] of running: half sines of 2.5 to 3 body weights' share, and no load or a slight pull in flight."""
    period, contact = random.uniform(0.6, 0.8), random.uniform(0.2, 0.35)
    peak = random.uniform(2.5, 3.0) * random.uniform(0.5, 0.7) * BODY_WEIGHT
    aerial = random.choice([0.0, -random.uniform(1.0, 30.0)])
    phase = np.mod(time + random.uniform(0.0, period), period)
    return np.where(
        phase < contact, peak * np.sin(math.pi * np.minimum(phase / contact, 1.0)), aerial
    )


def walking(random: Random, time: Floats, _mean: float) -> Floats:
    """The recorded load [N], scaled, shape (n,)."""
    return random.uniform(0.7, 1.4) * _strides(random, time)


def lifting_off(random: Random, time: Floats, mean: float) -> Floats:
    """The recorded load [N] less a constant pull, so that the knee comes apart in swing, shape (n,)."""
    return walking(random, time, mean) - random.uniform(60.0, 250.0)


LOADS: dict[str, Callable[[Random, Floats, float], Floats]] = {
    "press": press,
    "pull": pull,
    "walk": walk,
    "steps": steps,
    "noise": noise,
    "running": running,
    "gait": walking,
    "gait, lift-off": lifting_off,
}
GAITS = ("running", "gait", "gait, lift-off")


@functools.cache
def bag(side: str) -> tuple[Floats, Floats, Floats]:
    """See `gait`."""
    return gait(side)


def _strides(random: Random, time: Floats) -> Floats:
    """The recorded load [N], stride after stride, from a random moment on."""
    stamps, _, load = bag("right" if random.random() < 0.5 else "left")
    begin = random.uniform(0.0, STRIDE)
    return np.interp(0.62 + np.mod(time + begin, STRIDE), stamps, load)


def still(random: Random, time: Floats) -> Floats:
    """A flexion angle [rad] that stays, shape (n,)."""
    return np.full(len(time), random.uniform(0.0, 1.2))


def swing(random: Random, time: Floats) -> Floats:
    """A flexion angle [rad] that oscillates at up to some 10 rad/s, shape (n,)."""
    reach = random.uniform(0.1, 0.6)
    frequency = min(10 ** random.uniform(-0.5, 1.0), 10.0 / (math.tau * reach))
    return 0.6 + reach * np.sin(math.tau * (frequency * time + random.random()))


def wander(random: Random, time: Floats) -> Floats:
    """A flexion angle [rad] that is a random walk: its rate jumps at every tick, by up to some rad/s."""
    rate = random.uniform(0.2, 3.0) * random.standard_normal(len(time))
    return 0.5 + np.cumsum(rate * np.diff(time, prepend=time[0]))


ANGLES: tuple[Callable[[Random, Floats], Floats], ...] = (still, swing, wander)

"""Angles and loads of the study, all of the knee of config/healthy.yaml."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.problems import bump, thrown
from studies.accuracy import lift_off
from studies.gait import gait

Floats = NDArray[np.float64]
SEED = 16
"""Seed of the running strides"""
STRIDE, STRIDES = 0.7, 2
"""Duration of a running stride [s], and number of strides"""


class Scene(NamedTuple):
    """Time [s], flexion angle [rad] and load [N], shape (n,) each."""

    name: str
    about: str
    time: Floats
    angle: Floats
    load: Floats


def scenes() -> list[Scene]:
    """List the scenes."""
    fall = milliseconds(401)
    return [
        Scene("gait", "the bag `gait2354_right`: recorded, 1.93 s at 200 Hz, flexion −1° to 70°, load 0.11 to 1.61 kN",
              *gait("right")),
        Scene("running-like", f"{STRIDES} strides of {STRIDE:g} s at 1 kHz (random, seed {SEED}): an impact peak of "
              "1.6 kN and an active one of 3.3 kN, ± 10 % from stride to stride; 60 N and 95° of flexion in swing",
              *running(milliseconds(int(1000 * STRIDE * STRIDES) + 1))),
        Scene("lift-off and landing", "0.5 s at 1 kHz, load 300 + 350 cos(8πt) N: let go of twice for some "
              "50 ms; flexion 0.4 + 0.4 sin 9t rad", *lift_off()),
        Scene("impact", "0.4 s at 1 kHz: 300 N, 20 ms of pull with as much from 60 ms on, then pressed with 900 N; "
              "flexion 0.2 + t rad", fall, 0.2 + fall, thrown(fall)),
    ]  # fmt: skip


def milliseconds(number: int) -> Floats:
    """Times [s] of a number of ticks at 1 kHz."""
    return np.arange(number, dtype=np.float64) * 1e-3


def running(time: Floats) -> tuple[Floats, Floats, Floats]:
    """Running strides with an impact peak, an active peak and a deep swing, each slightly different from the others."""
    random = np.random.default_rng(SEED)
    angle, load = np.full_like(time, 0.2), np.full_like(time, 60.0)
    for stride in range(STRIDES):
        phase = time - stride * STRIDE - 0.06
        impact, active, stance, swing = 1.0 + 0.1 * random.uniform(-1.0, 1.0, 4)
        load += impact * 1540.0 * bump(phase, 0.025, 0.012) + active * 3240.0 * bump(phase, 0.11, 0.05)
        angle += stance * math.radians(30.0) * bump(phase, 0.10, 0.07) + swing * math.radians(84.0) * bump(
            phase, 0.42, 0.11
        )
    return time, angle, load

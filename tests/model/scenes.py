"""Surfaces and motions that tests of several modules build knees of."""

import math
from dataclasses import replace
from functools import cache

import numpy as np

from knee_contact_ros.model import run_state
from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.model.mechanisms import translation_table
from knee_contact_ros.model.profiles import Circle, Profile
from knee_contact_ros.model.surfaces import ContactPair, Cup, Plane, Plateau
from knee_contact_ros.model.types import Contact, blank_answers
from tests.helpers.scenes import RADIUS

Series = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Time [s], flexion angle [rad], load [N]"""
ROUNDING = 1e-15
"""[m]: a few roundings of heights of 34 mm (7e-18 m each), with room"""
HINGE = translation_table([0.0, 1.0], [0.0, 0.0], "hinge")
FORWARDS = translation_table([0.0, 1.0], [0.0, 0.012])
"""12 mm/rad, straight on beyond"""
TO_AND_FRO = translation_table([0.0, 0.5, 1.0], [0.0, 0.01, -0.01])


@cache
def ellipse(points, a=0.034, b=0.028, noise=0.0, seed=2):
    """The lower part of an ellipse, from posterior over inferior to anterior, with radial noise [m]: dents."""
    t = np.linspace(-np.pi - 0.9, 0.9, points)
    radial = np.random.default_rng(seed).normal(0.0, 1.0, points) * noise
    return Profile((a + radial) * np.cos(t), (b + radial) * np.sin(t))


@cache
def plateau(points=45):
    """A cup of radius 45 mm in the middle that rolls off at both edges, like a measured one."""
    x = np.linspace(-0.022, 0.022, points)
    return Plateau(x, 0.5 * x * x / 0.045 - 0.004 * (x / 0.022) ** 6 + 0.1 * x)


PAIRS = {
    "plane": lambda: ContactPair(Circle(RADIUS), Plane(), HINGE),
    "slope": lambda: ContactPair(ellipse(160), Plane(0.2), FORWARDS),
    "dents": lambda: ContactPair(ellipse(120, noise=2e-4), Plane(), HINGE),
    "cup": lambda: ContactPair(Circle(RADIUS), Cup(0.095), TO_AND_FRO),
    "plateau": lambda: ContactPair(ellipse(80), plateau(), FORWARDS),
}
"""Contact pairs of all kinds; a call builds one"""
LAWS_ON_PAIRS = [
    (law, pair)
    for i, law in enumerate(CONTACT_LAWS)
    for j, pair in enumerate(PAIRS)
    if (i + j) % 3 == 0
]
"""Names of laws and pairs: each law on a few kinds of surfaces, each kind of surfaces under laws of each form"""


def thrown(
    knee,
    depth,
    rate,
    duration,
    load=0.0,
    end_load=None,
    turn=(0.0, 0.0),
    parts=1,
    **state,
):
    """The answer to one tick, cut into parts, that a femur begins at a depth [m] and its rate at a held angle [m/s].

    `turn` are the angles [rad] and `load` to `end_load` the loads [N] of the tick. `state` has other entries of the
    run's state, by the names of their places in `run_state` after AT_.
    """
    touching = knee.pair.closest(turn[0], 0.0).depth  # of a level plane
    begin = {
        "BEGUN": 1.0,
        "ANGLE": turn[0],
        "LOAD": load,
        "HEIGHT": touching - depth,
        "VELOCITY": -rate,
    }
    before = np.zeros(run_state.STATE_SIZE)
    for name, value in ({**begin, "TRY_STEP": math.inf, "IMPACT_SPEED": math.nan} | state).items():
        before[getattr(run_state, f"AT_{name}")] = value
    part = np.linspace(0.0, 1.0, parts + 1)[1:, None]
    answers, last = blank_answers(parts), load if end_load is None else end_load
    samples = [duration / parts, turn[0], load, math.nan] + part * [
        0.0,
        turn[1] - turn[0],
        last - load,
        0.0,
    ]
    knee.compute(samples, answers, before)
    contact: Contact = answers[-1]
    return contact


def signed(answers):
    """The signed depth [m] of answers, < 0 apart."""
    return answers["penetration_depth"] - answers["gap"]


def walking(count=161, tick=5e-3):
    """Two humps of load over a stance, as in gait, and the knee bends meanwhile."""
    time = tick * np.arange(count)
    phase = math.tau * time / 0.8
    return (
        time,
        0.3 - 0.25 * np.cos(phase),
        700.0 - 350.0 * np.cos(phase) - 250.0 * np.cos(3.0 * phase),
    )


def hopping(count=161, tick=2e-3):
    """Let go of twice, for 2 cm each time at most, and landed on."""
    time = tick * np.arange(count)
    return time, 0.4 + 0.2 * np.sin(8.0 * time), 400.0 + 500.0 * np.cos(math.tau * time / 0.16)


def stepping(count=121, tick=5e-3):
    """Loads that jump from one tick to the next and are held."""
    time = tick * np.arange(count)
    return (
        time,
        0.3 + 0.0 * time,
        np.array([800.0, 2000.0, 100.0, 1200.0])[(np.arange(count) // 25) % 4],
    )


def fast(knee):
    """The same knee, compiled: the same bits."""
    return replace(knee, compiled=True)

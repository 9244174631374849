"""The instrumented knee's two trials as walks.

The centre of pressure is not in the data: net moments are those of inverse dynamics that came with them.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from knee_contact_ros.joint_reaction.estimator import LEVELS
from knee_contact_ros.joint_reaction.leg import GRAVITY, STILL, UNKNOWN, Ground, Joints, NetMoments, leg_of
from studies.load_validation.walks import Flags, Floats, Walk
from studies.validation.data import BODY_WEIGHT, TRIALS, Measured, read

HEIGHT = 1.7
"""Assumed height [m], which is not in the data; only the level `ground_force` needs it, for the length of the shank"""
ON_THE_PLATE_UNTIL = 3.2
"""Time [s] up to which the overground trial is used: the next step hits a plate that is not in the data"""
LARGEST_KNEE, LARGEST_ANKLE = 80.0, 150.0
"""Largest moments [N m] that are plausible in this man's walking: without the spikes they are 46 and 86 at most"""
MARGIN = 0.1
"""Time [s] before and behind a spike that is left out with it"""
MS = 1e3


class Moments(NamedTuple):
    """Net moments [N m] at the cells' samples, shape (n,)."""

    extension: Floats
    plantarflexion: Floats


def walks(folder: Path) -> list[Walk]:
    """The overground and the treadmill trial."""
    return [_walk(measured, _moments(folder, measured)) for measured in read(folder)]


def _moments(folder: Path, measured: Measured) -> Moments:
    """Net moments of inverse dynamics; the ankle's is positive in dorsiflexion in the data."""
    motion = np.genfromtxt(folder / f"{TRIALS[measured.name]}_motion.csv", delimiter=",", names=True)
    knee, ankle = (
        np.interp(measured.time, motion["time_s"], motion[column])
        for column in ("knee_flexion_moment_nm", "ankle_moment_nm")
    )
    return Moments(knee, -ankle)


def plausible(time: Floats, moments: Moments) -> Flags:
    """Samples that are farther than `MARGIN` from any implausible moment."""
    spikes = time[(np.abs(moments.extension) > LARGEST_KNEE) | (np.abs(moments.plantarflexion) > LARGEST_ANKLE)]
    near = np.zeros(len(time), dtype=bool)
    for spike in spikes.tolist():
        near |= np.abs(time - spike) <= MARGIN
    kept: Flags = ~near
    return kept


def _walk(measured: Measured, moments: Moments) -> Walk:
    mass = BODY_WEIGHT / GRAVITY
    leg = leg_of(mass, HEIGHT)
    vertical = np.interp(measured.time, measured.plate_time, measured.plate)
    joints = [Joints(flexion, UNKNOWN, UNKNOWN) for flexion in measured.flexion.tolist()]
    without_muscles = np.maximum(vertical, 0.0) - (leg.shank_mass + leg.foot_mass) * GRAVITY
    rows = list(zip(*(each.tolist() for each in (*moments, without_muscles)), strict=True))
    dynamics = LEVELS["ground_force"].dynamics
    nets = {
        "ground_force": [
            dynamics(leg, one, STILL, Ground((0.0, force, 0.0), (UNKNOWN,) * 3))
            for one, force in zip(joints, vertical.tolist(), strict=True)
        ],
        "knee_moment": [NetMoments(knee, UNKNOWN, force, UNKNOWN) for knee, _, force in rows],
        "ankle_moment": [NetMoments(knee, ankle, force, UNKNOWN) for knee, ankle, force in rows],
    }
    used = plausible(measured.time, moments)
    if measured.name == "overground":
        used = measured.time < ON_THE_PLATE_UNTIL
    return Walk(measured.name, mass, HEIGHT, measured.time, vertical, joints, nets, measured.total, used)


def largest_moments(walk: Walk) -> tuple[float, float]:
    """Largest used moments of knee and ankle [N m]."""
    kept = [net for net, used in zip(walk.nets["ankle_moment"], walk.used.tolist(), strict=True) if used]
    return max(abs(net.extension) for net in kept), max(abs(net.plantarflexion) for net in kept)


def moments_of(walk: Walk) -> Moments:
    """Moments of a walk; 0 where the ankle's is not known."""
    nets = walk.nets["ankle_moment"]
    ankles = [0.0 if math.isnan(net.plantarflexion) else net.plantarflexion for net in nets]
    return Moments(np.array([net.extension for net in nets]), np.array(ankles))

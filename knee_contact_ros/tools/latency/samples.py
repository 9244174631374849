"""Samples that the nodes are fed with: the bundled gait at any rate, forth and back without a leap, for ever."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import lru_cache
from itertools import cycle
from typing import NamedTuple

import numpy as np

from knee_contact_ros.offline.bundled_gait import gait
from knee_contact_ros.parameters.schema import Knee, Load
from knee_contact_ros.streams.messages import JointState, WrenchStamped, encode_joint_state, encode_wrench_stamped
from knee_contact_ros.streams.topics import NANOSECONDS

_START = struct.Struct("<4siI")
"""Beginning of each message: representation and stamp; the rest does not depend on the stamp"""


class Sample(NamedTuple):
    """An angle and a force with the same stamp, serialised."""

    stamp: int
    """Stamp [ns]"""
    angle: bytes
    """Serialised JointState"""
    force: bytes
    """Serialised WrenchStamped"""


def samples(rate: float, first: int) -> Iterator[Sample]:
    """Samples at `rate` [Hz] without end, stamped from `first` [ns] on."""
    stamp, step = first, round(NANOSECONDS / rate)
    for angle, force in cycle(rests(rate)):
        start = _START.pack(b"\x00\x01\x00\x00", *divmod(stamp, NANOSECONDS))
        yield Sample(stamp, start + angle, start + force)
        stamp += step


@lru_cache(maxsize=2)
def rests(rate: float) -> list[tuple[bytes, bytes]]:
    """Both messages without their beginnings, for one way forth and back at `rate` [Hz]."""
    time, angle, load = gait("right")
    velocity, axial = np.gradient(angle, time), -load / Load().share
    length = float(time[-1] - time[0])
    passed = np.arange(round(2.0 * length * rate)) / rate
    at = time[0] + np.minimum(passed, 2.0 * length - passed)
    messages = []
    columns = [np.interp(at, time, each).tolist() for each in (angle, velocity, axial)]
    for position, speed, force in zip(*columns, strict=True):
        state = JointState(0, "", (Knee().joint_name,), (position,), (speed,), ())
        wrench = WrenchStamped(0, "tibia_r", (0.0, force, 0.0), (0.0, 0.0, 0.0))
        messages.append((encode_joint_state(state)[_START.size :], encode_wrench_stamped(wrench)[_START.size :]))
    return messages

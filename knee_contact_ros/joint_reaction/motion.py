"""How quickly the joints turn, from the angles of a stream, without a look ahead."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from knee_contact_ros.joint_reaction.sensed import Joints

SECOND = 1e-9
"""[s] of a nanosecond"""
FEWEST = 4
"""Angles in the window, from which on a motion is told"""
MOST = 200
"""Angles in the window, at most: time is cut into so many cells a window, and the last one in a cell counts"""


class Turning(NamedTuple):
    """How a joint turns, in the sense in which its angle grows."""

    rate: float
    """[rad/s]"""
    acceleration: float
    """[rad/s^2]"""


class Motion(NamedTuple):
    """How the joints turn."""

    flexion: Turning
    hip: Turning
    ankle: Turning


STILL = Motion(*[Turning(0.0, 0.0)] * 3)


class MotionFilter:
    """Fits a parabola to the last angles by least squares: its slope at their middle, and its curvature.

    So both are half a window late. A window of twice the length has a sixth of the noise in the curvature.
    """

    def __init__(self, window: float) -> None:
        """`window` [s] is how far back the parabola looks; 0: the joints are taken to be still."""
        self._window = round(window / SECOND)
        self._cell = -(-self._window // (MOST - 1))
        self._held: deque[tuple[int, float, float, float]] = deque()

    def forget(self) -> None:
        """Begin anew."""
        self._held.clear()

    def at(self, stamp: int, joints: Joints) -> Motion:
        """Take the angles at a stamp [ns], later than all before; give the motion, still until enough is known."""
        if self._window == 0:
            return STILL
        held = self._held
        if held and stamp // self._cell == held[-1][0] // self._cell:
            held.pop()
        held.append((stamp, joints.flexion, joints.hip, joints.ankle))
        while stamp - held[0][0] > self._window:
            held.popleft()
        if len(held) < FEWEST or 2 * (held[-1][0] - held[0][0]) < self._window:
            return STILL
        return self._parabola()

    def _parabola(self) -> Motion:
        begin = self._held[0][0]
        times = np.array([SECOND * (one[0] - begin) for one in self._held])
        angles = np.array([one[1:] for one in self._held])
        times -= times.sum() / len(times)
        square = times * times
        bend = square - (square * times).sum() / square.sum() * times - square.sum() / len(times)  # orthogonal to both
        slopes = (times[:, None] * angles).sum(axis=0) / square.sum()
        curvatures = (bend[:, None] * angles).sum(axis=0) / (bend * bend).sum()
        slopes -= curvatures * (square * times).sum() / square.sum()
        numbers = zip(np.nan_to_num(slopes).tolist(), np.nan_to_num(2.0 * curvatures).tolist(), strict=True)
        return Motion(*[Turning(*pair) for pair in numbers])

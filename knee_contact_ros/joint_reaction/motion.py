"""Angular velocities and accelerations of the joints, from a stream of angles, without looking ahead."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from knee_contact_ros.joint_reaction.sensed import Joints

NANOSECOND = 1e-9
"""Duration [s] of a nanosecond"""
FEWEST = 4
"""The least number of samples in the window from which a motion is computed"""
MOST = 1000
"""The largest number of samples in the window (7 us): it is divided into so many cells, and of the samples in a cell
the last one counts"""


class Turning(NamedTuple):
    """Angular velocity and acceleration of a joint, positive where its angle grows."""

    rate: float
    """Angular velocity [rad/s]"""
    acceleration: float
    """Angular acceleration [rad/s^2]"""


class Motion(NamedTuple):
    """Angular velocities and accelerations of the leg's joints."""

    flexion: Turning
    hip: Turning
    ankle: Turning


STANDING = Turning(0.0, 0.0)
STILL = Motion(STANDING, STANDING, STANDING)


class MotionFilter:
    """Fits a parabola to the last angles by least squares, and gives its slope at their middle and its curvature.

    So both are half a window late. A window of twice the length has a sixth of the noise in the curvature. The bits
    depend only on stamps and angles in the window: cells and epochs are those of the clock, and the sums over the rows
    are computed anew at every stamp.
    """

    def __init__(self, window: float) -> None:
        """Take the duration [s] of the samples that the parabola is fitted to; 0: the joints count as still."""
        self._window = round(window / NANOSECOND)
        self._cell = -(-self._window // (MOST - 1))
        self._held: deque[int] = deque()  # stamps in the window
        self._motion = STILL
        # A row for each: powers of its time, from the epoch's beginning and in windows, and its angles. New rows go
        # behind the others; an epoch is as long as a window, and as it begins, what is held moves to the front.
        self._rows = np.empty((2 * MOST, 6))
        self._end = self._epoch = 0

    def forget(self) -> None:
        """Forget all angles."""
        self._held.clear()
        self._motion = STILL

    def now(self, stamp: int) -> Motion:
        """Give the motion at a stamp [ns] not before that of the last angles; still if these are too old by then."""
        return self._motion if self._held and stamp - self._held[-1] <= self._window else STILL

    def see(self, stamp: int, joints: Joints) -> Motion:
        """Take the angles measured at a stamp [ns], and give the motion; still until there are enough samples.

        A stamp that is not later than the last one makes the filter forget all angles before.
        """
        self._motion = self._seen(stamp, joints)
        return self._motion

    def _seen(self, stamp: int, joints: Joints) -> Motion:
        window, cell, held = self._window, self._cell, self._held
        if window == 0:
            return STILL
        if held and stamp <= held[-1]:
            held.clear()
        while held and stamp - held[0] > window:
            held.popleft()
        if held and stamp // cell == held[-1] // cell:
            held.pop()
            self._end -= 1
        if not held or stamp - self._epoch >= window:
            self._begin_epoch(stamp - stamp % window)
        time = (stamp - self._epoch) / window
        self._rows[self._end] = 1.0, time, time * time, joints.flexion, joints.hip, joints.ankle
        self._end += 1
        held.append(stamp)
        if len(held) < FEWEST or 2 * (stamp - held[0]) < window:
            return STILL
        return self._parabola()

    def _begin_epoch(self, epoch: int) -> None:
        many = len(self._held)
        angles = self._rows[self._end - many : self._end, 3:]
        times = (np.array(self._held, dtype=np.int64) - epoch) / self._window
        self._rows[:many] = np.column_stack([np.ones(many), times, times * times, angles])
        self._end, self._epoch = many, epoch

    def _parabola(self) -> Motion:
        """Fit by polynomials that are orthogonal on the stamps: 1, t - mean, t^2 - tilt t - level."""
        rows, window = self._rows[self._end - len(self._held) : self._end], self._window * NANOSECOND
        ones, firsts, seconds = (rows[:, :3].T @ rows).tolist()
        number, first, second = ones[:3]
        mean = first / number
        spread = second - mean * first
        tilt = (seconds[1] - mean * second) / spread
        level = (second - tilt * first) / number
        bend = seconds[2] - tilt * seconds[1] - level * second
        motion = []
        for one, by_time, by_square in zip(ones[3:], firsts[3:], seconds[3:], strict=True):
            curvature = (by_square - tilt * by_time - level * one) / bend
            slope = (by_time - mean * one) / spread + (2.0 * mean - tilt) * curvature
            known = math.isfinite(slope)
            motion.append(Turning(slope / window, 2.0 * curvature / (window * window)) if known else STANDING)
        return Motion(*motion)

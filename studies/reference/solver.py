"""Solve a scene twice, with different accuracy and different steps: the difference bounds the error."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from studies.reference.laws import Law
from studies.reference.library import Accuracy, Constants, library

Floats = NDArray[np.float64]
FINE = Accuracy(1e-18, 1e-11, 26, 4e6)
"""[m/s] a step, [N], degree of the series, and the cost at which a tick is given up"""
COARSE = Accuracy(5e-17, 5e-10, 21, 4e6)
SAFETY = 3.0
"""The bound over the difference; the coarse solution's error is some fifty times the fine one's"""
NEIGHBOURS = 4
"""Ticks to either side whose difference counts too: a difference passes through 0 now and then"""
ROUNDING = 4.5e-16
"""Rounding of the numbers handed back, as a part of them"""
NANOSECOND = 1e-9


class Knee(NamedTuple):
    """What does not change: an ellipse on an inclined plane, carried by a hinge."""

    law: Law
    mass: float
    """[kg]"""
    half_axes: tuple[float, float] = (0.034, 0.034)
    """Anterior and superior [m]; equal: a circle"""
    slope: float = 0.0
    """Slope of the plane [rad]"""
    allow_tension: bool = False


class Solution(NamedTuple):
    """One number per tick each; not a number where the tick was given up."""

    depth: Floats
    """Signed [m]: < 0 apart"""
    rate: Floats
    """Rate of the depth [m/s], at the end of the tick's interval"""
    force: Floats
    """[N]; >= 0 unless the contact may pull"""
    height: Floats
    """Height of the reference point above the plane's origin [m]"""
    depth_bound: Floats
    """Bound of the depth's error [m]; not finite where unknown"""
    force_bound: Floats
    """Bound of the force's error [N]; not finite where unknown"""


class _Run:
    """A solution that is taken on from tick to tick."""

    def __init__(self, knee: Knee, accuracy: Accuracy) -> None:
        law = knee.law
        pair = ctypes.c_double * 2
        self._constants = Constants(
            pair(*law.stiffness),
            pair(*law.exponent),
            pair(*law.damping),
            law.layer_depth,
            law.loss,
            law.least_impact_speed,
            knee.allow_tension,
            knee.mass,
            *knee.half_axes,
            knee.slope,
        )
        self._accuracy = accuracy
        self._library = library()
        self._state = ctypes.create_string_buffer(self._library.state_size() + 16)

    def take(self, duration: Floats, angle: Floats, load: Floats) -> Floats:
        """Depth, rate, force and height, shape (4, n)."""
        inputs = [
            np.ascontiguousarray(column, dtype=np.float64) for column in (duration, angle, load)
        ]
        outputs = np.empty((4, len(duration)))

        def address(column: Floats) -> ctypes.c_void_p:
            return ctypes.c_void_p(column.ctypes.data)

        # the state holds numbers of 16 bytes, which must lie on such
        state = (ctypes.addressof(self._state) + 15) // 16 * 16
        self._library.run(
            ctypes.byref(self._constants),
            ctypes.byref(self._accuracy),
            ctypes.c_void_p(state),
            ctypes.c_long(len(duration)),
            *map(address, inputs),
            *map(address, list(outputs)),
        )
        return outputs


class Reference:
    """The reference solution of a knee, in chunks of any length."""

    def __init__(self, knee: Knee, fine: Accuracy = FINE, coarse: Accuracy = COARSE) -> None:
        self._fine, self._coarse = _Run(knee, fine), _Run(knee, coarse)
        self._stamp: float | None = None

    def take(self, time: ArrayLike, angle: ArrayLike, load: ArrayLike) -> Solution:
        """Solve for more ticks, in times [s], flexion angles [rad] and loads [N] of shape (n,).

        The first tick of all is the contact at rest under its load. Times are rounded to the nanosecond.
        """
        time, angle, load = (
            np.asarray(column, dtype=np.float64) for column in (time, angle, load)
        )
        stamps = np.rint(time / NANOSECOND)
        duration = (
            np.diff(stamps, prepend=stamps[0] if self._stamp is None else self._stamp) * NANOSECOND
        )
        self._stamp = float(stamps[-1])
        fine, coarse = (
            self._fine.take(duration, angle, load),
            self._coarse.take(duration, angle, load),
        )
        depth, rate, force, height = fine
        return Solution(
            depth, rate, force, height, _bound(depth, coarse[0]), _bound(force, coarse[2])
        )


def solve(knee: Knee, time: ArrayLike, angle: ArrayLike, load: ArrayLike) -> Solution:
    """The whole of a series: see `Reference.take`."""
    return Reference(knee).take(time, angle, load)


def _bound(fine: Floats, coarse: Floats) -> Floats:
    """What the error may be: the largest difference around, and the rounding of the numbers themselves."""
    difference = np.abs(fine - coarse)
    padded = np.pad(difference, NEIGHBOURS, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1).max(axis=1)
    bound: Floats = SAFETY * around + ROUNDING * np.abs(fine)
    return bound

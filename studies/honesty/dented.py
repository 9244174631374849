"""A measured, noisy condyle on a level plane, solved once more: nothing of the model is used here.

The curve is SciPy's C2 cubic spline through the points over the chord length. Its lowest point is the lowest of those
of all segments, each by the roots of a quadratic. Where it leaps over a dent the rate of the depth jumps: samples are
put in shortly before and behind, between which load and angle stay linear. In between, steps by the 8th order method of
Dormand & Prince go on until one has left its mode: bisection finds the first moment at which it has.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import DOP853
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from studies.reference import Solution
from studies.reference.laws import Law

Floats = NDArray[np.float64]
FINE, COARSE = (1e-12, 8), (1e-10, 5)
"""Relative tolerance of the steps, and least number of looks in a tick, of the two solutions that are compared"""
SAFETY, NEIGHBOURS = 3.0, 4
"""Bound over the largest difference of as many ticks on either side"""
LOOK = 2e-4
"""Turn [rad] between two looks for a leap"""
LEAP = 1e-6
"""Distance along the curve [m] that counts as a leap"""
MARGIN = 1e-11
"""Turn [rad] from a leap to the samples before and behind it"""
MOST_STEPS = 100_000
"""Largest number of steps between two samples"""
A, B, C, E = (np.ascontiguousarray(part) for part in (DOP853.A, DOP853.B, DOP853.C, DOP853.E5))


class Condyle(NamedTuple):
    """A femoral curve, segment by segment."""

    begins: Floats
    """Chord length at which each segment begins [m], shape (n + 1,)"""
    x: Floats
    """Coefficients over the chord length since then, the constant first, shape (n, 4)"""
    y: Floats


def condyle(points: Floats) -> Condyle:
    """Build a condyle through points of shape (2, n) [m]."""
    chords = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points)))])
    x, y = (np.ascontiguousarray(CubicSpline(chords, column).c[::-1].T) for column in points)
    return Condyle(chords, x, y)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _lowest(begins: Floats, x: Floats, y: Floats, angle: float) -> tuple[float, float, float]:
    """Height and x of the lowest point relative to the reference point [m], and its place on the curve [m]."""
    sine, cosine, best, best_x, best_place = math.sin(angle), math.cos(angle), math.inf, 0.0, 0.0
    for i in range(len(x)):
        c0, c1, c2, c3 = sine * x[i] + cosine * y[i]
        length, half = begins[i + 1] - begins[i], c2
        root = half * half - 3.0 * c3 * c1
        far = -(half + math.copysign(math.sqrt(max(root, 0.0)), half))
        for k in range(4):
            u = 0.0
            if k == 1:
                u = length
            elif k == 2 and far != 0.0:
                u = c1 / far
            elif k == 3 and c3 != 0.0:
                u = far / (3.0 * c3)
            if root < 0.0 < u < length or not 0.0 <= u <= length:
                continue
            height = c0 + u * (c1 + u * (c2 + u * c3))
            if height < best:
                best, best_place = height, begins[i] + u
                a, b = x[i], y[i]
                px = a[0] + u * (a[1] + u * (a[2] + u * a[3]))
                py = b[0] + u * (b[1] + u * (b[2] + u * b[3]))
                best_x = cosine * px - sine * py
    return best, best_x, best_place


def lowest(femur: Condyle, angle: float) -> tuple[float, float, float]:
    """Height and x of the lowest point relative to the reference point [m], and its place on the curve [m]."""
    return cast("tuple[float, float, float]", _lowest(*femur, angle))


def leaps(femur: Condyle, start: float, end: float) -> list[float]:
    """Flexion angles between two at which the lowest point leaps, in the order of their passing."""
    angles = np.linspace(start, end, 2 + int(abs(end - start) / LOOK)).tolist()
    found = []
    for one, other in pairwise(angles):
        low, high, begin, after = one, other, lowest(femur, one)[2], lowest(femur, other)[2]
        while abs(after - begin) > LEAP and min(low, high) < 0.5 * (low + high) < max(low, high):
            middle = 0.5 * (low + high)
            place = lowest(femur, middle)[2]
            if abs(place - begin) > abs(after - place):
                high, after = middle, place
            else:
                low, begin = middle, place
        if abs(after - begin) > LEAP:
            found.append(0.5 * (low + high))
    return found


def solve(
    femur: Condyle, law: Law, mass: float, time: Floats, angle: Floats, load: Floats
) -> Solution:
    """Solve a scene from the static start twice, with different accuracy."""
    samples, ticks = [(0.0, angle[0], load[0])], [0]
    for i in range(1, len(time)):
        turn, duration, last = angle[i] - angle[i - 1], time[i] - time[i - 1], 0.0
        for leap in leaps(femur, angle[i - 1], angle[i]):
            for side in (-MARGIN, MARGIN):
                part = (leap - angle[i - 1]) / turn + side / abs(turn)
                if last < part < 1.0:
                    here = angle[i - 1] + part * turn, load[i - 1] + part * (load[i] - load[i - 1])
                    samples.append(((part - last) * duration, *here))
                    last = part
        ticks.append(len(samples))
        samples.append(((1.0 - last) * duration, angle[i], load[i]))
    constants = np.array(
        [
            *law.stiffness,
            *law.exponent,
            *law.damping,
            law.layer_depth,
            law.loss,
            law.least_impact_speed,
        ]
    )
    depth = 0.0
    if load[0] > 0.0:
        depth = brentq(
            lambda at: _static(constants, at) - load[0], 0.0, 1.0, xtol=1e-18, rtol=1e-15
        )
    start = np.array([-lowest(femur, angle[0])[0] - depth, depth])
    fine, coarse = (
        _solve(*femur, constants, mass, np.array(samples), start, A, B, C, E, *accuracy)[:, ticks]
        for accuracy in (FINE, COARSE)
    )
    depth, rate, force, height = fine
    return Solution(
        depth, rate, force, height, _around(depth - coarse[0]), _around(force - coarse[2])
    )


@njit(cache=True)  # type: ignore[untyped-decorator]
def _force(law: Floats, layer: int, depth: float, rate: float, impact: float) -> float:
    """Force of a layer's formula [N], which goes on beyond its beginning and changes its sign there."""
    over = depth - (law[6] if layer == 1 else 0.0)
    elastic = law[layer] * math.copysign(abs(over) ** law[2 + layer], over)
    base = law[0] * law[6] ** law[2] if layer == 1 else 0.0
    force: float = (
        base + elastic * (1.0 + law[7] * rate / max(impact, law[8])) + law[4 + layer] * rate
    )
    return force


def _static(law: Floats, depth: float) -> float:
    return cast("float", _force(law, int(0.0 <= law[6] < depth), depth, 0.0, 0.0))


@njit(cache=True)  # type: ignore[untyped-decorator]
def _left(
    law: Floats, layer: int, pressing: bool, depth: float, rate: float, impact: float
) -> int:
    """Which boundary of its mode a contact lies beyond: 1 above, 2 the change of the force's sign, 3 below; 0: none."""
    if layer >= 0 and depth < (law[6] if layer == 1 else 0.0):
        return 1
    if (layer < 0 and depth > 0.0) or (layer == 0 and 0.0 <= law[6] < depth):
        return 3
    force = _force(law, layer, depth, rate, impact) if layer >= 0 else 0.0
    return 2 if (force < 0.0 if pressing else force > 0.0) else 0


@njit(cache=True)  # type: ignore[untyped-decorator]
def _solve(  # noqa: C901, PLR0912, PLR0915
    begins: Floats,
    x: Floats,
    y: Floats,
    law: Floats,
    mass: float,
    samples: Floats,
    start: Floats,
    a: Floats,
    b: Floats,
    c: Floats,
    e: Floats,
    tolerance: float,
    looks: int,
) -> Floats:
    """Depth, rate, force and height at all samples, shape (4, n); not a number from where it has been given up."""
    found, slopes = np.full((4, len(samples)), np.nan), np.zeros((2, 13))
    height, velocity, impact, depth, rate = start[0], 0.0, 0.0, start[1], 0.0
    layer = -1 if depth <= 0.0 else int(0.0 <= law[6] < depth)
    pressing = layer >= 0
    found[:, 0] = depth, 0.0, _force(law, layer, depth, 0.0, 0.0) if pressing else 0.0, height
    for i in range(1, len(samples)):
        duration, angle, load = samples[i, 0], samples[i - 1, 1], samples[i - 1, 2]
        turn, growth = (samples[i, 1] - angle) / duration, (samples[i, 2] - load) / duration
        low, across, _ = _lowest(begins, x, y, angle)
        if i == 1:
            velocity = -across * turn
        rate = -across * turn - velocity
        if layer >= 0:
            pressing = _force(law, layer, depth, rate, impact) >= 0.0
        s, h, steps = 0.0, duration / looks, 0
        while s < duration:
            steps += 1
            if steps > MOST_STEPS:
                return found
            wanted, fits, inside, beyond, boundary = min(h, duration - s), False, 0.0, 0.0, 0
            h = wanted
            while True:  # a step of `wanted`: h, or a part of it on the way to a boundary
                for stage in range(13):
                    part = 1.0 if stage == 12 else c[stage]
                    up, fast = height, velocity
                    for j in range(stage):
                        weight = wanted * (b[j] if stage == 12 else a[stage, j])
                        up += weight * slopes[0, j]
                        fast += weight * slopes[1, j]
                    at, push = s + part * wanted, 0.0
                    low, across, _ = _lowest(begins, x, y, angle + turn * at)
                    depth, rate = -low - up, -across * turn - fast
                    if pressing:
                        push = _force(law, layer, depth, rate, impact)
                    slopes[0, stage], slopes[1, stage] = fast, (push - load - growth * at) / mass
                if not fits:
                    error = 0.0
                    for k, size in ((0, abs(depth) + 1e-7), (1, abs(velocity) + abs(fast) + 1e-6)):
                        off = 0.0
                        for j in range(13):
                            off += wanted * e[j] * slopes[k, j]
                        error = max(error, abs(off) / (tolerance * size))
                    if not error <= 1.0 and wanted > 1e-15:
                        wanted *= (
                            max(0.2, 0.9 * error ** (-1.0 / 8.0)) if error < math.inf else 0.2
                        )
                        h = wanted
                        continue
                    fits = True
                    following = wanted * min(4.0, 0.9 * max(error, 1e-8) ** (-1.0 / 8.0))
                    beyond = 2.0 * wanted
                now = _left(law, layer, pressing, depth, rate, impact)
                if now != 0:
                    beyond, boundary = wanted, now
                elif boundary == 0:
                    break
                else:
                    inside = wanted
                middle = 0.5 * (inside + beyond)
                if not inside < middle < beyond:
                    if now != 0:
                        break
                    middle = beyond
                wanted = middle
            s = duration if boundary == 0 and wanted >= duration - s else s + wanted
            height, velocity = up, fast
            if boundary == 0:
                h = min(following, duration / looks)
                continue
            h = min(h, duration / looks)
            if boundary == 2:
                pressing = not pressing
                continue
            if layer < 0:
                impact = rate
            layer += 1 if boundary == 3 else -1
            pressing = layer >= 0 and _force(law, layer, depth, rate, impact) >= 0.0
        force = _force(law, layer, depth, rate, impact) if pressing else 0.0
        found[:, i] = depth, rate, max(force, 0.0), height
    return found


def _around(difference: Floats) -> Floats:
    """Bound of the error of a solution by its difference from another one."""
    padded = np.pad(np.abs(difference), NEIGHBOURS, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1).max(axis=1)
    bound: Floats = SAFETY * around + 1e-16
    return bound

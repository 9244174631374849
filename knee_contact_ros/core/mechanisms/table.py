"""A measured anterior-posterior translation over flexion, for example from dynamic MRI or fluoroscopy."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from knee_contact_ros.core.arrays import Floats, count_up_to

LARGEST = 0.1
"""Largest translation [m]: a larger one is longer than a tibial plateau, and most likely in mm."""


class Cubic(NamedTuple):
    """A cubic x(u) = c0 + u (c1 + u (c2 + u c3)) [m] of the angle u [rad] from `start` on."""

    start: float
    c0: float
    c1: float
    c2: float
    c3: float


class _Table(NamedTuple):
    """Fields of a `Table`."""

    pieces: Floats
    """Shape (points + 1, 5): a `Cubic` in each row; the first and the last one are straight"""
    angles: Floats
    """Shape (points,) [rad]: angles at which the pieces begin, except the first one"""
    steepest_slope: float
    """Upper bound of |dx/dangle| [m/rad]"""


class Table(_Table):
    """Translation by a natural cubic spline through points, straight beyond its ends: C2 at every angle.

    A natural spline has no curvature at its ends, so the straight continuation joins it smoothly.
    """

    __slots__ = ()

    def __new__(cls, angle: Sequence[float] | Floats, x: Sequence[float] | Floats) -> Table:
        """Fit the spline through flexion angles `angle` [rad] and translations `x` [m], anterior positive.

        Raises:
            ValueError: fewer than 2 points, different lengths, a number that is not finite, angles that do not
                increase strictly, or a translation beyond 0.1 m.
        """
        angles, values = np.array(angle, float), np.asarray(x, float)
        _check(angles, values)
        pieces = _pieces(angles.tolist(), values.tolist())
        return super().__new__(cls, np.array(pieces), angles, _steepest(pieces, np.diff(angles).tolist()))

    def translation(self, angle: float) -> tuple[float, float]:
        """Return x [m] and dx/dangle [m/rad] at a flexion angle [rad]."""
        i = count_up_to(self.angles, angle)
        c0, c1 = float(self.pieces[i, 1]), float(self.pieces[i, 2])
        c2, c3 = float(self.pieces[i, 3]), float(self.pieces[i, 4])
        u = angle - float(self.pieces[i, 0])
        return c0 + u * (c1 + u * (c2 + u * c3)), c1 + u * (2.0 * c2 + u * 3.0 * c3)

    def largest_slope(self) -> float:
        """Return an upper bound of |dx/dangle| [m/rad] over all angles."""
        return self.steepest_slope


def _steepest(pieces: Sequence[Cubic], widths: Sequence[float]) -> float:
    """Return an upper bound of the slope, which lies in the hull of its Bézier points."""
    hull = [
        (piece.c1, piece.c1 + piece.c2 * width, piece.c1 + width * (2.0 * piece.c2 + 3.0 * piece.c3 * width))
        for piece, width in zip(pieces, (0.0, *widths, 0.0), strict=True)
    ]
    return max(abs(slope) for slopes in hull for slope in slopes)


def _check(angle: Floats, x: Floats) -> None:
    """Reject points that are no table of translations.

    Raises:
        ValueError: see `Table`.
    """
    if angle.ndim != 1 or angle.shape != x.shape:
        raise ValueError("a translation table needs as many translations as angles")
    if angle.size < 2:
        raise ValueError(f"a translation table needs at least 2 points, got {angle.size}")
    if not (np.isfinite(angle).all() and np.isfinite(x).all()):
        raise ValueError("a number in the translation table is not finite")
    if not (np.diff(angle) > 0.0).all():
        raise ValueError("the angles of a translation table must increase strictly")
    if (np.abs(x) > LARGEST).any():
        raise ValueError(f"a translation is beyond {LARGEST} m: are the numbers in metres?")


def _pieces(angle: list[float], x: list[float]) -> tuple[Cubic, ...]:
    """Return the cubics between the points, with a straight piece before and after them."""
    widths = [right - left for left, right in pairwise(angle)]
    chords = [(right - left) / width for (left, right), width in zip(pairwise(x), widths, strict=True)]
    bends = _second_derivatives(widths, chords)
    inner = [
        Cubic(
            start=start,
            c0=value,
            c1=chord - width * (2.0 * left + right) / 6.0,
            c2=left / 2.0,
            c3=(right - left) / (6.0 * width),
        )
        for start, value, chord, width, (left, right) in zip(
            angle[:-1], x[:-1], chords, widths, pairwise(bends), strict=True
        )
    ]
    last_slope = chords[-1] + widths[-1] * bends[-2] / 6.0
    before = Cubic(start=angle[0], c0=x[0], c1=inner[0].c1, c2=0.0, c3=0.0)
    after = Cubic(start=angle[-1], c0=x[-1], c1=last_slope, c2=0.0, c3=0.0)
    return (before, *inner, after)


def _second_derivatives(widths: list[float], chords: list[float]) -> list[float]:
    """Return second derivatives at the points [m/rad²], 0 at both ends, from the tridiagonal system of equal slopes."""
    diagonals: list[float] = []
    sums: list[float] = []
    for (left, right), (before, after) in zip(pairwise(widths), pairwise(chords), strict=True):
        diagonal, total = 2.0 * (left + right), 6.0 * (after - before)
        if diagonals:
            factor = left / diagonals[-1]
            diagonal, total = diagonal - factor * left, total - factor * sums[-1]
        diagonals.append(diagonal)
        sums.append(total)
    bends = [0.0]
    for diagonal, total, width in zip(reversed(diagonals), reversed(sums), reversed(widths[1:]), strict=True):
        bends.append((total - width * bends[-1]) / diagonal)
    return [0.0, *reversed(bends)]

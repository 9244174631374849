"""Roundness of a curve: balls that touch it at a point and contain all of it, or none of it.

The circle through a point v that touches the curve at u has the curvature q(u, v) = 2 Δ·n/Δ², with Δ = v - u and the
unit normal n at u. Where q >= a > 0 for all v, the curve lies in the ball of radius 1/a that touches at u on the side
of n; where q <= b, it lies outside the ball of radius 1/b. So one number of each of two curves bounds the distance of
all of their points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from knee_contact_ros.core.arrays import Floats, Integers

PARTS = 4
"""Number of parts of a piece of a spline for the bounds of its roundness"""
WINDOWS = (2, 4, 8, 16, 32, 64, 128, 256, 512)
"""Numbers of neighbours on both sides for which q is bounded by their curvature"""
LARGEST_TURN = 1.5
"""Largest turn [rad] of such a neighbourhood, so that it does not come back to where it began"""
ROWS = 64
"""Number of pieces whose pairs with all others are bounded at a time"""
SHARP = 1e9
"""Curvature [1/m] in place of an unbounded one"""
ROUNDING = 1e-9
"""Rounding of a bound, as a part of it"""


class Pieces(NamedTuple):
    """Pieces of a C1 curve, one after another; arrays of shape (n, 2) or (n,)."""

    places: Floats
    """Middles of the pieces [m]"""
    tangents: Floats
    """Unit vectors along the curve in the middles"""
    reach: Floats
    """Upper bounds of half the lengths along the curve [m]"""
    low: Floats
    """Lower bounds of the curvature [1/m], > 0 where the curve turns left"""
    high: Floats
    """Upper bounds of the curvature [1/m]"""


def least_roundness(pieces: Pieces) -> Floats:
    """A lower bound [1/m] of q(u, v) for all u of each piece and all v of the curve, shape (n,); n is to the left.

    Near u, q is no less than the least curvature in between (Blaschke). Farther away its change over a pair of pieces
    is bounded: 2 Δ·n - a Δ² with the a of their middles changes with u by 2 (a - κ) Δ·T per length, and with v by
    2 T·(n - a Δ).
    """
    count = len(pieces.reach)
    index, windows = np.arange(count), [window for window in WINDOWS if window < 2 * count]
    first, last = (np.array([np.clip(index + sign * window, 0, count - 1) for window in windows]) for sign in (-1, 1))
    turn = np.cumsum(np.concatenate([[0.0], 2.0 * pieces.reach * _largest(pieces)]))
    near = np.array([_least_around(pieces.low, window) for window in windows])
    near[turn[last + 1] - turn[first] > LARGEST_TURN] = -np.inf
    bounds = [
        np.minimum(near[:, rows], _beyond(_far(pieces, rows), first[:, rows], last[:, rows])).max(axis=0)
        for rows in (slice(begin, begin + ROWS) for begin in range(0, count, ROWS))
    ]
    bound = np.concatenate(bounds)
    return np.asarray(bound - ROUNDING * np.abs(bound))


def _far(pieces: Pieces, rows: slice) -> Floats:
    """Return a lower bound of q [1/m] for all u of one of these pieces and all v of any piece, shape (rows, n)."""
    (x, y), (along_x, along_y), reach = pieces.places.T, pieces.tangents.T, pieces.reach
    from_x, from_y, reach_u, largest_u = [values[rows, None] for values in (along_x, along_y, reach, _largest(pieces))]
    dx, dy = x - x[rows, None], y - y[rows, None]
    squared = dx * dx + dy * dy
    distance = np.sqrt(squared)
    nearest, farthest = distance - (reach_u + reach), distance + (reach_u + reach)
    with np.errstate(divide="ignore", invalid="ignore"):
        q = 2.0 * (from_x * dy - from_y * dx) / squared
        slope = 2.0 * np.abs(along_x * (-from_y - q * dx) + along_y * (from_x - q * dy))
        bend = 2.0 * _largest(pieces) * (1.0 + np.abs(q) * farthest) + 2.0 * np.abs(q)
        other = np.maximum(np.abs(q - pieces.low[rows, None]), np.abs(q - pieces.high[rows, None]))
        along = np.abs(from_x * dx + from_y * dy) + reach_u * (1.0 + largest_u * farthest) + reach
        change = slope * reach + 0.5 * bend * reach * reach + 2.0 * other * along * reach_u
        return np.asarray(np.where(nearest > 0.0, q - change / (nearest * nearest), -np.inf))


def _beyond(far: Floats, first: Integers, last: Integers) -> Floats:
    """Return the least of each row before `first` and after `last`, shape (windows, rows)."""
    edge = np.full((len(far), 1), np.inf)
    before = np.minimum.accumulate(np.concatenate([edge, far], axis=1), axis=1)
    behind = np.minimum.accumulate(np.concatenate([edge, far[:, ::-1]], axis=1), axis=1)[:, ::-1]
    row = np.arange(len(far))
    return np.minimum(before[row, first], behind[row, last + 1])


def _largest(pieces: Pieces) -> Floats:
    """Return an upper bound of the absolute curvature [1/m]."""
    return np.maximum(np.abs(pieces.low), np.abs(pieces.high))


def _least_around(values: Floats, window: int) -> Floats:
    """Return the least of every value and so many neighbours on both sides."""
    padded = np.pad(values, window, constant_values=np.inf)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, 2 * window + 1).min(axis=1))

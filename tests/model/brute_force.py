"""Contacts by brute force: dense points of both surfaces, finer ones around the best; nothing here is the model's."""

import itertools
import math
from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

DENSE = 2e-5
"""Distance of a plateau's points [m]"""
COARSE, FINE = 2e-4, 2e-5
"""Distances of a femur's points [m]"""
ROUNDS, ZOOM = 6, 12
"""Rounds of finer points around the best one, and how many times finer"""
Points = np.ndarray
Distance = Callable[..., tuple[Points, Points]]
"""Signed distance [m] of points of shape (n, 2), and the nearest tibial points, shape (n, 2) [m]"""


def above_plane(slope):
    normal = np.array([-math.sin(slope), math.cos(slope)])

    def distance(points, exact=True):
        above = points @ normal
        return above, points - above[:, None] * normal

    return distance


def in_cup(radius):
    def distance(points, exact=True):
        lean = np.arctan2(points[:, 0], radius - points[:, 1])
        lean = np.clip(lean, -math.pi / 3.0, math.pi / 3.0)  # beyond, the end's tangent goes on
        along = np.where(np.abs(lean) == math.pi / 3.0, 1.0, 0.0)
        foot = radius * np.stack([np.sin(lean), 1.0 - np.cos(lean)], axis=1)
        tangent, normal = (
            np.stack([np.cos(lean), np.sin(lean)], 1),
            np.stack([-np.sin(lean), np.cos(lean)], 1),
        )
        foot = foot + (along * ((points - foot) * tangent).sum(axis=1))[:, None] * tangent
        return ((points - foot) * normal).sum(axis=1), foot

    return distance


def on_plateau(x, y, reach=0.12):
    spline = CubicSpline(x, y)
    edges = (-reach, x[0], x[-1], reach)
    dense = np.concatenate(
        [np.arange(begin, end, DENSE) for begin, end in itertools.pairwise(edges)]
    )

    def height(place, order=0):
        inside = np.clip(place, x[0], x[-1])
        if order:
            return spline(inside, order) * ((inside == place) if order > 1 else 1.0)
        return spline(inside) + spline(inside, 1) * (place - inside)

    points, piece = np.stack([dense, height(dense)], axis=1), np.searchsorted(x, dense)
    # Two points may be equally near: also the nearest ones of every other, third and fifth piece are refined
    groups = [
        np.ones(len(dense), bool),
        *(piece % number == k for number in (2, 3, 5) for k in range(number)),
    ]
    trees = [(cKDTree(points[group]), dense[group]) for group in groups]

    def zoomed(points, place):
        for width in DENSE * (1.5 / ZOOM) ** np.arange(ROUNDS):
            near = place[:, None] + np.linspace(-width, width, 2 * ZOOM + 1)
            at = np.hypot(near - points[:, :1], height(near) - points[:, 1:]).argmin(axis=1)
            place = near[np.arange(len(place)), at]
        return place

    def distance(points, exact=True):
        best, best_foot = np.full(len(points), np.inf), np.zeros_like(points)
        for tree, places in trees if exact else trees[:1]:
            start = places[tree.query(points)[1]]
            place = start.copy()
            for _ in range(12 if exact else 2):
                dy, slope = points[:, 1] - height(place), height(place, 1)
                room = 1.0 + slope**2 - dy * height(place, 2)
                step = (points[:, 0] - place + slope * dy) / np.where(room > 0.0, room, 1.0)
                place = np.clip(place + step, start - DENSE, start + DENSE)
            stuck = exact & (
                np.abs(step) > 1e-10
            )  # near a centre of curvature Newton's method does not settle
            place[stuck] = zoomed(points[stuck], start[stuck])
            foot = np.stack([place, height(place)], axis=1)
            away = np.hypot(*(points - foot).T)
            best_foot[away < best] = foot[away < best]
            best = np.minimum(best, away)
        return np.where(points[:, 1] >= height(points[:, 0]), best, -best), best_foot

    return distance


class Femur:
    """A circle of a radius [m], or a spline over the chord length through points [m]."""

    def __init__(self, *given):
        self.radius = float(given[0]) if len(given) == 1 else 0.0
        if len(given) == 2:
            points = np.stack(given)
            chords = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points)))])
            self.spline, self.length = CubicSpline(chords, points, axis=1), float(chords[-1])

    def places(self, s, pose):
        """Points of the curve at `s` [m], shape (n, k), in poses (angle, x, height), shape (n, 3)."""
        px, py = self.spline(np.clip(s, 0.0, self.length))
        (sine, cosine), (x, y) = (
            (np.sin(pose[:, :1]), np.cos(pose[:, :1])),
            pose[:, 1:].T[:, :, None],
        )
        return np.stack([x + cosine * px - sine * py, y + sine * px + cosine * py], axis=2)


def deepest(femur, distance, poses):
    """Signed depth [m], shape (n,), and tibial point [m], shape (n, 2), in poses (angle, x, height), shape (n, 3)."""
    if femur.radius:
        away, foot = distance(poses[:, 1:])
        return femur.radius - away, foot
    s = np.linspace(0.0, femur.length, math.ceil(femur.length / COARSE))
    fine = np.linspace(-1.0, 1.0, 2 * math.ceil(s[1] / FINE) + 1) * s[1]

    def over(some, s, exact=False):
        found, foot = distance(femur.places(s, poses[some]).reshape(-1, 2), exact)
        return found.reshape(s.shape), foot.reshape(*s.shape, 2)

    coarse, _ = over(np.arange(len(poses)), np.broadcast_to(s, (len(poses), len(s))))
    best = coarse.min(axis=1)
    which, at = np.nonzero(
        coarse < best[:, None] + 1.2 * s[1]
    )  # the distance changes by no more than the way
    centre = s[at]
    found, _ = over(which, centre[:, None] + fine)
    lowest = np.full(len(poses), np.inf)
    np.minimum.at(lowest, which, found.min(axis=1))
    framed = np.pad(found, ((0, 0), (1, 1)), constant_values=np.inf)
    row, at = np.nonzero(
        (found <= np.minimum(framed[:, :-2], framed[:, 2:]))
        & (found < lowest[which][:, None] + 2e-5)
    )
    which, centre, width = which[row], centre[row] + fine[at], fine[1] - fine[0]
    for _ in range(ROUNDS):
        spread = np.linspace(-1.0, 1.0, 2 * ZOOM + 1) * width
        found, foot = over(which, centre[:, None] + spread, exact=True)
        at = found.argmin(axis=1)
        centre, width = np.clip(centre + spread[at], 0.0, femur.length), width * 1.5 / ZOOM
    found, foot = found[np.arange(len(at)), at], foot[np.arange(len(at)), at]
    order = np.lexsort((found, which))
    first = order[np.unique(which[order], return_index=True)[1]]
    return -found[first], foot[first]

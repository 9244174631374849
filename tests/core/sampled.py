"""Contacts by brute force, from many points of both surfaces; nothing here is the model's but its outlines."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from knee_contact_ros.core.geometries import Profile


def turn(points: np.ndarray, angle: float) -> np.ndarray:
    """Points (n, 2) of the femur in the directions of the tibia."""
    sine, cosine = math.sin(angle), math.cos(angle)
    return points @ np.array([[cosine, sine], [-sine, cosine]])


def curve(femur: Profile, points_per_segment: int = 400) -> np.ndarray:
    """Many points of a femoral profile and its last one, which its outline leaves out."""
    last = femur.curve.cubics[-1]
    end = [[np.polyval(axis[::-1], last[0]) for axis in (last[2:6], last[6:])]]
    return np.concatenate([femur.outline(points_per_segment), end])


class Sampled:
    """A tibial surface by many points and their normals; depths by the nearest of them."""

    def __init__(self, x: np.ndarray, y: np.ndarray, slope: np.ndarray) -> None:
        self.points = np.stack([x, y], axis=1)
        self.normals = np.stack([-slope, np.ones_like(slope)], axis=1) / np.hypot(1.0, slope)[:, None]
        self.tree = cKDTree(self.points)

    @classmethod
    def profile(cls, x: np.ndarray, y: np.ndarray, reach: float = 0.09, points: int = 40001) -> Sampled:
        spline = CubicSpline(x, y)
        dense = np.linspace(-reach, reach, points)
        inside = np.clip(dense, x[0], x[-1])
        return cls(dense, spline(inside) + spline(inside, 1) * (dense - inside), spline(inside, 1))

    @classmethod
    @cache
    def circle(cls, radius: float) -> Sampled:
        t = np.linspace(-1.0, 1.0, 40001)
        return cls(radius * np.sin(t), radius * (1.0 - np.cos(t)), np.tan(t))

    def distances(self, points: np.ndarray) -> np.ndarray:
        _, nearest = self.tree.query(points)
        return np.sum((points - self.points[nearest]) * self.normals[nearest], axis=1)

    def depth(self, femur: Profile, angle: float, x: float, height: float, points_per_segment: int = 400) -> float:
        points = turn(curve(femur, points_per_segment), angle) + np.array([x, height])
        return -least_along(points, self.distances)


def least_along(points: np.ndarray, distances: Callable[[np.ndarray], np.ndarray]) -> float:
    """The least distance of points of a curve: of every 400th, then of all that may be nearer than those."""
    way = np.hypot(*np.diff(points, axis=0).T).max()  # between two, the distance changes by no more than that
    chosen = np.arange(0, len(points), 400)
    for stride, finer in itertools.pairwise((400, 80, 16, 4, 1)):
        found = distances(points[chosen])
        near = chosen[found < found.min() + stride * way]
        chosen = (near[:, None] + np.arange(0, stride, finer)).ravel()
        chosen = chosen[chosen < len(points)]
    return float(distances(points[chosen]).min())

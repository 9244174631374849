"""Bounds of how round a curve is, against all pairs of many of its points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from knee_contact_ros.core.contact_pairs.femoral_curve import femoral_curve
from knee_contact_ros.core.contact_pairs.tibial_profile import TibialProfile, spline_at
from knee_contact_ros.core.geometries import Profile
from tests.core.surfaces import ellipse, plateau, wavy

FINE = 12
"""Places on each segment or piece"""


def roundness(places: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """Curvature of the circle through the second of all pairs of places that touches at the first, to the left."""
    x, y = np.moveaxis(places[None, :] - places[:, None], 2, 0)
    along_x, along_y = tangents.T[:, :, None]
    squared = x * x + y * y
    return np.where(squared > 1e-16, 2.0 * (along_x * y - along_y * x) / np.where(squared > 0.0, squared, 1.0), np.nan)


def femoral(profile: Profile) -> np.ndarray:
    """The least roundness seen from each segment, shape (segments,)."""
    length, _, x0, x1, x2, x3, y0, y1, y2, y3 = profile.curve.cubics.T[:, :, None]
    u = length * np.linspace(0.0, 1.0, FINE)
    places = np.stack([c0 + u * (c1 + u * (c2 + u * c3)) for c0, c1, c2, c3 in ((x0, x1, x2, x3), (y0, y1, y2, y3))], 2)
    slopes = np.stack([c1 + u * (2.0 * c2 + 3.0 * u * c3) for c1, c2, c3 in ((x1, x2, x3), (y1, y2, y3))], 2)
    tangents = slopes / np.hypot(*np.moveaxis(slopes, 2, 0))[:, :, None]
    found = roundness(places.reshape(-1, 2), tangents.reshape(-1, 2))
    return np.asarray(np.nanmin(found, axis=1).reshape(-1, FINE).min(axis=1))


def tibial(surface: TibialProfile) -> np.ndarray:
    """The largest roundness seen from each piece between two points, shape (points - 1,)."""
    nodes = surface.pieces[1:, 0]
    inner = (nodes[:-1, None] + np.diff(nodes)[:, None] * np.linspace(0.0, 1.0, FINE)).ravel()
    beyond = np.geomspace(1e-4, 5.0, 60)
    every = np.concatenate([nodes[0] - beyond[::-1], inner, nodes[-1] + beyond])
    height, slope, _ = np.array([spline_at(surface.pieces, x) for x in every.tolist()]).T
    tangents = np.stack([np.ones_like(slope), slope], axis=1) / np.hypot(1.0, slope)[:, None]
    found = roundness(np.stack([every, height], axis=1), tangents)[60:-60]
    return np.asarray(np.nanmax(found, axis=1).reshape(-1, FINE).max(axis=1))


@given(
    points=st.integers(8, 70), height=st.sampled_from([0.0, 1e-6, 1e-5, 1e-4, 3e-4]), waves=st.integers(2, 12),
    phase=st.floats(0.0, 6.3),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_no_pair_of_points_is_less_round_than_the_bounds(points: int, height: float, waves: int, phase: float) -> None:
    femur, tibia = wavy(points, height, waves, phase)
    assert (femoral_curve(femur).balls <= femoral(femur)).all()
    assert (tibia.pieces[1:-1, 6] >= tibial(tibia)).all()


@pytest.mark.parametrize("points", [40, 120])
def test_the_bounds_of_smooth_curves_are_close(points: int) -> None:
    """To what the curvature changes by within the nearest pieces, a few percent."""
    femur, tibia = ellipse(points), TibialProfile(*plateau(points))
    assert femoral_curve(femur).balls == pytest.approx(femoral(femur), rel=0.06)
    hollow = tibial(tibia) > 5.0
    assert tibia.pieces[1:-1, 6][hollow] == pytest.approx(tibial(tibia)[hollow], rel=0.1)


def test_the_bone_lies_on_the_same_side_whichever_way_the_points_go() -> None:
    femur = ellipse(80)
    x, y = np.concatenate([femur.outline(1), [[0.034 * np.cos(0.9), 0.028 * np.sin(0.9)]]]).T
    one, other = femoral_curve(Profile(x, y)), femoral_curve(Profile(x[::-1], y[::-1]))
    assert (one.sense, other.sense) == (1.0, -1.0)
    assert one.balls == pytest.approx(other.balls[::-1], rel=1e-6)  # the bounds are those of the same pieces

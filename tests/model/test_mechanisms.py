"""Mechanisms: splines against SciPy's, the parallel mechanism against its constraints and another formulation."""

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from knee_contact_ros.model import mechanisms
from knee_contact_ros.model.mechanisms import (
    MAX_SOLVED_FLEXION,
    MIN_SOLVED_FLEXION,
    hinge,
    parallel_mechanism,
    translation_table,
)

KNOTS, VALUES = [-0.2, 0.0, 0.3, 0.5, 1.1, 1.9], [0.001, 0.0, 0.004, 0.0055, 0.003, -0.006]
MANY = [
    hinge(0.003),
    translation_table(KNOTS, VALUES),
    translation_table([0.0, 1.0], [0.0, 0.01]),
    parallel_mechanism(),
]


@pytest.mark.parametrize("mechanism", MANY, ids=str)
def test_slope_and_bounds(mechanism):
    h, angles = (
        1e-5,
        np.linspace(-1.0, 3.0, 401).tolist(),
    )  # h² x''' / 6 with x''' < 1 m/rad³, and rounding 1e-17 m / h
    slopes = np.array([mechanism.translation(angle)[1] for angle in angles])
    around = [[mechanism.translation(angle + sign * h) for sign in (-1, 1)] for angle in angles]
    assert slopes == pytest.approx([(b[0] - a[0]) / (2.0 * h) for a, b in around], abs=1e-10)
    bends = np.array([(b[1] - a[1]) / (2.0 * h) for a, b in around])
    assert (
        np.abs(slopes).max() <= mechanism.largest_slope <= 1.5 * np.abs(slopes).max() + 1e-15
    )  # a hull
    assert 0.9 * np.abs(bends).max() <= mechanism.largest_bend * (1.0 + 1e-9) + 1e-12
    assert mechanism.largest_bend <= 1.2 * np.abs(bends).max() + 1e-12


@pytest.mark.parametrize("points", [2, 3, 4, 6])
def test_a_table_is_the_natural_spline_and_goes_on_straight(points):
    angles, x = KNOTS[:points], VALUES[:points]
    made, spline = translation_table(angles, x), CubicSpline(angles, x, bc_type="natural")
    for angle in np.linspace(-1.0, 3.0, 401).tolist():
        inside = min(max(angle, angles[0]), angles[-1])
        slope = float(spline(inside, 1))
        goal = float(spline(inside)) + slope * (angle - inside)
        assert made.translation(angle) == pytest.approx(
            (goal, slope), abs=1e-15
        )  # rounding errors of 0.02 m/rad


@pytest.mark.parametrize(
    ("angle", "x", "reason"),
    [
        ([0.0], [0.0], "at least 2 points, got 1"),
        ([], [], "at least 2 points, got 0"),
        ([0.0, 1.0], [0.0], "as many translations as angles"),
        ([0.0, 1.0, 1.0], [0.0, 0.0, 0.0], "increase strictly"),
        ([0.0, 1.0, 0.5], [0.0, 0.0, 0.0], "increase strictly"),
        ([0.0, math.inf], [0.0, 0.0], "not finite"),
        ([0.0, 1.0], [0.0, math.nan], "not finite"),
        ([0.0, 1.0], [0.0, -5.0], "in metres"),
    ],
)
def test_what_is_no_table_is_refused(angle, x, reason):
    with pytest.raises(ValueError, match=reason):
        translation_table(angle, x)


def test_the_parallel_mechanism_stays_closed():
    made = parallel_mechanism()
    angles, poses = mechanisms.passive_motion()
    assert (angles[0], angles[-1]) == (MIN_SOLVED_FLEXION, MAX_SOLVED_FLEXION)
    assert np.diff(angles).max() <= mechanisms.GRID_STEP + 1e-12
    x0 = made.translation(0.0)[0]
    assert x0 == pytest.approx(0.0, abs=1e-17)
    centres = []
    for angle, pose in zip(angles.tolist(), poses, strict=True):
        turn = Rotation.from_euler("YXZ", [-pose[4], pose[3], angle])  # instead of our matrix
        normals = (
            mechanisms.PLANE_NORMALS / np.sqrt((mechanisms.PLANE_NORMALS**2).sum(axis=1))[:, None]
        )
        above = (
            (turn.apply(mechanisms.SPHERE_CENTRES) + pose[:3] - mechanisms.PLANE_POINTS) * normals
        ).sum(axis=1)
        lengths = np.hypot.reduce(
            turn.apply(mechanisms.FEMORAL_ATTACHMENTS) + pose[:3] - mechanisms.TIBIAL_ATTACHMENTS,
            axis=1,
        )
        # 1e-14 m in the solver, rounding here
        assert [*above, *lengths] == pytest.approx(mechanisms.MECHANISM_LENGTHS, abs=1e-13)
        centres.append(turn.apply(mechanisms.SPHERE_CENTRES[0])[0] + pose[0])
    assert [made.translation(angle)[0] for angle in angles] == pytest.approx(
        centres - np.interp(0, angles, centres)
    )
    # The published knee's own answer, written down in mm with two decimals
    x = [1e3 * made.translation(math.radians(degrees))[0] for degrees in (0, 20, 40, 60, 80, 100)]
    assert x == pytest.approx([0.0, 2.33, 1.15, -1.50, -4.39, -6.94], abs=0.005)
    turned = np.interp(np.radians([0.0, 30.0, 60.0, 90.0]), angles, poses[:, 4])
    assert (np.diff(turned) > 0.0).all()  # the tibia turns inwards with flexion

"""Mechanisms: splines against SciPy's, the parallel mechanism against closed forms and another formulation."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from knee_contact_ros.core.mechanisms import MECHANISMS, Hinge, Mechanism, ParallelMechanism, Table
from knee_contact_ros.core.mechanisms.closure import Closure, Condyle, ConstrainedKnee, Fibre, SpatialPose, Vector
from knee_contact_ros.core.mechanisms.parallel_mechanism import SANCISI_2017, START, STOP
from tests import ROOT

ANGLES = np.linspace(-1.0, 3.0, 401)
INSIDE = np.random.default_rng(1).uniform(START, STOP, 200)
KNOTS = [-0.2, 0.0, 0.3, 0.5, 1.1, 1.9]
VALUES = [0.001, 0.0, 0.004, 0.0055, 0.003, -0.006]
HALF, RADIUS = 0.024, 0.03


def level(fibres: tuple[Fibre, Fibre, Fibre]) -> ConstrainedKnee:
    """Equal spheres on one horizontal plane, their centres on the femur's z axis: for closed forms."""
    medial, lateral = (Condyle((0.0, 0.0, z), RADIUS, (0.0, -RADIUS, z), (0.0, 2.0, 0.0)) for z in (-HALF, HALF))
    return ConstrainedKnee(medial, lateral, fibres)


def taut(femur: Vector, tibia: Vector) -> Fibre:
    """A fibre that is as long as it is with both frames in one place."""
    return Fibre(femur, tibia, math.dist(femur, tibia))


AXIS = (
    taut((0.0, 0.0, 0.03), (0.03, -0.02, 0.03)),
    taut((0.0, 0.0, -0.03), (-0.03, -0.02, -0.02)),
    taut((0.0, 0.0, 0.0), (0.0, -0.02, 0.03)),
)
"""All fibres start from the axis through the spheres' centres."""

CRUCIATE = taut((-0.01, 0.004, 0.006), (0.015, -0.02, -0.005))
PIVOT = (
    taut((0.0, 0.0, HALF), (0.03, -0.02, HALF)),
    taut((0.0, 0.0, HALF), (0.004, -0.02, 0.06)),
    CRUCIATE,
)
"""Two fibres hold the centre of the lateral sphere; the third one turns the femur about it."""


def mechanisms() -> list[Mechanism]:
    knees = (SANCISI_2017, level(AXIS), level(PIVOT))
    return [Hinge(), Table(KNOTS, VALUES), Table([0.0, 1.0], [0.0, 0.01]), *(ParallelMechanism(k).table for k in knees)]


@pytest.mark.parametrize("mechanism", mechanisms())
def test_the_slope_is_the_derivative(mechanism: Mechanism) -> None:
    h = 1e-5  # error h² x''' / 6 with x''' < 1 m/rad³, and rounding 1e-17 m / h: 2e-11 m/rad at most
    for angle in ANGLES:
        difference = (mechanism.translation(angle + h)[0] - mechanism.translation(angle - h)[0]) / (2.0 * h)
        assert mechanism.translation(angle)[1] == pytest.approx(difference, abs=1e-10)


def test_mechanisms_by_name() -> None:
    assert set(MECHANISMS) == {"hinge", "ball_and_socket", "parallel_mechanism", "table"}
    assert MECHANISMS["ball_and_socket"]().translation(0.7) == (0.0, 0.0)
    assert MECHANISMS["table"]([0.0, 1.0], [0.0, 0.01]).translation(0.5)[0] == pytest.approx(0.005, rel=1e-15)


def test_a_table_passes_through_its_points() -> None:
    table = Table(KNOTS, VALUES)
    for angle, x in zip(KNOTS, VALUES, strict=True):
        assert table.translation(angle)[0] == pytest.approx(x, abs=1e-17)  # a rounding error of 0.006 m


@pytest.mark.parametrize("points", [2, 3, 4, 6])
def test_a_table_is_the_natural_spline(points: int) -> None:
    angles, x = KNOTS[:points], VALUES[:points]
    table, spline = Table(angles, x), CubicSpline(angles, x, bc_type="natural")
    for angle in np.linspace(angles[0], angles[-1], 101):
        # rounding errors of 0.006 m, and of slopes of 0.02 m/rad
        assert table.translation(angle)[0] == pytest.approx(float(spline(angle)), abs=1e-16)
        assert table.translation(angle)[1] == pytest.approx(float(spline(angle, 1)), abs=1e-15)


def test_a_table_goes_on_straight() -> None:
    table = Table(KNOTS, VALUES)
    for end, sign in ((KNOTS[0], -1.0), (KNOTS[-1], 1.0)):
        x, slope = table.translation(end)
        assert slope != 0.0
        for way in (1e-9, 0.5, 7.0):  # rounding errors of 0.2 m at most
            assert table.translation(end + sign * way) == pytest.approx((x + sign * way * slope, slope), abs=1e-15)


def test_a_table_bends_without_a_jump() -> None:
    table, h = Table(KNOTS, VALUES), 1e-6

    def bend(angle: float) -> float:
        return (table.translation(angle + h)[1] - table.translation(angle - h)[1]) / (2.0 * h)

    for knot in KNOTS:  # C2: the second derivative moves by x''' 4 h, with x''' < 1 m/rad³, and rounding 1e-17 / h
        assert bend(knot + 2.0 * h) == pytest.approx(bend(knot - 2.0 * h), abs=5e-6)
    assert max(abs(bend(knot)) for knot in KNOTS) > 0.01


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
def test_what_is_no_table_is_refused(angle: Sequence[float], x: Sequence[float], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Table(angle, x)


def test_the_equations_are_linearised_rightly() -> None:
    closure, h = Closure(SANCISI_2017), 1e-6
    pose = np.array([0.004, -0.003, 0.002, 0.2, 0.4])
    columns = [
        (
            closure.linearised(0.8, SpatialPose(*(pose + step)))[0]
            - closure.linearised(0.8, SpatialPose(*(pose - step)))[0]
        )
        / (2 * h)
        for step in h * np.eye(5)
    ]  # error h² / 6 times third derivatives below 100, and rounding 1e-17 / h
    assert closure.linearised(0.8, SpatialPose(*pose))[1] == pytest.approx(np.array(columns).T, abs=1e-9)


def placed(point: Vector, pose: SpatialPose, angle: float) -> np.ndarray:
    """A femoral point in the tibia frame, by SciPy's Euler angles instead of our matrix."""
    turn = Rotation.from_euler("YXZ", [-pose.internal_rotation, pose.abduction, angle])
    return np.asarray(turn.apply(point) + np.array([pose.x, pose.y, pose.z]))


@pytest.mark.parametrize("knee", [SANCISI_2017, level(AXIS), level(PIVOT)])
def test_the_parallel_mechanism_stays_closed(knee: ConstrainedKnee) -> None:
    mechanism = ParallelMechanism(knee)
    for angle in INSIDE:
        pose = mechanism.pose(angle)
        for condyle in (knee.medial, knee.lateral):
            normal = np.array(condyle.normal) / math.hypot(*condyle.normal)
            height = (placed(condyle.centre, pose, angle) - np.array(condyle.contact)) @ normal
            assert height == pytest.approx(condyle.radius, abs=1e-13)  # 1e-14 m in the solver, rounding here
        for fibre in knee.fibres:
            length = math.dist(placed(fibre.femur, pose, angle), fibre.tibia)
            assert length == pytest.approx(fibre.length, abs=1e-13)


def test_the_translation_is_that_of_the_medial_centre() -> None:
    mechanism = ParallelMechanism()
    centre = SANCISI_2017.medial.centre
    rest = placed(centre, mechanism.pose(0.0), 0.0)[0]
    assert mechanism.table.translation(0.0)[0] == pytest.approx(0.0, abs=1e-17)
    for angle in INSIDE:
        exact = placed(centre, mechanism.pose(angle), angle)[0] - rest
        # The spline is not bent at its ends, the mechanism is (x'' < 0.02 m/rad²): x'' h² / 8 = 1.6e-6 m there,
        # and 3.7 times less for each grid cell further in. Inside: x h⁴ / 384 with x < 5 m/rad⁴.
        cells = min(angle - START, STOP - angle) / 0.025
        assert mechanism.table.translation(angle)[0] == pytest.approx(
            exact, abs=5e-9 + 2e-6 * 0.27 ** math.floor(cells)
        )


PUBLISHED = {
    "medial sphere's centre": (0.2458, 3.4071, -23.2019),
    "medial plane's point": (-2.1344, -28.6241, -19.1308),
    "lateral sphere's centre": (-3.2853, 2.1225, 26.2054),
    "lateral plane's point": (-2.7946, -26.0861, 24.3679),
    "radii": (32.32, 28.34),
    "anterior cruciate, femur": (-6.7712, 7.5255, 9.1575),
    "anterior cruciate, tibia": (12.7709, -26.1454, -0.0617),
    "posterior cruciate, femur": (-2.6610, -1.0906, -2.1857),
    "posterior cruciate, tibia": (-25.8519, -38.1449, -3.5210),
    "medial collateral, femur": (2.7608, 5.7798, -47.6279),
    "medial collateral, tibia": (2.1345, -117.1068, -5.7872),
    "lengths": (40.53, 43.26, 129.70),
}
"""[mm] Sancisi, Gasparutto, Parenti-Castelli & Dumas 2017, doi:10.1007/s11012-016-0532-x"""


def test_the_default_knee_is_the_published_one() -> None:
    medial, lateral, fibres = SANCISI_2017
    ends = [end for fibre in fibres for end in (fibre.femur, fibre.tibia)]
    used = [medial.centre, medial.contact, lateral.centre, lateral.contact, (medial.radius, lateral.radius)]
    used += [*ends, tuple(fibre.length for fibre in fibres)]
    for (name, published), metres in zip(PUBLISHED.items(), used, strict=True):
        assert np.array(metres) * 1e3 == pytest.approx(published, rel=1e-14), name  # rounding of mm to m
    assert medial.normal == (0.0675, 0.9896, -0.1273)
    assert lateral.normal == (-0.0881, 0.9942, 0.0617)


def test_the_default_knees_translation_stays_what_it_was() -> None:
    mechanism = ParallelMechanism()
    x = [1e3 * mechanism.table.translation(math.radians(degrees))[0] for degrees in (0, 20, 40, 60, 80, 100)]
    # The published knee's own answer, written down in mm with two decimals
    assert x == pytest.approx([0.0, 2.33, 1.15, -1.50, -4.39, -6.94], abs=0.005)


def test_fibres_from_the_axis_make_a_hinge() -> None:
    mechanism = ParallelMechanism(level(AXIS))
    for angle in INSIDE:  # closed to 1e-14 m; the five equations are conditioned by 20 or so, and levers are 0.03 m
        assert mechanism.pose(angle) == pytest.approx((0.0, 0.0, 0.0, 0.0, 0.0), abs=1e-11)
        assert mechanism.table.translation(angle) == pytest.approx((0.0, 0.0), abs=1e-11)


def rotation_about_the_pivot(angle: float) -> float:
    """Internal rotation that keeps the third fibre's length when the lateral centre is fixed, by hand.

    With g the fibre's femoral end (flexed) and t its tibial one, both from the pivot:
    a cos i + b sin i = c with a = t_x g_x + t_z g_z, b = t_z g_x - t_x g_z, c = (g² + t² - length²) / 2 - t_y g_y.
    """
    (fx, fy, fz), (tx, ty, tz) = (np.array(end) - (0.0, 0.0, HALF) for end in CRUCIATE[:2])
    gx, gy, gz = math.cos(angle) * fx - math.sin(angle) * fy, math.sin(angle) * fx + math.cos(angle) * fy, fz
    a, b = tx * gx + tz * gz, tz * gx - tx * gz
    c = (gx**2 + gy**2 + gz**2 + tx**2 + ty**2 + tz**2 - CRUCIATE.length**2) / 2.0 - ty * gy
    ways = [math.atan2(b, a) + sign * math.acos(c / math.hypot(a, b)) for sign in (-1.0, 1.0)]
    return min(ways, key=abs)  # at full extension one way is 0


def test_a_pivot_has_a_closed_form() -> None:
    mechanism = ParallelMechanism(level(PIVOT), stop=1.2)
    inside = np.linspace(-0.2, 1.1, 66)  # away from the ends, where the table is not bent
    for angle in inside:
        rotation = rotation_about_the_pivot(angle)
        assert mechanism.pose(angle).internal_rotation == pytest.approx(rotation, abs=1e-11)
        assert mechanism.table.translation(angle)[0] == pytest.approx(2.0 * HALF * math.sin(rotation), abs=1e-7)
    assert abs(rotation_about_the_pivot(1.1)) > 0.1


@pytest.mark.parametrize("fibres", [AXIS, PIVOT])
def test_equal_spheres_on_one_plane_do_not_tilt(fibres: tuple[Fibre, Fibre, Fibre]) -> None:
    mechanism = ParallelMechanism(level(fibres))
    for angle in INSIDE:  # both heights are the same to 2e-14 m over 0.048 m
        assert mechanism.pose(angle).abduction == pytest.approx(0.0, abs=1e-12)
        assert mechanism.pose(angle).y == pytest.approx(0.0, abs=1e-13)


def test_the_default_knee_rolls_back_and_turns_inwards() -> None:
    mechanism = ParallelMechanism()
    poses = {degrees: mechanism.pose(math.radians(degrees)) for degrees in range(0, 91, 15)}
    turns = [pose.internal_rotation for pose in poses.values()]
    assert all(later > earlier for earlier, later in itertools.pairwise(turns))
    assert 10.0 < math.degrees(turns[-1] - turns[0]) < 25.0  # Wilson et al. 1998; Johal et al. 2005: 20 deg to 120 deg
    lateral = [placed(SANCISI_2017.lateral.centre, pose, math.radians(d))[0] for d, pose in poses.items()]
    medial = mechanism.table.translation(math.radians(90.0))[0]
    assert lateral[-1] - lateral[0] < 2.0 * medial < 0.0  # rollback, more of it on the lateral side


@pytest.mark.parametrize(
    ("knee", "reason"),
    [
        (level((*PIVOT[:2], CRUCIATE._replace(length=0.15))), "cannot be assembled at 0.0 deg"),
        (level((*AXIS[:2], AXIS[0])), "cannot be assembled"),  # one fibre twice leaves a second degree of freedom
        (level((*PIVOT[:2], CRUCIATE._replace(length=math.nan))), "not finite"),
        (level((*PIVOT[:2], CRUCIATE._replace(length=-0.03))), "must not be 0"),
        (SANCISI_2017._replace(medial=SANCISI_2017.medial._replace(normal=(0.0, 0.0, 0.0))), "must not be 0"),
    ],
)
def test_what_cannot_be_assembled_is_refused(knee: ConstrainedKnee, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        ParallelMechanism(knee)


def test_a_jump_to_another_way_of_assembling_is_refused() -> None:
    fibres = (  # near 21 deg of flexion this knee jams, and Newton's method finds one turned inwards by 60 deg more
        taut((-0.008, 0.004, 0.009), (0.015, -0.027, -0.002)),
        taut((0.003, -0.007, 0.003), (-0.025, -0.042, -0.005)),
        taut((-0.002, 0.009, -0.046), (-0.001, -0.123, -0.004)),
    )
    with pytest.raises(ValueError, match=r"jams before 22\.\d deg"):
        ParallelMechanism(SANCISI_2017._replace(fibres=fibres), start=-0.025, stop=0.41)


def test_a_range_beyond_the_jam_is_refused() -> None:
    with pytest.raises(ValueError, match=r"(jams before|assembled at) 1[01]\d\.\d deg"):
        ParallelMechanism(stop=2.1)
    with pytest.raises(ValueError, match="full extension"):
        ParallelMechanism(start=0.1)
    with pytest.raises(ValueError, match="outside"):
        ParallelMechanism().pose(STOP + 0.1)


def test_the_measured_table_is_the_sum_of_the_published_steps() -> None:
    path = ROOT / "config" / "translation_medial.csv"
    angle, x = np.loadtxt(path, delimiter=",", comments=["#", "flexion_angle"], unpack=True)
    assert np.degrees(angle) == pytest.approx(np.arange(0.0, 121.0, 30.0), abs=1e-6)  # 8 decimals of a radian
    assert np.diff(x) == pytest.approx([4.5e-3, 0.8e-3, -0.3e-3, -1.8e-3], abs=1e-15)
    assert x[0] == 0.0
    assert Table(angle, x).translation(math.radians(90.0))[0] == pytest.approx(5.0e-3, abs=1e-10)

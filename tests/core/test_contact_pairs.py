"""Femur on a curved tibia: exact cases, dense sampling, and the conditions of the common normal (Eq. 5)."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from knee_contact_ros.core.contact_pairs.base import Closest, pose_at
from knee_contact_ros.core.contact_pairs.certain import certain_contact
from knee_contact_ros.core.contact_pairs.on_curve import CurveContact
from knee_contact_ros.core.contact_pairs.profile_search import deepest_of, searched_contact
from knee_contact_ros.core.contact_pairs.tibial_circle import TibialCircle
from knee_contact_ros.core.contact_pairs.tibial_profile import TibialProfile
from knee_contact_ros.core.geometries import Circle, Profile
from tests.core.sampled import Sampled, curve, least_along, turn
from tests.core.surfaces import CUP, DEGENERATE, PLATEAU, TIBIAL_RADIUS, ellipse, noisy_femur, plateau, wavy
from tests.helpers.scenes import RADIUS

LAST_BITS = 1e-15
"""A few rounding errors of lengths below 0.2 m, in m"""
SAMPLING = 3e-9
"""Of the brute force below [m]: (3 um to the next sample)² x curvature (a few 100/m) / 2"""

angles = st.floats(-0.5, 2.2)
offsets = st.floats(-0.008, 0.008)
depths = st.floats(-0.01, 0.003)


def touching(pair: CurveContact, angle: float, x: float, depth: float) -> float:
    """Height at which the depth is `depth` [m], to 1e-9 m: the depth falls with the height everywhere, by n_y of it."""
    low, high, height = -0.2, 0.4, 0.03
    for _ in range(40):
        found = pair.closest(angle, x, height)
        deeper = found.depth - depth
        if abs(deeper) < 1e-9:
            break
        low, high = (height, high) if deeper > 0.0 else (low, height)
        height += deeper / found.normal_y
        if not low < height < high:
            height = 0.5 * (low + high)
    return height


PAIRS = {
    "circle in circle": CurveContact(Circle(RADIUS), CUP),
    "circle on profile": CurveContact(Circle(RADIUS), PLATEAU),
    "ellipse in circle": CurveContact(ellipse(80), CUP),
    "ellipse on profile": CurveContact(ellipse(80), PLATEAU),
    "noisy in circle": CurveContact(noisy_femur(5e-5), CUP),
    "noisy on profile": CurveContact(noisy_femur(5e-5), PLATEAU),
}
any_pair = pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)


@given(angle=angles, x=st.floats(-0.03, 0.03), height=st.floats(0.02, 0.09))
def test_circle_in_circle_is_exact(angle: float, x: float, height: float) -> None:
    found = PAIRS["circle in circle"].closest(angle, x, height)
    between = math.hypot(x, TIBIAL_RADIUS - height)
    assume(math.sqrt(0.75) * (TIBIAL_RADIUS - height) > 0.5 * abs(x))  # over the arc
    assert found.depth == pytest.approx(between + RADIUS - TIBIAL_RADIUS, abs=LAST_BITS)
    assert (found.extent, found.turning) == (RADIUS, 0.0)
    assert found.normal_x == pytest.approx(-x / between, abs=LAST_BITS)


def test_the_arc_goes_on_along_its_end_tangents() -> None:
    pair, side, up = PAIRS["circle in circle"], math.sqrt(0.75), 0.5
    end = TIBIAL_RADIUS * np.array([side, 1.0 - up])
    for along, across in itertools.product((0.0, 0.02, 3.0), (-0.005, 0.034, 0.2)):
        x, y = end + along * np.array([up, side]) + across * np.array([-side, up])
        for sign in (1.0, -1.0):
            found = pair.closest(0.3, sign * float(x), float(y))
            if x < 0.0:  # beyond the middle the other side is nearer
                assert found.depth > RADIUS - across
                continue
            assert found.depth == pytest.approx(RADIUS - across, abs=2e-15)  # rounding of 3 m
            assert found.normal_x == pytest.approx(-sign * side, abs=LAST_BITS)


def test_a_profile_goes_on_along_its_end_tangents() -> None:
    x, y = plateau()
    spline = CubicSpline(x, y)
    tibia = TibialProfile(x, y)
    for end, outward in ((x[0], -1.0), (x[-1], 1.0)):
        tangent = np.array([1.0, spline(end, 1)]) / math.hypot(1.0, spline(end, 1))
        for along, across in ((0.001, -0.0005), (0.02, 0.001), (2.0, 0.03)):
            normal = np.array([-tangent[1], tangent[0]])
            px, py = np.array([end, spline(end)]) + outward * along * tangent + across * normal
            assert tibia.foot(px, py).distance == pytest.approx(across, abs=2e-15)  # rounding of 2 m


def test_a_fine_profile_comes_close_to_the_circle_at_fourth_order() -> None:
    def largest_error(points: int) -> float:
        pair = CurveContact(ellipse(points, RADIUS, RADIUS), CUP)
        exact = PAIRS["circle in circle"]
        poses = [(angle, x, 0.034) for angle in np.linspace(-0.1, 1.9, 23) for x in (-0.004, 0.007)]
        return max(abs(pair.closest(*pose).depth - exact.closest(*pose).depth) for pose in poses)

    errors = [largest_error(points) for points in (40, 80, 160)]
    assert min(math.log2(coarse / fine) for coarse, fine in itertools.pairwise(errors)) > 3.7
    assert errors[-1] < 1e-9


def test_a_wide_cup_comes_close_to_the_plane() -> None:
    """The surface rises by x²/2R under the contact at x = -h', and the femur's own curvature adds less than that."""
    femur, height = ellipse(80), 0.0275
    for angle in np.linspace(0.0, 1.5, 9):
        h, slope = femur.support(angle)
        errors = []
        for radius in (1e2, 1e3, 1e4, 1e9):
            found = CurveContact(femur, TibialCircle(radius)).closest(angle, 0.002, height)
            errors.append(found.depth - (h - height))
            assert errors[-1] == pytest.approx((0.002 - slope) ** 2 / (2.0 * radius), abs=1e-6 / radius**2 + 2e-15)


@any_pair
@given(angle=angles, x=offsets, depth=depths)
@settings(max_examples=25, deadline=None)
def test_the_common_normal_and_the_envelope(pair: CurveContact, angle: float, x: float, depth: float) -> None:
    """Eq. 5, and the derivatives against central differences: 2nd order, curvature jumps where the place does."""
    height = touching(pair, angle, x, depth)
    found = pair.closest(angle, x, height)
    assert math.hypot(found.normal_x, found.normal_y) == pytest.approx(1.0, abs=LAST_BITS)
    tibial = found.point(x, height)
    assert pair.tibia.foot(*tibial).distance == pytest.approx(0.0, abs=LAST_BITS)
    assert pair.tibia.foot(*tibial).normal_x == pytest.approx(found.normal_x, abs=1e-12)  # curvature x rounding
    step = 1e-6
    pose = np.array([angle, x, height])
    around = [(pair.closest(*(pose - step * axis)), pair.closest(*(pose + step * axis))) for axis in np.eye(3)]
    # else the contact jumps from one bump to another
    assume(all(abs(before.turning - after.turning) < 1e-4 for before, after in around))
    differences = [(after.depth - before.depth) / (2.0 * step) for before, after in around]
    # Within a bump the slope changes by at most (1/m) x step over the step.
    assert differences[0] == pytest.approx(found.turning, abs=1e-4)
    assert differences[1] == pytest.approx(-found.normal_x, abs=2e-4)
    assert differences[2] == pytest.approx(-found.normal_y, abs=2e-4)


@pytest.mark.parametrize("name", ["ellipse in circle", "ellipse on profile", "noisy in circle", "noisy on profile"])
def test_the_femoral_tangent_is_parallel_to_the_tibia(name: str) -> None:
    """n x n' = 0, with the femoral tangent by a difference quotient over its own dense outline."""
    pair = PAIRS[name]
    outline = pair.femur.outline(2000)
    for angle in np.linspace(-0.1, 1.9, 13):
        found = pair.closest(angle, 0.001, touching(pair, angle, 0.001, 5e-4))
        r = -found.extent * np.array([found.normal_x, found.normal_y])
        r -= found.turning * np.array([found.normal_y, -found.normal_x])
        curve = turn(outline, angle)
        nearest = int(np.argmin(np.hypot(*(curve - r).T)))
        tangent = curve[nearest + 1] - curve[nearest - 1]
        tangent /= np.hypot(*tangent)
        # The nearest sample is up to 0.6 um away, times a curvature of up to 1000/m.
        assert abs(tangent @ (found.normal_x, found.normal_y)) < 1e-3


@pytest.mark.parametrize("noise", [0.0, 1e-5, 1e-4])
@given(angle=angles, x=offsets, depth=depths, seed=st.integers(0, 50))
@settings(max_examples=15, deadline=None)
def test_a_noisy_femur_in_a_cup_against_sampling(noise: float, angle: float, x: float, depth: float, seed: int) -> None:
    femur = noisy_femur(noise, seed=seed)
    pair = CurveContact(femur, CUP)
    height = touching(PAIRS["ellipse in circle"], angle, x, depth)
    sampled = Sampled.circle(TIBIAL_RADIUS).depth(femur, angle, x, height)
    assert pair.closest(angle, x, height).depth == pytest.approx(sampled, abs=SAMPLING)


@pytest.mark.parametrize(("femoral", "tibial"), [(0.0, 0.0), (1e-4, 0.0), (0.0, 2e-5), (5e-5, 2e-5)])
@given(angle=angles, x=offsets, depth=depths, seed=st.integers(0, 50))
@settings(max_examples=10, deadline=None)
def test_profiles_on_profiles_against_sampling(
    femoral: float, tibial: float, angle: float, x: float, depth: float, seed: int
) -> None:
    femur, points = noisy_femur(femoral, seed=seed), plateau(noise=tibial, seed=seed)
    pair = CurveContact(femur, TibialProfile(*points))
    height = touching(PAIRS["ellipse on profile"], angle, x, depth)
    sampled = Sampled.profile(*points).depth(femur, angle, x, height)
    assert pair.closest(angle, x, height).depth == pytest.approx(sampled, abs=2.0 * SAMPLING)  # noise is more curved


@pytest.mark.parametrize("noise", [0.0, 5e-5])
def test_the_nearest_place_of_a_plateau_against_sampling(noise: float) -> None:
    """High above it many places compete; a circle's centre is there."""
    points = plateau(noise=noise)
    tibia = TibialProfile(*points)
    rng = np.random.default_rng(5)
    places = np.stack([rng.uniform(-0.03, 0.03, 300), rng.uniform(0.02, 0.08, 300)], axis=1)
    found = [tibia.foot(*place).distance for place in places.tolist()]
    nearest, _ = Sampled.profile(*points).tree.query(places)
    assert found == pytest.approx(nearest, abs=SAMPLING)


def test_the_listed_segments_hold_the_deepest_point() -> None:
    """Against a search of all segments; steep places, where n_y differs the most."""
    rng = np.random.default_rng(6)
    for seed in range(6):
        pair = CurveContact(noisy_femur(1e-5, seed=seed), CUP)
        curve = pair.searched.curve
        every = np.array([(-math.inf, i) for i in range(len(curve.cubics) - 1)])
        for _ in range(60):
            angle, x = rng.uniform(-0.3, 1.5), rng.uniform(0.025, 0.04)
            height = touching(PAIRS["circle in circle"], angle, x, 0.0)
            found = searched_contact(curve, CUP, pose_at(angle, x), height)
            assert found.depth == deepest_of(every, curve, CUP, pose_at(angle, x), height).depth


@pytest.mark.parametrize("cup", [False, True])
@given(
    height=st.sampled_from([0.0, 1e-6, 1e-5, 1e-4, 3e-4]), waves=st.integers(2, 12), phase=st.floats(0.0, 6.3),
    pose=st.tuples(st.floats(-3.2, 3.2), st.floats(-0.03, 0.03), st.floats(-0.02, 0.008)), seed=st.integers(0, 10**6),
)  # fmt: skip
@settings(max_examples=30, deadline=None)
def test_what_is_certain_is_what_a_search_of_all_finds(
    cup: bool, height: float, waves: int, phase: float, pose: tuple[float, float, float], seed: int
) -> None:
    """To rounding, of 0.1 m and of the places, which the distance does not fix, times curvatures up to 1000/m."""
    femur, measured = wavy(60, height, waves, phase)
    pair = CurveContact(femur, CUP if cup else measured)
    # Many poses of a surface, which takes the time of a hundred of them to build
    others = np.random.default_rng(seed).uniform((-3.2, -0.03, -0.02), (3.2, 0.03, 0.008), (30, 3)).tolist()
    for angle, x, depth in (pose, *others):
        above = touching(PAIRS["circle in circle"], angle, x, depth)
        certain = certain_contact(pair.searched.curve, pair.tibia, pose_at(angle, x), above)
        if certain.proven:
            found = searched_contact(pair.searched.curve, pair.tibia, pose_at(angle, x), above)
            assert certain.contact.depth == pytest.approx(found.depth, abs=LAST_BITS)
            assert certain.contact.turning == pytest.approx(found.turning, abs=1e-11)
            assert certain.contact.normal_x == pytest.approx(found.normal_x, abs=1e-11)


def test_smooth_contacts_are_certain() -> None:
    rounder = ellipse(80, 0.030, 0.028)  # than the plateau is hollow
    for pair in (PAIRS["ellipse in circle"], CurveContact(rounder, PLATEAU)):
        for angle, x, depth in itertools.product((0.0, 0.6, 1.2), (-0.003, 0.0, 0.003), (-1e-3, 5e-4)):
            height = touching(pair, angle, x, depth)
            assert certain_contact(pair.searched.curve, pair.tibia, pose_at(angle, x), height).proven


def test_the_measured_surfaces_against_sampling(reference_data) -> None:
    def points(name: str) -> np.ndarray:
        path = reference_data / "geometry" / f"{name}.csv"
        return 1e-3 * np.loadtxt(path, delimiter=",", comments="#", skiprows=4, unpack=True)[:2]

    x, y = points("tibia_medial_profile")
    y = y - np.interp(0.0, x, y)
    tibia, brute = TibialProfile(x, y), Sampled.profile(x, y)
    for name in ("femur_medial_raw", "femur_medial_profile"):
        femur = Profile(*points(name))
        pair = CurveContact(femur, tibia)
        for angle, depth in itertools.product(np.radians(np.linspace(-10.0, 110.0, 9)), (-0.02, 5e-4, 5e-3)):
            height = touching(pair, angle, 0.002, depth)
            sampled = brute.depth(femur, angle, 0.002, height)
            assert pair.closest(angle, 0.002, height).depth == pytest.approx(sampled, abs=SAMPLING)


@any_pair
@given(angle=angles, x=offsets, depth=depths, moves=st.lists(st.floats(-3e-4, 3e-4), max_size=6))
@settings(max_examples=20, deadline=None)
def test_touch_gives_the_bits_of_closest(
    pair: CurveContact, angle: float, x: float, depth: float, moves: list[float]
) -> None:
    height = touching(pair, angle, x, depth)
    touch = pair.at(angle, 0.7, x, -0.2)
    for at in (height, *(height + move for move in moves), height):
        found = pair.closest(angle, x, at)
        rate = found.turning * 0.7 - found.normal_x * -0.2
        assert touch.touch(at) == (found.depth, rate, found.normal_y)


@pytest.mark.parametrize("tibia", [CUP, TibialProfile(np.linspace(-0.02, 0.02, 41), np.linspace(-0.06, 0.06, 41) ** 2)])
@pytest.mark.parametrize("femur", [Circle(RADIUS), ellipse(81)])
def test_mirrored_poses_give_mirrored_contacts(femur: Circle | Profile, tibia: TibialCircle | TibialProfile) -> None:
    """To the last bits of 0.1 m times the slopes of the places, which the distance does not fix."""
    pair = CurveContact(femur, tibia)
    for angle, x in itertools.product((0.0, 0.4), (0.0, 0.003)):
        one, other = pair.closest(angle, x, 0.0282), pair.closest(-angle, -x, 0.0282)
        assert one.depth == pytest.approx(other.depth, abs=LAST_BITS)
        assert one.turning == pytest.approx(-other.turning, abs=1e-13)
        assert one.normal_x == pytest.approx(-other.normal_x, abs=1e-13)


@any_pair
@pytest.mark.parametrize("height", [1.0, 30.0, 1e6, 0.01, -0.1, -1e6])
@pytest.mark.parametrize("angle", [-10.0, 0.0, 3.0, 10.0])
def test_far_away_and_deep_under_the_answer_is_finite(pair: CurveContact, height: float, angle: float) -> None:
    for x in (0.0, 0.05, -1e6):
        assert np.isfinite(pair.closest(angle, x, height)).all()


@pytest.mark.parametrize("height", [0.1, 1.0, 30.0])
def test_a_wide_gap_is_the_least_distance(height: float) -> None:
    femur, points = ellipse(80), plateau()
    pair, brute = CurveContact(femur, TibialProfile(*points)), Sampled.profile(*points)
    nearest = least_along(turn(curve(femur), 0.3) + np.array([0.001, height]), lambda some: brute.tree.query(some)[0])
    # (4 um between the samples)² x curvatures (below 200/m) / 8
    assert pair.closest(0.3, 0.001, height).depth == pytest.approx(-nearest, abs=5e-10)


@pytest.mark.parametrize("femur", DEGENERATE.values(), ids=DEGENERATE)
@pytest.mark.parametrize("tibia", DEGENERATE.values(), ids=DEGENERATE)
def test_odd_profiles_against_sampling(femur, tibia) -> None:
    x, y = tibia[0], np.array(tibia[1]) + 0.03
    pair = CurveContact(Profile(*femur), TibialProfile(x, y))
    different = np.unique(np.stack([x, y]), axis=1)
    brute = Sampled.profile(*different, reach=0.03, points=200001)
    for angle, height in itertools.product((-0.2, 0.0, 0.3), (0.032, 0.04)):
        sampled = brute.depth(pair.femur, angle, 0.001, height, 40000 // len(pair.femur.curve.cubics))
        depth = pair.closest(angle, 0.001, height).depth
        # On the zigzag's bumps (2e4/m) the nearest sample, 0.5 um aside, has a normal that is 1e-2 off: 5e-5 of 1 mm.
        assert sampled <= depth + 5e-8
        # Deep under a bump two nearest places compete and the depth has an edge, which samples 2 um apart miss.
        assert depth <= sampled + 1e-6


def test_a_profile_may_be_given_in_either_order() -> None:
    x, y = plateau()
    there, back = TibialProfile(x, y), TibialProfile(x[::-1], y[::-1])
    assert there.foot(0.004, 0.03) == back.foot(0.004, 0.03)


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        ([0.0, 1.0, 2.0], [0.0, 1.0, 0.0], "at least 4"),
        ([0.0, 0.0, 1.0, 2.0], [0.0, 0.0, 1.0, 0.0], "at least 4"),
        ([0.0, 1.0, math.inf, 3.0], [0.0, 1.0, 0.0, 1.0], "not finite"),
        ([0.0, 1.0, 2.0, 3.0], [0.0, math.nan, 0.0, 1.0], "not finite"),
        ([0.0, 2.0, 1.0, 3.0], [0.0, 1.0, 0.0, 1.0], "turn back"),
        ([0.0, 1.0, 1.0, 3.0], [0.0, 1.0, 2.0, 1.0], "turn back"),
    ],
)
def test_tibial_profiles_that_cannot_be_used_are_refused(x: list[float], y: list[float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        TibialProfile(x, y)


@pytest.mark.parametrize("radius", [0.0, -0.095, math.nan, math.inf])
def test_tibial_radii_that_cannot_be_used_are_refused(radius: float) -> None:
    with pytest.raises(ValueError, match="finite and > 0"):
        TibialCircle(radius)


@any_pair
def test_the_outline_lies_on_the_surface(pair: CurveContact) -> None:
    outline = pair.outline(0.15)
    measured = pair.tibia.outline(10.0)[[0, -1], 0] if isinstance(pair.tibia, TibialProfile) else (-10.0, 10.0)
    assert (outline[0, 0], outline[-1, 0]) == (max(-0.15, measured[0]), min(0.15, measured[1]))
    assert max(abs(pair.tibia.foot(*point).distance) for point in outline.tolist()) < LAST_BITS


def test_the_answer_is_a_closest() -> None:
    assert isinstance(PAIRS["noisy on profile"].closest(0.0, 0.0, 0.03), Closest)

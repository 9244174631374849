"""Contact pairs against brute force, exact cases, the conditions of the common normal (Eq. 5), and kinks.

`python -m tests.model.test_surfaces 1000 7` compares so many random poses of every pair, by a seed.
"""

import itertools
import math
import pickle
import sys
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from knee_contact_ros.model import compiler, surfaces
from knee_contact_ros.model.closest import closest, contact_point, next_kink, touch
from knee_contact_ros.model.mechanisms import hinge, parallel_mechanism
from knee_contact_ros.model.profiles import CELLS, Circle, Profile, lowest_point
from knee_contact_ros.model.surfaces import ContactPair, Cup, Plane, Plateau
from studies.ellipse import SmoothFemur
from tests import ROOT
from tests.model.brute_force import Femur, above_plane, deepest, in_cup, on_plateau

RADIUS, CUP_RADIUS, SLOPE = 0.034, 0.095, 0.07
MECHANISM = parallel_mechanism()


def measured(name, noise=0.0):
    points = np.loadtxt(
        ROOT / "config" / f"{name}.csv", delimiter=",", comments=["#", "x"], unpack=True
    )
    shaken = np.random.default_rng(len(name)).normal(size=points.shape) * noise
    return points + (shaken if name.startswith("femur") else shaken * [[0.0], [1.0]])


def ellipse(points, a=RADIUS, b=0.028):
    t = np.linspace(-np.pi - 0.9, 0.9, points)
    return Profile(a * np.cos(t), b * np.sin(t))


def two_bumps(lean=0.0, bump=0.01):
    x = np.linspace(-0.03, 0.03, 121)
    y = -0.03 + 200.0 * (x**2 - bump**2) ** 2 / bump
    return Profile(
        math.cos(lean) * x - math.sin(lean) * y, math.sin(lean) * x + math.cos(lean) * y
    )


def scenes():
    """Every pair with what the brute force needs."""
    found = {}
    for noise in (0.0, 5e-5):
        tibia = measured("tibia_medial", noise)
        tibiae = {
            "plane": (Plane(SLOPE), above_plane(SLOPE)),
            "cup": (Cup(CUP_RADIUS), in_cup(CUP_RADIUS)),
            "plateau": (Plateau(*tibia), on_plateau(*tibia)),
        }
        femora = {"circle": (Circle(RADIUS), Femur(np.array(RADIUS)))}
        for name in ("femur_medial", "femur_lateral"):
            points = measured(name, noise)
            femora[name] = Profile(*points), Femur(*points)
        for (femur, (one, brute)), (on, (other, distance)) in itertools.product(
            femora.items(), tibiae.items()
        ):
            label = f"{'noisy ' if noise else ''}{femur} {on}"
            found[label] = (ContactPair(one, other, MECHANISM), brute, distance)
    return found


SCENES = scenes()
any_pair = pytest.mark.parametrize("name", SCENES)


@cache
def compiled():
    made: Callable[..., tuple[float, ...]] = compiler.numba_functions(
        closest, no_cpython_wrapper=False
    )
    return made


def found_by(pair, angle, height):
    """The same as `pair.closest`, bit for bit as a test below shows, but sooner."""
    return compiled()(pair.surfaces, angle, pair.mechanism.translation(angle)[0], height)


def height_for(pair, angle, depth):
    low, high = -0.05, 0.2
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if found_by(pair, angle, middle).depth > depth else (low, middle)
        )
    return low


def poses(pair, number, seed=7):
    """Angle [rad], x [m] and height [m]: from 30 mm apart to 3 mm deep."""
    rng = np.random.default_rng(seed)
    depths = np.where(
        rng.random(number) < 0.6,
        rng.uniform(-0.003, 0.003, number),
        rng.uniform(-0.03, 0.003, number),
    )
    angles = rng.uniform(-0.3, 2.4, number).tolist()
    return [
        (angle, pair.mechanism.translation(angle)[0], height_for(pair, angle, depth))
        for angle, depth in zip(angles, depths.tolist(), strict=True)
    ]


def compared(name, some):
    """The largest error of the depth [m] in poses; the contact points are compared, too."""
    pair, femur, distance = SCENES[name]
    depths, feet = deepest(femur, distance, np.array(some))
    found = [found_by(pair, angle, height) for angle, _, height in some]
    for (_, x, height), one, depth, foot in zip(some, found, depths, feet, strict=True):
        point = np.array(contact_point(one, x, height))
        if math.dist(point, foot) > 1e-8:  # then both of two places are equally deep
            assert distance(point[None])[0] == pytest.approx(0.0, abs=1e-12)
            across = point + one.depth * -np.array([one.normal_x, one.normal_y])
            assert distance(across[None])[0] == pytest.approx(-depth, abs=1e-10)
    return float(np.abs([one.depth for one in found] - depths).max())


@any_pair
def test_depth_and_contact_point_against_brute_force(name):
    assert compared(name, poses(SCENES[name][0], 4 if "noisy" in name else 10)) < 1e-10


@pytest.mark.parametrize(
    ("name", "angle", "height"),
    [
        ("noisy circle plateau", 1.0133005125619086, 0.06331255827099086),
        ("noisy femur_medial plateau", 1.1558456428460924, 0.04867138136178256),
        ("noisy femur_medial plateau", 2.0241706222454496, 0.03643194381147624),
        ("noisy femur_medial plateau", 0.34920350119148574, 0.020540575077757244),
        ("noisy femur_medial plateau", 0.8552910554030468, 0.01995588843710721),
        ("noisy femur_medial plateau", 1.4761029555127767, 0.019069441640749578),
        ("noisy femur_lateral plateau", 1.3271049680061464, 0.0201357366520232),
    ],
)
def test_the_nearest_of_many_bumps_is_found(name, angle, height):
    """Poses that were wrong: feet too coarse, one foot to a femoral point, steps that led to another bump."""
    assert compared(name, [(angle, MECHANISM.translation(angle)[0], height)]) < 1e-10


def test_a_wrong_node_of_a_table_is_found():
    pair, _, _ = SCENES["femur_medial plane"]
    cells = pair.surfaces.cells
    kept = cells[:, 1].copy()
    cells[:, 1] *= 1.0 + 1e-3
    with pytest.raises(AssertionError):
        assert compared("femur_medial plane", poses(pair, 25)) < 1e-10
    cells[:, 1] = kept
    pair, _, _ = SCENES["noisy femur_medial cup"]
    kept = pair.surfaces.starts.copy()
    pair.surfaces.starts[:, 0] = (
        10.0  # the search walks downhill from anywhere, but not over bumps
    )
    with pytest.raises(AssertionError):
        assert compared("noisy femur_medial cup", poses(pair, 6)) < 1e-10
    pair.surfaces.starts[:] = kept


@any_pair
def test_touch_is_closest_and_its_derivatives(name):
    pair, _, _ = SCENES[name]
    tables, step = pickle.loads(pickle.dumps(pair)).surfaces, 1e-6  # noqa: S301
    for angle, _, height in poses(pair, 6, seed=3):
        found = closest(tables, angle, pair.mechanism.translation(angle)[0], height)
        assert math.hypot(found.normal_x, found.normal_y) == pytest.approx(1.0, abs=1e-15)
        _, x_slope = pair.mechanism.translation(angle)
        rate = found.turning * 0.7 - found.normal_x * (x_slope * 0.7)
        assert touch(tables, angle, 0.7, height) == pytest.approx(
            (found.depth, rate, found.normal_y), abs=1e-16
        )
        if "noisy" in name:
            continue  # the contact may leap
        around = [
            (angle + i * k, height + j * k) for i, j in ((1, 0), (0, 1)) for k in (-step, step)
        ]
        depths = np.reshape([pair.closest(*pose).depth for pose in around], (2, 2))
        slopes = [(after - before) / (2.0 * step) for before, after in depths]
        # Curvature jumps by less than 1/m x step
        assert slopes == pytest.approx([rate / 0.7, -found.normal_y], abs=2e-5)


def test_compiled_gives_the_same_bits():
    for pair, _, _ in SCENES.values():
        for angle, _, height in poses(pair, 5, seed=4):
            assert found_by(pair, angle, height) == pair.closest(angle, height)


@pytest.mark.parametrize("angle", [-10.0, 3.0])
@pytest.mark.parametrize("height", [30.0, 0.01, -0.1])
def test_odd_poses_have_finite_answers(angle, height):
    for name in (
        "circle cup",
        "circle plateau",
        "femur_medial plateau",
        "noisy femur_lateral cup",
    ):
        assert np.isfinite(SCENES[name][0].closest(angle, height)).all()


def test_splines_through_an_ellipse_converge_at_fourth_order():
    angles, (a, b) = np.radians(np.linspace(-10.0, 110.0, 97)).tolist(), (RADIUS, 0.028)

    def exact(angle):
        h = math.hypot(a * math.sin(angle), b * math.cos(angle))
        return h, (a * a - b * b) * math.sin(angle) * math.cos(angle) / h

    splines = [ellipse(n) for n in (40, 80, 160)]
    errors = [max(abs(spline.support(t)[0] - exact(t)[0]) for t in angles) for spline in splines]
    assert min(math.log2(coarse / fine) for coarse, fine in itertools.pairwise(errors)) > 3.7
    assert errors[-1] < 1e-9
    smooth, fine = ContactPair(SmoothFemur(closed_form=exact), Plane(), hinge()), ellipse(320)
    for angle in angles:
        found = smooth.closest(angle, 0.03)
        assert (found.extent, found.turning) == pytest.approx(exact(angle), abs=1e-15)
        assert fine.support(angle)[1] == pytest.approx(exact(angle)[1], abs=1e-8)
    with pytest.raises(ValueError, match="not smooth"):
        _ = ContactPair(
            SmoothFemur(closed_form=lambda t: (abs(math.sin(t)), math.cos(t))), Plane(), hinge()
        ).surfaces


def test_the_arc_goes_on_along_its_end_tangents():
    side, up = math.sqrt(0.75), 0.5
    end = CUP_RADIUS * np.array([side, 1.0 - up])
    for along, across in itertools.product((0.0, 0.02, 3.0), (-0.005, 0.034)):
        x, y = end + along * np.array([up, side]) + across * np.array([-side, up])
        found = ContactPair(Circle(RADIUS), Cup(CUP_RADIUS), hinge(float(x))).closest(
            0.3, float(y)
        )
        assert found.depth == pytest.approx(RADIUS - across, abs=2e-15)  # rounding of 3 m
        assert (found.normal_x, found.normal_y) == pytest.approx((-side, up), abs=1e-15)


@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-4])
def test_polynomials_are_the_support(noise):
    profile = Profile(*measured("femur_lateral", noise))
    pair, edges = (
        ContactPair(profile, Plane(), hinge()),
        np.arange(-10, CELLS + 10) * (math.tau / CELLS),
    )
    angles = np.concatenate(
        [edges, np.nextafter(edges, -9.0), np.nextafter(edges, 9.0), edges + 1e-3]
    )
    for angle in angles.tolist():
        h, slope, _ = lowest_point(*profile.on_plane[1:4], angle)
        found = pair.closest(angle, 0.03)
        assert found.extent == pytest.approx(h, abs=1e-16)
        if abs(found.turning - slope) > 3e-16:  # then the edge is a kink
            assert (
                np.abs(np.remainder(profile.on_plane.kinks - angle + 1.0, math.tau) - 1.0).min()
                < 1e-12
            )
    if noise == 0.0:
        assert np.isnan(profile.on_plane.cells[: CELLS // 4, 0]).mean() < 0.12


def kinks_between(pair, start, end):
    found = []
    while not math.isnan(start := next_kink(pair.surfaces, start, end)):
        found.append(start)
    return found


@pytest.mark.parametrize("lean", [-0.2, 0.0, 0.3])
def test_two_equal_bumps_change_places_where_they_are_level(lean):
    pair = ContactPair(two_bumps(lean), Plane(SLOPE), hinge())
    (kink,) = [one for one in kinks_between(pair, -0.6, 0.6) if abs(one - SLOPE + lean) < 0.1]
    assert kink == pytest.approx(SLOPE - lean, abs=1e-12)  # bisection to 1e-13, spline's rounding
    before, behind = (pair.closest(kink + side * 1e-9, 0.03).turning for side in (-1, 1))
    assert behind - before == pytest.approx(0.02, rel=1e-6)
    assert kinks_between(pair, 0.6, -0.6) == kinks_between(pair, -0.6, 0.6)[::-1]
    assert any(
        abs(one - kink - math.tau) < 1e-9 for one in kinks_between(pair, 5.5, 7.0)
    )  # a whole turn on
    assert any(abs(one - kink + math.tau) < 1e-9 for one in kinks_between(pair, -5.5, -7.0))


def test_figures_that_the_solver_reads():
    for name, (pair, _, _) in SCENES.items():
        tables = pair.surfaces
        assert tables.non_convex == float(
            "noisy" in name and "plane" not in name and name != "noisy circle cup"
        )
        assert tables.largest_radius >= np.hypot(*pair.femur.outline().T).max() * (1.0 - 1e-12)
        assert math.isinf(tables.knot_spacing) == ("circle" in name)
        assert tables.concave >= 0.0
    assert ContactPair(
        ellipse(80, RADIUS, RADIUS), Plane(), hinge()
    ).femoral_radius == pytest.approx(RADIUS, rel=1e-5)
    assert math.isinf(
        ContactPair(Profile([0, 1, 2, 3], [0, 0, 0, 0]), Plane(), hinge()).femoral_radius
    )


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: Profile([0.0, 1.0, 2.0], [0.0, 1.0, 0.0]), "at least 4"),
        (lambda: Profile(np.zeros(5), np.ones(5)), "at least 4"),
        (lambda: Profile([0.0, 1.0, math.nan, 3.0], [0.0, 1.0, 0.0, 1.0]), "not finite"),
        (lambda: Plateau([0.0, 0.0, 1.0, 2.0], [0.0, 0.0, 1.0, 0.0]), "at least 4"),
        (lambda: Plateau([0.0, 1.0, 2.0, 3.0], [0.0, math.nan, 0.0, 1.0]), "not finite"),
        (lambda: Plateau([0.0, 2.0, 1.0, 3.0], [0.0, 1.0, 0.0, 1.0]), "turn back"),
        *(
            (lambda radius=radius: Cup(radius), "finite and > 0")
            for radius in (0.0, -0.095, math.nan, math.inf)
        ),
    ],
)
def test_surfaces_that_cannot_be_used_are_refused(made, words):
    with pytest.raises(ValueError, match=words):
        made()


def test_points_may_repeat_and_come_in_either_order():
    x, y = measured("tibia_medial")
    backwards = x[::-1].repeat(2), y[::-1].repeat(2)
    there, back = (
        ContactPair(Circle(RADIUS), Plateau(*points), hinge()) for points in ((x, y), backwards)
    )
    assert there.closest(0.4, 0.035) == back.closest(0.4, 0.035)
    assert surfaces.TIBIAL_GEOMETRIES["profile"] is Plateau
    outline = there.tibia.outline(0.15)
    assert (outline[0, 0], outline[-1, 0]) == (x[0], x[-1])


if __name__ == "__main__":
    count, chosen = map(int, sys.argv[1:3])
    for label in sys.argv[3:] or SCENES:
        print(  # noqa: T201
            f"{label}: {compared(label, poses(SCENES[label][0], count, chosen)):.1e} m", flush=True
        )

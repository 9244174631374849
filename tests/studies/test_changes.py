"""What judges live changes and measured condyles: the reference goes on, and the noisy curve is as brute force says."""

import numpy as np
import pytest

pytest.importorskip("tabulate", reason="the studies' tables")

from studies.honesty.changes import (
    SEGMENTS,
    TICKS,
    WHAT,
    ChangedReference,
    place,
    plan,
    rows,
    truth_of,
)
from studies.honesty.dented import condyle, leaps, lowest, solve
from studies.honesty.measured import draw
from studies.honesty.truth import knee_of
from studies.reference import LAWS, Reference
from studies.reference import solve as solve_ellipse

SEED = 3
TWO_LAYERS = {"layer_depth": 3e-4, "stiffness_2": 7.9e7, "damp_first_layer": True}
"""Second layer that begins under the load of the scene below"""


def test_a_change_to_the_same_knee_is_none():
    scene = plan(SEED)[0].scene
    whole = solve_ellipse(knee_of(scene), scene.time, scene.angle, scene.load)
    going = ChangedReference(knee_of(scene))
    for now in range(SEGMENTS):
        going.go_on_with(knee_of(scene))
        part = going.take(scene.time[place(now)], scene.angle[place(now)], scene.load[place(now)])
        assert part.depth.tobytes() == whole.depth[place(now)].tobytes()


def test_a_contact_comes_to_rest_where_the_new_law_carries_the_load():
    """At rest under 1 kN: K δⁿ in one layer, then in two, of which the second one begins above that depth, and back."""
    time, still, load = np.arange(3 * TICKS) * 0.05, np.full(TICKS, 0.3), np.full(TICKS, 1000.0)
    spring = {"stiffness": 7.9e7, "exponent": 1.5, "damping": 5000.0}
    one, two = (
        LAWS["kelvin_voigt"](**spring),
        LAWS["two_layer_viscoelastic"](**spring, **TWO_LAYERS),
    )
    first = plan(SEED)[0].scene._replace(
        mass=9.3, half_axes=(0.034, 0.034), slope=0.0, allow_tension=False
    )
    knee, depth = knee_of(first), (1000.0 / 7.9e7) ** (2.0 / 3.0)
    deeper = 3e-4 + (1000.0 / 7.9e7 - 3e-4**1.5) ** (2.0 / 3.0)
    going = ChangedReference(knee._replace(law=one))
    for now, (law, expected) in enumerate(((one, depth), (two, deeper), (one, depth))):
        going.go_on_with(knee._replace(law=law))
        found = going.take(time[place(now)], still, load)
        assert found.depth[-1] == pytest.approx(expected, rel=1e-12)


def test_plans_come_again_and_have_all_changes():
    again = [[one._replace(scene=one.scene.content()) for one in plan(seed)] for seed in (1, 1)]
    assert again[0] == again[1]
    assert {one.what for seed in range(20) for one in plan(seed)} == {"", *WHAT}
    assert all(np.isfinite(part.depth).any() for part in truth_of(plan(SEED)))


def test_the_model_is_right_or_says_so_through_a_plan():
    found = list(rows(SEED))
    assert len(found) == 2 * SEGMENTS
    assert not any(one.wrong or one.not_finite for one in found)


def test_the_lowest_point_and_its_leaps_are_those_of_a_dense_row():
    scene = draw(3)
    femur = condyle(scene.points)
    assert scene.dents > 0.0
    place = np.linspace(0.0, femur.begins[-1], 200_001)
    i = np.clip(np.searchsorted(femur.begins, place, side="right") - 1, 0, len(femur.x) - 1)
    powers = (place - femur.begins[i])[:, None] ** np.arange(4)
    x, y = (femur.x[i] * powers).sum(axis=1), (femur.y[i] * powers).sum(axis=1)
    found = leaps(femur, 0.2, 0.5)
    assert found
    for angle in [
        *np.linspace(0.2, 0.5, 7),
        *(leap + side for leap in found for side in (-1e-6, 1e-6)),
    ]:
        row = np.sin(angle) * x + np.cos(angle) * y
        height, _, at = lowest(femur, float(angle))
        # The row is 0.4 µm apart, where the curve bends by some 1e3 /m.
        assert 0.0 <= row.min() - height < 1e-10
        assert abs(at - place[row.argmin()]) < 1e-5


def test_both_references_agree_on_a_circle():
    turn = np.linspace(-2.8, -0.3, 400)
    femur = condyle(0.034 * np.stack([np.cos(turn), np.sin(turn)]))
    scene = draw(7)
    law = LAWS["hunt_crossley"](
        stiffness=7.9e7, exponent=1.5, restitution=0.5, least_impact_speed=0.1
    )
    time, angle, load = scene.time[:16], 0.3 + 0.3 * np.sin(5.0 * scene.time[:16]), scene.load[:16]
    load[6:10] = -300.0
    knee = knee_of(plan(SEED)[0].scene)._replace(
        law=law, mass=9.3, half_axes=(0.034, 0.034), slope=0.0, allow_tension=False
    )
    found, other = (
        solve(femur, law, 9.3, time, angle, load),
        Reference(knee).take(time, angle, load),
    )
    assert np.isfinite(other.depth).all()
    assert (found.depth < 0.0).any()
    # The spline through 400 points is 1e-11 m off the circle; its slope turns a smooth femur by 1e-9 m/rad.
    assert np.abs(found.depth - other.depth).max() < 1e-9

"""The quasi-static level on surfaces, spikes and rates of all kinds, beside the motion that it leaves out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("tabulate", reason="the studies' tables")

from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.model.profiles import Circle, Profile
from knee_contact_ros.model.surfaces import ContactPair, Cup, Plane
from knee_contact_ros.model.ticks import QUASI_STATIC
from knee_contact_ros.model.types import Status
from studies.choosing.surfaces import read_points
from studies.honesty.judging import judge
from studies.honesty.ours import model as answers_of
from studies.honesty.scenes import ARTHRITIC, FEMUR, HEALTHY, Scene, shipped
from studies.honesty.truth import reference
from tests.helpers.needs import needs_compiler
from tests.model.scenes import FORWARDS, HINGE, TO_AND_FRO, plateau

pytestmark = [
    needs_compiler,
    pytest.mark.filterwarnings("ignore:the (knee turns|samples are|flexion)"),
]
"""These motions are faster than any knee's, and some are sampled more slowly"""
CONFIG = Path(__file__).parents[2] / "config"
RATES = (5.0, 7.0, 10.0, 20.0, 50.0, 100.0, 200.0)
"""[Hz]"""
SCENES, TICKS, PARTS = 40, 50, 16
ROUNDING = 1e-9
"""[m]: what the finely cut run may be off, at its tolerance of 1e-8 m"""


def femur(random):
    """A circle, a measured condyle, or one with dents."""
    name = random.choice(["", "femur_medial.csv", "femur_lateral.csv"], p=[0.2, 0.4, 0.4])
    if not name:
        return Circle(0.034)
    points = read_points(CONFIG / str(name))
    return Profile(
        *(points + random.normal(0.0, 1.0, points.shape) * random.choice([0.0, 1e-5, 5e-5]))
    )


def motion(random):
    """Times, angles and loads of a knee that swings or steps, with spikes."""
    rate = random.choice(RATES)
    time = np.rint(np.arange(TICKS) / rate * 1e9) * 1e-9
    angle = 0.7 + random.uniform(0.1, 0.8) * np.sin(2.0 * np.pi * random.uniform(0.3, 1.0) * time)
    if random.random() < 0.5:
        angle = random.uniform(0.0, 1.5) + np.cumsum(
            (random.random(TICKS) < 0.2) * random.normal(0.0, 0.3, TICKS)
        )
    spikes = (random.random(TICKS) < 0.1) * random.uniform(-0.9, 0.9, TICKS)
    load = np.full(TICKS, 10.0 ** random.uniform(2.0, 3.4)) + random.choice(
        [0.0, 10.0]
    ) * random.standard_normal(TICKS)
    return time, np.clip(angle, -0.1, 2.0) + spikes, load


def test_what_is_left_out_is_covered():
    random, known, covered = np.random.default_rng(91), 0, 0
    for _ in range(SCENES):
        tibia = (Plane(), Plane(-0.1), Cup(0.095), plateau())[random.integers(4)]
        law, constants = shipped(str(random.choice([HEALTHY, ARTHRITIC])))
        pair = ContactPair(femur(random), tibia, (HINGE, FORWARDS, TO_AND_FRO)[random.integers(3)])
        model = KneeModel(
            pair, CONTACT_LAWS[law](**constants), FEMUR, 1e-8, budget=20_000, compiled=True
        )
        samples = motion(random)
        fine = [
            np.interp(np.arange(PARTS * (TICKS - 1) + 1) / PARTS, np.arange(TICKS), one)
            for one in samples
        ]
        best = model.run(np.rint(1e9 * fine[0]) * 1e-9, *fine[1:])[::PARTS]
        for tolerance in (1e-4, 1e-5, 1e-6):
            series = replace(model, level=QUASI_STATIC, tolerance=tolerance).run(*samples)
            error = np.abs(
                series.penetration_depth - series.gap - best.penetration_depth + best.gap
            )
            right = best.status & Status.NOT_CONVERGED == 0
            said = series.status & Status.NOT_CONVERGED == 0
            assert not (right & said & (error > tolerance + 1e-8)).any()
            known += right.sum()
            covered += (
                right & (error <= series.error_estimate + best.error_estimate + ROUNDING)
            ).sum()
    assert covered >= 0.999 * known  # what the studies ask for


def test_a_circle_is_covered_as_a_reference_that_shares_no_code_has_it():
    random, known, covered = np.random.default_rng(92), 0, 0
    for number in range(24):
        family, slope = (HEALTHY, ARTHRITIC)[number % 2], (0.0, -0.1)[number // 2 % 2]
        law, constants = shipped(family)
        scene = Scene(
            number, "", law, constants, FEMUR, (0.034, 0.034), slope, False, "", *motion(random)
        )
        for tolerance in (1e-4, 1e-6):
            series = answers_of(scene, "quasi_static", tolerance)
            depth = judge(series, reference(scene), tolerance).depth
            assert not depth.wrong.any()
            known += depth.known.sum()
            covered += depth.covered[depth.known].sum()
    assert covered >= 0.999 * known > 0.0

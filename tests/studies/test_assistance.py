"""The study of assistance: what a torque takes off the load, where the companion gives way, and the page."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("tabulate", reason="the studies' tables")
pytest.importorskip("rclpy", reason="the companion's law is in its node")

import knee_contact_ros
from knee_contact_ros.commands.demo import LOAD_FILE
from knee_contact_ros.joint_reaction.estimator import LEVELS
from knee_contact_ros.joint_reaction.muscles import QUADRICEPS, arm
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import LoadParameters
from studies.assistance.__main__ import TABLE, TORQUES, cells
from studies.assistance.walks import FORCE_LIMIT, LAWS, Sample, constant_in_stance, person, sensors, walk
from tests import ROOT


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    return sensors()


def test_a_torque_takes_off_the_load_what_it_takes_off_the_extensors(samples: list[Sample]) -> None:
    at_once = {"person.electromechanical_delay": 0.0}
    parameters = load_parameters([LOAD_FILE, at_once], LoadParameters)
    model = knee_contact_ros.load_model("healthy")
    alone, assisted = (walk(samples, constant_in_stance(torque), model, parameters) for torque in (0.0, 10.0))
    at = int(alone.axial.argmax())
    quadriceps = parameters.person.moment_arm_scale * arm(QUADRICEPS, samples[at].flexion)
    assert alone.axial[at] - assisted.axial[at] == pytest.approx(10.0 / quadriceps, rel=1e-9)
    swing = np.array([sample.vertical for sample in samples]) == 0.0
    assert np.array_equal(alone.axial[swing], assisted.axial[swing])
    for peaks in (alone.peaks, assisted.peaks):
        assert peaks.force[0] < peaks.force[1] < peaks.force[2]
        assert peaks.depth[0] < peaks.depth[1] < peaks.depth[2]
    level = LEVELS[parameters.chosen_level].uncalibrated
    deviation = level.at(alone.axial[at], parameters.person.constants.weight)
    assert alone.peaks.force[2] - alone.peaks.force[1] == pytest.approx(0.5 * deviation, abs=1.0)  # the femur's inertia


def test_the_companion_gives_way_where_the_contact_is_large(samples: list[Sample]) -> None:
    found = walk(samples, LAWS["companion's law"](20.0), knee_contact_ros.load_model("healthy"), person())
    above = found.force[:-1] > FORCE_LIMIT
    assert above.any()
    assert (np.diff(found.torque)[above] <= 0.0).all()
    assert found.torque[int(found.force.argmax())] == 0.0
    assert found.torque.max() > 10.0


def test_the_page_has_these_numbers(samples: list[Sample]) -> None:
    page, model = (
        (ROOT / "docs" / "studies" / "assistance.md").read_text(encoding="utf-8"),
        knee_contact_ros.load_model("healthy"),
    )
    for torque in (TORQUES[place] for place in TABLE):
        told = " | ".join(cells(walk(samples, law(torque), model, person())) for law in LAWS.values())
        assert f"| {torque:g} | {told} |" in page

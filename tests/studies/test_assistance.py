"""The study of assistance: what a torque takes off the load, where the companion gives way, and the page."""

import pytest

pytest.importorskip("tabulate", reason="the studies' tables")
pytest.importorskip("rclpy", reason="the companion's law is in its node")

import knee_contact_ros
from studies.assistance.__main__ import TABLE, TORQUES, cells
from studies.assistance.walks import LAWS, person, sensors, walk
from tests import ROOT


@pytest.fixture(scope="module")
def samples():
    return sensors()


def test_the_page_has_these_numbers(samples):
    page, model = (
        (ROOT / "docs" / "studies" / "assistance.md").read_text(encoding="utf-8"),
        knee_contact_ros.load_model("healthy"),
    )
    for torque in (TORQUES[place] for place in TABLE):
        told = " | ".join(
            cells(walk(samples, law(torque), model, person())) for law in LAWS.values()
        )
        assert f"| {torque:g} | {told} |" in page

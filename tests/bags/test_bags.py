"""The shipped bags: what is in them, and that they can be made again to the byte."""

import csv
import runpy
import sys
from decimal import Decimal

import pytest

from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.bags.bag import INPUT_TYPES
from knee_contact_ros.streams.topics import stamp_to_ns
from knee_contact_ros.system.files import share_folder
from tests import ROOT

SIDES = ("right", "left")


@pytest.mark.parametrize("side", SIDES)
def test_bags_hold_the_tables_numbers(reference_data, side):
    with (reference_data / "gait" / f"gait2354_{side}.csv").open() as lines:
        rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    messages = read_bag(share_folder() / "bags" / f"gait2354_{side}", INPUT_TYPES)
    angles = [m.message for m in messages if m.topic == "/joint_states"]
    forces = [m.message for m in messages if m.topic == "/joint_reaction_force"]
    for row, angle, force in zip(rows, angles, forces, strict=True):
        assert stamp_to_ns(angle.header.stamp) == Decimal(row["t"]) * 10**9
        assert (angle.name, angle.position[0]) == (["knee"], float(row["knee_angle"]))
        assert force.wrench.force.y == float(row["Fy"])
        assert force.wrench.torque.x == float(row["Mx"])


def test_bags_can_be_made_again(reference_data, tmp_path, monkeypatch):
    script = ROOT / "scripts" / "make_gait_bags.py"
    monkeypatch.setattr(sys, "argv", [str(script), str(reference_data / "gait"), str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(script), run_name="__main__")
    assert ended.value.code == 0
    for name in ("gait2354_right", "gait2354_left", "gait2354_right_sensors"):
        for shipped in (share_folder() / "bags" / name).iterdir():
            assert (tmp_path / name / shipped.name).read_bytes() == shipped.read_bytes()

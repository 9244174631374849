"""Columns are found by their names in files of all tools and models, or asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.lab.opensim.results import angle_column, find_reaction, speed_column
from knee_contact_ros.lab.tables import Storage
from knee_contact_ros.system.errors import UsageError

COMPONENTS = ("fx", "fy", "fz", "mx", "my", "mz")


def storage(*names: str) -> Storage:
    return Storage(Path("f.sto"), names, np.array([0]), np.zeros((1, len(names))), None, 0)


def reaction(*prefixes: str) -> Storage:
    return storage(*(f"{prefix}_{axis}" for prefix in prefixes for axis in COMPONENTS))


@pytest.mark.parametrize(
    "name", ["knee_angle_r", "knee_flexion_r", "knee_flex_r", "knee_r", "KNEE_ANGLE_R", "r_knee_flexion",
             "right_knee_angle", "/jointset/knee_r/knee_angle_r/value", "knee_r/knee_angle_r/value"],
)  # fmt: skip
def test_a_knees_angle_is_found(name: str) -> None:
    others = (
        "hip_flexion_r",
        "knee_angle_r_beta",
        "knee_adduction_r",
        "knee_angle_l",
        "/jointset/knee_r/knee_angle_r/speed",
    )
    assert angle_column(storage(*others, name), "right", None) == name


def test_what_is_not_found_or_not_unique_is_asked_for() -> None:
    with pytest.raises(UsageError, match=r"no angle of the left knee, but knee_angle_r, hip.*--coordinate"):
        angle_column(storage("knee_angle_r", "hip"), "left", None)
    with pytest.raises(UsageError, match="has knee_angle_r, knee_flexion_r; choose one with --coordinate"):
        angle_column(storage("knee_angle_r", "knee_flexion_r"), "right", None)
    assert angle_column(storage("/jointset/k/kfr/value", "x"), "right", "kfr") == "/jointset/k/kfr/value"
    with pytest.raises(UsageError, match=r"no column kfl \(--coordinate\); it has x"):
        angle_column(storage("x"), "right", "kfl")


def test_a_rate_stands_beside_its_angle() -> None:
    value, speed = "/jointset/knee_r/knee_angle_r/value", "/jointset/knee_r/knee_angle_r/speed"
    assert speed_column((value, speed), value) == speed
    assert speed_column(("hip", "knee_angle_r"), value) == "knee_angle_r"
    assert speed_column(("hip", "knee_angle_r"), "knee_angle_r") == "knee_angle_r"
    assert speed_column((value, speed), "knee_angle_r") == speed
    assert speed_column(("hip",), "knee_angle_r") is None


@pytest.mark.parametrize(
    "prefix", ["knee_r_on_tibia_r_in_tibia_r", "walker_knee_r_on_tibia_r_in_tibia_r",
               "knee_r_on_tibia_proximal_r_in_tibia_proximal_r"],
)  # fmt: skip
def test_the_knees_reaction_on_the_tibia_is_found(prefix: str) -> None:
    others = (
        "hip_r_on_femur_r_in_femur_r",
        "patellofemoral_r_on_patella_r_in_patella_r",
        "knee_l_on_tibia_l_in_tibia_l",
    )
    found = find_reaction(reaction(*others, prefix), "right", None)
    assert found.prefix == f"{prefix}_"
    assert found.on_tibia


def test_that_on_the_tibia_is_preferred_to_that_on_the_femur() -> None:
    both = reaction("knee_r_on_femur_r_in_tibia_r", "knee_r_on_tibia_r_in_tibia_r")
    assert find_reaction(both, "right", None).body == "tibia_r"
    assert find_reaction(reaction("knee_r_on_femur_r_in_tibia_r"), "right", None).on_femur


@pytest.mark.parametrize(
    ("prefix", "says"),
    [
        ("knee_r_on_tibia_r_in_ground", "on tibia_r is expressed in ground, .*express_in_frame child"),
        ("knee_r_on_tibia_r_in_femur_r", "expressed in femur_r"),
        ("knee_r_on_femur_r_in_femur_r", "on femur_r is expressed in femur_r, .*apply_on_bodies child"),
        ("knee_r_on_femur_r_in_tibia_r_offset", "expressed in tibia_r_offset"),
        ("knee_r_on_patella_r_in_patella_r", "acts on patella_r, and must on the tibia"),
        ("hip_r_on_femur_r_in_femur_r", "no joint of the right knee among hip_r; .*--joint"),
    ],
)
def test_other_frames_and_bodies_are_refused_with_what_to_set(prefix: str, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        find_reaction(reaction(prefix), "right", None)


def test_joints_by_name() -> None:
    file = reaction("k1_on_tibia_r_in_tibia_r", "knee_r_on_tibia_r_in_tibia_r", "old_knee_r_on_tibia_r_in_tibia_r")
    assert find_reaction(file, "right", "k1").joint == "k1"
    with pytest.raises(UsageError, match=r"no joint k2 \(--joint\); it has k1, knee_r, old_knee_r"):
        find_reaction(file, "right", "k2")
    with pytest.raises(UsageError, match=r"2 joints of the right knee .*--joint"):
        find_reaction(file, "right", None)


def test_missing_components_are_named() -> None:
    with pytest.raises(UsageError, match=r"no column knee_r_on_tibia_r_in_tibia_r_fy, .*_mz"):
        find_reaction(
            storage(*(f"knee_r_on_tibia_r_in_tibia_r_{axis}" for axis in ("fx", "fz", "mx", "my"))), "right", None
        )
    with pytest.raises(UsageError, match="no reaction <joint>_on_<body>_in_<frame>_fx"):
        find_reaction(storage("knee_angle_r"), "right", None)

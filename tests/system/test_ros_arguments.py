"""`-p NAME:=VALUE` offline: read and checked like a parameter file."""

from __future__ import annotations

from pathlib import Path

import pytest

from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.ros_files import parameters_of
from knee_contact_ros.system.errors import UsageError


def test_values_have_the_types_of_a_parameter_file(config: Path) -> None:
    rules = ["knee.joint_name:=knee_r", "contact.damping:=100", "contact.allow_tension:=true", "rerun.mode:=off"]
    parameters = load_parameters([config / "osteoarthritis.yaml", parameters_of(rules)])
    assert parameters.knee.joint_name == "knee_r"
    assert parameters.contact.damping == 100.0
    assert parameters.contact.allow_tension
    assert parameters.contact.law == load_parameters(config / "osteoarthritis.yaml").contact.law  # the file's
    assert parameters_of(["knee.joint_name:='5'"]) == {"knee.joint_name": "5"}


@pytest.mark.parametrize(
    ("rule", "words"),
    [
        ("knee.joint_name", "-p 'knee.joint_name': it must be NAME:=VALUE"),
        ("knee.joint_nam:=x", "unknown parameter knee.joint_nam; did you mean knee.joint_name?"),
        ("load.share:=2.0", "parameter load.share: 2.0 is not allowed"),
        ("knee.joint_name:=5", "parameter knee.joint_name: 5 is not allowed"),
        ("femur.profile:=[a", "the value is not YAML"),
    ],
)
def test_a_wrong_value_is_told_in_one_line(rule: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        load_parameters([parameters_of([rule])])
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)

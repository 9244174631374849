"""Parameters of the load node: the level that the inputs allow, its files, and what is refused in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from knee_contact_ros.joint_reaction.estimator import LEVELS
from knee_contact_ros.parameters.files import check_file, load_parameters
from knee_contact_ros.parameters.schema import LoadParameters, Parameters, allowed_levels
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import shipped_parameter_files

HIP, ANKLE = {"hip.joint_name": "hip"}, {"ankle.joint_name": "ankle"}
FULL, ON_FOOT = {"ground.components": "full"}, {"ground.axes": "foot"}


def load(values: Any) -> LoadParameters:
    return load_parameters(values, LoadParameters)


@pytest.mark.parametrize(
    ("inputs", "allowed"),
    [
        ({}, 1),
        (FULL, 1),
        (HIP | ANKLE, 1),
        (FULL | HIP, 2),
        (FULL | ANKLE, 1),  # where the shank stands in upright axes, only the hip tells
        (FULL | HIP | ANKLE, 3),
        (FULL | ON_FOOT | HIP, 1),  # where the foot stands, only the ankle tells
        (FULL | ON_FOOT | ANKLE, 3),
        (FULL | ON_FOOT | HIP | ANKLE, 3),
    ],
)
def test_inputs_allow_levels_and_auto_is_the_last_of_them(inputs: dict[str, Any], allowed: int) -> None:
    parameters = load(inputs)
    assert allowed_levels(parameters) == list(LEVELS)[:allowed]
    assert parameters.chosen_level == list(LEVELS)[allowed - 1]
    for number, level in enumerate(LEVELS):
        if number < allowed:
            assert load(inputs | {"level": level}).chosen_level == level
            continue
        with pytest.raises(UsageError, match=f"^parameter level: '{level}' is not allowed; it needs ground") as caught:
            load(inputs | {"level": level})
        assert str(caught.value).endswith(f"These inputs allow {', '.join(list(LEVELS)[:allowed])}")


def test_shipped_files_load_and_say_their_level(config: Path) -> None:
    names = {f"load/{path.stem}": path for path in shipped_parameter_files("load")}
    assert set(names) == {"load/gait2354", "load/insole", "load/inverse_dynamics"}
    for name, path in names.items():
        first, level = path.read_text().splitlines()[0], load(name).chosen_level
        assert first.startswith(f"# Level {level}: "), name
        assert load(path) == load(config / "load" / path.name) == load(name)
    assert load("load/insole") == load({})  # what it says are the defaults, said aloud


def test_a_file_has_sections_for_both_nodes(tmp_path: Path) -> None:
    path = tmp_path / "leg.yaml"
    path.write_text(
        "/**/knee_load:\n  ros__parameters:\n    person: {mass: 60.0}\n    hip.joint_name: hip\n"
        "/**/knee_contact:\n  ros__parameters:\n    body_weight: 588.4\n"
        "/**:\n  ros__parameters:\n    pairing.wait: 0.5\n    use_sim_time: true\n"
    )
    check_file(path, LoadParameters)
    check_file(path, Parameters)
    ours, others = load(path), load_parameters(path)
    assert (ours.person.mass, ours.hip.joint_name, ours.pairing.wait) == (60.0, "hip", 0.5)
    assert (others.body_weight, others.pairing.wait) == (588.4, 0.5)

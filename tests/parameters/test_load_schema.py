"""Parameters of the load node: the level that the inputs allow, its files, and what is refused in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from knee_contact_ros.joint_reaction.estimator import LEVELS
from knee_contact_ros.parameters.files import check_file, flat_parameters, known_parameters, load_parameters
from knee_contact_ros.parameters.schema import LoadParameters, Parameters, allowed_levels
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import shipped_parameter_files

HIP, ANKLE = {"hip.joint_name": "hip"}, {"ankle.joint_name": "ankle"}
FULL, ON_FOOT = {"ground.components": "full"}, {"ground.axes": "foot"}
CONTRACT = {
    "level": "auto", "knee.joint_name": "knee", "knee.sign": 1.0, "knee.offset": 0.0, "knee.assisted": False,
    "ankle.joint_name": "", "ankle.sign": 1.0, "ankle.offset": 0.0, "ankle.assisted": False,
    "hip.joint_name": "", "hip.sign": 1.0, "hip.offset": 0.0,
    "ground.components": "vertical", "ground.axes": "ground", "ground.ankle_x": 0.0, "ground.ankle_y": 0.0,
    "frame.ground": "", "frame.tibia": "tibia", "person.mass": 75.16, "person.height": 1.75,
    "person.moment_arm_scale": 1.5, "person.co_contraction": 0.2, "person.tone": 0.3,
    "calibrated": False, "standard_deviation": 0.0, "motion_window": 0.05, "pairing.wait": 0.1, "autostart": True,
    "record.path": "",
}  # fmt: skip


def load(values: Any) -> LoadParameters:
    return load_parameters(values, LoadParameters)


def test_names_and_defaults_hold() -> None:
    known = known_parameters(LoadParameters)
    assert {name: known[name].default for name in CONTRACT} == CONTRACT
    assert all(each.description for each in known.values())


def test_sections_that_both_nodes_have_are_the_same() -> None:
    ours, others = known_parameters(LoadParameters), known_parameters()
    for name in others:
        if name.startswith(("pairing.", "diagnostics.", "record.")):
            assert ours[name] == others[name], name


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


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"level": "muscles"}, r"level: 'muscles' is not allowed; .*auto, ground_force, knee_moment, ankle_moment"),
        ({"knee.joint_name": ""}, r"knee\.joint_name: '' is not allowed"),
        ({"knee.sign": 2.0}, r"knee\.sign: 2\.0 is not allowed; .*1\.0, -1\.0"),
        ({"hip.offset": 11.0}, r"hip\.offset: 11\.0 is not allowed; .*less than or equal to 10"),
        ({"hip.joint_name": "knee"}, r"parameter knee\.joint_name: knee, knee are not different joints"),
        (HIP | {"ankle.joint_name": "hip"}, r"knee, hip, hip are not different joints"),
        ({"ankle.assisted": True}, r"ankle\.assisted: True is not allowed; ankle\.joint_name is empty"),
        ({"hip.assisted": True}, r"unknown parameter hip\.assisted"),
        ({"ground.components": "half"}, r"ground\.components: 'half' is not allowed; .*vertical, full"),
        ({"ground.axes": "sky"}, r"ground\.axes: 'sky' is not allowed; .*ground, foot"),
        ({"ground.ankle_x": 80.0}, r"ground\.ankle_x: 80\.0 is not allowed"),
        ({"frame.tibia": ""}, r"frame\.tibia: '' is not allowed"),
        ({"frame.ground": "/plate"}, r"frame\.ground: '/plate' is not allowed; .*without a slash before it"),
        ({"person.mass": 0.0}, r"person\.mass: 0\.0 is not allowed; .*greater than or equal to 10"),
        ({"person.mass": float("nan")}, r"person\.mass: nan is not allowed; .*finite"),
        ({"person.height": 175.0}, r"person\.height: 175\.0 is not allowed; .*2\.5"),
        ({"person.tone": "much"}, r"person\.tone: 'much' is not allowed; .*valid number"),
        ({"person.moment_arm_scale": 0.0}, r"person\.moment_arm_scale: 0\.0 is not allowed"),
        ({"standard_deviation": 0.001}, r"standard_deviation: 0\.001 .* 0 \(as measured for the level\) or a num"),
        ({"motion_window": 0.001}, r"motion_window: 0\.001 .* 0 \(no inertia\) or a number >= 0\.01"),
        ({"calibrated": 1}, r"calibrated: 1 is not allowed; .*valid boolean"),
        ({"person.mas": 70.0}, r"unknown parameter person\.mas; did you mean person\.mass\?"),
        ({"contact.law": "hertz"}, r"unknown parameter contact\.law; "),
    ],
)
def test_what_is_not_allowed_is_refused_in_one_line(values: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError, match=words) as caught:
        load(values)
    assert "\n" not in str(caught.value)


def test_shipped_files_load_and_say_their_level(config: Path) -> None:
    names = {f"load/{path.stem}": path for path in shipped_parameter_files("load")}
    assert set(names) == {"load/gait2354", "load/insole", "load/inverse_dynamics"}
    for name, path in names.items():
        first, level = path.read_text().splitlines()[0], load(name).chosen_level
        assert first.startswith(f"# Level {level}: "), name
        assert load(path) == load(config / "load" / path.name) == load(name)
    assert load("load/insole") == load({})  # what it says are the defaults, said aloud


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (
            "inverse_dynamic",
            r"\(load/gait2354, load/insole, load/inverse_dynamics\); did you mean load/inverse_dynamics\?$",
        ),
        ("load/insol", r"\(load/gait2354, load/insole, load/inverse_dynamics\); did you mean load/insole\?$"),
        ("xyz", r"the package's own \(load/gait2354, load/insole, load/inverse_dynamics\)$"),
    ],
)
def test_a_missing_file_is_refused_with_those_for_this_node(name: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        load(name)


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


def test_what_is_said_for_all_nodes_must_be_known_to_this_one(tmp_path: Path) -> None:
    path = tmp_path / "all.yaml"
    path.write_text("/**:\n  ros__parameters: {body_weight: 588.4}\n")
    with pytest.raises(UsageError, match=r"all\.yaml: unknown parameter body_weight; "):
        check_file(path, LoadParameters)


@pytest.mark.parametrize("node", ["knee_contact", "/left/knee_contact", "/**/knee_contact"])
def test_a_file_for_the_contact_node_alone_is_refused_by_name(tmp_path: Path, node: str) -> None:
    path = tmp_path / "contact.yaml"
    path.write_text(f"{node}:\n  ros__parameters: {{body_weight: 588.4}}\n")
    with pytest.raises(UsageError) as caught:
        load(path)
    assert str(caught.value) == f"{path}: no parameters for node knee_load; found {node}"
    check_file(path, LoadParameters)  # ROS passes it over likewise


def test_legs_may_share_a_file(tmp_path: Path) -> None:
    path = tmp_path / "legs.yaml"
    sections = [f"/{side}/knee_load:\n  ros__parameters: {{knee.joint_name: knee_{side}}}\n" for side in ("l", "r")]
    path.write_text("".join(sections))
    check_file(path, LoadParameters)
    path.write_text("".join([*sections, "/x/knee_load:\n  ros__parameters: {level: ankle_moment}\n"]))
    with pytest.raises(UsageError, match=r"legs\.yaml: parameter level: 'ankle_moment' is not allowed"):
        check_file(path, LoadParameters)


def test_values_go_out_as_they_came_in() -> None:
    values = HIP | ANKLE | FULL | {"person.tone": 0.3, "calibrated": True, "standard_deviation": 0.25}
    parameters = load(values)
    assert load(flat_parameters(parameters)) == parameters == load([{"person.tone": 0.1}, values])
    assert {name: flat_parameters(parameters)[name] for name in values} == values

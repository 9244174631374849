"""The launch files: names and options, read from their text; where launch is installed, what they describe.

The launch packages are not among the ROS 2 wheels. `tests/ros/test_launch.py` runs a file where they are.
"""

from __future__ import annotations

import re
import runpy

import pytest

from knee_contact_ros.commands.main import knee_contact
from knee_contact_ros.parameters.files import STANDARD_PARAMETERS, known_parameters
from knee_contact_ros.parameters.schema import LoadParameters
from knee_contact_ros.system.files import PACKAGE, share_folder

FOLDER = share_folder() / "launch"
FILES = ["knee_contact.launch.py", "knee_load.launch.py", "replay.launch.py", "rviz.launch.py", "two_knees.launch.py"]
OTHERS = {"--params-file", "--log-level", "--display-config", "--frame-id", "--child-frame-id"}
"""Options of ROS 2 itself, and of programs of other packages"""
OURS = {option for command in knee_contact.commands.values() for one in command.params for option in one.opts}


def text_of(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")


def named(name: str, *functions: str) -> set[str]:
    """First arguments, as they are written, of all calls of some functions."""
    return set(re.findall(rf"\b(?:{'|'.join(functions)})\(\s*f?\"([^\"]+)\"", text_of(name)))


def test_all_launch_files_are_checked() -> None:
    assert sorted(path.name for path in FOLDER.iterdir() if path.is_file()) == FILES


@pytest.mark.parametrize("name", FILES)
def test_arguments_are_declared_described_and_used(name: str) -> None:
    declared = named(name, "DeclareLaunchArgument")
    assert named(name, "LaunchConfiguration", "number") == declared
    for told in ("default_value=", "description="):
        assert text_of(name).count(told) == text_of(name).count("DeclareLaunchArgument(")


def test_what_holds_for_both_knees_is_listed_and_is_as_for_one() -> None:
    one, both = (
        dict(re.findall(r"DeclareLaunchArgument\(\s*\"(\w+)\",([^()]*)\)", text_of(f"{name}.launch.py")))
        for name in ("knee_contact", "two_knees")
    )
    of_each_knee = {"namespace", "params", "joint", "record", "rerun", "rerun_port", "rerun_knees"}
    assert {name: both.get(name) for name in one.keys() - of_each_knee} == {
        name: one[name] for name in one.keys() - of_each_knee
    }


@pytest.mark.parametrize("name", FILES)
def test_parameters_options_and_files_are_there(name: str) -> None:
    text = text_of(name)
    known = known_parameters(LoadParameters) if name == "knee_load.launch.py" else known_parameters()
    sections = {parameter.split(".")[0] for parameter in known}
    words = set(re.findall(r"\"([a-z_]+(?:\.[a-z_]+)+)\"", text))
    assert {word for word in words if word.split(".")[0] in sections and not word.endswith(".urdf")} <= set(known)
    assert set(re.findall(r"given\[\"([^\"]+)\"\]", text)) <= {*known, *STANDARD_PARAMETERS}
    assert set(re.findall(r"\"(--[a-z-]+)\"", text)) <= OURS | OTHERS
    included = re.findall(r"\"(\w+\.launch\.py)\"", text)
    assert set(included) <= set(FILES)
    if included:  # what is handed on is an argument there
        assert set(re.findall(r"^ +\"(\w+)\": ", text, re.MULTILINE)) <= named(included[0], "DeclareLaunchArgument")
    assert f'PACKAGE = "{PACKAGE}"' in text
    for place in re.findall(r"PathJoinSubstitution\(\[(?:share|FindPackageShare\(PACKAGE\)), ([^\]]+)\]", text):
        assert share_folder().joinpath(*re.findall(r"\"([^\"]+)\"", place)).exists()


@pytest.mark.parametrize("name", FILES)
def test_a_launch_file_loads(name: str) -> None:
    pytest.importorskip("launch_ros", reason="the launch packages are not installed")
    description = runpy.run_path(str(FOLDER / name))["generate_launch_description"]()
    names = {argument.name for argument in description.get_launch_arguments()}
    for side in ("left", "right"):
        assert {argument.replace("{side}", side) for argument in named(name, "DeclareLaunchArgument")} <= names

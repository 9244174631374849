"""The launch files: names and options, read from their syntax trees; where launch is installed, what they describe.

The launch packages are not among the ROS 2 wheels. `tests/ros/test_launch.py` runs a file where they are.
"""

from __future__ import annotations

import ast
import re
import runpy
from collections.abc import Iterator

import pytest

from knee_contact_ros.commands.main import knee_contact
from knee_contact_ros.parameters.files import STANDARD_PARAMETERS, known_parameters
from knee_contact_ros.parameters.schema import LoadParameters, Parameters
from knee_contact_ros.system.files import PACKAGE, share_folder

FOLDER = share_folder() / "launch"
FILES = ["knee_contact.launch.py", "knee_load.launch.py", "replay.launch.py", "rviz.launch.py", "two_knees.launch.py"]
ROS_OPTIONS = {"--params-file", "--log-level"}
OTHERS = {
    "robot_state_publisher": {"robot_description"},
    "rviz2": {"--display-config"},
    "static_transform_publisher": {"--frame-id", "--child-frame-id"},
}
"""Programs of other packages, and what they are given: parameters and options of ROS 2 Jazzy's"""
FOR_OTHERS = set.union(*OTHERS.values())


def tree_of(name: str) -> ast.Module:
    return ast.parse((FOLDER / name).read_text(encoding="utf-8"), name)


def calls(tree: ast.AST, function: str) -> Iterator[ast.Call]:
    """All calls of a function by its plain name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == function:
            yield node


def text(node: ast.expr) -> str:
    """A text as written; one with a gap, such as f"{side}_params", keeps its gap."""
    assert isinstance(node, (ast.Constant, ast.JoinedStr)), ast.unparse(node)
    return str(node.value) if isinstance(node, ast.Constant) else ast.unparse(node)


def declared(name: str) -> set[str]:
    return {text(call.args[0]) for call in calls(tree_of(name), "DeclareLaunchArgument")}


def keyword(call: ast.Call, name: str) -> ast.expr | None:
    return next((keyword.value for keyword in call.keywords if keyword.arg == name), None)


def constants(tree: ast.AST) -> list[str]:
    return [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)]


def test_all_launch_files_are_checked() -> None:
    assert sorted(path.name for path in FOLDER.iterdir() if path.is_file()) == FILES


@pytest.mark.parametrize("name", FILES)
def test_arguments_are_declared_described_and_used(name: str) -> None:
    tree = tree_of(name)
    used = {text(call.args[0]) for call in calls(tree, "LaunchConfiguration") if not isinstance(call.args[0], ast.Name)}
    used |= {text(call.args[0]) for call in calls(tree, "number")}  # looks an argument up by its name
    assert used == declared(name)
    for call in calls(tree, "DeclareLaunchArgument"):
        assert keyword(call, "description")
        assert keyword(call, "default_value")


def test_what_holds_for_both_knees_is_listed_and_is_as_for_one() -> None:
    def said(name: str) -> dict[str, list[str]]:
        options = "default_value", "choices", "description"
        found = {text(call.args[0]): call for call in calls(tree_of(name), "DeclareLaunchArgument")}
        return {
            argument: [ast.unparse(value) for option in options if (value := keyword(call, option))]
            for argument, call in found.items()
        }

    one, both = said("knee_contact.launch.py"), said("two_knees.launch.py")
    of_each_knee = {"namespace", "params", "joint", "record", "rerun", "rerun_port", "rerun_knees"}
    for argument in one.keys() - of_each_knee:
        assert both.get(argument) == one[argument], argument


@pytest.mark.parametrize("name", FILES)
def test_parameters_are_the_nodes(name: str) -> None:
    tree = tree_of(name)
    handed_on = [keyword(call, "launch_arguments") for call in calls(tree, "IncludeLaunchDescription")]
    included = [constant for constant in constants(tree) if constant.endswith(".launch.py")]
    for arguments in filter(None, handed_on):
        for dictionary in (node for node in ast.walk(arguments) if isinstance(node, ast.Dict)):
            assert {text(key) for key in dictionary.keys if key} <= set.union(*map(declared, included))
    inside = {id(node) for arguments in filter(None, handed_on) for node in ast.walk(arguments)}
    names = [
        text(key)
        for node in ast.walk(tree)
        if isinstance(node, ast.Dict) and id(node) not in inside
        for key in node.keys
        if key
    ]
    names += [
        text(node.slice) for node in ast.walk(tree) if isinstance(node, ast.Subscript) and node.value.id == "given"
    ]
    known = known_parameters(LoadParameters) if name == "knee_load.launch.py" else known_parameters()
    assert set(names) - FOR_OTHERS <= {*known, *STANDARD_PARAMETERS}
    assert names or included


@pytest.mark.parametrize("name", FILES)
def test_commands_have_the_options_they_are_given(name: str) -> None:
    tree = tree_of(name)
    for function in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)):
        lists = (node for node in ast.walk(function) if isinstance(node, ast.List))
        words = [word for node in lists for word in constants(node)]
        options = {word for word in words if word.startswith("-")} - FOR_OTHERS
        commands = [word for word in words if word in knee_contact.commands]
        if options:
            (command,) = set(commands)
            ours = {option for parameter in knee_contact.commands[command].params for option in parameter.opts}
            assert options <= (ROS_OPTIONS if command in ("node", "load") else ours)
    nodes = [call for call in calls(tree, "Node") if text(keyword(call, "executable")) not in OTHERS]
    for call in nodes:  # which puts ROS arguments behind the command
        (command,) = ast.literal_eval(keyword(call, "arguments"))
        assert text(keyword(call, "name")) == {"node": Parameters.node, "load": LoadParameters.node}[command]
    for call in [*nodes, *calls(tree, "ExecutableInPackage")]:
        assert ast.unparse(keyword(call, "package")) == "PACKAGE"
        assert text(keyword(call, "executable")) == "knee_contact"


@pytest.mark.parametrize("name", FILES)
def test_the_files_they_name_are_there_and_installed(name: str) -> None:
    tree = tree_of(name)
    cmake = (share_folder() / "CMakeLists.txt").read_text(encoding="utf-8")
    folders = re.search(r"install\(DIRECTORY ([a-z ]+) DESTINATION share", cmake)
    assert folders
    assert "install(PROGRAMS scripts/knee_contact DESTINATION lib/${PROJECT_NAME})" in cmake
    assert (share_folder() / "scripts" / "knee_contact").is_file()
    assigned = {ast.unparse(part.targets[0]): part.value for part in tree.body if isinstance(part, ast.Assign)}
    assert text(assigned["PACKAGE"]) == PACKAGE
    for call in calls(tree, "PathJoinSubstitution"):
        parts = constants(call.args[0])
        if list(calls(call, "ThisLaunchFileDir")):
            parts = [FOLDER.name, *parts]
        assert share_folder().joinpath(*parts).exists()
        assert {parts[0], "launch"} <= set(folders[1].split())


@pytest.mark.parametrize("name", FILES)
def test_a_launch_file_loads(name: str) -> None:
    pytest.importorskip("launch_ros", reason="the launch packages are not installed")
    description = runpy.run_path(str(FOLDER / name))["generate_launch_description"]()
    names = {argument.name for argument in description.get_launch_arguments()}
    for side in ("left", "right"):
        assert {name.replace("{side}", side).removeprefix("f'").removesuffix("'") for name in declared(name)} <= names

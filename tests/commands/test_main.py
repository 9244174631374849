"""How a command ends, where it writes and what it refuses to."""

import os
import shutil
import subprocess
import sys

import click
import pytest

from knee_contact_ros.commands.main import GROUPS, INTERRUPTED, knee_contact, main
from knee_contact_ros.system.files import share_folder
from tests import ROOT
from tests.helpers.commands import run


@pytest.fixture
def failing():
    """A command `fail` that raises what is put in the list."""
    raised: list[BaseException] = []

    @knee_contact.command()
    def fail():
        raise raised[0]

    yield raised
    del knee_contact.commands["fail"]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), click.Abort()])
def test_ctrl_c_is_an_interruption(failing, error, capsys):
    failing.append(error)
    assert run("fail") == INTERRUPTED
    assert capsys.readouterr().err.strip() == "knee-contact: interrupted"


def test_a_file_that_ends_too_early_is_no_interruption(failing):
    failing.append(EOFError("Ran out of input"))
    with pytest.raises(EOFError, match="Ran out of input"):
        run("fail")


ROS_COMMANDS = ["node", "demo --output new", "replay gait2354_right"]


def errors_of(words, folder, **environment):
    """Return the errors of a command that is refused, in a process that imports from this folder first."""
    done = subprocess.run(
        [sys.executable, "-m", "knee_contact_ros.commands.main", *words.split()],
        env=os.environ | {"PYTHONPATH": f"{folder}:{ROOT}"} | environment,
        cwd=share_folder() / "bags",
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    return done.stderr


@pytest.fixture
def broken_ros(tmp_path):
    """A folder with a `rclpy` that cannot be loaded."""
    (tmp_path / "rclpy.py").write_text("raise ImportError('none')\n")
    return tmp_path


@pytest.mark.parametrize("words", ROS_COMMANDS)
def test_another_ros_on_the_path_is_named_with_the_cure(words, tmp_path):
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy" / "__init__.py").write_text("from rclpy._rclpy_pybind11 import rclpy\n")
    errors = errors_of(words, tmp_path)
    reason = "ROS cannot be loaded (No module named 'rclpy._rclpy_pybind11'): is "
    assert errors.startswith(f"knee-contact: {reason}")
    assert "by PYTHONPATH" in errors
    assert "env -u PYTHONPATH" in errors


@pytest.mark.parametrize("words", [*ROS_COMMANDS, "load", "load --with-contact"])
def test_a_command_without_ros_says_where_to_read(words, tmp_path):
    (tmp_path / "sitecustomize.py").write_text("import sys; sys.modules['rclpy'] = None\n")
    (line,) = errors_of(words, tmp_path).splitlines()
    assert line.startswith("knee-contact: this command needs ROS 2: ")
    assert "docs/how-to/install.md" in line
    assert "## With ROS" in (ROOT / "docs/how-to/install.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("words", ["node", "load", "demo --output new"])
def test_a_command_without_our_messages_says_where_to_read(words, tmp_path):
    hidden = "import sys; sys.modules['knee_contact_ros.msg'] = None\n"
    (tmp_path / "sitecustomize.py").write_text(hidden)
    (tmp_path / "rclpy.py").touch()
    (line,) = errors_of(words, tmp_path).splitlines()
    assert "needs the package's ROS messages" in line
    assert "docs/how-to/install.md" in line


@pytest.mark.parametrize("words", ROS_COMMANDS)
def test_a_missing_middleware_is_named_with_the_cure(words, broken_ros):
    """The demo goes on without it, and then finds the ROS that cannot be loaded."""
    errors = errors_of(words, broken_ros, RMW_IMPLEMENTATION="rmw_none_cpp")
    first = errors.splitlines()[0]
    assert "RMW_IMPLEMENTATION asks for rmw_none_cpp, which is not installed here" in first
    is_demo = words.startswith("demo")
    assert ("the demo runs without it" in errors) == is_demo
    assert ("ROS cannot be loaded" in errors) == is_demo


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        ({"ROS_DOMAIN_ID": "233"}, "ROS_DOMAIN_ID: 233 is not allowed; it must be from 0 to 232"),
        (
            {"ROS_SECURITY_STRATEGY": "Enforce"},
            "warning: nothing is encrypted: ROS_SECURITY_STRATEGY=Enforce needs ROS",
        ),
        (
            {"ROS_SECURITY_STRATEGY": "Enforce", "ROS_SECURITY_ENABLE": "true"},
            "ROS_SECURITY_KEYSTORE: '' is no folder",
        ),
    ],
)
def test_an_environment_that_ros_does_not_explain_is_reported(environment, words, broken_ros):
    """The warning is followed by a ROS that cannot be loaded."""
    assert errors_of("node", broken_ros, **environment).startswith(f"knee-contact: {words}")


def test_the_bare_command_shows_every_command_in_its_group(
    capsys,
):
    assert main([]) == 0
    shown = capsys.readouterr().out
    for heading in GROUPS:
        assert f"\n{heading}:\n" in shown
    assert all(f"\n  {name} " in shown for name in knee_contact.commands)


def test_help_loads_nothing_heavy():
    """It would take a second."""
    heavy = "{'numpy', 'pydantic', 'rich', 'rclpy', 'subprocess', 'multiprocessing'}"
    code = f"import sys, knee_contact_ros.commands.main; print({heavy} & {{*sys.modules}})"
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout
        == "set()\n"
    )


def test_solve_leaves_a_file_and_nothing_beside(right_bag, tmp_path, capsys):
    """Two in one folder are two recordings: of the folder none is taken, and both are named."""
    for name in ("a", "b"):
        assert run(f"solve {right_bag} --output {tmp_path}/{name}.mcap") == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap", "b.mcap"]
    assert run(f"solve {tmp_path}/a.mcap --output {tmp_path}/b.mcap") == 2
    assert (
        capsys.readouterr().err
        == f"knee-contact: {tmp_path / 'b.mcap'} exists already; choose another name, or --overwrite\n"
    )
    assert run(f"solve {tmp_path} --output {tmp_path}/c.mcap") == 2
    assert capsys.readouterr().err == (
        f"knee-contact: {tmp_path} has more than one recording, and no usable metadata.yaml that names one; "
        "give one of these files: a.mcap, b.mcap\n"
    )


def test_the_other_recordings_of_a_bags_folder_are_named(right_bag, tmp_path, capsys):
    folder = tmp_path / "bag"
    shutil.copytree(right_bag, folder)
    shutil.copy(folder / "gait2354_right_0.mcap", folder / "later.mcap")
    assert run(f"solve {folder} --output {tmp_path}/out.mcap") == 0
    reported = "only gait2354_right_0.mcap is read; to read later.mcap, give it as a file\n"
    assert capsys.readouterr().err == f"knee-contact: warning: {folder}: {reported}"

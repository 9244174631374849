"""How the command ends."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from knee_contact_ros.commands.main import INTERRUPTED, knee_contact, main
from knee_contact_ros.system.files import share_folder
from tests import ROOT


@pytest.fixture
def failing() -> Iterator[list[BaseException]]:
    """A command `fail` that raises what is put in the list."""
    raised: list[BaseException] = []

    @knee_contact.command()
    def fail() -> None:
        raise raised[0]

    yield raised
    del knee_contact.commands["fail"]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), click.Abort()])
def test_ctrl_c_is_an_interruption(
    failing: list[BaseException], error: BaseException, capsys: pytest.CaptureFixture[str]
) -> None:
    failing.append(error)
    assert main(["fail"]) == INTERRUPTED
    assert capsys.readouterr().err.strip() == "knee-contact: interrupted"


def test_a_file_that_ends_too_early_is_no_interruption(failing: list[BaseException]) -> None:
    failing.append(EOFError("Ran out of input"))
    with pytest.raises(EOFError, match="Ran out of input"):
        main(["fail"])


def test_ctrl_c_while_a_data_class_is_made_is_an_interruption(tmp_path: Path) -> None:
    """When a KeyboardInterrupt leaves a text given to exec, CPython remembers, and kills a module that runs by -m."""
    (tmp_path / "sitecustomize.py").write_text(
        "import click\nclick.Group.main = lambda *_, **__: exec('raise KeyboardInterrupt')\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "knee_contact_ros.commands.main"],
        env=os.environ | {"PYTHONPATH": str(tmp_path)}, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == INTERRUPTED
    assert done.stderr.strip() == "knee-contact: interrupted"


STARTS = [["node"], ["demo", "--output", "new"], ["replay", "gait2354_right"]]
"""What starts ROS"""


def refused(arguments: list[str], path: str, **environment: str) -> str:
    """What a command writes that is refused, in an environment with this path of Python."""
    done = subprocess.run(
        [sys.executable, "-m", "knee_contact_ros.commands.main", *arguments],
        env=os.environ | {"PYTHONPATH": path} | environment, cwd=share_folder() / "bags",
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    return done.stderr


@pytest.mark.parametrize("arguments", STARTS)
def test_another_ros_on_the_path_is_named_with_the_cure(arguments: list[str], tmp_path: Path) -> None:
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy" / "__init__.py").write_text("from rclpy._rclpy_pybind11 import rclpy\n")
    told = refused(arguments, f"{tmp_path}:{ROOT}")
    assert told.startswith("knee-contact: ROS cannot be loaded (No module named 'rclpy._rclpy_pybind11'): is ")
    assert "by PYTHONPATH" in told
    assert "env -u PYTHONPATH" in told


@pytest.mark.parametrize("arguments", STARTS)
def test_a_middleware_that_is_not_there_is_named_with_the_cure(arguments: list[str], tmp_path: Path) -> None:
    """The demo goes on without it, and here with a ROS that cannot be loaded, to the same end."""
    (tmp_path / "rclpy.py").write_text("raise ImportError('none')\n")
    told = refused(arguments, f"{tmp_path}:{ROOT}", RMW_IMPLEMENTATION="rmw_none_cpp")
    assert "RMW_IMPLEMENTATION asks for rmw_none_cpp, which is not installed here" in told.splitlines()[0]
    assert ("the demo runs without it" in told) == (arguments[0] == "demo") == ("ROS cannot be loaded" in told)


def test_the_bare_command_shows_every_command_in_its_group(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    shown = capsys.readouterr().out
    assert [line for line in shown.splitlines() if line.endswith(":") and line != "Options:"] == [
        "See it:", "Compute:", "Bring your own data:", "Study:",
    ]  # fmt: skip
    assert all(f"\n  {name} " in shown for name in knee_contact.commands)


def test_help_loads_nothing_heavy() -> None:
    """It would take a second."""
    heavy = "{'numpy', 'pydantic', 'rich', 'rclpy', 'subprocess', 'multiprocessing'}"
    code = f"import sys, knee_contact_ros.commands.main; print({heavy} & {{*sys.modules}})"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "set()\n"

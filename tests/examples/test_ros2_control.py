"""The example of a chainable controller: no warning, and in each cycle the answer of the tick."""

import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path

import pytest

from knee_contact_ros.lab.export import export
from knee_contact_ros.parameters.files import load_parameters
from tests import ROOT

pytestmark = [
    pytest.mark.xdist_group("export"),
    pytest.mark.skipif(find_spec("numba") is None, reason="needs the extra compile"),
    pytest.mark.skipif(not shutil.which("c++"), reason="needs Debian: apt install g++)"),
]
EXAMPLE = ROOT / "examples" / "ros2_control"
STAND_IN = Path(__file__).parent / "ros2_control"
WARNINGS = ["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O2", "-std=c++17"]


def test_the_controller_exports_what_the_tick_answers(tmp_path):
    export(load_parameters(["healthy"]), "healthy", tmp_path, "x86-64")
    subprocess.run(["cc", "-c", "-std=c99", "healthy.c"], cwd=tmp_path, check=True)  # noqa: S607
    sources = [EXAMPLE / "knee_contact_controller.cpp", STAND_IN / "loop.cpp"]
    folders = [f"-I{folder}" for folder in (EXAMPLE, STAND_IN, tmp_path)]
    parts = "healthy.o", "knee_contact.o", "-o", "loop", "-lm"
    built = subprocess.run(
        ["c++", *WARNINGS, *folders, *sources, *parts],  # noqa: S607
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (built.returncode, built.stderr) == (0, "")
    told = subprocess.run(
        ["./loop", "500"], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout
    names = " ".join(
        f"knee_contact/{one}" for one in ("contact_force", "penetration_depth", "status")
    )
    assert told.startswith(f"{names}: 500 of 500 as the tick, 0 unusable, bad force flagged\n"), (
        told
    )

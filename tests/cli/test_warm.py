"""`knee-contact warm`: what it compiles needs no compiling afterwards, and it says where that is."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from knee_contact_ros.cli.main import main
from knee_contact_ros.compiled import kernel
from knee_contact_ros.parameters.build import load_model

pytestmark = pytest.mark.xdist_group("kernel for kelvin_voigt")
LOADED = """
import sys
import knee_contact_ros
knee_contact_ros.load_model(compiled=True).stream().tick(0.0, 0.3, 700.0)
print("numba" in sys.modules)
"""


def test_what_it_compiles_is_there_for_others(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["warm", "--params", "healthy"]) == 0
    first, where = capsys.readouterr().out.splitlines()
    assert first.startswith("healthy: ")
    assert where == f"kept in {kernel.kernel_folder()}"
    assert kernel.is_kept(load_model().scene, only_on_disk=True)
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("False\n", "")
    assert main(["warm", "-p", "contact.damping:=1.0"]) == 0  # a number is no kind of knee
    assert capsys.readouterr().out.splitlines()[0] == "contact.damping:=1.0: was there already"


def test_what_cannot_be_kept_is_no_success(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    load_model(compiled=True).stream()
    monkeypatch.setattr(kernel, "is_kept", lambda _scene, only_on_disk=False: not only_on_disk)
    assert main(["warm", "--params", "healthy"]) == 1
    assert "could not be kept in " in capsys.readouterr().err


def test_bad_parameters_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["warm", "--params", "nowhere"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_without_a_home_one_line_says_what_is_missing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    assert main(["warm", "--params", "healthy"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "XDG_CACHE_HOME is not set" in line

"""Rerun's viewer: found wherever it is installed; and files on a full disk."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from importlib import invalidate_caches
from pathlib import Path
from typing import Any

import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.view.viewer import NOT_INSTALLED, executable
from tests.helpers.needs import needs_viewer
from tests.helpers.processes import NO_BYTECODE

pytestmark = pytest.mark.xdist_group("the scene")  # what is drawn once is read by several


def test_the_viewer_is_found_among_the_packages_of_a_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "rerun_cli").mkdir()
    for name in ("__init__.py", "rerun"):
        (tmp_path / "rerun_cli" / name).touch()
    monkeypatch.delitem(sys.modules, "rerun_cli", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    invalidate_caches()
    assert executable() == tmp_path / "rerun_cli" / "rerun"


@pytest.mark.parametrize("arguments", [["nowhere.mcap"], ["{bag}", "--save", "out.rrd"], ["rerun+http://127.0.0.1/"]])
def test_the_command_tells_what_to_install(
    arguments: list[str], right_bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "rerun_cli", None)
    assert main(["view", *(each.format(bag=right_bag) for each in arguments)]) == 2
    assert capsys.readouterr().err == f"knee-contact: {NOT_INSTALLED}\n"
    assert not list(tmp_path.iterdir())


@needs_viewer
def test_view_ends_with_one_line_when_the_disk_is_full(osteoarthritic: Path, tmp_path: Path) -> None:
    path = tmp_path / "pictures" / "knee.rrd"
    path.parent.mkdir()
    done = subprocess.run(
        [sys.executable, "-m", "knee_contact_ros.commands.main", "view", str(osteoarthritic), "--save", str(path)],
        capture_output=True, text=True, timeout=180, check=False, env=os.environ | NO_BYTECODE,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000)),
    )  # fmt: skip
    assert done.stderr.splitlines()[-1] == f"knee-contact: {path}.partial: File too large"
    assert done.returncode == 1
    assert not list(path.parent.iterdir())

"""Rerun's viewer is found wherever its package is installed."""

from __future__ import annotations

import re
import sys
from importlib import invalidate_caches
from pathlib import Path
from typing import Any

import pytest

from knee_contact_ros.cli.main import main
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.view.window import NOT_INSTALLED, executable, viewer


def test_the_viewer_is_found_among_the_packages_of_a_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "rerun_cli").mkdir()
    for name in ("__init__.py", "rerun"):
        (tmp_path / "rerun_cli" / name).touch()
    monkeypatch.delitem(sys.modules, "rerun_cli", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    invalidate_caches()
    assert executable() == tmp_path / "rerun_cli" / "rerun"


def test_a_viewer_that_is_not_there_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "rerun_cli", raising=False)
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    assert viewer() is None
    with pytest.raises(UsageError, match=f"^{re.escape(NOT_INSTALLED)}$"):
        executable()


@pytest.mark.parametrize("arguments", [["nowhere.mcap"], ["{bag}", "--save", "out.rrd"], ["rerun+http://127.0.0.1/"]])
def test_the_command_tells_what_to_install(
    arguments: list[str], right_bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "rerun_cli", None)
    assert main(["view", *(each.format(bag=right_bag) for each in arguments)]) == 2
    assert capsys.readouterr().err == f"knee-contact: {NOT_INSTALLED}\n"
    assert not list(tmp_path.iterdir())

"""Rerun's viewer is found wherever its package is installed."""

from __future__ import annotations

import sys
from importlib import invalidate_caches
from pathlib import Path

import pytest

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.view.window import executable


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
    with pytest.raises(UsageError, match="pip install rerun-sdk"):
        executable()

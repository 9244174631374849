"""How to get what is not installed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from knee_contact_ros.system import files
from knee_contact_ros.system.files import not_installed
from tests import ROOT


def test_the_command_is_one_that_works_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The package is in no index: its name would be somebody else's."""
    # The share folder of an installed package is not that of its sources.
    monkeypatch.setattr(files, "share_folder", lambda: ROOT)
    monkeypatch.setattr(sys, "prefix", str(ROOT / ".venv"))
    told = not_installed("jinja2", "report")
    assert told == f"jinja2 is not installed; in {ROOT}: .venv/bin/uv pip install -e '.[report]'"
    monkeypatch.setattr(files, "share_folder", lambda: tmp_path)
    assert f"{sys.executable} -m pip install '.[report]'" in not_installed("jinja2", "report")
    assert "knee-contact-ros[" not in told

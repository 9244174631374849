"""How to get what is not installed."""

import sys
from importlib.machinery import ModuleSpec
from types import ModuleType

import pytest

from knee_contact_ros.system import files
from knee_contact_ros.system.files import not_installed
from tests import ROOT


def test_the_command_is_one_that_works_here(tmp_path, monkeypatch):
    """The package is in no index: its name would be somebody else's."""
    # The share folder of an installed package is not that of its sources.
    monkeypatch.setattr(files, "share_folder", lambda: ROOT)
    monkeypatch.setattr(sys, "prefix", str(ROOT / ".venv"))
    told = not_installed("jinja2", "report")
    assert told == f"jinja2 is not installed; in {ROOT}: .venv/bin/uv pip install -e '.[report]'"
    monkeypatch.setattr(files, "share_folder", lambda: tmp_path)
    messages = ModuleType("knee_contact_ros.msg")
    messages.__spec__ = ModuleSpec(messages.__name__, None)
    monkeypatch.setitem(sys.modules, messages.__name__, messages)
    command = f"{sys.executable} -m pip install --config-settings messages=yes '.[report]'"
    assert command in not_installed("jinja2", "report")
    monkeypatch.setitem(sys.modules, "knee_contact_ros.msg", None)
    assert f"{sys.executable} -m pip install '.[report]'" in not_installed("jinja2", "report")
    assert "knee-contact-ros[" not in told


@pytest.mark.parametrize("site", ["lib/python3.11/site-packages", "Lib/site-packages", "."])
def test_the_files_of_an_installation_are_beside_its_modules(site, tmp_path, monkeypatch):
    """Of an environment, one on Windows, and `pip install --target`; another one's do not come before."""
    share, other = (tmp_path / name / "share" / "knee_contact_ros" for name in ("own", "other"))
    for folder in (share, other):
        folder.mkdir(parents=True)
        (folder / "package.xml").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "other"))
    monkeypatch.setattr(
        files, "__file__", str(tmp_path / "own" / site / "knee_contact_ros/system/files.py")
    )
    assert files.share_folder() == share

"""`knee-contact warm`: what it compiles needs no compiling afterwards, and it says where that is."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.model import compiler

LOADED = """
import knee_contact_ros
knee_contact_ros.load_model(compiled=True).stream().tick(0.0, 0.3, 700.0)
"""


def test_what_it_compiles_is_there_for_others(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["warm"]) == 0
    first, where = capsys.readouterr().out.splitlines()
    assert first in ("compiled", "was there already")
    assert where == f"kept in {compiler.kept_files()[0].parent}"
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert main(["warm", "--params", "mri_knee", "-p", "contact.law:=flores"]) == 0  # it is for every kind of knee
    assert capsys.readouterr().out.splitlines()[0] == "was there already"


def test_what_cannot_be_kept_is_no_success(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiler, "kept_files", list)
    assert main(["warm"]) == 1
    assert "could not be compiled and kept in " in capsys.readouterr().err


def test_bad_parameters_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["warm", "--params", "nowhere"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_without_a_home_one_line_says_what_is_missing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(compiler, "folders", lambda _entry: [tmp_path])
    monkeypatch.setattr(compiler, "kept_files", list)
    assert main(["warm"]) == 2
    *_, line = capsys.readouterr().err.splitlines()  # before it, maybe, that the model is compiled
    assert "set XDG_CACHE_HOME" in line

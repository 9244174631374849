"""Compiling ahead: what processes of its own have compiled is there; what ends the wait ends them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from knee_contact_ros.compiled import ahead
from knee_contact_ros.compiled.ahead import compile_ahead
from knee_contact_ros.parameters.build import load_model
from tests.helpers.processes import has_ended

PATIENCE = 60.0
"""[s] in which a process starts or ends on a busy machine"""


TWO_KINDS = """
from knee_contact_ros.compiled.ahead import compile_ahead
from knee_contact_ros.parameters.build import load_model

compile_ahead(load_model({"contact.law": law, "tibia.geometry": "circle"}).scene for law in ("flores", "hertz"))
"""
"""Kinds that no kernel is shipped for"""


@pytest.mark.xdist_group("kernel for kelvin_voigt")
def test_what_is_kept_takes_no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    model = load_model(compiled=True)
    model.stream()
    monkeypatch.delattr(ahead, "connected")
    compile_ahead([model.scene])


def test_an_interruption_ends_the_compilers(tmp_path: Path) -> None:
    processors = len(os.sched_getaffinity(0))
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    process = subprocess.Popen([sys.executable, "-c", TWO_KINDS], env=environment, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + PATIENCE
    kinds = f".{'[0-9a-f]' * 16}.lock"
    while len(list(tmp_path.glob(f"*/kernel-*/{kinds}"))) < min(2, processors):  # each takes its turn to compile
        assert time.monotonic() < deadline
        time.sleep(0.05)
    compilers = psutil.Process(process.pid).children()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE)
    assert "KeyboardInterrupt" in errors
    assert len(compilers) == min(2, processors)
    assert not [one for one in compilers if not has_ended(one)]
    assert not list(tmp_path.glob("*/kernel-*/*.kernel"))


def test_compilers_end_with_who_has_asked(tmp_path: Path) -> None:
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    process = subprocess.Popen([sys.executable, "-c", TWO_KINDS], env=environment)
    deadline = time.monotonic() + PATIENCE
    while not list(tmp_path.glob("*/kernel-*/.*.lock")) or not psutil.Process(process.pid).children():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    compilers = psutil.Process(process.pid).children()
    process.kill()
    process.wait()
    gone, left = psutil.wait_procs(compilers, PATIENCE)
    assert gone
    assert not left


def test_where_nothing_can_be_kept_nothing_is_begun(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "knee_contact_ros").write_text("a file in the folder's place", encoding="utf-8")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(ahead, "is_kept", lambda _scene, only_on_disk: not only_on_disk)
    monkeypatch.delattr(ahead, "connected")
    compile_ahead([load_model("healthy").scene])

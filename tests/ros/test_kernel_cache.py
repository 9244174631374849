"""The real kernel, kept and damaged: what a loss of power leaves stops neither `load_model` nor the node."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from knee_contact_ros.compiled import cache
from tests.ros.conftest import NodeProcess, Peer
from tests.ros.series import send_all

PARAMETERS = {"contact.law": "kelvin_voigt", "femur.geometry": "circle", "tibia.geometry": "plane"}
"""What other tests have compiled already"""
RUN = """
import json, sys
import knee_contact_ros
model = knee_contact_ros.load_model(json.loads(sys.argv[1]), compiled=True)
series = model.run([0.0, 0.01], [0.3, 0.4], [700.0, 900.0])
stream = model.stream()
depths = [stream.tick(0.0, 0.3, 700.0).penetration_depth, stream.tick(0.01, 0.4, 900.0).penetration_depth]
assert depths == series.penetration_depth.tolist()
print(series.tobytes().hex(), "numba" not in sys.modules)
"""


def run() -> tuple[str, bool, str]:
    """Answers of a process of its own, whether it did not even import the compiler, and what it said."""
    command = [sys.executable, "-c", RUN, json.dumps(PARAMETERS)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    answers, loaded = done.stdout.split()
    return answers, loaded == "True", done.stderr


def test_a_kernel_that_was_not_written_to_its_end_is_compiled_again(
    start_node: Callable[..., NodeProcess], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers, loaded, said = run()
    assert loaded or "compiling for this kind of knee" in said
    folder = tmp_path / "knee_contact_ros" / cache.kernel_folder().name
    shutil.copytree(cache.kernel_folder(), folder, ignore=shutil.ignore_patterns(".*"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert run() == (answers, True, "")
    whole = {path: path.read_bytes() for path in folder.glob("knee-*")}
    for path in whole:
        path.write_bytes(b"")
    node = start_node(*(word for name, value in PARAMETERS.items() for word in ("-p", f"{name}:={value}")))
    lines: list[str] = []
    for line in node.process.stdout or ():
        lines.append(line)
        if "active, listening" in line:
            break
    code, rest = node.stop()
    assert code == 0, "".join(lines) + rest
    (line,) = [line for line in lines if "is damaged" in line]
    (path,) = [path for path in whole if path.stat().st_size]
    assert line == f"knee_contact_ros: compiled code: {path} is damaged; compiling again\n"
    assert run() == (answers, True, "")  # it is whole again; its bytes may be of another way to the same code


def test_a_node_without_numba_answers_uncompiled(
    peer: Peer, start_node: Callable[..., NodeProcess], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # what is kept needs no Numba
    node = start_node("-p", "tibia.geometry:=circle", without="numba")  # no kernel is shipped for it
    peer.wait_for_node()
    send_all(peer)
    code, said = node.stop()
    assert code == 0, said
    assert said.count("Numba cannot be used") == 1
    assert "40 ticks, 0 samples refused" in said

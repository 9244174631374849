"""Files of somebody who means no good, given to the commands that read such files: they end soon, and say why."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.helpers.needs import HAS_REPORT, HAS_VIEWER, needs_viewer
from tests.hostile.cases import BAGS, GAIT

COMMANDS: dict[str, Callable[[str, str], list[str]]] = {
    "solve": lambda bag, output: ["solve", bag, "--output", f"{output}/out.mcap"],
    "report": lambda bag, output: ["report", bag, "--output", f"{output}/report"],
    "view": lambda bag, output: ["view", bag, "--save", f"{output}/out.rrd"],
    "recover": lambda bag, output: ["recover", bag, f"{output}/out.mcap"],
    "estimate-load": lambda bag, output: [
        "estimate-load",
        bag,
        "--output",
        f"{output}/out.mcap",
        "--remap",
        "ground_reaction_force:=/joint_reaction_force",
    ],
}
OTHERWISE = [
    ("a chunk that hides ten gigabytes", "recover"),
    ("channels without end", "recover"),
    ("escape codes in topics", "recover"),
    ("quality of service without end", "recover"),
    ("records within each other", "recover"),
    ("a profile that is named", "report"),
    ("metadata that is a pipe", "report"),
    ("escape codes in topics", "estimate-load"),
    ("messages that are none", "estimate-load"),
]
"""Where other commands have ways of their own"""
SEEN = [
    pytest.param(name, "view", marks=needs_viewer) for name in ("a profile that is named", "escape codes in topics")
]
Run = Callable[[list[str], Path], tuple[int, str]]


@pytest.fixture(scope="module")
def run() -> Iterator[Run]:
    """Runs a command with little memory and time: exit code (negative: of a signal), and what it said."""
    server = subprocess.Popen(
        [sys.executable, "-m", "tests.hostile.commands"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert server.stdin
    assert server.stdout

    def done(arguments: list[str], log: Path) -> tuple[int, str]:
        assert server.stdin
        assert server.stdout
        print(json.dumps({"arguments": arguments, "log": str(log)}), file=server.stdin, flush=True)
        return json.loads(server.stdout.readline()), log.read_text(errors="replace")

    yield done
    server.stdin.close()
    assert server.wait(60.0) == 0


def files(folder: Path) -> dict[str, tuple[int, int]]:
    """All that is in a folder: sizes and times."""
    return {str(path): (path.lstat().st_size, path.lstat().st_mtime_ns) for path in folder.rglob("*")}


@pytest.mark.parametrize(("name", "command"), [(name, "solve") for name in BAGS] + OTHERWISE + SEEN)
def test_bags(name: str, command: str, run: Run, tmp_path: Path) -> None:
    theirs, output = tmp_path / "theirs", tmp_path / "output"
    theirs.mkdir()
    output.mkdir()
    bag = BAGS[name](theirs)
    before = files(theirs)
    code, said = run(COMMANDS[command](str(bag), str(output)), tmp_path / "log")
    assert code in (0, 1, 2), said
    assert "Traceback" not in said
    assert code == 0 or said.splitlines()[-1].startswith("knee-contact: ")
    assert said.replace("\n", "").isprintable()
    assert files(theirs) == before
    assert {path.name for path in output.iterdir()} <= {"out.mcap", "out.rrd", "report", "metadata.yaml"}


def test_a_good_bag_passes_the_same_way(run: Run, tmp_path: Path) -> None:
    for command in ("solve", *["report"][:HAS_REPORT], *["view"][:HAS_VIEWER]):
        assert run(COMMANDS[command](str(GAIT), str(tmp_path)), tmp_path / "log")[0] == 0
    (tmp_path / "again").mkdir()
    assert run(COMMANDS["recover"](str(tmp_path / "out.mcap"), str(tmp_path / "again")), tmp_path / "log")[0] == 0

"""Files of somebody who means no good, given to the commands that read such files: they end soon, and say why."""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
import sys
from pathlib import Path

import pytest

from knee_contact_ros.commands.main import main
from tests.helpers.needs import HAS_REPORT, HAS_VIEWER, needs_viewer
from tests.hostile.cases import BAGS, GAIT

COMMANDS = {
    "solve": ["solve", "{bag}", "--output", "{output}/out.mcap"],
    "report": ["report", "{bag}", "--output", "{output}/report"],
    "view": ["view", "{bag}", "--save", "{output}/out.rrd"],
    "recover": ["recover", "{bag}", "{output}/out.mcap"],
    "estimate-load": [
        "estimate-load",
        "{bag}",
        "--output",
        "{output}/out.mcap",
        "--remap=ground_reaction_force:=/joint_reaction_force",
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
    pytest.param(name, "view", marks=needs_viewer)
    for name in ("a profile that is named", "escape codes in topics")
]
MEMORY, SECONDS, PATIENCE = 3 * 2**30, 20, 60
"""Addresses [B] and processor time [s] that a command may use, and the time [s] for one that waits"""
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(
    [
        f"knee_contact_ros.{name}"
        for name in (
            "commands.main",
            "lab.report",
            "bags.recover",
            "offline.solve",
            "offline.estimate_load",
            *["commands.view"][:HAS_VIEWER],
        )
    ]
)


def limited(arguments: list[str], log: Path) -> None:
    """In a process of its own: run a command with little memory and time; what it says goes to `log`."""
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(descriptor, stream)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    signal.alarm(PATIENCE)
    sys.exit(main(arguments))


def run(command: str, bag: Path, output: Path) -> tuple[int | None, str]:
    """Exit code (negative: of a signal) of a command, and what it said."""
    log = output.with_name("log")
    arguments = [word.format(bag=bag, output=output) for word in COMMANDS[command]]
    process = PROCESSES.Process(target=limited, args=(arguments, log))
    process.start()
    process.join()
    return process.exitcode, log.read_text(errors="replace")


def files(folder: Path) -> dict[str, tuple[int, int]]:
    """All that is in a folder: sizes and times."""
    return {
        str(path): (path.lstat().st_size, path.lstat().st_mtime_ns) for path in folder.rglob("*")
    }


@pytest.mark.parametrize(
    ("name", "command"), [(name, "solve") for name in BAGS] + OTHERWISE + SEEN
)
def test_bags(name: str, command: str, tmp_path: Path) -> None:
    theirs, output = tmp_path / "theirs", tmp_path / "output"
    theirs.mkdir()
    output.mkdir()
    bag = BAGS[name](theirs)
    before = files(theirs)
    code, said = run(command, bag, output)
    assert code in (0, 1, 2), said
    assert "Traceback" not in said
    assert code == 0 or said.splitlines()[-1].startswith("knee-contact: ")
    assert said.replace("\n", "").isprintable()
    assert files(theirs) == before
    assert {path.name for path in output.iterdir()} <= {
        "out.mcap",
        "out.rrd",
        "report",
        "metadata.yaml",
    }


def test_a_good_bag_passes_the_same_way(tmp_path: Path) -> None:
    output, again = tmp_path / "output", tmp_path / "again"
    output.mkdir()
    again.mkdir()
    for command in ("solve", *["report"][:HAS_REPORT], *["view"][:HAS_VIEWER]):
        assert run(command, GAIT, output)[0] == 0
    assert run("recover", output / "out.mcap", again)[0] == 0

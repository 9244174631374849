"""Surroundings in which a node is measured: rates, several nodes, a busy machine, a slow disk, a served scene."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from benchmarks.latency import bare
from benchmarks.latency.driver import (
    BARE,
    OURS,
    PARAMETERS,
    Driver,
    Feed,
    start_bare,
    start_node,
)
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.processes import EXIT_PATIENCE, Child
from knee_contact_ros.system.realtime import begin_realtime, end_realtime

REALTIME = f"{OURS}, --realtime"
BARE_REALTIME = f"{BARE}, real-time"
BESIDE = (OURS, REALTIME, BARE, BARE_REALTIME)
BUSY = "while True: pass"
SYNCED = """
import os, sys
while True:
    with open(sys.argv[1], "wb") as file:
        for _ in range(64):
            file.write(os.urandom(1 << 20))
            os.fsync(file)
"""


class Surroundings(NamedTuple):
    """Where a node is measured."""

    name: str
    rate: float = 1000.0
    """Samples per second [Hz]"""
    nodes: int = 1
    """Number of nodes that get the samples; one of them is measured"""
    beside: tuple[str, ...] = ()
    """Programs that run beside it; the first argument is the name of a file"""
    values: tuple[tuple[str, str], ...] = ()
    """Parameters of our node"""
    listens_first: bool = False
    """Whether the measuring process is a real-time one, as the controller that listens to a node is"""


SURROUNDINGS = (
    Surroundings("200 Hz", 200.0),
    Surroundings("1 kHz"),
    Surroundings("4 kHz", 4000.0),
    Surroundings("1 kHz, 2 nodes", nodes=2),
    Surroundings("200 Hz, 8 nodes", 200.0, 8),
    Surroundings("1 kHz, 4 busy processes", beside=(BUSY,) * 4),
    Surroundings(
        "1 kHz, 4 busy processes, real-time listener", beside=(BUSY,) * 4, listens_first=True
    ),
    Surroundings("1 kHz, another process fills the disk", beside=(SYNCED,)),
    Surroundings("1 kHz, scene served", values=(("rerun.mode", '"serve"'),)),
)


@contextmanager
def node_in(
    place: Surroundings,
    candidate: str,
    driver: Driver,
    work: Path,
    patience: float = EXIT_PATIENCE,
) -> Iterator[Child]:
    """Run a candidate in its surroundings until it answers, and end all of them; it must end within `patience` [s].

    Raises:
        UsageError: it failed, or the system forbids real-time scheduling.
    """
    work.mkdir()
    with ExitStack() as stack:
        for number in range(1, place.nodes):
            stack.enter_context(started(place, candidate, work / str(number), f"/extra_{number}"))
        driver.feed = Feed(peers=(place.nodes, place.nodes, 1))
        one = stack.enter_context(started(place, candidate, work / "0", patience=patience))
        driver.wait_for_node(one.check)
        # They end before the node does, which would not complete the file of its viewer beside them.
        for number, program in enumerate(place.beside):
            command = [sys.executable, "-c", program, str(work / f"filled_{number}")]
            process = stack.enter_context(subprocess.Popen(command))
            stack.callback(process.kill)
        if place.listens_first:
            stack.callback(end_realtime)
            if forbidden := begin_realtime():
                raise UsageError(forbidden)
        yield one
    driver.wait_for_nobody()


def started(
    place: Surroundings,
    candidate: str,
    work: Path,
    namespace: str = "",
    patience: float = EXIT_PATIENCE,
) -> AbstractContextManager[Child]:
    """Start a candidate, in a namespace of its own if it is not the one that is measured."""
    work.mkdir()
    topics = ("joint_states", "joint_reaction_force")
    remaps = [f"{topic}:=/{topic}" for topic in topics] + [f"__ns:={namespace}"]
    more = ["--ros-args", *(word for each in remaps for word in ("-r", each))] if namespace else []
    if candidate in (BARE, BARE_REALTIME):
        kind = bare.EVENTS if candidate == BARE else bare.REALTIME
        return start_bare(kind, work, patience, more)
    command = [sys.executable, "-m", "knee_contact_ros.commands.main", "node"]
    command += ["--realtime"] if candidate == REALTIME else []
    files = [] if namespace else [PARAMETERS]
    return start_node([*command, *more], files, dict(place.values), work, patience)

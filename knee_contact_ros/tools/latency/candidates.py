"""The nodes that are measured: ours as it is, and bare nodes beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

from knee_contact_ros.offline.stage import node_process
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.executor import Quickest
from knee_contact_ros.system.processes import PATIENCE, Child, child_process
from knee_contact_ros.system.resources import share_folder
from knee_contact_ros.tools.latency import bare
from knee_contact_ros.tools.latency.driver import Driver
from knee_contact_ros.view.viewer import viewer

PARAMETERS = share_folder() / "config" / "healthy.yaml"
INCOMPLETE = 1
"""Exit code of a node that did not complete its files"""
DRAWS = " and draws to a Rerun file" if viewer() else ""


class Candidate(NamedTuple):
    """A node that is measured."""

    name: str
    about: str
    start: Callable[[Path, float], AbstractContextManager[Child]]
    """Starts its process, with its files in a folder and a time [s] within which it must end"""


def start_bare(kind: str, work: Path, patience: float) -> AbstractContextManager[Child]:
    """Start a bare node of a kind of `bare`."""
    return child_process("the bare node", ["-m", bare.__name__, kind], work / "bare.log", patience)


@contextmanager
def start_ours(parameter_files: list[Path], work: Path, patience: float) -> Iterator[Child]:
    """Start this node with parameter files; that it does not wait for its files on a busy machine is no failure."""
    done = False
    try:
        with node_process(parameter_files, work, patience) as child:
            yield child
            done = True
    except UsageError:
        if not done or child.process.returncode != INCOMPLETE:
            raise


OURS = Candidate(
    "this node", f"computes, publishes, records to MCAP{DRAWS} (healthy.yaml)", partial(start_ours, [PARAMETERS])
)
BOTH = Candidate(
    "this node, both", "the same with both compartments (and both_compartments.yaml)",
    partial(start_ours, [PARAMETERS, share_folder() / "config" / "both_compartments.yaml"]),
)  # fmt: skip
BARE = Candidate(
    "bare", f"rclpy's {Quickest.__name__}, ordinary messages in and out, no computation, no files",
    partial(start_bare, bare.EVENTS),
)  # fmt: skip
SINGLE = Candidate(
    "bare, single-threaded", "the same with rclpy's SingleThreadedExecutor", partial(start_bare, bare.SINGLE)
)
BYTES = Candidate(
    "bare, bytes", "the bare node with bytes in and prepared bytes out: the least that rclpy can take",
    partial(start_bare, bare.BYTES),
)  # fmt: skip
CANDIDATES = (OURS, BOTH, BARE, SINGLE, BYTES)


@contextmanager
def running(candidate: Candidate, driver: Driver, work: Path, patience: float = PATIENCE) -> Iterator[Child]:
    """Run a candidate in a process of its own until it answers; its files are in `work` until it has ended.

    Raises:
        UsageError: it failed.
    """
    work.mkdir()
    with candidate.start(work, patience) as child:
        driver.wait_for_node(child.check)
        yield child
        child.check()
    driver.wait_for_nobody()


def rotated(candidates: tuple[Candidate, ...], number: int) -> tuple[Candidate, ...]:
    """Order of the candidates in a round, counted from 0: each time another one is first."""
    first = number % len(candidates)
    return candidates[first:] + candidates[:first]

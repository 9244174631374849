"""Studies that the tests of cohorts share, and what they ask of a table."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pandas as pd

from knee_contact_ros.lab.run_study import Done, run_study
from knee_contact_ros.lab.study import Study
from tests import ROOT

LEAN = {"DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False"}
"""Settings of a cluster that waits for most of its time: nothing samples what it does"""
DAMPINGS = [1e3, 2e3, 3e3, 4e3, 5e3]


def silent(_done: int, _total: int) -> None:
    """No bar."""


def study(bag: Path | str, **content: Any) -> Study:
    """A study of one bag."""
    return Study({"bags": [str(bag)], **content})


def computed(asked: Study, output: Path | str, **how: Any) -> Done:
    """Run a study without a bar."""
    return run_study(asked, str(output), advance=silent, **how)


def table(folder: Path) -> pd.DataFrame:
    """All that is in a table, in an order of its own, but for the time that it took."""
    found = pd.read_parquet(folder)
    assert found["case"].is_unique
    return found.drop(columns="seconds").sort_values("case", ignore_index=True)


def assert_same(one: pd.DataFrame, other: pd.DataFrame) -> None:
    """The same bits in two tables."""
    pd.testing.assert_frame_equal(one, other, check_exact=True)


def left_over(folder: Path) -> list[str]:
    """Unfinished files in a folder of results."""
    return [path.name for path in folder.rglob("_unfinished-*")]


def begin(*arguments: str, **environment: str) -> subprocess.Popen[str]:
    """A command, in a group of processes of its own, as a terminal has it."""
    code = "import sys; from knee_contact_ros.commands.main import main; sys.exit(main())"
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        env=os.environ | environment, start_new_session=True,
    )  # fmt: skip


def end(process: subprocess.Popen[Any]) -> None:
    """Kill a process and all that it has started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def wait_until(is_so: Callable[[], object], seconds: float = 60.0) -> None:
    """Wait until something is so."""
    deadline = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.02)


class Cluster:
    """A scheduler and workers of this machine, as Dask's own commands start them."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self._folder = folder
        self.workers: list[subprocess.Popen[bytes]] = []
        self.start_scheduler()

    def start_scheduler(self) -> None:
        """Start it, again at the same address after it was killed."""
        self.scheduler = self._started(
            "scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard", "--no-show",
            "--dashboard-address", "127.0.0.1:0",
        )  # fmt: skip
        wait_until(self._answers)

    def _answers(self) -> bool:
        assert self.scheduler.poll() is None
        with socket.socket() as tried:
            return tried.connect_ex(("127.0.0.1", self.port)) == 0

    def add_worker(self, folder: Path = ROOT) -> None:
        """Start a worker with one thread, in a folder."""
        self.workers.append(
            self._started(
                "worker", self.address, "--host", "127.0.0.1", "--nthreads", "1", "--no-nanny", "--no-dashboard",
                "--local-directory", str(self._folder), folder=folder,
            )
        )  # fmt: skip

    def _started(self, *arguments: str, folder: Path = ROOT) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *arguments], cwd=folder, stdout=subprocess.DEVNULL,
            stderr=(self._folder / f"{arguments[0]}.log").open("ab"), env=os.environ | {"PYTHONPATH": str(ROOT)} | LEAN,
            start_new_session=True,
        )  # fmt: skip

    def close(self) -> None:
        """Kill all of it."""
        for process in (*self.workers, self.scheduler):
            end(process)

"""Studies that the tests of sweeps share, what they ask of a table, and a cluster of this machine."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress

import pandas as pd

from knee_contact_ros.lab.study import run_study
from knee_contact_ros.lab.study_file import Study
from tests import ROOT

DAMPINGS = [1e3, 2e3, 3e3, 4e3, 5e3]


def study(bag, **content):
    """A study of one bag."""
    return Study(bags=[str(bag)], **content)


def computed(asked, output, **how):
    """Run a study; give the numbers of cases that were there, were computed, and failed."""
    return run_study(asked, str(output), **how)[:3]


def table(folder):
    """All that is in a table, in an order of its own, but for the time that it took."""
    found = pd.read_parquet(folder)
    assert found["case"].is_unique
    return found.drop(columns="seconds").sort_values("case", ignore_index=True)


def assert_same(one, other):
    """The same bits in two tables."""
    pd.testing.assert_frame_equal(one, other, check_exact=True)


def started(*arguments, cwd=ROOT, **options):
    """A process of Python, in a group of its own, as a terminal has it."""
    own = {"PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False"}
    return subprocess.Popen(
        [sys.executable, *arguments],
        cwd=cwd,
        env=os.environ | own,
        start_new_session=True,
        **options,
    )


def end(process):
    """Kill a process and all that it has started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def wait_until(is_so, seconds=60.0):
    """Wait until something is so."""
    deadline = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.02)


class Cluster:
    """A scheduler and workers of this machine, as Dask's own commands start them."""

    def __init__(self, folder):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self._quiet = {
            "stdout": subprocess.DEVNULL,
            "stderr": (folder / "log").open("ab"),
        }
        self._folder = folder
        self.workers = []
        self.start_scheduler()

    def start_scheduler(self):
        """Start it, again at the same address after it was killed."""
        options = f"--host 127.0.0.1 --port {self.port} --no-dashboard --no-show --dashboard-address 127.0.0.1:0"
        self.scheduler = started("-m", "dask", "scheduler", *options.split(), **self._quiet)
        wait_until(self._answers)

    def _answers(self):
        assert self.scheduler.poll() is None
        with socket.socket() as tried:
            return tried.connect_ex(("127.0.0.1", self.port)) == 0

    def add_worker(self, cwd=ROOT):
        """Start a worker with one thread, in a folder."""
        options = f"{self.address} --host 127.0.0.1 --nthreads 1 --no-nanny --no-dashboard --local-directory"
        worker = started(
            "-m", "dask", "worker", *options.split(), str(self._folder), cwd=cwd, **self._quiet
        )
        self.workers.append(worker)

    def close(self):
        """Kill all of it."""
        for process in (*self.workers, self.scheduler):
            end(process)

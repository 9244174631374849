"""Cases in processes of their own, which are ended when a case takes too long."""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path

from studies.fuzz_bags.bags import MAKERS, make
from studies.fuzz_bags.judge import HANG, Verdict, try_case

LIMIT = 20.0
"""Time [s] that a case may take"""


class Worker:
    """A process that tries one case after another."""

    def __init__(self, bags: dict[str, Path], folder: Path) -> None:
        self._bags, self._folder = bags, folder
        self.seed = 0
        self.begun = 0.0
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, self._bags, self._folder), daemon=True)
        self._process.start()
        theirs.close()

    def give(self, seed: int) -> None:
        """Give a case to the process."""
        self.seed, self.begun = seed, time.monotonic()
        self.connection.send(seed)

    def replace(self) -> None:
        """End the process, and start another one."""
        self._process.kill()
        self._process.join()
        self.connection.close()
        self._start()

    def end(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()


def run(seeds: Sequence[int], workers: int) -> Iterator[Verdict]:
    """Try cases, and yield every verdict as it comes."""
    with tempfile.TemporaryDirectory() as name:
        folder, left = Path(name), iter(seeds)
        (folder / "whole").mkdir()
        bags = make(folder / "whole")
        busy = {worker.connection: worker for worker in (Worker(bags, folder / str(n)) for n in range(workers))}
        for worker in list(busy.values()):
            _next(worker, left, busy)
        while busy:
            for connection in wait(list(busy), timeout=1.0):
                assert isinstance(connection, Connection)  # noqa: S101
                worker = busy[connection]
                try:
                    yield connection.recv()
                except EOFError:  # it died, of memory for instance
                    yield _lost(worker, "the process died")
                    _replace(worker, busy)
                _next(worker, left, busy)
            for worker in [worker for worker in busy.values() if time.monotonic() - worker.begun > LIMIT]:
                yield _lost(worker, f"longer than {LIMIT:g} s")
                _replace(worker, busy)
                _next(worker, left, busy)


def _work(connection: Connection, bags: dict[str, Path], folder: Path) -> None:
    while True:
        connection.send(try_case(connection.recv(), bags, folder))


def _next(worker: Worker, left: Iterator[int], busy: dict[Connection, Worker]) -> None:
    seed = next(left, None)
    if seed is None:
        del busy[worker.connection]
        worker.end()
    else:
        worker.give(seed)


def _replace(worker: Worker, busy: dict[Connection, Worker]) -> None:
    del busy[worker.connection]
    worker.replace()
    busy[worker.connection] = worker


def _lost(worker: Worker, why: str) -> Verdict:
    kind = list(MAKERS)[worker.seed % len(MAKERS)]
    return Verdict(worker.seed, kind, "unknown", HANG, why)

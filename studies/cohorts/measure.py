"""Time the finalists in turns, on one core and on two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

import numpy as np

from studies.cohorts import worker
from studies.cohorts.method import Method
from studies.cohorts.peers import Peer
from studies.cohorts.problem import Cohort, Floats
from studies.cohorts.search import LIMIT, Setting
from studies.cohorts.worker import Share, Workers

CORES = (1, 2)


class Finalist(NamedTuple):
    """A method that is timed."""

    peer: Peer
    method: Method
    setting: Setting


class Timed(NamedTuple):
    """Times and error of a method."""

    finalist: Finalist
    cases: int
    """Knees that it ran"""
    value: float
    """The setting"""
    error: float
    """Largest error [m] of all of these"""
    times: Mapping[int, Floats]
    """Clock time [s] per knee of each round, by the number of cores"""
    processor: Floats
    """Processor time [s] per knee on one core, of each round"""
    set_up: float
    """Time [s] of the set-up on one core, which is in no other time"""


class _Entry:
    """A finalist and its processes, in which its runs are prepared."""

    def __init__(
        self, finalist: Finalist, workers: Sequence[ProcessPoolExecutor], knees: Cohort, truth: Floats
    ) -> None:
        self.finalist, self._workers = finalist, workers
        self.cases = min(knees.cases, finalist.method.most)
        self.value, self.error, self.set_up = self._settle(knees, truth)
        key = finalist.method.key
        for process, share in zip(workers, self._shares(2), strict=False):
            process.submit(worker.prepare, self._slot(2), key, knees, share, self.value).result()

    def _slot(self, cores: int) -> str:
        return f"{self.finalist.method.key}, {cores}"

    def _shares(self, cores: int) -> list[Share]:
        if cores == 1 or self.finalist.method.threads:
            return [Share(0, self.cases, cores)]
        half = self.cases // 2
        return [Share(0, half, 1), Share(half, self.cases, 1)]

    def _settle(self, knees: Cohort, truth: Floats) -> tuple[float, float, float]:
        """Setting that was searched, or the next finer one that holds for all knees; its error [m] and set-up [s]."""
        method, process, slot = self.finalist.method, self._workers[0], self._slot(1)
        for value in method.settings[method.settings.index(self.finalist.setting.value) :]:
            set_up = process.submit(worker.prepare, slot, method.key, knees, self._shares(1)[0], value).result()
            error = float(np.abs(process.submit(worker.depths, slot).result() - truth[: self.cases]).max())
            if error <= LIMIT:
                break
        return value, error, set_up

    def run(self, cores: int) -> tuple[float, float]:
        """Time [s] per knee, from the first process's begin to the last one's end, and processor time."""
        at_work = self._workers[: len(self._shares(cores))]
        runs = [process.submit(worker.run, self._slot(cores)) for process in at_work]
        spans = [run.result() for run in runs]
        whole = max(span.end for span in spans) - min(span.begin for span in spans)
        return whole / self.cases, sum(span.processor for span in spans) / self.cases


def timed(finalists: Sequence[Finalist], workers: Workers, knees: Cohort, truth: Floats, rounds: int) -> list[Timed]:
    """Time every finalist once a round on one core and on two, in turns."""
    entries = [_Entry(finalist, workers.of(finalist.peer.driver), knees, truth) for finalist in finalists]
    times = np.array([[[entry.run(cores) for cores in CORES] for entry in entries] for _ in range(rounds)])
    return [
        Timed(
            entry.finalist, entry.cases, entry.value, entry.error,
            {cores: times[:, i, j, 0] for j, cores in enumerate(CORES)}, times[:, i, 0, 1], entry.set_up,
        )
        for i, entry in enumerate(entries)
    ]  # fmt: skip

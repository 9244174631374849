"""The cohort study: every method of every tool meets the reference on short knees; processes keep what they prepare."""

from __future__ import annotations

import math
from importlib import import_module

import numpy as np
import pytest

from studies.cohorts.__main__ import BEST, finalists
from studies.cohorts.measure import Finalist
from studies.cohorts.method import STEPS, TOLERANCE, Method
from studies.cohorts.peers import OURS, PEERS, Peer
from studies.cohorts.problem import Cohort, cohort, truth
from studies.cohorts.search import Setting
from studies.cohorts.worker import Share, Workers, depths, prepare, run

LOOP = PEERS[0]


@pytest.fixture(scope="module")
def knees() -> Cohort:
    """Three knees in a tenth of a second of gait."""
    whole = cohort(3)
    return whole._replace(**{name: getattr(whole, name)[:21] for name in ("time", "angle", "load")})


def fine(method: Method) -> float:
    """The setting next to 1e-7, or 6 steps per tick; of our own with one setting, that."""
    return min(method.settings, key=lambda value: abs(math.log(value / (6.0 if method.control == STEPS else 1e-7))))


@pytest.mark.parametrize("peer", [OURS, *PEERS], ids=lambda peer: peer.name)
def test_every_method_meets_the_reference(peer: Peer, knees: Cohort) -> None:
    pytest.importorskip(peer.module)
    exact = truth(knees)
    for method in import_module(peer.driver).methods():
        answer = method.prepare(knees, fine(method), 1)()
        # 1e-7 of a depth of some 0.5 mm per step, with room for what adds up; equal steps: 2e-8 m and less.
        assert np.abs(answer - exact).max() < 1e-6, method.key


def test_a_process_keeps_what_it_prepares(knees: Cohort) -> None:
    method = LOOP.methods()[0]
    expected = method.prepare(knees, 1e-6, 1)()
    workers = Workers()
    try:
        process, other = workers.of(LOOP.driver)
        assert workers.of(LOOP.driver) == [process, other]
        assert process.submit(prepare, "a", method.key, knees, Share(1, 3, 1), 1e-6).result() > 0.0
        span = process.submit(run, "a").result()
        assert span.end > span.begin
        assert np.array_equal(process.submit(depths, "a").result(), expected[1:])
        with pytest.raises(KeyError):
            process.submit(run, "b").result()
        assert process.submit(run, "a").result().processor > 0.0
    finally:
        workers.close()


def test_the_quickest_of_every_tool_are_timed_with_and_without_error_control() -> None:
    def one(name: str, control: str, per_tick: float) -> Finalist:
        method = Method("tool", name, control, lambda *_: lambda: np.zeros((1, 1)), (1.0,))
        return Finalist(LOOP, method, Setting(method.key, 1.0, 0.0, per_tick, 0.0))

    found = [one("a", TOLERANCE, 3.0), one("b", STEPS, 9.0), one("c", TOLERANCE, 1.0), one("d", TOLERANCE, 2.0),
             one("e", STEPS, math.nan)]  # fmt: skip
    assert BEST == 2
    assert [each.method.name for each in finalists(found)] == ["c", "d", "b"]

"""Every solver solves its short problem to the error that is stated here; what is not installed is skipped."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from importlib import import_module

import numpy as np
import pytest

from knee_contact_ros.system.extras import not_installed
from knee_contact_ros.tools.work_precision import ours
from knee_contact_ros.tools.work_precision import worker as worker_module
from knee_contact_ros.tools.work_precision.motion import contact_force, force_gradient, load_at
from knee_contact_ros.tools.work_precision.peers import PEERS, Entry, entries
from knee_contact_ros.tools.work_precision.problems import Problem, find_problems
from knee_contact_ros.tools.work_precision.solver import MODES, STREAM, Setting, Solver
from knee_contact_ros.tools.work_precision.start import exact_depth
from knee_contact_ros.tools.work_precision.worker import FailedRunError, GivenUpError, LostProcessError, Task, Worker

STEPS = Setting("20 per tick", 20.0)
TOLERANCE = Setting("1e-8", 1e-8)
LOOSE = {"MuJoCo Euler": 1e-4, "Exudyn trapezoidal": 1e-4, "MuJoCo RK4": 1e-4, "Exudyn RK44": 1e-4, "Exudyn RK67": 1e-4}
"""Errors [m] of solvers whose steps go across lift-off and landing; 1 mm of depth is large"""
ENTRIES = {entry.solver.name: entry for peer in PEERS for entry in peer.entries()}
ABSENT = {peer.name: not_installed(peer.name, peer.extra) for peer in PEERS if not peer.installed}
ENTRIES |= {entry.solver.name: entry for entry in entries(ours.__name__)}
del ENTRIES["knee-contact quasi_static"]  # it solves other equations than the reference


def short(name: str, first: float, last: float) -> Problem:
    """A part of a problem [s]."""
    (problem,) = find_problems((name,))
    part = (problem.time >= first - 1e-9) & (problem.time <= last + 1e-9)
    return problem._replace(time=problem.time[part] - problem.time[part][0], load=problem.load[part])


PARTS = [short("gait", 0.2, 0.25), short("lift-off", 0.38, 0.5), short("osteoarthritis", 0.0, 0.1)]
EXACT = [exact_depth(problem) for problem in PARTS]


def fine_setting(solver: Solver) -> Setting:
    """Fine enough for the errors below."""
    return STEPS if "per tick" in solver.settings[0].label else TOLERANCE


@pytest.fixture(scope="module")
def workers() -> Iterator[dict[str, Worker]]:
    """A process per peer."""
    running: dict[str, Worker] = defaultdict(Worker)
    yield running
    for worker in running.values():
        worker.stop()


@pytest.mark.parametrize("entry", ENTRIES.values(), ids=ENTRIES)
@pytest.mark.parametrize("mode", MODES)
def test_the_reference_is_met(workers: dict[str, Worker], entry: Entry, mode: str) -> None:
    solver = entry.solver
    run = solver.run_in(mode)
    if run is None:
        pytest.skip("not this way")
    if solver.peer in ABSENT:
        pytest.skip(ABSENT[solver.peer])
    for problem, exact in zip(PARTS, EXACT, strict=True):
        task = Task(entry.driver, solver.name, mode, problem, fine_setting(solver))
        outcome = workers[solver.peer].run(task, 90.0)  # the first run of a level compiles it
        assert outcome.seconds > 0.0
        assert not outcome.note
        assert np.abs(outcome.depth - exact).max() < LOOSE.get(solver.name, 2e-6)


def test_a_peer_that_is_absent_has_solvers_all_the_same() -> None:
    for peer in PEERS:
        for driver in peer.drivers:
            assert import_module(f"knee_contact_ros.tools.work_precision.peers.{driver}").solvers()


def test_the_law_never_pulls_and_its_gradient_is_its_slope() -> None:
    for problem in PARTS:
        force, gradient = contact_force(problem), force_gradient(problem)
        assert force(-1e-3, 1.0) == 0.0
        assert force(1e-5, -10.0) >= 0.0
        for depth in (2e-4, 7e-4):
            slope = (force(depth + 1e-9, 0.01) - force(depth - 1e-9, 0.01)) / 2e-9
            # Central differences: rounding of some 1e-13 N over 2e-9 m.
            assert gradient(depth, 0.01)[0] == pytest.approx(slope, rel=1e-3)


def test_the_load_is_linear_between_ticks() -> None:
    problem = PARTS[0]
    middle = (problem.time[3] + problem.time[4]) / 2.0
    assert load_at(problem)(float(middle)) == pytest.approx((problem.load[3] + problem.load[4]) / 2.0)
    assert load_at(problem)(float(problem.time[-1])) == pytest.approx(problem.load[-1])


def test_a_worker_says_what_a_tool_raised_or_ended_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    worker = Worker()
    problem = PARTS[0]
    try:
        with pytest.raises(FailedRunError, match="ZeroDivisionError"):
            worker.run(Task("tests.tools.work_precision.faulty", "raises", STREAM, problem, TOLERANCE), 20.0)
        with pytest.raises(LostProcessError):
            worker.run(Task("tests.tools.work_precision.faulty", "ends", STREAM, problem, TOLERANCE), 20.0)
        outcome = worker.run(Task("tests.tools.work_precision.faulty", "answers", STREAM, problem, TOLERANCE), 20.0)
        assert outcome.depth.shape == problem.time.shape
        monkeypatch.setattr(worker_module, "GRACE", 0.0)
        with pytest.raises(GivenUpError, match=r"0\.5 s"):
            worker.run(Task("tests.tools.work_precision.faulty", "hangs", STREAM, problem, TOLERANCE), 0.5)
    finally:
        worker.stop()

"""Problems, and solvers: each solves its short problem to the error that is stated here, if it is installed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np
import pytest

from benchmarks.peers import measure, ours
from benchmarks.peers.problems import Problem, exact_depth, problems, start_depth
from benchmarks.peers.scipy import contact_force, force_gradient
from knee_contact_ros.system.files import not_installed

PROBLEMS = {problem.name: problem for problem in problems()}
STEPS = measure.Setting("20 per tick", 20.0)
TOLERANCE = measure.Setting("1e-8", 1e-8)
DRIVERS = [ours.__name__, *(peer.driver for peer in measure.PEERS if peer.installed)]
ENTRIES = {entry.solver.name: entry for driver in DRIVERS for entry in measure.entries(driver)}
del ENTRIES["knee-contact quasi_static"]  # it solves other equations than the reference


def short(name: str, first: float, last: float) -> Problem:
    """A part of a problem [s]."""
    problem = PROBLEMS[name]
    part = (problem.time >= first - 1e-9) & (problem.time <= last + 1e-9)
    return problem._replace(time=problem.time[part] - problem.time[part][0], load=problem.load[part])


PARTS = [short("gait", 0.2, 0.25), short("lift-off", 0.38, 0.5), short("osteoarthritis", 0.0, 0.1)]
EXACT = [exact_depth(problem) for problem in PARTS]


def fine_setting(solver: measure.Solver) -> measure.Setting:
    """Fine enough for the errors below."""
    return STEPS if "per tick" in solver.settings[0].label else TOLERANCE


@pytest.fixture(scope="module")
def workers() -> Iterator[dict[str, measure.Worker]]:
    """A process per peer."""
    running: dict[str, measure.Worker] = defaultdict(measure.Worker)
    yield running
    for worker in running.values():
        worker.stop()


@pytest.mark.parametrize("entry", ENTRIES.values(), ids=ENTRIES)
@pytest.mark.parametrize("mode", measure.MODES)
def test_the_reference_is_met(workers: dict[str, measure.Worker], entry: measure.Entry, mode: str) -> None:
    solver = entry.solver
    run = solver.run_in(mode)
    if run is None:
        pytest.skip("not this way")
    for problem, exact in zip(PARTS, EXACT, strict=True):
        task = measure.Task(entry.driver, solver.name, mode, problem, fine_setting(solver))
        outcome = workers[solver.peer].run(task, 90.0)  # the first run of a level compiles it
        assert outcome.seconds > 0.0
        assert not outcome.note
        assert np.abs(outcome.depth - exact).max() < 2e-6


@pytest.mark.parametrize("peer", [peer for peer in measure.PEERS if not peer.installed], ids=lambda peer: peer.name)
def test_the_reference_is_met_by_what_is_absent(peer: measure.Peer) -> None:
    pytest.skip(not_installed(peer.name, peer.extra))


def test_the_law_never_pulls_and_its_gradient_is_its_slope() -> None:
    for problem in PARTS:
        force, gradient = contact_force(problem), force_gradient(problem)
        assert force(-1e-3, 1.0) == 0.0
        assert force(1e-5, -10.0) >= 0.0
        for depth in (2e-4, 7e-4):
            slope = (force(depth + 1e-9, 0.01) - force(depth - 1e-9, 0.01)) / 2e-9
            # Central differences: rounding of some 1e-13 N over 2e-9 m.
            assert gradient(depth, 0.01)[0] == pytest.approx(slope, rel=1e-3)


def test_a_worker_says_what_a_tool_raised_or_ended_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    worker = measure.Worker()
    problem = PARTS[0]
    try:
        with pytest.raises(measure.FailedRunError, match="ZeroDivisionError"):
            worker.run(measure.Task("tests.benchmarks.faulty", "raises", measure.STREAM, problem, TOLERANCE), 20.0)
        with pytest.raises(measure.LostProcessError):
            worker.run(measure.Task("tests.benchmarks.faulty", "ends", measure.STREAM, problem, TOLERANCE), 20.0)
        outcome = worker.run(
            measure.Task("tests.benchmarks.faulty", "answers", measure.STREAM, problem, TOLERANCE), 20.0
        )
        assert outcome.depth.shape == problem.time.shape
        monkeypatch.setattr(measure, "GRACE", 0.0)
        with pytest.raises(measure.GivenUpError, match=r"0\.5 s"):
            worker.run(measure.Task("tests.benchmarks.faulty", "hangs", measure.STREAM, problem, TOLERANCE), 0.5)
    finally:
        worker.stop()


@pytest.mark.parametrize("problem", PROBLEMS.values(), ids=PROBLEMS)
def test_time_increases_and_loads_are_those_of_a_knee(problem: Problem) -> None:
    assert problem.time.shape == problem.load.shape
    assert problem.time[0] == 0.0
    assert np.all(np.diff(problem.time) > 0.0)
    assert problem.load[0] > 0.0
    assert np.all(np.abs(problem.load) < 2500.0)


def test_the_reference_lifts_off_crosses_the_layer_and_bounces() -> None:
    lifted = exact_depth(PROBLEMS["lift-off"])
    assert np.count_nonzero(np.diff(np.sign(lifted))) == 2
    layered = PROBLEMS["osteoarthritis"]
    assert np.count_nonzero(np.diff(exact_depth(layered) > layered.layer_depth)) == 8
    thrown = exact_depth(PROBLEMS["impact"])
    assert np.count_nonzero(np.diff(np.sign(thrown))) >= 6


def test_runs_start_where_the_law_carries_the_first_load() -> None:
    problem = PROBLEMS["gait"]
    force = problem.stiffness * start_depth(problem) ** 1.5
    assert force == pytest.approx(problem.load[0], rel=1e-12)

"""Each solver that is installed solves its short problem; one that fails is named, and others go on."""

import csv
from collections import defaultdict

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.peers import __main__ as command
from benchmarks.peers import measure, ours
from benchmarks.peers.problems import exact_depth, problems

PROBLEMS = {problem.name: problem for problem in problems()}
STEPS = measure.Setting("20 per tick", 20.0)
TOLERANCE = measure.Setting("1e-8", 1e-8)
DRIVERS = [ours.__name__, *(peer.driver for peer in measure.PEERS if peer.installed)]
ENTRIES = {entry.solver.name: entry for driver in DRIVERS for entry in measure.entries(driver)}
del ENTRIES["knee-contact quasi_static"]  # it solves other equations than the reference


def short(name, first, last):
    """A part of a problem [s]."""
    problem = PROBLEMS[name]
    part = (problem.time >= first - 1e-9) & (problem.time <= last + 1e-9)
    return problem._replace(
        time=problem.time[part] - problem.time[part][0], load=problem.load[part]
    )


PARTS = [short("gait", 0.2, 0.25), short("lift-off", 0.38, 0.5), short("osteoarthritis", 0.0, 0.1)]
EXACT = [exact_depth(problem) for problem in PARTS]


@pytest.fixture(scope="module")
def workers():
    """A process per peer."""
    running: dict[str, measure.Worker] = defaultdict(measure.Worker)
    yield running
    for worker in running.values():
        worker.stop()


@pytest.mark.parametrize("entry", ENTRIES.values(), ids=ENTRIES)
@pytest.mark.parametrize("mode", measure.MODES)
def test_the_reference_is_met(workers, entry, mode):
    solver = entry.solver
    if solver.run_in(mode) is None:
        return
    fine = STEPS if "per tick" in solver.settings[0].label else TOLERANCE
    for problem, exact in zip(PARTS, EXACT, strict=True):
        task = measure.Task(entry.driver, solver.name, mode, problem, fine)
        outcome = workers[solver.peer].run(task)
        assert outcome.seconds > 0.0
        assert not outcome.note
        assert np.abs(outcome.depth - exact).max() < 2e-6


def test_a_sweep_tells_what_failed_and_goes_on(monkeypatch):
    monkeypatch.setattr(measure, "LIMIT", 2.0)
    rows = measure.measure([PARTS[0]], measure.entries("tests.benchmarks.faulty"), 1)
    failures = {(each.solver, each.failure) for each in rows if each.failure}
    assert failures == {
        ("raises", "ZeroDivisionError: "),
        ("ends", "ended the process"),
        ("hangs", "given up after 2 s"),
    }
    assert [each.error > 0.0 for each in rows if each.solver == "answers"] == 3 * [True]


def test_the_command_writes_its_three_files(tmp_path, monkeypatch):
    monkeypatch.setattr(command, "find_problems", lambda _names: [PARTS[0]])
    arguments = ["--output", str(tmp_path), "--problem", "gait", "--solver", "knee-contact"]
    result = CliRunner().invoke(
        command.main, [*arguments, "--solver", "scipy dop853", "--repeat", "1"]
    )
    assert result.exit_code == 0, result.output
    text = (tmp_path / "trade.md").read_text(encoding="utf-8")
    assert all(word in text for word in ("SciPy DOP853", "knee-contact dynamic", "## Solvers"))
    with (tmp_path / "trade.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {each["mode"] for each in rows} == {measure.WHOLE, measure.LOOP, measure.STREAM}
    fine = [
        each
        for each in rows
        if each["solver"] == "knee-contact dynamic" and each["setting"] == "1e-8"
    ]
    assert all(float(each["error"]) < 1e-8 for each in fine)
    assert (tmp_path / "trade.png").read_bytes().startswith(b"\x89PNG")

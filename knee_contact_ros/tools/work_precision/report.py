"""The study's page, its data, and what the terminal shows."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from knee_contact_ros.tools.work_precision import frontier, targets
from knee_contact_ros.tools.work_precision.frontier import ASKED
from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import LOOP, STREAM, WHOLE, Solver
from knee_contact_ros.tools.work_precision.steadiness import Moment
from knee_contact_ros.tools.work_precision.study import Row
from knee_contact_ros.tools.work_precision.timing import summed_up

LEVELS = (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
"""Errors [m] of the frontiers"""
TITLES = {
    WHOLE: "Whole run",
    LOOP: "Tick by tick in a loop",
    STREAM: "Every tick when its sample arrives",
}
INTRODUCTION = """
What precision costs, here and with what a user would take instead, in one run of the study. The error is the largest
difference of the signed depth (penetration, or gap) from the reference at any tick; the reference is DOP853 at 1e-12,
split at every event of the law and at every tick (at 3e-14 it differs by 2e-12 m in the problem "impact", and by less
than 2e-15 m elsewhere). Every solver starts at rest at the same static depth and goes from its coarsest setting to the
first one with an error below 1e-11 m or a run beyond 1 s.

Times are processor time of the run alone, without set-up, compilation and the building of models, in a process that
stays on one processor. All runs are timed in {repeat} turns, minutes apart, and a short run up to five times in each
(runs of 0.25 s and more in fewer turns, but two); the fastest counts. Read the ratios: times are of this machine and
this run. {noise}

Functions that a tool takes from Python are in plain Python, as users write them; those of CyRK, numbalsoda and diffrax
are compiled, by Numba or XLA, and called by what is compiled, without Python in between. Their tolerances and ours are
half a decade apart, those of the others a decade. Where a tool's own contact is another law (linear in the depth in
MuJoCo and Drake, not clamped in Exudyn, Hunt and Crossley's in OpenSim), it is not used: the law is given as a force.
The others give the depth; ours besides gives contact force, contact point and an estimate of its error, in the same
time.

There are three ways to run. *Every tick when its sample arrives*: Python has a sample and calls the tool, which carries
its state on. *Tick by tick in a loop*: the samples lie in memory, and compiled code takes one after another, none
before its time: what a user of compiled code does with a stream that reaches it without Python; our
`Stream.advance_all`. *Whole run*: all samples are known beforehand, and it may be one call. What is allowed in one way
is so in the next; a streamed run counts as a loop and a whole run, where it is the cheaper way. With the load linear
between the ticks, every tick begins with a kink: solvers with error control that step across them pay for small
tolerances, and runs that stop at every tick do not. Where a series is so smooth that a step spans many ticks, only a
whole run can make it.

Lift-off, landing and layers: the compiled tools step across them, by their error control; numbalsoda also stops at them
in whole runs ("events"), where its `solve_ivp` can. CyRK knows events from Python only (`pysolve_ivp`), where a whole
run takes nine times as long by itself, and diffrax takes longer for a run without an event than the others with them.
"""
SEE = "`trade.csv` has every run. `trade.png`:\n\n![Time per tick over error](trade.png)"
QUICKEST = "Its time over ours (less than 1x: it is the quicker one), and both times per tick in µs."
HOW_TO_READ = "In µs, of the cheapest setting, in brackets as a multiple of ours; otherwise the smallest error reached."
LONG_RUNS = (
    "One run of gait over and over, tick by tick: time per tick since the line above, and what the run holds in memory."
)
Table = list[list[str]]


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """Write all rows as a CSV file."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(Row._fields)
        writer.writerows([f"{value:.6g}" if isinstance(value, float) else value for value in row] for row in rows)


class Study(NamedTuple):
    """All that the page shows."""

    problems: Sequence[Problem]
    solvers: Sequence[Solver]
    absent: Sequence[str]
    """A sentence for every peer that is not installed"""
    rows: Sequence[Row]
    yardsticks: Sequence[float]
    """Times [s] of the same piece of work in every turn"""
    moments: Sequence[Moment]
    repeat: int
    command: str
    machine: str


def write_page(path: Path, study: Study) -> None:
    """Write the page of a study."""
    problems, rows = [problem.name for problem in study.problems], study.rows
    parts = ["# Work and precision", f"Made by `{study.command}` on {study.machine}."]
    parts += [INTRODUCTION.format(repeat=study.repeat, noise=noise(study)).strip(), SEE]
    if best := against_the_quickest(rows, problems):
        parts += [f"## Against the quickest of the others at an error of {power_of_ten(ASKED)} m", QUICKEST]
        parts += [table(("problem", *TITLES.values()), best)]
    parts += ["## Problems", table(("problem", "what happens"), [[each.name, each.about] for each in study.problems])]
    parts += ["## Solvers", table(("solvers", "the contact law"), laws(study.solvers)), *study.absent]
    if judgement := targets.judged(rows, problems):
        parts += ["## Targets", f"At an error of {power_of_ten(ASKED)} m where nothing else is said."]
        parts += [table(("target", *problems), judgement)]
    for mode, title in TITLES.items():
        parts += [f"## {title}: time per tick at an error of {power_of_ten(ASKED)} m or less", HOW_TO_READ]
        parts += [table(("solver", *problems), times_at_asked(rows, problems, mode))]
    for problem in problems:
        header = ("error [m] at most", *(power_of_ten(level) for level in LEVELS))
        for mode, title in ((mode, TITLES[mode]) for mode in (WHOLE, STREAM)):
            parts += [
                f"## {problem}, {title.lower()}: time per tick [µs]",
                table(header, frontiers(rows, problem, mode)),
            ]
    if study.moments:
        parts += [
            "## Long runs",
            LONG_RUNS,
            table(("level", "ticks", "µs per tick", "kB held"), long_runs(study.moments)),
        ]
    failures = [[row.problem, row.solver, row.mode, row.setting, row.failure] for row in rows if row.failure]
    if failures:
        parts += ["## Failed runs", table(("problem", "solver", "run", "setting", "what happened"), failures)]
    path.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def noise(study: Study) -> str:
    """A sentence on the machine's noise: how far the turns of the yardstick and those of the runs lie apart."""
    yardsticks = summed_up(study.yardsticks)
    text = (
        f"The machine's noise: a fixed loop of plain Python, timed {yardsticks.turns} times in between, took up to "
        f"{max(study.yardsticks) / yardsticks.least:.2f} times its least"
    )
    spreads = [row.spread_percent for row in study.rows if row.turns > 1]
    if not spreads:
        return f"{text}."
    middle, most = np.percentile(spreads, [50, 90])
    return (
        f"{text}; from its fastest to its slowest turn, a run's time differs by {middle:.0f} % in the median, and by "
        f"{most:.0f} % or less in nine of ten runs (`trade.csv`: `median_microseconds`, `spread_percent`, `turns`)."
    )


def power_of_ten(error: float) -> str:
    """Format an error as 1e-8."""
    return f"{error:.0e}".replace("e-0", "e-")


def table(header: Sequence[str], rows: Table) -> str:
    """Format a table in Markdown."""
    from tabulate import tabulate

    return tabulate(rows, header, tablefmt="pipe", disable_numparse=True)


def laws(solvers: Sequence[Solver]) -> Table:
    """Lines of the table of laws: one for all solvers that express the law in the same way."""
    return [[", ".join(each.name for each in solvers if each.law == law), law]
            for law in dict.fromkeys(each.law for each in solvers)]  # fmt: skip


def against_the_quickest(rows: Sequence[Row], problems: Sequence[str]) -> Table:
    """Lines of a table: one per problem, with the quickest peer of each mode, its time over ours, and both times."""
    lines = []
    for problem in problems:
        cells = []
        for mode in TITLES:
            ours, theirs = targets.split(frontier.of(rows, problem, mode))
            us, them = frontier.quickest(ours, ASKED), frontier.quickest(theirs, ASKED)
            if us is None or them is None:
                cells.append("-")
                continue
            times = them.microseconds_per_tick, us.microseconds_per_tick
            ratio = frontier.multiple(times[0] / times[1])
            cells.append(f"{ratio} ({them.solver}: {times[0]:.3g}; ours: {times[1]:.3g})")
        lines.append([problem, *cells])
    return lines if any(cell != "-" for _, *cells in lines for cell in cells) else []


def times_at_asked(rows: Sequence[Row], problems: Sequence[str], mode: str) -> Table:
    """Lines of a table: one per solver, with the time per tick at `ASKED` for every problem, or the error reached."""
    lines = []
    for solver in dict.fromkeys(row.solver for row in rows):
        mine = [row for row in rows if row.solver == solver]
        if any(frontier.of(mine, problem, mode) for problem in problems):
            lines.append([solver, *(cell(rows, mine, problem, mode) for problem in problems)])
    return lines


def cell(rows: Sequence[Row], mine: Sequence[Row], problem: str, mode: str) -> str:
    """Format time and ratio to ours of some of the rows, or the error reached."""
    runs = frontier.of(mine, problem, mode)
    time = frontier.cheapest(runs, ASKED)
    if not math.isnan(time):
        return with_ratio(time, our_time(rows, problem, mode, ASKED))
    return f"{power_of_ten(frontier.best_error(runs))} m" if runs else "-"


def short_cell(rows: Sequence[Row], name: str, problem: str, mode: str) -> str:
    """Format a cell for the terminal: ours in µs, others as a multiple of ours, or the error reached."""
    runs = [row for row in frontier.of(rows, problem, mode) if frontier.line_name(row) == name]
    time, ours = frontier.cheapest(runs, ASKED), our_time(rows, problem, mode, ASKED)
    if math.isnan(time):
        return f"{power_of_ten(frontier.best_error(runs))} m" if runs else "-"
    return f"{time:.3g} µs" if frontier.is_ours(name) or math.isnan(ours) else frontier.multiple(time / ours)


def our_time(rows: Sequence[Row], problem: str, mode: str, error: float) -> float:
    """Time per tick [µs] of the cheapest of our levels at an error [m]; nan if none reaches it."""
    return frontier.cheapest([row for row in frontier.of(rows, problem, mode) if frontier.is_ours(row.solver)], error)


def with_ratio(time: float, ours: float) -> str:
    """Format a time [µs], with its multiple of ours in brackets if ours is known."""
    return f"{time:.3g}" if math.isnan(ours) else f"{time:.3g} ({frontier.multiple(time / ours)})"


def frontiers(rows: Sequence[Row], problem: str, mode: str) -> Table:
    """Lines of a table: one per peer and per level of ours, with the cheapest time per tick at each error."""
    runs = frontier.of(rows, problem, mode)
    lines = []
    for name in frontier.line_names(runs):
        mine = [row for row in runs if frontier.line_name(row) == name]
        times = [(frontier.cheapest(mine, level), our_time(rows, problem, mode, level)) for level in LEVELS]
        lines.append([name, *("-" if math.isnan(time) else with_ratio(time, ours) for time, ours in times)])
    return lines


def long_runs(moments: Sequence[Moment]) -> Table:
    """Lines of the table of long runs: one per moment."""
    return [
        [each.level, str(each.ticks), f"{each.microseconds_per_tick:.3g}", f"{each.kilobytes:.1f}"] for each in moments
    ]

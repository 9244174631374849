"""Who is the quickest at an error, and the page that says it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.peers.measure import LOOP, MODES, STREAM, WHOLE, Row, Solver
from benchmarks.peers.ours import NAME
from benchmarks.peers.problems import Problem
from benchmarks.report import Section, save

ASKED = 1e-8
"""Error [m] at which tables and the picture compare times"""
COUNTED = {WHOLE: MODES, LOOP: (LOOP, STREAM), STREAM: (STREAM,)}
"""Modes whose runs count for a mode: a solver may know less, or be called more often, where that is cheaper"""


def of(rows: Iterable[Row], problem: str, mode: str) -> list[Row]:
    """Runs of a problem that count for a mode and did not fail; a streamed run also counts as a whole run."""
    return [
        row
        for row in rows
        if row.problem == problem and row.mode in COUNTED[mode] and not row.failure
    ]


def quickest(rows: Iterable[Row], error: float) -> Row | None:
    """The cheapest run with at most this error [m], if there is one."""
    able = [row for row in rows if row.error <= error]
    return min(able, key=lambda row: row.microseconds_per_tick) if able else None


def cheapest(rows: Iterable[Row], error: float) -> float:
    """Time per tick [µs] of the cheapest run with at most this error [m]; nan if there is none."""
    row = quickest(rows, error)
    return row.microseconds_per_tick if row else math.nan


def multiple(ratio: float) -> str:
    """Format a ratio with two digits: 6.1x, 42x, 1300x."""
    return f"{float(f'{ratio:.2g}'):g}x"


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
stays on one processor. All runs are timed in {repeat} turns, minutes apart (runs beyond 1 s in two), and a short run up
to five times in each; the fastest counts. Read the ratios: times are of this machine and this run. {noise}

Functions that a tool takes from Python are in plain Python, as users write them; those of CyRK, numbalsoda and diffrax
are compiled, by Numba or XLA, and called by what is compiled, without Python in between. Their tolerances and ours are
half a decade apart, those of SciPy a decade. The others give the depth; ours besides gives contact force, contact
point and an estimate of its error, in the same time.

There are three ways to run. *Every tick when its sample arrives*: Python has a sample and calls the tool, which carries
its state on. *Tick by tick in a loop*: the samples lie in memory, and compiled code takes one after another, none
before its time: what a user of compiled code does with a stream that reaches it without Python; our
`Stream.advance_all`. *Whole run*: all samples are known beforehand, and it may be one call. What is allowed in one way
is so in the next; a streamed run counts as a loop and a whole run, where it is the cheaper way. With the load linear
between the ticks, every tick begins with a kink: solvers with error control that step across them pay for small
tolerances, and runs that stop at every tick do not. Where a series is so smooth that a step spans many ticks, only a
whole run can make it.

All of them step across lift-off, landing and layers by their error control; ours ends its steps there.
"""
SEE = "`trade.csv` has every run. `trade.png`:\n\n![Time per tick over error](trade.png)"
QUICKEST = (
    "Its time over ours (less than 1x: it is the quicker one), and both times per tick in µs."
)
HOW_TO_READ = "In µs, of the cheapest setting, in brackets as a multiple of ours; otherwise the smallest error reached."
Table = list[list[str]]


class Study(NamedTuple):
    """All that the page shows."""

    problems: Sequence[Problem]
    solvers: Sequence[Solver]
    absent: Sequence[str]
    """A sentence for every peer that is not installed"""
    rows: Sequence[Row]
    repeat: int
    command: str
    machine: str


def write_page(path: Path, study: Study) -> None:
    """Write the page of a study."""
    problems = [problem.name for problem in study.problems]
    rows = study.rows
    asked = power_of_ten(ASKED)
    introduction = (
        f"{INTRODUCTION.format(repeat=study.repeat, noise=noise(rows)).strip()}\n\n{SEE}"
    )
    sections = [Section("", introduction, (), ())]
    if best := against_the_quickest(rows, problems):
        heading = f"Against the quickest of the others at an error of {asked} m"
        sections.append(Section(heading, QUICKEST, ("problem", *TITLES.values()), best))
    about = [[each.name, each.about] for each in study.problems]
    sections += [
        Section("Problems", "", ("problem", "what happens"), about),
        Section(
            "Solvers",
            "\n\n".join(study.absent),
            ("solvers", "the contact law"),
            laws(study.solvers),
        ),
    ]
    for mode, title in TITLES.items():
        heading = f"{title}: time per tick at an error of {asked} m or less"
        sections.append(
            Section(
                heading, HOW_TO_READ, ("solver", *problems), times_at_asked(rows, problems, mode)
            )
        )
    failures = [
        [row.problem, row.solver, row.mode, row.setting, row.failure]
        for row in rows
        if row.failure
    ]
    if failures:
        sections.append(
            Section(
                "Failed runs",
                "",
                ("problem", "solver", "run", "setting", "what happened"),
                failures,
            )
        )
    save(path, "Work and precision", study.command, sections, study.machine)


def noise(rows: Sequence[Row]) -> str:
    """A sentence on the machine's noise: how far the turns of a run lie apart."""
    spreads = [row.spread_percent for row in rows if row.turns > 1]
    if not spreads:
        return ""
    middle, most = np.percentile(spreads, [50, 90])
    return (
        f"The machine's noise: from its fastest to its slowest turn, a run's time differs by {middle:.0f} % in the "
        f"median, and by {most:.0f} % or less in nine of ten runs (`trade.csv`: `spread_percent`, `turns`)."
    )


def power_of_ten(error: float) -> str:
    """Format an error as 1e-8."""
    return f"{error:.0e}".replace("e-0", "e-")


def laws(solvers: Sequence[Solver]) -> Table:
    """Lines of the table of laws: one for all solvers that express the law in the same way."""
    return [
        [", ".join(each.name for each in solvers if each.law == law), law]
        for law in dict.fromkeys(each.law for each in solvers)
    ]


def against_the_quickest(rows: Sequence[Row], problems: Sequence[str]) -> Table:
    """Lines of a table: one per problem, with the quickest peer of each mode, its time over ours, and both times."""
    lines = []
    for problem in problems:
        cells = []
        for mode in TITLES:
            runs = of(rows, problem, mode)
            us = quickest([row for row in runs if row.peer == NAME], ASKED)
            them = quickest([row for row in runs if row.peer != NAME], ASKED)
            if us is None or them is None:
                cells.append("-")
                continue
            times = them.microseconds_per_tick, us.microseconds_per_tick
            ratio = multiple(times[0] / times[1])
            cells.append(f"{ratio} ({them.solver}: {times[0]:.3g}; ours: {times[1]:.3g})")
        lines.append([problem, *cells])
    return lines if any(cell != "-" for _, *cells in lines for cell in cells) else []


def times_at_asked(rows: Sequence[Row], problems: Sequence[str], mode: str) -> Table:
    """Lines of a table: one per solver, with the time per tick at `ASKED` for every problem, or the error reached."""
    lines = []
    for solver in dict.fromkeys(row.solver for row in rows):
        mine = [row for row in rows if row.solver == solver]
        if any(of(mine, problem, mode) for problem in problems):
            lines.append([solver, *(cell(rows, mine, problem, mode) for problem in problems)])
    return lines


def cell(rows: Sequence[Row], mine: Sequence[Row], problem: str, mode: str) -> str:
    """Format time and ratio to ours of some of the rows, or the error reached."""
    runs = of(mine, problem, mode)
    time = cheapest(runs, ASKED)
    if math.isnan(time):
        return f"{power_of_ten(min(run.error for run in runs))} m" if runs else "-"
    ours = cheapest([row for row in of(rows, problem, mode) if row.peer == NAME], ASKED)
    return f"{time:.3g}" if math.isnan(ours) else f"{time:.3g} ({multiple(time / ours)})"

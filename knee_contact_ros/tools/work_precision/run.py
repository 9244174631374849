"""The work of `knee-contact trade`: choose problems and solvers, measure, write, and show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from knee_contact_ros.system import machine
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.extras import not_installed, require
from knee_contact_ros.system.terminal import WIDTH, natural_width, progress
from knee_contact_ros.tools.work_precision import frontier, ours, plot, report, steadiness, study
from knee_contact_ros.tools.work_precision.peers import PEERS, Entry, entries
from knee_contact_ros.tools.work_precision.problems import Problem, find_problems, problems
from knee_contact_ros.tools.work_precision.study import Row

EXTRA = "trade"
FILES = ("trade.md", "trade.csv", "trade.png")
DRAWING = ("matplotlib", "tabulate")


def run_trade(output: Path, problem_names: tuple[str, ...], solver_names: tuple[str, ...], repeat: int) -> None:
    """Measure and write `trade.md`, `trade.csv` and `trade.png`.

    Args:
        output: Folder for the files.
        problem_names: Problems to solve; none: all.
        solver_names: Solvers to run, by their names' beginnings, whatever the case; none: all that are installed.
        repeat: In how many turns runs are timed.

    Raises:
        UsageError: an unknown name, or something that the report needs is not installed.
    """
    require(EXTRA, *DRAWING)
    chosen = known_problems(problem_names)
    candidates, absent = available()
    solvers = matching(candidates, solver_names)
    output.mkdir(parents=True, exist_ok=True)
    measured_on = f"{machine.describe(('numpy', *(peer.distribution for peer in PEERS)))}; {machine.business()}"
    with progress("Measuring") as advance:
        rows, yardsticks = study.measure(chosen, solvers, repeat, advance)
        levels = [
            level for level in ours.LEVELS if any(each.solver.name == ours.solver_name(level) for each in solvers)
        ]
        moments = [moment for level in levels for moment in steadiness.moments(level)]
    report.write_csv(rows, output / FILES[1])
    plot.draw(rows, output / FILES[2])
    command = " ".join(["knee-contact trade", *(f'--problem "{name}"' for name in problem_names),
                        *(f'--solver "{name}"' for name in solver_names), f"--repeat {repeat}"])  # fmt: skip
    solved_by = [each.solver for each in solvers]
    page = report.Study(chosen, solved_by, absent, rows, yardsticks, moments, repeat, command, measured_on)
    report.write_page(output / FILES[0], page)
    show(rows, chosen, absent, [output / name for name in FILES])


def known_problems(names: tuple[str, ...]) -> list[Problem]:
    """List the problems of these names.

    Raises:
        UsageError: no such problem.
    """
    try:
        return find_problems(names)
    except KeyError as error:
        known = ", ".join(f'"{problem.name}"' for problem in problems())
        raise UsageError(f"--problem {error.args[0]}: no such problem; there are {known}") from None


def available() -> tuple[list[Entry], list[str]]:
    """List our solvers and those of every installed peer, and a sentence for every peer that is not installed."""
    candidates, absent = entries(ours.__name__), []
    for peer in PEERS:
        if peer.installed:
            candidates += peer.entries()
        else:
            absent.append(not_installed(peer.name, peer.extra))
    return candidates, absent


def matching(candidates: Sequence[Entry], names: tuple[str, ...]) -> list[Entry]:
    """List the solvers whose names begin with one of these, or all solvers if there are no names.

    Raises:
        UsageError: no solver's name begins so.
    """
    for name in names:
        if not any(begins(entry, name) for entry in candidates):
            known = ", ".join(f'"{entry.solver.name}"' for entry in candidates)
            raise UsageError(f"--solver {name}: no such solver installed; there are {known}")
    return [entry for entry in candidates if not names or any(begins(entry, name) for name in names)]


def begins(entry: Entry, name: str) -> bool:
    """Whether a solver's name begins so, whatever the case."""
    return entry.solver.name.lower().startswith(name.lower())


def short_table(rows: Sequence[Row], chosen: Sequence[Problem], mode: str) -> Table:
    """Build the terminal's table: a line per level of ours and per peer, a column per problem."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("", no_wrap=True)
    for problem in chosen:
        table.add_column(problem.name, justify="right", no_wrap=True)
    for name in frontier.line_names(rows):
        table.add_row(name, *(report.short_cell(rows, name, problem.name, mode) for problem in chosen))
    return table


def batched(rows: Sequence[Row], chosen: Sequence[Problem], mode: str, width: int) -> Iterator[Table]:
    """Tables with as many problems side by side as fit a width in columns, at least one."""
    beside: list[Problem] = []
    for problem in chosen:
        if beside and natural_width(short_table(rows, [*beside, problem], mode)) > width:
            yield short_table(rows, beside, mode)
            beside = []
        beside.append(problem)
    if beside:
        yield short_table(rows, beside, mode)


def show(rows: Sequence[Row], chosen: Sequence[Problem], absent: Sequence[str], files: Sequence[Path]) -> None:
    """Print the cheapest time of ours and of every peer at `ASKED`, and where the files are."""
    console = Console()
    width = console.width if console.is_terminal else WIDTH
    wide = Console(width=max(width, WIDTH))
    subtitle = f"time per tick at {report.power_of_ten(frontier.ASKED)} m or less; peers as a multiple of ours"
    for mode, title in report.TITLES.items():
        console.print(f"{title}: {subtitle}", highlight=False, soft_wrap=True)
        for table in batched(rows, chosen, mode, width):
            wide.print(table)
    for sentence in absent:
        console.print(sentence, markup=False, highlight=False)
    for path in files:
        console.print(str(path), soft_wrap=True, highlight=False, markup=False)

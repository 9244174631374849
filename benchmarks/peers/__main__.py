"""Measure what precision costs, here and with what a user could take instead: `python -m benchmarks.peers --help`.

Work and precision of this model and of SciPy, CyRK and diffrax (the extra peers) and numbalsoda (peers-built).
Writes trade.md, trade.csv and trade.png. It takes some minutes.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import click

from benchmarks.peers import measure, ours, page, picture
from benchmarks.peers.problems import EVENTFUL, SMOOTH, find_problems
from benchmarks.report import machine, table
from knee_contact_ros.system.files import not_installed
from knee_contact_ros.system.progress import progress


def chosen_solvers(names: tuple[str, ...]) -> tuple[list[measure.Entry], list[str]]:
    """List the installed solvers whose names begin so, whatever the case, and say which tools are not installed."""
    there = [peer for peer in measure.PEERS if peer.installed]
    absent = [not_installed(peer.name, peer.extra) for peer in measure.PEERS if not peer.installed]
    known = [
        entry
        for driver in (ours.__name__, *(peer.driver for peer in there))
        for entry in measure.entries(driver)
    ]
    for name in names:
        if not any(entry.solver.name.lower().startswith(name.lower()) for entry in known):
            listed = ", ".join(dict.fromkeys(entry.solver.peer for entry in known))
            raise click.BadParameter(
                f"no solver is called {name!r}, or is not installed; there are {listed}"
            )
    begins = tuple(name.lower() for name in names) or ("",)
    return [entry for entry in known if entry.solver.name.lower().startswith(begins)], absent


@click.command(help=__doc__)
@click.option(
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default="knee_contact_trade",
    show_default=True,
    help="Folder of the three files.",
)
@click.option(
    "--problem",
    "problem_names",
    type=click.Choice(SMOOTH + EVENTFUL),
    multiple=True,
    help="Can be given several times. [default: all]",
)
@click.option(
    "--solver",
    "solver_names",
    multiple=True,
    help="Name or its beginning, as SciPy; can be repeated. [default: all that are installed]",
)
@click.option(
    "--repeat",
    type=click.IntRange(1, 100),
    default=5,
    show_default=True,
    help="In how many turns runs are timed; those that take long in two.",
)
def main(
    output: Path, problem_names: tuple[str, ...], solver_names: tuple[str, ...], repeat: int
) -> None:
    """Measure, write the three files, and print who is the quickest."""
    chosen = find_problems(problem_names)
    entries, absent = chosen_solvers(solver_names)
    solvers = [entry.solver for entry in entries]
    output.mkdir(parents=True, exist_ok=True)
    measured_on = machine(*(peer.module for peer in measure.PEERS))
    with progress("Measuring") as advance:
        rows = measure.measure(chosen, entries, repeat, advance)
    with (output / "trade.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(measure.Row._fields)
        writer.writerows(
            [f"{value:.6g}" if isinstance(value, float) else value for value in row]
            for row in rows
        )
    picture.draw(rows, output / "trade.png")
    command = " ".join(["python -m benchmarks.peers", *sys.argv[1:]])
    page.write_page(
        output / "trade.md",
        page.Study(chosen, solvers, absent, rows, repeat, command, measured_on),
    )
    names = [problem.name for problem in chosen]
    print(
        table(
            ("time per tick [µs], over ours", *page.TITLES.values()),
            page.against_the_quickest(rows, names),
        )
    )
    print(*absent, output / "trade.md", sep="\n")


if __name__ == "__main__":
    main()

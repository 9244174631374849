"""How honest the error estimates are: random runs of all kinds, judged tick by tick.

python -m studies.honesty STUDY [--count N] [--seed S] [--table FILE] [--show NUMBER]
python -m studies.honesty knobs [--part P] [--seed S]      what each tuned constant is worth, in an hour
"""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import click
from tabulate import tabulate

from knee_contact_ros.model import kernel
from studies.honesty import knobs
from studies.honesty.kinds import STUDIES, found
from studies.honesty.study import COLUMNS, Row, save, table

MOST_UNCOVERED = 0.01
"""Part of the known depths that may be uncovered"""
SEEDS = 1_000_000
"""Distance between the numbers of two seeds"""


@click.command()
@click.argument("study", type=click.Choice([*STUDIES, "knobs"]))
@click.option("--count", type=int, help="How many numbers are run.  [default: all]")
@click.option("--first", default=0, show_default=True, help="The first of them.")
@click.option("--seed", default=1, show_default=True)
@click.option(
    "--part",
    default=1.0,
    show_default=True,
    help="Part of the duration of long runs, or of the numbers of knobs.",
)
@click.option("--workers", default=2, show_default=True)
@click.option(
    "--table",
    "path",
    type=click.Path(path_type=Path),
    default=Path("docs/studies/honesty.csv"),
    show_default=True,
)
@click.option("--show", type=int, help="Print what one number is worth, and write nothing.")
def main(
    study: str,
    count: int | None,
    first: int,
    seed: int,
    part: float,
    workers: int,
    path: Path,
    show: int | None,
) -> None:
    """Judge the model, and put the counts into a table.

    Exit code 1 if an OK is wrong, a number is not finite, or less than 99 % of the known depths are covered.
    """
    if show is not None:
        click.echo(
            tabulate([one._asdict() for one in found(study, part, seed * SEEDS + show)[1]], "keys")
        )
        return
    if study == "knobs":
        knobs.write(path.with_name("knobs.csv"), knobs.lines(part, seed, workers))
        return
    numbers = [seed * SEEDS + first + i for i in range(count or STUDIES[study][1])]
    rows: list[Row] = []
    kernel.library()  # once, so that the workers do not both compile it
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        for number, some in pool.map(partial(found, study, part), numbers):
            rows += some
            for one in some:
                if one.wrong or one.forces[2] or one.not_finite:
                    click.echo(f"{number}: {one}", err=True)
    lines = table(study, rows)
    save(path, lines)
    click.echo(tabulate([one[1:] for one in lines], COLUMNS[1:]))
    uncovered = sum(one.known - one.covered for one in rows) > MOST_UNCOVERED * sum(
        one.known for one in rows
    )
    raise SystemExit(uncovered or any(one.wrong or one.not_finite for one in rows))


if __name__ == "__main__":
    main()

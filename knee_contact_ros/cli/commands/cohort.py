"""The commands on many knees: sweep, sensitivity."""

from __future__ import annotations

from pathlib import Path

import click

from knee_contact_ros.cli.options import FILE, together
from knee_contact_ros.system.files import require

on_workers = together(
    click.option("--workers", type=click.IntRange(1, 1024), help="Processes. [default: one for each processor]"),
    click.option(
        "--scheduler", default="", metavar="ADDRESS", help="Of a Dask scheduler to use instead, as tcp://host:8786."
    ),
)


@click.command()
@click.argument("study", type=FILE, metavar="STUDY.yaml")
@click.option(
    "--output", required=True, metavar="DIR",
    help="Folder of the table, a Parquet dataset, here or as fsspec spells it. What is there is not computed again.",
)  # fmt: skip
@on_workers
def sweep(study: Path, output: str, workers: int | None, scheduler: str) -> None:
    """Compute many knees.

    Bags, parameter files and values of a study, all combined: a row of outcomes for each case. A study that was
    stopped, or has grown, goes on where it is.
    """
    require("sweep", "pyarrow", "distributed", "fsspec")
    from knee_contact_ros.lab.run_study import run_sweep

    run_sweep(study, output, workers or 0, scheduler)


@click.command()
@click.argument("study", type=FILE, metavar="STUDY.yaml")
@click.option(
    "--output", required=True, metavar="DIR",
    help="Folder of page, pictures, indices.csv and cases. Cases that are there are not computed again.",
)  # fmt: skip
@on_workers
def sensitivity(study: Path, output: str, workers: int | None, scheduler: str) -> None:
    """Find out which parameters matter.

    Indices of Sobol or Morris, with intervals, of depth, pressure, bone contact and force: in a page with figures. A
    study is as for sweep, with `sensitivity` (method, n, ranges) in the place of `sample`.
    """
    require("sweep", "pyarrow", "distributed", "fsspec", "SALib", "matplotlib")
    require("report", "jinja2")
    from knee_contact_ros.lab.sensitivity_page import run_sensitivity

    run_sensitivity(study, output, workers or 0, scheduler)

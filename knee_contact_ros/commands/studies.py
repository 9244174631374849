"""Commands on many knees, and on results: sweep, sensitivity, trade, report."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import click

from knee_contact_ros.commands.options import (
    FILE,
    Output,
    find_parameters,
    names_in_bag_options,
    parameter_files,
    parameter_values,
    together,
)
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
    help="Folder of pictures, indices.csv and cases. Cases that are there are not computed again.",
)  # fmt: skip
@on_workers
def sensitivity(study: Path, output: str, workers: int | None, scheduler: str) -> None:
    """Find out which parameters matter.

    Indices of Sobol or Morris, with intervals, of depth, pressure, bone contact and force: a table and pictures. A
    study is as for sweep, with `sensitivity` (method, n, ranges) in the place of `sample`.
    """
    require("sweep", "pyarrow", "distributed", "fsspec", "SALib", "matplotlib")
    from knee_contact_ros.lab.sensitivity_study import run_sensitivity

    run_sensitivity(study, output, workers or 0, scheduler)


@click.command()
@click.argument("bag", type=FILE)
@parameter_files
@parameter_values
@names_in_bag_options()
@click.option(
    "--worth",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="METRES",
    help="Error of the depth that the measured data leave anyway. [default: what 1 % of the load makes of it]",
)
@click.option(
    "--picture",
    type=Output(".png"),
    default="knee_contact_trade.png",
    show_default=True,
    metavar="FILE.png",
    help="Picture to write; an earlier one is replaced.",
)
def trade(
    bag: Path,
    parameter_files: tuple[Path, ...],
    parameter_values: tuple[str, ...],
    remaps: tuple[str, ...],
    namespace: str,
    worth: float | None,
    picture: Path,
) -> None:
    """Show what accuracy costs on your own bag and knee.

    Computes BAG at every fidelity.level and at tolerances from 1e-3 to 1e-9 m. Prints the largest errors against the
    tightest tolerance, the cost of a tick and the share of flagged ticks, draws them, and recommends a setting. A
    recording of ours is computed with the parameters stored in it, unless --params is given.
    """
    from knee_contact_ros.lab.trade import draw, measure, show
    from knee_contact_ros.offline.notebooks import solve
    from knee_contact_ros.parameters.ros_files import parameters_of
    from knee_contact_ros.system.files import require, split
    from knee_contact_ros.system.terminal import progress, say, warn

    require("trade", "matplotlib")
    remap = dict(split(rule, "--remap") for rule in remaps)
    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always")
        results = solve(bag, parameter_files or None, parameters_of(parameter_values), remap=remap, namespace=namespace)
    with progress("Measuring") as advance:
        found = measure(results, worth, advance)
    show(found)
    draw(found, picture)
    say(f"Picture: {picture}")
    warn(str(doubt.message) for doubt in doubts)


@click.command()
@click.argument("files", nargs=-1, required=True, type=FILE, metavar="FILE...")
@click.option(
    "--output",
    type=Output(folder=True),
    default="knee_contact_report",
    show_default=True,
    metavar="DIR",
    help="Where the page, its figures and data go; those of an earlier report are replaced.",
)
@parameter_files
@parameter_values
@click.option(
    "--compare",
    "compare",
    multiple=True,
    type=FILE,
    metavar="FILE",
    help="Compute each FILE again with this parameter file over its own parameters, as --compare osteoarthritis.yaml, "
    "and show it beside. Can be given several times, the later one wins.",
)
@click.option(
    "--uncertainty",
    type=FILE,
    metavar="FILE",
    help="Show what the standard deviations in this YAML file make of depth and force, as 'contact.stiffness: 20 %'.",
)
@click.option("--label", "labels", multiple=True, metavar="TEXT", help="Name of a FILE; once for each, in their order.")
@names_in_bag_options()
def report(
    files: tuple[Path, ...],
    output: Path,
    parameter_files: tuple[Path, ...],
    parameter_values: tuple[str, ...],
    compare: tuple[Path, ...],
    uncertainty: Path | None,
    labels: tuple[str, ...],
    remaps: tuple[str, ...],
    namespace: str,
) -> None:
    """Write figures and tables that need no viewer.

    A page (report.html, which needs no other file), figures (PNG) and data (CSV). FILEs are recordings of ours, or
    bags with the inputs, which are computed with --params; several are shown side by side, as both knees. Needs
    the extra report.
    """
    from knee_contact_ros.bags.reader import names_in_bag, others_beside
    from knee_contact_ros.lab.report.page import run_report
    from knee_contact_ros.lab.report.runs import ReportOptions
    from knee_contact_ros.parameters.files import values_set_in
    from knee_contact_ros.parameters.ros_files import parameters_of
    from knee_contact_ros.system.terminal import say, warn

    values = parameters_of(parameter_values)
    sources: list[Path | dict[str, Any]] = [*find_parameters(parameter_files), *([values] if values else [])]
    if namespace:
        sets = [values_set_in(path, namespace=namespace) for path in find_parameters(parameter_files)]
        sources = [{name: value for each in [*sets, values] for name, value in each.items()}]
    given, names = bool(parameter_files or values), names_in_bag(remaps, namespace)
    compared = find_parameters(compare, None)
    for path in run_report(ReportOptions(files, labels, sources, given, compared, names, uncertainty), output):
        say(str(path))
    warn(sentence for path in files for sentence in others_beside(path))

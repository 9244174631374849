"""Commands on many knees, and on results: sweep, sensitivity, trade, report."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import click

from knee_contact_ros.commands.options import (
    FILE,
    Given,
    InBag,
    Output,
    folder_option,
    names_in_bag_options,
    number_option,
    parameter_options,
    together,
)
from knee_contact_ros.system.files import require

study_options = together(
    click.argument("study", type=FILE, metavar="STUDY.yaml"),
    click.option(
        "--output",
        required=True,
        metavar="DIR",
        help="Folder of the results, a path or an fsspec address. Cases that it holds are not computed again.",
    ),
    number_option("--workers", 1, 1024, None, "Number of processes. [default: one for each processor]"),
    click.option(
        "--scheduler",
        default="",
        metavar="ADDRESS",
        help="Use this Dask scheduler instead, for example tcp://host:8786.",
    ),
)


@click.command()
@study_options
def sweep(study: Path, output: str, workers: int | None, scheduler: str) -> None:
    """Compute many knees.

    It combines all bags, parameter files and values of a study, and writes a row of outcomes for each case, as a
    Parquet dataset. Run it again to continue a study that was stopped, or that has grown.
    """
    require("sweep", "pyarrow", "distributed", "fsspec")
    from knee_contact_ros.lab.study import Study, read_study, run_study
    from knee_contact_ros.system.terminal import say

    run_study(read_study(study, Study), output, workers or 0, scheduler)
    say(f"table: {output} (pandas.read_parquet)")


@click.command()
@study_options
def sensitivity(study: Path, output: str, workers: int | None, scheduler: str) -> None:
    """Find out which parameters matter.

    It writes the indices of Sobol or Morris, with intervals, for depth, pressure, bone contact and force, as a table
    (indices.csv) and pictures. A study is written as for sweep, with `sensitivity` (method, n, ranges) instead of
    `sample`.
    """
    require("sweep", "pyarrow", "distributed", "fsspec", "SALib", "matplotlib")
    from knee_contact_ros.lab.sensitivity import run_sensitivity

    run_sensitivity(study, output, workers or 0, scheduler)


@click.command()
@click.argument("bag", type=FILE)
@parameter_options()
@names_in_bag_options()
@number_option(
    "--worth",
    0.0,
    None,
    None,
    "Error of the depth that your measured data cause anyway. [default: that of a 1 % change of the load]",
    "METRES",
    min_open=True,
)
@click.option(
    "--picture",
    type=Output(".png"),
    default="knee_contact_trade.png",
    show_default=True,
    metavar="FILE.png",
    help="Picture to write. An earlier one is replaced.",
)
def trade(bag: Path, given: Given, in_bag: InBag, worth: float | None, picture: Path) -> None:
    """Show what accuracy costs on your own bag and knee.

    It computes BAG at every fidelity.level, with tolerances from 1e-3 to 1e-9 m. It prints and draws the largest errors
    compared with the tightest tolerance, the cost of a tick and the share of flagged ticks, and recommends a setting.
    If BAG is a recording of this package, its own parameters are used unless you give --params.
    """
    from knee_contact_ros.lab.trade import draw, measure, show
    from knee_contact_ros.offline.notebooks import solve
    from knee_contact_ros.system.files import split
    from knee_contact_ros.system.output_files import refuse_impossible
    from knee_contact_ros.system.terminal import progress, say, warn

    require("trade", "matplotlib")
    refuse_impossible(picture)
    remap = dict(split(rule, "--remap") for rule in in_bag.remaps)
    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always")
        files = given.parameter_files or None
        results = solve(bag, files, given.values(), remap=remap, namespace=in_bag.namespace)
    with progress("Measuring") as advance:
        found = measure(results, worth, advance)
    show(found)
    draw(found, picture)
    say(f"Picture: {picture}")
    warn(str(doubt.message) for doubt in doubts)


@click.command()
@click.argument("files", nargs=-1, required=True, type=FILE, metavar="FILE...")
@folder_option(
    "knee_contact_report", "Folder for the page, its figures and data. Those of an earlier report are replaced."
)
@parameter_options()
@click.option(
    "--compare",
    "compare",
    multiple=True,
    type=FILE,
    metavar="FILE",
    help="Compute each FILE again with this parameter file on top of its own parameters, and show both side by side, "
    "for example --compare osteoarthritis.yaml. Can be given several times; later files win.",
)
@click.option(
    "--uncertainty",
    type=FILE,
    metavar="FILE",
    help="YAML file with standard deviations, for example 'contact.stiffness: 20 %'. The report shows their effect on "
    "depth and force.",
)
@click.option("--label", "labels", multiple=True, metavar="TEXT", help="Name of a FILE. Once for each, in their order.")
@names_in_bag_options()
def report(files: tuple[Path, ...], output: Path, given: Given, in_bag: InBag, **options: Any) -> None:
    """Write a report: figures and tables that need no viewer.

    It writes one page (report.html, which needs no other file), figures (PNG) and data (CSV). A FILE is a recording of
    this package, or a bag with the inputs, which is computed with --params. Several files stand side by side. It needs
    the extra report.
    """
    require("report", "matplotlib", "jinja2", "pandas")
    from knee_contact_ros.bags.reader import others_beside
    from knee_contact_ros.lab.report import run_report
    from knee_contact_ros.lab.report.runs import ReportOptions
    from knee_contact_ros.parameters.files import values_set_in
    from knee_contact_ros.system.terminal import say, warn

    values = given.values()
    sources: list[Path | dict[str, Any]] = [*given.files(), *([values] if values else [])]
    if in_bag.namespace:
        sets = [values_set_in(path, namespace=in_bag.namespace) for path in given.files()]
        sources = [{name: value for each in [*sets, values] for name, value in each.items()}]
    compare = Given(options.pop("compare")).files(None)
    for path in run_report(
        ReportOptions(
            files, parameters=sources, parameters_given=any(given), compare=compare, names=in_bag.names(), **options
        ),
        output,
    ):
        say(str(path))
    warn(sentence for path in files for sentence in others_beside(path))

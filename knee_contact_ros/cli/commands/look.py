"""Commands for the eye: view, report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from knee_contact_ros.cli.options import (
    FILE,
    Output,
    find_parameters,
    names_in_bag_options,
    parameter_files,
    parameter_values,
)


@click.command()
@click.argument("sources", nargs=-1, required=True, metavar="FILE...")
@parameter_files
@parameter_values
@click.option("--save", type=Output(".rrd"), metavar="OUT.rrd", help="Write a Rerun file instead.")
@click.option("--overwrite", is_flag=True, help="Replace OUT.rrd if it exists.")
@click.option("--serve", is_flag=True, help="Serve it to browsers and viewers on this machine instead.")
@click.option(
    "--port", type=click.IntRange(1024, 65534), default=9876, show_default=True, help="For --serve; and the next one."
)
def view(
    sources: tuple[str, ...],
    parameter_files: tuple[Path, ...],
    parameter_values: tuple[str, ...],
    save: Path | None,
    overwrite: bool,
    serve: bool,
    port: int,
) -> None:
    """See recordings in Rerun.

    FILE is a recording with answers, or a bag with inputs, which is computed first. A recording of ours is drawn with
    the parameters stored in it, others with those of --params. Several knees, of one recording or of several, are seen
    side by side. FILE can also be a Rerun file, or the address that a node (rerun.mode serve) or
    --serve tells.
    """
    from knee_contact_ros.view.viewer import executable

    executable()  # before what imports its library
    from knee_contact_ros.bags.bag_files import others_beside
    from knee_contact_ros.offline.view import ViewOptions, run_view
    from knee_contact_ros.parameters.files import load_parameters
    from knee_contact_ros.system.files import parameters_of
    from knee_contact_ros.system.terminal import warn

    warn(sentence for source in sources for sentence in others_beside(Path(source)))
    parameters = load_parameters([*find_parameters(parameter_files), parameters_of(parameter_values)])
    run_view(sources, parameters, ViewOptions(save, overwrite, serve, port))


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
@names_in_bag_options
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
    from knee_contact_ros.bags.bag_files import others_beside
    from knee_contact_ros.bags.topic_names import names_in_bag
    from knee_contact_ros.system.files import parameters_of
    from knee_contact_ros.system.terminal import say, warn
    from knee_contact_ros.tools.report.run import run_report
    from knee_contact_ros.tools.report.runs import ReportOptions

    values = parameters_of(parameter_values)
    sources: list[Path | dict[str, Any]] = [*find_parameters(parameter_files), *([values] if values else [])]
    given, names = bool(parameter_files or values), names_in_bag(remaps, namespace)
    compared = find_parameters(compare, None)
    for path in run_report(ReportOptions(files, labels, sources, given, compared, names, uncertainty), output):
        say(str(path))
    warn(sentence for path in files for sentence in others_beside(path))

"""The command that measures: trade."""

from __future__ import annotations

import warnings
from pathlib import Path

import click

from knee_contact_ros.cli.options import FILE, Output, names_in_bag_options, parameter_files, parameter_values


@click.command()
@click.argument("bag", type=FILE)
@parameter_files
@parameter_values
@names_in_bag_options
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
    from knee_contact_ros.offline.in_memory import solve
    from knee_contact_ros.system.files import parameters_of, require, split
    from knee_contact_ros.system.terminal import progress, say, warn

    require("trade", "matplotlib")
    remap = dict(split(rule, "--remap") for rule in remaps)
    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always")
        results = solve(bag, parameter_files or None, parameters_of(parameter_values), remap=remap, namespace=namespace)
    with progress("Measuring") as advance:
        found = measure(results, worth, advance)
    draw(found, picture)
    show(found)
    say(f"Picture: {picture}")
    warn(str(doubt.message) for doubt in doubts)

"""Commands that measure: trade, latency."""

from __future__ import annotations

from pathlib import Path

import click

from knee_contact_ros.cli.options import Output


@click.command()
@click.option(
    "--output",
    type=Output(folder=True),
    default="knee_contact_trade",
    show_default=True,
    metavar="DIR",
    help="Where trade.md, trade.csv and trade.png go.",
)
@click.option("--problem", "problems", multiple=True, metavar="NAME", help="Can be given several times. [default: all]")
@click.option(
    "--solver",
    "solvers",
    multiple=True,
    metavar="NAME",
    help="Name or its beginning, as SciPy; can be given several times. [default: all that are installed]",
)
@click.option(
    "--repeat",
    type=click.IntRange(1, 100),
    default=5,
    show_default=True,
    help="In how many turns runs are timed; those that take long in fewer, but two.",
)
def trade(output: Path, problems: tuple[str, ...], solvers: tuple[str, ...], repeat: int) -> None:
    """Measure what precision costs.

    Work and precision of this model and of what could be taken instead (SciPy, CVODE, MuJoCo, Exudyn, Drake, OpenSim:
    the extra trade; CyRK, numbalsoda, diffrax: the extra peers). All of it takes a quarter of an hour.
    """
    from knee_contact_ros.tools.work_precision.run import run_trade

    run_trade(output, problems, solvers, repeat)


@click.command()
@click.option(
    "--output",
    type=Output(folder=True),
    default="knee_contact_latency",
    show_default=True,
    metavar="DIR",
    help="Where the pages and their data go; those of an earlier run are replaced.",
)
@click.option(
    "--rate", type=click.FloatRange(10.0, 20_000.0), default=1000.0, show_default=True, help="Samples per second."
)
@click.option(
    "--duration", type=click.FloatRange(0.5, 3600.0), default=20.0, show_default=True, help="Seconds of a run."
)
@click.option(
    "--rounds", type=click.IntRange(1, 100), default=3, show_default=True, help="How often all candidates take turns."
)
@click.option("--sustained", is_flag=True, help="Search the highest rate that each candidate sustains instead.")
@click.option(
    "--soak",
    type=click.IntRange(1, 1_000_000_000),
    metavar="TICKS",
    help="Run the node alone for so many ticks at --rate instead: its memory, and what it recorded.",
)
def latency(output: Path, rate: float, duration: float, rounds: int, sustained: bool, soak: int | None) -> None:
    """Measure the node beside a bare one.

    Latency, losses and CPU time of the node, recording and drawing, and of bare rclpy nodes that compute nothing, over
    real topics on this machine only. Writes latency.md and latency.csv (sustained.*, soak.*).
    """
    from knee_contact_ros.tools.latency.run import LatencyOptions, run_latency

    run_latency(output, LatencyOptions(rate, duration, rounds, sustained, soak or 0))

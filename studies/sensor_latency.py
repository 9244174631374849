"""From a leg's sensors to the contact: how much later the answer comes than that of the contact node alone.

    python -m studies.sensor_latency [--rate HZ] [--rounds N] [--duration S]

Three ways in turn, each started anew for every round; in all of them the contact node records. It alone, fed with the
joint reaction; the load node and it in one process (`load --with-contact`), fed with joints and ground force; the two
in a process each. Leave the machine alone meanwhile, and read the ratios.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import click
from tabulate import tabulate

from benchmarks.latency.driver import DISTRIBUTIONS, Candidate, Driver, Feed, Sample, figures, joined, ratios, running
from benchmarks.report import machine
from knee_contact_ros.streams.messages import JointState, WrenchStamped, encode_joint_state, encode_wrench_stamped
from knee_contact_ros.streams.topics import GROUND_REACTION_FORCE, JOINT_REACTION_FORCE, NANOSECONDS
from knee_contact_ros.system.files import share_folder
from knee_contact_ros.system.processes import Child, child_process
from knee_contact_ros.system.ros import private_graph

CONFIG = share_folder() / "config"
JOINTS = ("hip", "knee", "ankle")
COMMAND = ("-m", "knee_contact_ros.cli.main")


def sensor_samples(rate: float, first: int, factor: float = 1.0) -> Iterator[Sample]:
    """Joints and a ground force that vary as in walking; `factor` makes a joint reaction of the force."""
    stamp, step, number = first, round(NANOSECONDS / rate), 0
    while True:
        phase = 2.0 * math.pi * number / rate
        angles = 0.3 * math.sin(phase), 0.5 - 0.4 * math.cos(phase), 0.1 * math.sin(phase)
        force = 50.0 * math.sin(phase), factor * (400.0 + 300.0 * math.sin(phase)), 10.0
        state = JointState(stamp, "", JOINTS, angles, (), ())
        wrench = WrenchStamped(stamp, "ground", force, (0.0, 0.0, 40.0 * math.sin(phase)))
        yield Sample(stamp, encode_joint_state(state), encode_wrench_stamped(wrench))
        stamp, number = stamp + step, number + 1


class Way(NamedTuple):
    """A way from sensors to contact: the processes of its nodes."""

    candidate: Candidate
    feed: Feed


def start(commands: tuple[tuple[str, ...], ...], work: Path, patience: float) -> AbstractContextManager[Child]:
    """Start nodes, each command in a process of its own; yield the first one."""
    files = [CONFIG / "load" / "inverse_dynamics.yaml", CONFIG / "healthy.yaml"]
    rest = ["--ros-args", *(word for file in files for word in ("--params-file", str(file)))]
    rest += ["-p", f"knee_contact:record.path:={work / 'contact.mcap'}"]

    @contextmanager
    def started() -> Iterator[Child]:
        with ExitStack() as opened:
            children = [
                opened.enter_context(
                    child_process("a node", [*COMMAND, *words, *rest], work / f"{number}.log", patience)
                )
                for number, words in enumerate(commands)
            ]
            yield children[0]

    return started()


def way(name: str, *commands: tuple[str, ...], feed: Feed) -> Way:
    """A way whose processes are these commands of `knee-contact`."""
    return Way(Candidate(name, "", partial(start, commands)), feed)


REACTIONS = Feed(JOINT_REACTION_FORCE, partial(sensor_samples, factor=-2.0))
SENSORS = Feed(GROUND_REACTION_FORCE, sensor_samples)
ALONE = way("contact node alone", ("node",), feed=REACTIONS)
WAYS = (
    ALONE,
    way("load and contact, one process", ("load", "--with-contact"), feed=SENSORS),
    way("load and contact, two processes", ("load",), ("node",), feed=SENSORS._replace(peers=(2, 1, 1))),
)


def measured(one: Way, work: Path, rate: float, duration: float) -> list[int]:
    """Latencies [ns] of a run, without its first second."""
    with joined(partial(Driver, feed=one.feed)) as driver, running(one.candidate, driver, work):
        driver.run(rate, round(rate))
        return driver.run(rate, round(duration * rate)).latencies


@click.command()
@click.option("--rate", default=1000.0, help="[Hz]")
@click.option("--rounds", default=3)
@click.option("--duration", default=10.0, help="[s] of a run")
def main(rate: float, rounds: int, duration: float) -> None:
    """Measure and print the table."""
    found: dict[str, list[int]] = {one.candidate.name: [] for one in WAYS}
    with tempfile.TemporaryDirectory() as folder, private_graph() as environment:
        os.environ.update(environment)
        for number in range(rounds):
            for one in WAYS:
                name = one.candidate.name
                found[name] += measured(one, Path(folder) / f"{number} {name}", rate, duration)
    alone, rows = figures(found[ALONE.candidate.name]), []
    for name, each in found.items():
        times, parts = figures(each), ratios(figures(each), alone)
        rows.append([name, *(f"{time:.3f}" for time in times[:3]), *(f"{part:.2f}" for part in parts[:3])])
    click.echo(f"{machine(*DISTRIBUTIONS)}; {rate:g} Hz, {rounds} rounds of {duration:g} s")
    click.echo(tabulate(rows, ["", "median [ms]", "p99", "p99.9", "median over alone", "p99", "p99.9"]))


if __name__ == "__main__":
    main()

"""The costs of viewing: time within a tick, processor time beside it, and the size of a Rerun file.

python -m studies.viewing [--output FILE] [--seconds S] [--rounds N]
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.latency.driver import Snapshot, samples, snapshot
from benchmarks.report import Section, machine, save
from knee_contact_ros.bags.recorder import ABSOLUTE_NAMES
from knee_contact_ros.model.types import ROW
from knee_contact_ros.node.outputs import Listeners, Outputs
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_stream import ContactStream
from knee_contact_ros.streams.output import Knee
from knee_contact_ros.streams.topics import KNEE_CONTACT, NANOSECONDS, Ending
from knee_contact_ros.system.files import share_folder
from knee_contact_ros.system.processes import free_port
from knee_contact_ros.view.anatomy import KneeOutlines, drawing_of
from knee_contact_ros.view.output import RerunFile
from knee_contact_ros.view.scene import Scene
from knee_contact_ros.view.viewer import address, connect_command

RATE = 1000
"""Rate of the ticks [Hz]"""
LIMIT = 30.0
"""Time [µs] that viewing may add to a tick"""
WARM_UP = 1000
"""Number of ticks before the ones that count"""
OFF = "off"
HEADER = (
    "viewing",
    "median [us]",
    "mean",
    "p99",
    "p99.9",
    "median added",
    "mean added",
    "dropped",
    "viewer's CPU [us a tick]",
)
MINUTES = 10
"""Length [min] of the files that sizes are taken from"""
SIZES = ("knee", "bytes a tick", "MB an hour", "memory grows by [MB an hour]")
SIZE_TEXT = """
Files of {minutes} minutes. Rerun keeps a list of all pieces of a file in memory, for the file's end: so the process
that writes one grows, here from its second minute on.
"""
TEXT = """
Ticks at 1 kHz (healthy.yaml, compiled), taken as the node takes them: two messages decoded, paired, computed, encoded
and handed to the outputs; ROS's own part is left out. The time is that of one tick on its thread, with all that the
viewer's thread in the same process holds it up. {rounds} rounds of {seconds:g} s; the modes take turns, and the figures
are those of all rounds together. "Viewer's CPU" is the processor time of the processes beside it: the scene's own and,
where there is one, that of Rerun's viewer, which draws in software here.
"""


class Run(NamedTuple):
    """Costs of one mode of viewing."""

    times: NDArray[np.float64]
    """Time of each tick [s]"""
    dropped: int
    cpu: float
    """Processor time per tick [s] of the processes beside it"""


def pipeline_of(files: list[str]) -> tuple[ContactStream, float]:
    """Compiled pipeline of parameter files, and the body weight [N]."""
    parameters = load_parameters([share_folder() / "config" / name for name in files])
    return ContactStream(parameters, compiled=True), parameters.body_weight


def run(mode: Mapping[str, Any], looked_at: bool, seconds: float) -> Run:
    """Compute ticks at 1 kHz in a mode of viewing, and measure their cost."""
    pipeline, _ = pipeline_of(["healthy.yaml"])
    parameters = load_parameters([share_folder() / "config" / "healthy.yaml", dict(mode)])
    complaints: list[str] = []
    outputs = Outputs(
        Knee(parameters, {KNEE_CONTACT: pipeline.model}, ABSOLUTE_NAMES, {}),
        Listeners(complaints.append, complaints.append),
    )
    outputs.wait_until_known()
    with ExitStack() as stack:
        if looked_at:
            stack.enter_context(viewer(parameters.rerun.port))
        paced(pipeline, outputs, WARM_UP, NANOSECONDS)
        before, ticks = snapshot(os.getpid()), round(seconds * RATE)
        times = paced(pipeline, outputs, ticks, 2 * NANOSECONDS)
        cpu = taken_beside(before, snapshot(os.getpid())) / ticks
        dropped = sum(int(values["dropped"]) for _, values, *_ in outputs.reports())
    outputs.close(Ending((), {}))
    if complaints:
        raise RuntimeError("; ".join(complaints))
    return Run(times, dropped, cpu)


def taken_beside(before: Snapshot, after: Snapshot) -> float:
    """Processor time [s] of this process's children between two snapshots."""
    begun = {usage.process: usage.cpu for usage in before.family[1:]}
    return sum(usage.cpu - begun.get(usage.process, 0.0) for usage in after.family[1:])


def paced(pipeline: ContactStream, outputs: Outputs, ticks: int, first: int) -> NDArray[np.float64]:
    """Times [s] of ticks, one a millisecond, stamped from `first` [ns] on."""
    clock, times = time.perf_counter, np.zeros(ticks)
    gc.collect()
    gc.disable()
    begin = clock()
    for number, sample in enumerate(islice(samples(RATE, first), ticks)):
        ahead = begin + number / RATE - clock()
        if ahead > 0.0:
            time.sleep(ahead)
        start = clock()
        pairs = pipeline.take_joint_state(sample.angle) + pipeline.take_force(sample.force)
        for pair in pairs:
            message = pipeline.compute(pair)
            outputs.put(pipeline.answer(pair, message, clock() - start))
        times[number] = clock() - start
    gc.enable()
    return times


@contextmanager
def viewer(port: int) -> Iterator[None]:
    """Run Rerun's viewer without a screen, connected to a port."""
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen([*connect_command([address(port)]), "--headless"], stdout=log, stderr=log)
        time.sleep(3.0)
        try:
            yield
        finally:
            process.kill()
            process.wait()


class Size(NamedTuple):
    """Size and cost of a Rerun file."""

    tick: float
    """Size of a tick [B]"""
    growth: float
    """Memory [B] that a tick leaves behind in the process that writes it"""


def size_of(files: list[str], minutes: int, folder: Path) -> Size:
    """Write a Rerun file at 1 kHz as the node does, and measure its size."""
    ticks, first = minutes * 60 * RATE, 60 * RATE
    pipeline, weight = pipeline_of(files)
    drawing: KneeOutlines = drawing_of(pipeline.model, "knee", weight)
    outlet = RerunFile(folder / f"{'_'.join(files)}.rrd", [drawing], latency=True)
    scene = Scene(outlet.recording, drawing, latency=True)
    rows: list[bytes] = []
    begun = 0
    for number, sample in enumerate(islice(samples(RATE, NANOSECONDS), ticks)):
        if number == first:
            begun = snapshot(os.getpid()).family[0].resident
        pairs = pipeline.take_joint_state(sample.angle) + pipeline.take_force(sample.force)
        rows += [pipeline.answer(pair, pipeline.compute(pair)).row for pair in pairs]
        if len(rows) >= RATE // 2:  # what comes in the half second that a batch waits
            scene.show(np.frombuffer(b"".join(rows), ROW))
            outlet.flush()
            rows = []
    grown = snapshot(os.getpid()).family[0].resident - begun
    outlet.close()
    return Size(outlet.path.stat().st_size / ticks, grown / (ticks - first))


def modes(folder: Path, number: int) -> dict[str, tuple[dict[str, Any], bool]]:
    """Parameters of each mode, and whether a viewer is connected."""
    return {
        OFF: ({}, False),
        "file": ({"rerun.mode": "file", "rerun.path": str(folder / f"{number}.rrd")}, False),
        "served, nobody looks": ({"rerun.mode": "serve", "rerun.port": free_port()}, False),
        "served to a viewer": ({"rerun.mode": "serve", "rerun.port": free_port()}, True),
    }


@click.command()
@click.option("--output", type=click.Path(path_type=Path), default=Path("docs/studies/viewing.md"), show_default=True)
@click.option("--seconds", type=float, default=20.0, show_default=True)
@click.option("--rounds", type=int, default=3, show_default=True)
def main(output: Path, seconds: float, rounds: int) -> None:
    """Measure and write the page."""
    found: dict[str, list[Run]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in range(rounds):
            for mode, (values, looked_at) in modes(folder, number).items():
                found.setdefault(mode, []).append(run(values, looked_at, seconds))
                print(f"round {number + 1}: {mode}", file=sys.stderr)  # noqa: T201
        knees = {
            "healthy.yaml": ["healthy.yaml"],
            "osteoarthritis.yaml, mri_femur.yaml": ["osteoarthritis.yaml", "mri_femur.yaml"],
        }
        sizes = {knee: size_of(files, MINUTES, folder) for knee, files in knees.items()}
    times = {mode: 1e6 * np.concatenate([one.times for one in runs]) for mode, runs in found.items()}
    rows = []
    for mode, runs in found.items():
        median, p99, p999 = np.percentile(times[mode], [50.0, 99.0, 99.9])
        mean, cpu = times[mode].mean(), 1e6 * np.mean([one.cpu for one in runs])
        added = median - np.median(times[OFF]), mean - times[OFF].mean()
        figures = (median, mean, p99, p999, *added)
        dropped = sum(one.dropped for one in runs)
        rows.append((mode, *(f"{figure:.1f}" for figure in figures), str(dropped), f"{cpu:.0f}"))
    hour = RATE * 3600 / 1e6
    hours = [(knee, *(f"{n:.0f}" for n in (s.tick, s.tick * hour, s.growth * hour))) for knee, s in sizes.items()]
    worst = max(float(row[5]) for row in rows)
    words = f"Viewing adds {worst:.1f} us to the median tick at most; allowed are {LIMIT:g}."
    text = TEXT.format(rounds=rounds, seconds=seconds).strip()
    tables = [
        Section("Time of a tick", f"{text}\n\n{words}", HEADER, rows),
        Section("Size of a Rerun file at 1 kHz", SIZE_TEXT.format(minutes=MINUTES).strip(), SIZES, hours),
    ]
    command = f"python -m studies.viewing --seconds {seconds:g} --rounds {rounds}"
    save(output, "What viewing costs", command, tables, machine())
    if worst > LIMIT:
        raise SystemExit(1)


if __name__ == "__main__":
    main()

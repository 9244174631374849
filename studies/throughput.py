"""How long `knee-contact solve` takes for a long recording, beside merely reading and writing the same messages.

python -m studies.throughput [--output FILE] [--ticks N] [--work DIR]
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import click

from knee_contact_ros.bags.batch import Batch
from knee_contact_ros.bags.reader import INPUT_TYPES, BagReader
from knee_contact_ros.bags.writer import BagWriter
from knee_contact_ros.core.types import blank
from knee_contact_ros.messages.answer_out import encode_answer, encode_answer_wrench
from knee_contact_ros.messages.cdr import SECOND
from knee_contact_ros.messages.topics import (
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    KNEE_CONTACT,
    KNEE_CONTACT_WRENCH,
    MESSAGE_TYPES,
)
from knee_contact_ros.offline.solve import Run, solve
from knee_contact_ros.parameters.reading import load_parameters
from knee_contact_ros.system.regular_file import sha256_of
from knee_contact_ros.system.resources import share_folder
from knee_contact_ros.tools.latency.samples import samples
from studies.report import Section, machine, save

RATE = 1000
"""[Hz] of angle and force"""
PARAMETERS = share_folder() / "config" / "healthy.yaml"
MB = 1e6
HEADER = ("what", "time [s]", "over reading and writing", "times real time", "us per tick", "largest memory [MB]")
TEXT = """
A bag of {ticks} ticks at 1 kHz (an angle and a force each, {size:.0f} MB) and healthy.yaml. "Reading and writing" reads
all inputs and writes four messages a tick with `mcap`, as `solve` does, and computes nothing: the
outputs' bytes are prepared. "One by one" is `solve` without its way for whole blocks. Every row is a process of its
own; the time is that of the work, without imports, with what is compiled kept from an earlier run.
"""


def make_bag(path: Path, ticks: int) -> None:
    """The gait of the right leg, on and on."""
    with BagWriter(path) as bag:
        for topic, name in INPUT_TYPES.items():
            bag.add_topic(topic, name)
        for sample in islice(samples(RATE, SECOND), ticks):
            bag.write(f"/{JOINT_STATES}", sample.stamp, sample.angle)
            bag.write(f"/{JOINT_REACTION_FORCE}", sample.stamp, sample.force)


def read_and_write(bag: Path, output: Path) -> None:
    """All that `solve` reads and writes, and nothing else."""
    with BagReader(bag) as reader, BagWriter(output) as writer:
        for topic, name in MESSAGE_TYPES.items():
            writer.add_topic(f"/{topic}", name)
        contact, wrench = prepared()
        for topic, stamp, data in reader.raw_messages():
            writer.write(topic, stamp, data)
            if topic == f"/{JOINT_REACTION_FORCE}":
                writer.write(f"/{KNEE_CONTACT}", stamp, contact)
                writer.write(f"/{KNEE_CONTACT_WRENCH}", stamp, wrench)


def prepared() -> tuple[bytes, bytes]:
    """Bytes of an answer and of its wrench."""
    row = blank(1).tobytes()
    return encode_answer(0, "tibia_r", row), encode_answer_wrench(0, "tibia_r", row)


def solve_blocks(bag: Path, output: Path) -> None:
    """`solve` as it is."""
    solve(bag, load_parameters(PARAMETERS), output, lambda _done, _total: None)


def solve_one_by_one(bag: Path, output: Path) -> None:
    """`solve` where no block can be taken at once."""

    def refuse(_run: Run, _block: Batch) -> bool:
        return False

    Run._take_at_once = refuse  # type: ignore[assignment,method-assign]
    solve_blocks(bag, output)


WAYS: dict[str, Callable[[Path, Path], None]] = {
    "reading and writing": read_and_write,
    "solve": solve_blocks,
    "solve, one by one": solve_one_by_one,
}


def measured(way: str, bag: Path, work: Path) -> tuple[float, float, str]:
    """Time [s] and largest memory [MB] of a way, in a process of its own; and what it wrote."""
    output = work / "out" / "out.mcap"
    command = [sys.executable, "-m", "studies.throughput", "--way", way, "--work", str(work), "--bag", str(bag)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    seconds, memory = json.loads(done.stdout)
    with output.open("rb") as file:
        digest = sha256_of(file)
    output.unlink()
    return seconds, memory, digest


@click.command()
@click.option("--output", type=click.Path(path_type=Path), default="docs/studies/throughput.md", show_default=True)
@click.option("--ticks", type=click.IntRange(1000), default=3_600_000, show_default=True)
@click.option("--work", type=click.Path(path_type=Path), help="Where the bags go. [default: a temporary folder]")
@click.option("--way", type=click.Choice(list(WAYS)), hidden=True)
@click.option("--bag", type=click.Path(path_type=Path), hidden=True)
def main(output: Path, ticks: int, work: Path | None, way: str | None, bag: Path | None) -> None:
    """Measure, or be one of the processes that are measured."""
    if way and work and bag:
        begin = time.perf_counter()
        WAYS[way](bag, work / "out" / "out.mcap")
        seconds = time.perf_counter() - begin
        click.echo(json.dumps([seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / MB]))
        return
    with tempfile.TemporaryDirectory(dir=work) as folder:
        report(output, ticks, Path(folder))


def report(output: Path, ticks: int, work: Path) -> None:
    """All ways in turn, and the page."""
    bag = work / "bag.mcap"
    make_bag(bag, ticks)
    warm = work / "warm.mcap"
    make_bag(warm, 60_000)
    measured("solve", warm, work)  # compiles what is not kept yet
    measured("solve, one by one", warm, work)
    found = {}
    for way in WAYS:
        found[way] = measured(way, bag, work)
        click.echo(f"{way}: {found[way][0]:.1f} s, {found[way][1]:.0f} MB")
    least = found["reading and writing"][0]
    rows = [
        (
            way, f"{seconds:.1f}", f"{seconds / least:.2f}", f"{ticks / RATE / seconds:.0f}",
            f"{seconds / ticks * 1e6:.2f}", f"{memory:.0f}",
        )
        for way, (seconds, memory, _) in found.items()
    ]  # fmt: skip
    same = found["solve"][2] == found["solve, one by one"][2]
    text = TEXT.strip().format(ticks=ticks, size=bag.stat().st_size / MB)
    words = f"The files of both ways of `solve` are {'the same to the last byte' if same else 'NOT THE SAME'}."
    section = Section("", f"{text}\n\n{words}", HEADER, rows)
    save(output, "Throughput", f"python -m studies.throughput --ticks {ticks}", [section], machine())
    if not same:
        raise SystemExit(1)


if __name__ == "__main__":
    main()

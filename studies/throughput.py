"""How long `knee-contact solve` takes for a long recording, beside mcap reading and writing the same messages.

python -m studies.throughput [--output FILE] [--ticks N] [--rounds N] [--work DIR]
"""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import click
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from benchmarks.latency.driver import samples
from benchmarks.report import Section, machine, save
from knee_contact_ros.bags.bag import INPUT_TYPES, Bag
from knee_contact_ros.bags.mcap_writer import CHUNK_SIZE
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.model.types import blank_answers
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.messages import encode_answer, encode_answer_wrench
from knee_contact_ros.streams.topics import (
    EACH_TICK,
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    KNEE_CONTACT,
    KNEE_CONTACT_WRENCH,
    MESSAGE_TYPES,
    NANOSECONDS,
    definition,
)
from knee_contact_ros.system.files import share_folder

RATE = 1000
"""Rate of angle and force [Hz]"""
PARAMETERS = share_folder() / "config" / "healthy.yaml"
FORCES = f"/{JOINT_REACTION_FORCE}"
"""Topic of the forces, each of which is answered by a tick"""
Way = Callable[[Path, Path], int]
Message = tuple[str, int, bytes]
"""Topic, log time [ns] and bytes"""


def make_bag(path: Path, ticks: int) -> None:
    """Write a bag of the right leg's gait, over and over, with a number of ticks."""
    with BagWriter(path) as bag:
        for topic, name in INPUT_TYPES.items():
            bag.add_topic(topic, name)
        for sample in islice(samples(RATE, NANOSECONDS), ticks):
            bag.write_message(f"/{JOINT_STATES}", sample.stamp, sample.angle)
            bag.write_message(FORCES, sample.stamp, sample.force)


def solve_blocks(bag: Path, output: Path) -> int:
    """Run `solve` as it is."""
    told = [0]

    def advance(done: int, _total: int) -> None:
        told[0] = done

    with Bag(bag) as opened:
        solve(opened, load_parameters(PARAMETERS), output / "out.mcap", advance)
    return told[0]


def read_by_mcap(bag: Path, _output: Path) -> int:
    """Read a bag by mcap, without decoding."""
    return sum(1 for _ in messages_by_mcap(bag))


def copy_by_mcap(bag: Path, output: Path) -> int:
    """Read and write by mcap what `solve` does, in chunks of the same size; the answers' bytes are prepared."""
    output.mkdir()
    with (output / "out.mcap").open("wb") as file:
        writer = McapWriter(
            file, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        writer.start(profile="ros2")
        channels = {}
        for topic in EACH_TICK:
            name = MESSAGE_TYPES[topic]
            kind = writer.register_schema(name, "ros2msg", definition(name))
            channels[f"/{topic}"] = writer.register_channel(f"/{topic}", "cdr", kind)
        read = 0
        for message in messages_by_mcap(bag):
            read += 1
            for topic, time, data in with_answers(message):
                writer.add_message(channels[topic], time, data, time)
        writer.finish()  # type: ignore[no-untyped-call]
    return read


def messages_by_mcap(bag: Path) -> Iterable[Message]:
    """Messages of a bag in the order of time, read by mcap."""
    with bag.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            yield channel.topic, message.log_time, message.data


def with_answers(message: Message) -> list[Message]:
    """A message, followed by the answers that are written behind it."""
    topic, time, _ = message
    if topic != FORCES:
        return [message]
    return [message, *((answer, time, data) for answer, data in ANSWERS)]


def prepared() -> list[tuple[str, bytes]]:
    """An answer and its wrench, serialised, with their topics."""
    row, frame = blank_answers(1).tobytes(), "tibia_r"
    wrench = encode_answer_wrench(0, frame, row)
    return [
        (f"/{KNEE_CONTACT}", encode_answer(0, frame, row)),
        (f"/{KNEE_CONTACT_WRENCH}", wrench),
    ]


ANSWERS = prepared()
SOLVE = "solve"
WAYS: dict[str, Way] = {
    SOLVE: solve_blocks,
    "mcap: reading": read_by_mcap,
    "mcap: reading and writing": copy_by_mcap,
}

MB = 1e6
HEADER = (
    "what",
    "time [s]",
    "of which a processor works [s]",
    "times real time",
    "over `solve`",
    "memory [MB]",
)
TEXT = """
A bag of {ticks} ticks at 1 kHz (an angle and a force each, {size:.0f} MB) and healthy.yaml. `solve` checks, hashes and
reads the bag, computes, and writes four messages a tick. `mcap` reads the same inputs, or reads them and writes as many
messages of the same size, one by one; it checks and computes nothing. Every row is a process of its own (rounds in
turns: {rounds}; the shortest time counts); the time is that of the work, without imports, with what is compiled kept
from an earlier run; memory is the largest.
"""


class Measured(NamedTuple):
    """Time and memory of one run of a way."""

    seconds: float
    processor: float
    """Processor time [s] of all threads"""
    memory: float
    """Largest resident memory [MB]"""
    read: int
    """Number of messages read"""


def measure(way: str, bag: Path, output: Path) -> Measured:
    """Run a way in this process, and measure it."""
    begin = time.perf_counter(), time.process_time()
    read = WAYS[way](bag, output)
    seconds, processor = time.perf_counter() - begin[0], time.process_time() - begin[1]
    return Measured(
        seconds, processor, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / MB, read
    )


def measured(way: str, bag: Path, work: Path) -> Measured:
    """Measure a way in a process of its own."""
    output = work / "out"
    command = [
        sys.executable,
        "-m",
        "studies.throughput",
        "--way",
        way,
        "--work",
        str(output),
        "--bag",
        str(bag),
    ]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    shutil.rmtree(output, ignore_errors=True)
    return Measured(*json.loads(done.stdout))


@click.command()
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    default="docs/studies/throughput.md",
    show_default=True,
)
@click.option("--ticks", type=click.IntRange(1000), default=3_600_000, show_default=True)
@click.option("--rounds", type=click.IntRange(1), default=1, show_default=True)
@click.option(
    "--work",
    type=click.Path(path_type=Path),
    help="Where the bags go. [default: a temporary folder]",
)
@click.option("--way", type=click.Choice(list(WAYS)), hidden=True)
@click.option("--bag", type=click.Path(path_type=Path), hidden=True)
def main(
    output: Path, ticks: int, rounds: int, work: Path | None, way: str | None, bag: Path | None
) -> None:
    """Measure all ways, or, with the hidden options, be one of the processes that are measured."""
    if way and work and bag:
        click.echo(json.dumps(measure(way, bag, work)))
        return
    with tempfile.TemporaryDirectory(dir=work) as folder:
        report(output, ticks, rounds, Path(folder))


def report(output: Path, ticks: int, rounds: int, work: Path) -> None:
    """Measure all ways in turns, and write the page."""
    bag, warm = work / "bag.mcap", work / "warm.mcap"
    make_bag(bag, ticks)
    make_bag(warm, 60_000)
    measured(SOLVE, warm, work)  # compiles what is not kept yet
    found: dict[str, list[Measured]] = {way: [] for way in WAYS}
    for _ in range(rounds):
        for way, times in found.items():
            one = measured(way, bag, work)
            if one.read != 2 * ticks:
                raise RuntimeError(f"{way} has read {one.read} messages")
            times.append(one)
            click.echo(
                f"{way}: {one.seconds:.1f} s ({one.processor:.1f} s of processors), {one.memory:.0f} MB"
            )
    best = {way: min(times) for way, times in found.items()}
    rows = [
        (
            way,
            f"{one.seconds:.1f}",
            f"{one.processor:.1f}",
            f"{ticks / RATE / one.seconds:.0f}",
            f"{one.seconds / best[SOLVE].seconds:.1f}",
            f"{max(times.memory for times in found[way]):.0f}",
        )
        for way, one in best.items()
    ]
    text = TEXT.strip().format(ticks=ticks, size=bag.stat().st_size / MB, rounds=rounds)
    command = f"python -m studies.throughput --ticks {ticks} --rounds {rounds}"
    save(output, "Throughput", command, [Section("", text, HEADER, rows)], machine())


if __name__ == "__main__":
    main()

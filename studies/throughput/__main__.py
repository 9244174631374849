"""Measure all ways in turns, each time in a process of its own, and write the page.

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
from pathlib import Path
from typing import NamedTuple

import click

from benchmarks.report import Section, machine, save
from knee_contact_ros.system.files import sha256_of
from studies.throughput.ways import ONE_BY_ONE, RATE, SOLVE, WAYS, make_bag

MB = 1e6
HEADER = ("what", "time [s]", "of which a processor works [s]", "times real time", "over `solve`", "memory [MB]")
TEXT = """
A bag of {ticks} ticks at 1 kHz (an angle and a force each, {size:.0f} MB) and healthy.yaml. `solve` checks, hashes and
reads the bag, computes, and writes four messages a tick. `mcap` and `rosbags` read the same inputs ("decoding": make
Python objects of them), or read them and write as many messages of the same size, one by one; they check and compute
nothing. "One by one" is `solve` without its way for whole blocks. Every row is a process of its own (rounds in turns:
{rounds}; the shortest time counts); the time is that of the work, without imports, with what is compiled kept from an
earlier run; memory is the largest.
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
    return Measured(seconds, processor, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / MB, read)


def measured(way: str, bag: Path, work: Path) -> tuple[Measured, str]:
    """Measure a way in a process of its own; return a digest of what it wrote, too."""
    output = work / "out"
    command = [sys.executable, "-m", "studies.throughput", "--way", way, "--work", str(output), "--bag", str(bag)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    digest = ""
    if way in (SOLVE, ONE_BY_ONE):
        with (output / "out.mcap").open("rb") as file:
            digest = sha256_of(file)
    shutil.rmtree(output, ignore_errors=True)
    return Measured(*json.loads(done.stdout)), digest


@click.command()
@click.option("--output", type=click.Path(path_type=Path), default="docs/studies/throughput.md", show_default=True)
@click.option("--ticks", type=click.IntRange(1000), default=3_600_000, show_default=True)
@click.option("--rounds", type=click.IntRange(1), default=1, show_default=True)
@click.option("--work", type=click.Path(path_type=Path), help="Where the bags go. [default: a temporary folder]")
@click.option("--way", type=click.Choice(list(WAYS)), hidden=True)
@click.option("--bag", type=click.Path(path_type=Path), hidden=True)
def main(output: Path, ticks: int, rounds: int, work: Path | None, way: str | None, bag: Path | None) -> None:
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
    for way in (SOLVE, ONE_BY_ONE):
        measured(way, warm, work)  # compiles what is not kept yet
    found: dict[str, list[Measured]] = {way: [] for way in WAYS}
    digests = set()
    for _ in range(rounds):
        for way, times in found.items():
            one, digest = measured(way, bag, work)
            if one.read != 2 * ticks:
                raise RuntimeError(f"{way} has read {one.read} messages")
            times.append(one)
            digests |= {digest} - {""}
            click.echo(f"{way}: {one.seconds:.1f} s ({one.processor:.1f} s of processors), {one.memory:.0f} MB")
    best = {way: min(times) for way, times in found.items()}
    rows = [
        (
            way, f"{one.seconds:.1f}", f"{one.processor:.1f}", f"{ticks / RATE / one.seconds:.0f}",
            f"{one.seconds / best[SOLVE].seconds:.1f}", f"{max(times.memory for times in found[way]):.0f}",
        )
        for way, one in best.items()
    ]  # fmt: skip
    same = len(digests) == 1
    text = TEXT.strip().format(ticks=ticks, size=bag.stat().st_size / MB, rounds=rounds)
    words = f"The files of both ways of `solve` are {'the same to the last byte' if same else 'NOT THE SAME'}."
    section = Section("", f"{text}\n\n{words}", HEADER, rows)
    save(output, "Throughput", f"python -m studies.throughput --ticks {ticks} --rounds {rounds}", [section], machine())
    if not same:
        raise SystemExit(1)


if __name__ == "__main__":
    main()

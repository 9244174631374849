"""Random disturbances of the stamps: what every good sample gets, against a plain account of what it must get.

python -m studies.pairing [--disturbances N] [--minutes N] [--seed S] [--output FILE]
"""

from __future__ import annotations

import math
import multiprocessing
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import click

from benchmarks.report import Section, machine, save
from studies.pairing.judging import IN_A_WORLD, Breach, Judged, judged
from studies.pairing.world import KINDS, LATENCIES, MAX_GAP, MS, PERIODS, WAIT

SHOWN = 3
"""Number of breaches of a world that are shown"""
TEXT = f"""\
Two sensors with periods of {", ".join(f"{p / MS:g}" for p in PERIODS)} ms, a jitter of 20 %, latencies of
{", ".join(f"{t / MS:g}" for t in LATENCIES)} ms and clocks of their own; `pairing.max_gap` and `pairing.wait` of
{MAX_GAP / MS:g} and {WAIT / MS:g} ms. Disturbances come one by one, or three of them within a fraction of `max_gap`.
The first ones come after three, six or 24 samples of the slower stream.

Breaches, of which there must be none: a good force that is not answered, or twice; an answer without a flag whose angle
is not that between two good neighbours; a good angle that is not recorded; a wrong force that is answered without a
flag; an answer that is flagged, or comes later than its angle, although all disturbances had time to heal: `max_gap`,
one sample, and what is on its way or waits. While three disturbances come upon each other, good samples may be lost.

Lost are good samples whose clock was set back by less than `max_gap`, so that they seem late, and forces before the
first angle. A stamp that is less than three steps ahead, or not ahead of the other stream, is no surprise to a pairing,
and not among the disturbances. Nor is a wrong force
at the time of angles whose clock is wrong by as much, or of a clock that has just been set and had no time to heal.
Clocks of both that are set back right after a pause, to just behind what was there before it, make it a shorter one.

If three wrong stamps in a row have by chance the time to which the other stream's clock is set just then, both streams
agree, and both are believed. These are counted as breaches."""
HEADER = (
    "disturbance",
    "times",
    "breaches",
    "answers flagged, per time",
    "good samples lost, per time",
)


class Sum:
    """Sums over many worlds."""

    def __init__(self) -> None:
        self.breaches: list[tuple[int, Breach]] = []
        self.disturbances: Counter[str] = Counter()
        self.flagged: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()

    def add(self, seed: int, judged: Judged) -> None:
        """Add the judgement of a world."""
        self.breaches += [(seed, breach) for breach in judged.breaches]
        self.disturbances += judged.disturbances
        self.flagged += judged.flagged
        self.lost += judged.lost

    def row(self, kind: str) -> list[str]:
        """Row of the table for a kind of disturbance."""
        times = max(self.disturbances[kind], 1)
        breaches = sum(breach.kind == kind for _, breach in self.breaches)
        return [
            kind.replace("_", " "),
            str(self.disturbances[kind]),
            str(breaches),
            f"{self.flagged[kind] / times:.2f}",
            f"{self.lost[kind] / times:.2f}",
        ]


@click.command()
@click.option("--disturbances", default=100_000, show_default=True)
@click.option(
    "--minutes", default=math.inf, help="Stop after so long; the page tells how far it came."
)
@click.option("--seed", default=0, show_default=True)
@click.option("--workers", default=2, show_default=True)
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    default=Path("docs/studies/pairing.md"),
    show_default=True,
)
def main(disturbances: int, minutes: float, seed: int, workers: int, output: Path) -> None:
    """Measure and write the table."""
    seeds, total, end = (
        range(seed, seed + disturbances // IN_A_WORLD),
        Sum(),
        time.monotonic() + 60.0 * minutes,
    )
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        for number, found in pool.map(judged, seeds, chunksize=20):
            total.add(number, found)
            for breach in found.breaches[:SHOWN]:
                click.echo(
                    f"seed {number}: {breach.what} ({breach.kind}): {breach.arrival}", err=True
                )
            if time.monotonic() > end:
                pool.shutdown(wait=False, cancel_futures=True)
                break
    command = (
        f"python -m studies.pairing --disturbances {total.disturbances.total()} --seed {seed}"
    )
    save(
        output,
        "Pairing",
        command,
        [Section("", TEXT, HEADER, [total.row(kind) for kind in KINDS])],
        machine(),
    )


if __name__ == "__main__":
    main()

"""OK means right, for hours: long runs of both shipped knees and of nearly undamped ones, against the reference.

python -m studies.long_runs [--part P] [--level LEVEL] [--output FILE]
"""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from benchmarks.report import Section, machine, save
from studies.honesty.judging import Judged, judge
from studies.honesty.loads import STRIDE, bag
from studies.honesty.ours import knee
from studies.honesty.scenes import ARTHRITIC, FEMUR, HEALTHY, KNEE, Scene, shipped
from studies.honesty.study import LEVELS
from studies.honesty.tally import Tally, not_finite, percentile
from studies.honesty.truth import knee_of
from studies.reference import Reference

Floats = NDArray[np.float64]
Random = np.random.Generator
Drive = Callable[[Random, Floats], tuple[Floats, Floats]]
"""Flexion angles [rad] and loads [N] as a function of times [s], shape (n,) each"""
HOUR = 3600.0
TOLERANCE = 1e-6
CHUNK = 50_000
"""Number of ticks that are compared at a time"""
WORKERS = 2
TEXT = (
    f"A tolerance of {TOLERANCE:.0e} m, without a break from the static start on, in comparison with "
    "`studies/reference`. Wrong: status OK and an error beyond the tolerance, or an estimate that is not finite. "
    "Known and covered as in [how honest the error estimates are](honesty.md); a nearly undamped knee that bounces "
    "is chaotic: after some time nobody knows where it is, and the share of known ticks says so."
)
HEADER = (
    "run", "hours", "rate [Hz]", "ticks", "said right and wrong", "first at [s]", "not finite", "flagged",
    "largest error said right [m]", "known", "covered", "of errors above rounding",
    "estimate over error in contact: median, 95 %", "apart", "force: covered", "estimate over error: median, 95 %",
    "evaluations per tick",
)  # fmt: skip


class LongRun(NamedTuple):
    """A knee, and the angles and loads that drive it."""

    name: str
    law: str
    arguments: dict[str, Any]
    hours: float
    rate: float
    """Number of ticks per second"""
    drive: Drive


class Found(NamedTuple):
    """Result of a run."""

    tally: Tally
    not_finite: int
    first_wrong: float
    """Time [s] of the first tick that is wrong and said to be right; nan if there is none"""
    largest: float
    """Largest error [m] of the known ticks that are said to be right"""


def walking(_random: Random, time: Floats) -> tuple[Floats, Floats]:
    """The recorded gait, stride after stride, of slowly changing strength."""
    stamps, angle, load = bag("right")
    phase = 0.62 + np.mod(time, STRIDE)
    strength = 1.0 + 0.2 * np.sin(math.tau * time / 97.0) + 0.1 * np.sin(math.tau * time / 13.7)
    return np.interp(phase, stamps, angle), strength * np.interp(phase, stamps, load)


def lifting_off(random: Random, time: Floats) -> tuple[Floats, Floats]:
    """The recorded gait less 150 N, so that the knee lifts off in swing."""
    angle, load = walking(random, time)
    return angle, load - 150.0


def running(random: Random, time: Floats) -> tuple[Floats, Floats]:
    """Strides of 0.7 s: half sines of 0.26 s, up to three body weights' share, and no load or a slight pull between."""
    stride = np.floor(time / 0.7).astype(int)
    peak = random.uniform(1000.0, 1500.0, int(stride[-1]) + 1)[stride]
    aerial = random.choice([0.0, -5.0, -20.0], int(stride[-1]) + 1)[stride]
    phase = np.mod(time, 0.7)
    load = np.where(phase < 0.26, peak * np.sin(math.pi * np.minimum(phase / 0.26, 1.0)), aerial)
    return 0.5 + 0.4 * np.sin(math.tau * time / 0.7), load


def held_in_swing(random: Random, time: Floats) -> tuple[Floats, Floats]:
    """The recorded gait less 150 N, with muscles that press between the strides by 5 to 80 N: lift-offs of 0.1 mm."""
    angle, load = running(random, time)
    stride = np.floor(time / 0.7).astype(int)
    return angle, np.maximum(load, random.choice([5.0, 10.0, 20.0, 40.0, 80.0], int(stride[-1]) + 1)[stride])


def wandering(random: Random, time: Floats) -> tuple[Floats, Floats]:
    """A load that wanders about 400 N within some 0.1 s, and pulls at times."""
    step = float(time[1] - time[0])
    keep = math.exp(-step / 0.1)
    noise = random.standard_normal(len(time)) * math.sqrt(1.0 - keep * keep)
    return 0.4 + 0.3 * np.sin(3.0 * time), 400.0 + 300.0 * lfilter([1.0], [1.0, -keep], noise)


def shaken(_random: Random, time: Floats) -> tuple[Floats, Floats]:
    """Four swings a second that pull at their end: the scene of a known failure, of which 20 s were enough."""
    return np.zeros(len(time)), 300.0 + 350.0 * np.cos(8.0 * math.pi * time)


def thrown(_random: Random, time: Floats) -> tuple[Floats, Floats]:
    """A knee that is released for 20 ms every ten seconds, and pressed by 200 N: it bounces until it rests."""
    return np.full(len(time), 0.3), np.where(np.mod(time, 10.0) < 0.02, -100.0, 200.0)


def long_runs() -> Iterator[LongRun]:
    """List all runs."""
    soft = KNEE | {"damping": 20.0}
    impact = {"stiffness": KNEE["stiffness"], "exponent": 1.5, "restitution": 0.97, "least_impact_speed": 0.1}
    for family in (HEALTHY, ARTHRITIC):
        law, arguments = shipped(family)
        yield LongRun(f"{family}, gait", law, arguments, 1.0, 200.0, walking)
        yield LongRun(f"{family}, gait with lift-offs", law, arguments, 1.0, 200.0, lifting_off)
        yield LongRun(f"{family}, gait with lift-offs", law, arguments, 0.5, 1000.0, lifting_off)
        yield LongRun(f"{family}, running", law, arguments, 1.0, 200.0, running)
        yield LongRun(f"{family}, running", law, arguments, 0.5, 1000.0, running)
        yield LongRun(f"{family}, running, held in swing", law, arguments, 0.5, 200.0, held_in_swing)
        yield LongRun(f"{family}, running, held in swing", law, arguments, 0.25, 1000.0, held_in_swing)
        yield LongRun(f"{family}, wandering load", law, arguments, 0.5, 500.0, wandering)
        yield LongRun(f"{family}, shaken", law, arguments, 0.5, 1000.0, shaken)
        yield LongRun(f"{family}, thrown", law, arguments, 0.25, 1000.0, thrown)
    yield LongRun("Kelvin-Voigt, 20 N s/m, thrown", "kelvin_voigt", soft, 0.25, 1000.0, thrown)
    yield LongRun("Hunt-Crossley, e = 0.97, thrown", "hunt_crossley", impact, 0.25, 1000.0, thrown)
    yield LongRun("Hertz, gait", "hertz", {key: KNEE[key] for key in ("stiffness", "exponent")}, 0.25, 200.0, walking)
    yield LongRun("Hertz, thrown", "hertz", {key: KNEE[key] for key in ("stiffness", "exponent")}, 0.1, 1000.0, thrown)


def scene_of(run: LongRun, part: float, seed: int) -> Scene:
    """Scene of a part of a run's duration."""
    count = max(int(run.hours * HOUR * run.rate * part), 2000)
    time = np.rint(np.arange(count) * (1e9 / run.rate)) * 1e-9
    angle, load = run.drive(np.random.default_rng((seed, 17)), time)
    return Scene(seed, run.name, run.law, run.arguments, FEMUR, (0.034, 0.030), 0.0, False, "", time, angle, load)


def measured(run: LongRun, part: float, seed: int, level: str) -> Found:
    """Compare a run at a level chunk by chunk."""
    scene = scene_of(run, part, seed)
    truth, stream = Reference(knee_of(scene)), knee(scene, level, TOLERANCE).stream()
    stamps = np.rint(scene.time * 1e9).astype(np.int64)
    tally, lost, first, largest = Tally(), 0, math.nan, 0.0
    for begin in range(0, len(stamps), CHUNK):
        here = slice(begin, begin + CHUNK)
        answers = stream.advance_all(stamps[here], scene.angle[here], scene.load[here], None)
        series = answers.view(np.recarray)
        judged = judge(series, truth.take(scene.time[here], scene.angle[here], scene.load[here]), TOLERANCE)
        tally.count(judged)
        lost += not_finite(series)
        if math.isnan(first) and judged.depth.wrong.any():
            first = float(scene.time[here][np.argmax(judged.depth.wrong)])
        largest = max(largest, _largest(judged))
    return Found(tally, lost, first, largest)


def _largest(judged: Judged) -> float:
    chosen = judged.depth.error[judged.depth.known & judged.said_right]
    return float(chosen.max()) if len(chosen) else 0.0


def row(run: LongRun, found: Found) -> list[str]:
    """Row of the table for a run."""
    tally, depth, force = found.tally, found.tally.depth, found.tally.force

    def ratios(histogram: NDArray[np.int64]) -> str:
        return f"{percentile(histogram, 50):.3g}, {percentile(histogram, 95):.3g}" if histogram.any() else "-"

    return [
        run.name, f"{tally.ticks / run.rate / HOUR:.3g}", f"{run.rate:g}", str(tally.ticks), str(depth.wrong),
        "-" if math.isnan(found.first_wrong) else f"{found.first_wrong:.3f}", str(found.not_finite),
        f"{100 * tally.flagged / tally.ticks:.2f} %", f"{found.largest:.1e}",
        f"{100 * depth.known / tally.ticks:.2f} %", f"{100 * depth.covered / max(depth.known, 1):.3f} %",
        f"{100 * depth.covered_large / max(depth.large, 1):.3f} %",
        ratios(depth.contact), ratios(depth.apart),
        f"{100 * force.covered / force.known:.3f} %" if force.known else "-", ratios(force.contact + force.apart),
        f"{tally.evaluations / tally.ticks:.1f}",
    ]  # fmt: skip


def total_row(found: list[tuple[LongRun, Found]]) -> list[str]:
    """Last row of the table: hours and ticks of all runs, and what was wrong in them."""
    hours = sum(one.tally.ticks / run.rate / HOUR for run, one in found)
    ticks = sum(one.tally.ticks for _, one in found)
    wrong = sum(one.tally.depth.wrong for _, one in found)
    lost = sum(one.not_finite for _, one in found)
    return ["all", f"{hours:.3g}", "", str(ticks), str(wrong), "", str(lost), *[""] * (len(HEADER) - 7)]


@click.command()
@click.option("--part", default=1.0, show_default=True, help="Part of each run's duration.")
@click.option("--level", type=click.Choice(LEVELS), default="dynamic", show_default=True)
@click.option("--output", type=click.Path(path_type=Path), default=Path("docs/studies/long_runs.md"), show_default=True)
def main(part: float, level: str, output: Path) -> None:
    """Measure and write the table."""
    runs = list(long_runs())
    found: list[tuple[LongRun, Found]] = []
    with ProcessPoolExecutor(WORKERS, multiprocessing.get_context("spawn")) as workers:
        results = workers.map(measured, runs, [part] * len(runs), range(len(runs)), [level] * len(runs))
        for run, one in zip(runs, results, strict=True):
            found.append((run, one))
            click.echo(" | ".join(row(run, one)), err=True)
    rows = [row(run, one) for run, one in found] + [total_row(found)]
    command = (
        "python -m studies.long_runs"
        + (f" --part {part:g}" if part != 1.0 else "")
        + f" --level {level}" * (level != "dynamic")
    )
    save(output, f"Long runs at level {level}", command, [Section("", TEXT, HEADER, rows)], machine())


if __name__ == "__main__":
    main()

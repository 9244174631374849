"""The dearest tick that a search finds, by surface, tick and budget: what a loop must allow for.

python -m studies.worst_tick [--output FILE] [--motions N] [--seed N]
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from benchmarks.report import Section, machine, save
from knee_contact_ros import load_model
from knee_contact_ros.model.knee import BUDGET, KneeModel
from knee_contact_ros.model.run_state import STATE_SIZE
from knee_contact_ros.model.types import blank_answers
from studies.honesty.cut import pair

BUDGETS = (100, 1000, BUDGET)
DURATIONS = (0.001, 0.005, 0.02, 0.1)
"""Ticks [s]"""
TICKS = 30
"""Ticks of a motion"""
REPEATS = 5
"""Number of times that a tick is timed; the least counts"""
FRESH = 0.3
"""Part of the motions that are drawn anew; the others are the dearest one until then, changed"""
KEPT = 0.8
"""Part of a motion's samples that a change leaves as they are"""
FASTEST, STRONGEST = 15.0, 3000.0
"""Largest rate of the angle [rad/s] and largest load [N] of a motion: beyond those of running"""
HEADER = ("knee", "tick", *(f"budget {budget}" for budget in BUDGETS))
TEXT = """
Each cell: evaluations and probes of the dearest tick of {motions} motions of {ticks} ticks, and the longest time of
such ticks in µs. A motion is drawn at random, up to {fastest:g} rad/s and {strongest:g} N, with loads that vanish or
pull, or is the dearest one until then with one sample in five changed. So this is no bound; the budget is. An
evaluation searches the surfaces once: the time of the dearest one is in the last table. A tick is timed {repeats}
times, warm, and the least time counts.
"""


class Dearest(NamedTuple):
    """The dearest tick of a motion."""

    evaluations: int
    seconds: float
    samples: np.ndarray
    """The motion, as `KneeModel.compute` takes it"""


def knees() -> Iterator[tuple[str, KneeModel]]:
    """Shipped knees, and two with dents of 0.1 mm, by what they are."""
    yield "circle on plane (`healthy`)", load_model("healthy", compiled=True)
    yield "circle, two layers (`osteoarthritis`)", load_model("osteoarthritis", compiled=True)
    yield "condyle on plane (`mri_femur`)", load_model("mri_femur", compiled=True)
    measured = load_model("mri_knee", compiled=True)
    yield "condyle on plateau (`mri_knee`)", measured
    for name in ("dents on slope", "dents on plateau"):
        yield name, replace(measured, pair=pair(name, False))


def drawn(random: np.random.Generator, duration: float) -> np.ndarray:
    """Draw a motion; its samples have shape (n, 4)."""
    step = duration * FASTEST * 10.0 ** random.uniform(-3.0, 0.0)
    angle = random.uniform(0.0, 1.4) + np.cumsum(step * random.uniform(-1.0, 1.0, TICKS))
    load = 10.0 ** random.uniform(-2.0, np.log10(STRONGEST)) * random.random(TICKS)
    load[random.random(TICKS) < random.choice([0.0, 0.2])] *= -0.1
    return samples_of(duration, angle, load)


def samples_of(duration: float, angle: Any, load: Any) -> np.ndarray:
    """Return samples of a motion that stays within a knee's range."""
    reach = duration * FASTEST
    angle = np.clip(angle, 0.0, 2.0)
    for i in range(1, TICKS):
        angle[i] = np.clip(angle[i], angle[i - 1] - reach, angle[i - 1] + reach)
    return np.column_stack(
        [np.full(TICKS, duration), angle, np.minimum(load, STRONGEST), np.full(TICKS, np.nan)]
    )


def changed(random: np.random.Generator, samples: np.ndarray) -> np.ndarray:
    """Return a motion with some of its samples changed."""
    duration, angle, load = float(samples[0, 0]), samples[:, 1].copy(), samples[:, 2].copy()
    new = random.random(TICKS) > KEPT
    angle[new] += duration * FASTEST * random.normal(0.0, 0.3, int(new.sum()))
    load[new] *= 10.0 ** random.normal(0.0, 0.5, int(new.sum()))
    return samples_of(duration, angle, load)


def dearest(knee: KneeModel, samples: np.ndarray) -> Dearest:
    """Run a motion, and time its dearest tick."""
    answers, state, before = blank_answers(TICKS), np.zeros(STATE_SIZE), np.zeros(STATE_SIZE)
    knee.compute(samples, answers)
    at, least = int(answers["evaluations"].argmax()), np.inf
    knee.compute(samples[:at], answers[:at], before)
    run = knee.kernel.bind(state, samples[at : at + 1], answers[at : at + 1])
    for _ in range(REPEATS):
        state[:] = before
        begin = time.perf_counter()
        run()
        least = min(least, time.perf_counter() - begin)
    return Dearest(int(answers["evaluations"][at]), least, samples)


def search(knee: KneeModel, duration: float, motions: int, seed: int) -> list[Dearest]:
    """Return the dearest ticks of all motions that are tried, the dearest one last."""
    random = np.random.default_rng((61, seed))
    found: list[Dearest] = []
    for _ in range(motions):
        fresh = not found or random.random() < FRESH
        samples = drawn(random, duration) if fresh else changed(random, found[-1].samples)
        one = dearest(knee, samples)
        found.append(one)
        found.sort(key=lambda tick: tick.evaluations)
    return found


@click.command()
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    default="docs/studies/worst_tick.md",
    show_default=True,
)
@click.option("--motions", type=click.IntRange(1), default=60, show_default=True)
@click.option("--seed", default=1, show_default=True)
def main(output: Path, motions: int, seed: int) -> None:
    """Search all knees, and write the page."""
    rows, costs = [], []
    for name, knee in knees():
        dear = 0.0
        for duration in DURATIONS:
            cells = []
            for budget in BUDGETS:
                found = search(replace(knee, budget=budget), duration, motions, seed)
                worst = found[-1]
                dear = max(
                    [
                        dear,
                        *(one.seconds / one.evaluations for one in found if one.evaluations > 20),
                    ]
                )
                slowest = max(one.seconds for one in found)
                cells.append(f"{worst.evaluations}; {1e6 * slowest:.0f} µs")
            rows.append((name, f"{1e3 * duration:g} ms", *cells))
            click.echo(" | ".join(rows[-1]))
        costs.append((name, f"{1e6 * dear:.2f}"))
    text = TEXT.strip().format(
        motions=motions, ticks=TICKS, fastest=FASTEST, strongest=STRONGEST, repeats=REPEATS
    )
    sections = [
        Section("", text, HEADER, rows),
        Section("The dearest evaluation", "", ("knee", "µs for each evaluation"), costs),
    ]
    command = f"python -m studies.worst_tick --motions {motions} --seed {seed}"
    save(output, "The dearest tick", command, sections, machine())


if __name__ == "__main__":
    main()

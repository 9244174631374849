"""A budget is a bound, and whatever is lost by it is told: loads that pull, on both knees, and femurs that turn.

python -m studies.budgets [--output FILE]
"""

from __future__ import annotations

import itertools
import math
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from benchmarks.report import Section, machine, save
from studies.honesty.judging import judge
from studies.honesty.ours import model
from studies.honesty.scenes import ARTHRITIC, FEMUR, HEALTHY, Scene, draw, shipped
from studies.honesty.scenes import TICKS as DRAWN
from studies.honesty.tally import Tally, not_finite, percentile
from studies.honesty.truth import reference

BUDGETS = (100, 200, 400, 1000)
PULLS = (1.02, 1.1, 1.2, 1.4, 1.7, 2.0)
"""Ratios of the load's swing to its mean; above 1 the load pulls at times"""
MEANS = (300.0, 1000.0, 2000.0)
"""Mean loads [N]"""
FREQUENCIES = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Frequencies [Hz]"""
TOLERANCE = 1e-6
TICKS = 1500
"""Number of ticks, each of 1 ms"""
TURNING = "turning"
TURNS = 360
"""Number of scenes of random knees whose surface turns under them"""
SEED = 3_000_000
STEPS = 10
"""Number of ticks in which an angle is held every other half"""
WORKERS = 2
TEXT = (
    "Loads of mean (1 + pull sin 2πft) N for 1.5 s at 1 kHz on the shipped knees: pulls of 1.02 to 2, means of 300 to "
    "2000 N, 0.5 to 8 Hz. Wrong: status OK and an error beyond 1e-6 m, or an estimate that is not finite, against "
    "`studies/reference`. A tick that would take more is answered statically and flagged, and so are all after it "
    "until the contact has forgotten the difference. Known and covered as in [how honest the error estimates are]"
    "(honesty.md)."
)
HEADER = (
    "budget", "scenes", "ticks", "most evaluations of a tick", "ticks over budget", "not finite", "flagged",
    "answered statically", "said right and wrong", "in scenes", "worst of them [m]", "known", "covered",
    "estimate over error: median, 95 %", "force: covered", "estimate over error: median, 95 %",
)  # fmt: skip


TURNING_TEXT = (
    f"The knees of {TURNS} seeds from {SEED} of [how honest the error estimates are](honesty.md), with angles that "
    "wander, swing or stop, under loads that stay, end or are theirs: the surface kicks a femur that next to nothing "
    "presses, and a tick of 100 or 200 evaluations is often given up at its very beginning."
)


class Found(NamedTuple):
    """Result of one run."""

    family: str
    budget: int
    tally: Tally
    most: int
    """Largest number of evaluations in a tick"""
    over: int
    """Number of ticks over budget"""
    not_finite: int
    """Number of ticks with a depth, force or estimate that is not finite"""
    worst: float
    """Largest error [m] that is said to be within the tolerance and is not"""


def scenes() -> Iterator[Scene]:
    """Scenes of shipped knees under loads that pull: 180, for each budget."""
    time = np.rint(np.arange(TICKS) * 1e6) * 1e-9
    for family, pull, mean, frequency in itertools.product((HEALTHY, ARTHRITIC), PULLS, MEANS, FREQUENCIES):
        law, arguments = shipped(family)
        load = mean * (1.0 + pull * np.sin(math.tau * frequency * time))
        name = f"{mean:g} N, {pull:g}, {frequency:g} Hz"
        angle = np.zeros(TICKS)
        yield Scene(0, family, law, arguments, FEMUR, (0.034, 0.034), 0.0, False, name, time, angle, load)


def turning() -> Iterator[Scene]:
    """Scenes of random knees whose surface turns from tick to tick."""
    for seed in range(SEED, SEED + TURNS):
        scene, random, tick = draw(seed), np.random.default_rng((seed, 22)), np.arange(DRAWN)
        wander = scene.angle[0] + 0.06 * random.random() * np.cumsum(random.choice([-1.0, 0.0, 1.0], DRAWN))
        sway = scene.angle[0] - 0.05 * np.cos(random.uniform(0.2, 2.0) * tick)
        stop = scene.angle[np.where(tick % STEPS < STEPS // 2, tick, np.maximum(tick - STEPS // 2, 0))]
        still = np.full(DRAWN, 10 ** random.uniform(-1.0, 3.0))
        ends = np.where(tick < DRAWN // 2, still, random.choice([-1e-8, 1e-8, 0.0, -5.0]))
        angle, load = (wander, sway, stop)[seed % 3], (still, ends, scene.load)[random.integers(3)]
        yield scene._replace(family=TURNING, angle=angle, load=load)


def measured(scene: Scene) -> list[Found]:
    """Run a scene with all budgets, and judge the answers."""
    truth, found = reference(scene), []
    for budget in BUDGETS:
        series = model(scene, "dynamic", TOLERANCE, budget)
        judged = judge(series, truth, TOLERANCE)
        tally = Tally()
        tally.count(judged)
        wrong = judged.depth.wrong
        worst = float(np.max(judged.depth.error[wrong])) if wrong.any() else 0.0
        most = int(judged.evaluations.max())
        over = int(np.sum(judged.evaluations > budget))
        found.append(Found(scene.family, budget, tally, most, over, not_finite(series), worst))
    return found


def rows(found: list[Found]) -> list[list[str]]:
    """Rows of a table: one per budget."""
    return [row(budget, found) for budget in BUDGETS]


def row(budget: int, found: list[Found]) -> list[str]:
    """Row of a table for a budget."""
    total, chosen = Tally(), [one for one in found if one.budget == budget]
    for one in chosen:
        total.add(one.tally)
    depth, force = total.depth, total.force
    ratios, pushes = depth.contact + depth.apart, force.contact + force.apart
    return [
        str(budget), str(len(chosen)), str(total.ticks), str(max(one.most for one in chosen)),
        str(sum(one.over for one in chosen)), str(sum(one.not_finite for one in chosen)),
        f"{100 * total.flagged / total.ticks:.2f} %", f"{100 * total.static / total.ticks:.2f} %", str(depth.wrong),
        str(sum(one.tally.depth.wrong > 0 for one in chosen)), f"{max(one.worst for one in chosen):.1e}",
        f"{100 * depth.known / total.ticks:.2f} %", f"{100 * depth.covered / max(depth.known, 1):.2f} %",
        f"{percentile(ratios, 50):.3g}, {percentile(ratios, 95):.3g}",
        f"{100 * force.covered / force.known:.2f} %" if force.known else "-",
        f"{percentile(pushes, 50):.3g}, {percentile(pushes, 95):.3g}",
    ]  # fmt: skip


@click.command()
@click.option("--output", type=click.Path(path_type=Path), default=Path("docs/studies/budgets.md"), show_default=True)
def main(output: Path) -> None:
    """Measure and write the table."""
    with ProcessPoolExecutor(WORKERS, multiprocessing.get_context("spawn")) as workers:
        found = [one for part in workers.map(measured, [*scenes(), *turning()], chunksize=5) for one in part]
    pulled, turned = [[one for one in found if (one.family == TURNING) is turns] for turns in (False, True)]
    sections = [
        Section("Loads that pull", TEXT, HEADER, rows(pulled)),
        Section("Femurs that turn", TURNING_TEXT, HEADER, rows(turned)),
    ]
    save(output, "Budgets", "python -m studies.budgets", sections, machine())


if __name__ == "__main__":
    main()

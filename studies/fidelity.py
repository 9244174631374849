"""How honest the error estimate of every level is, on random scenes: load, constants and mass drawn over wide ranges.

python -m studies.fidelity [--scenes N] [--seed S] [--output FILE]
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.compiled import compiled
from knee_contact_ros.core.contact_laws import CONTACT_LAWS, ContactLaw
from knee_contact_ros.core.contact_pairs import OnPlane
from knee_contact_ros.core.geometries import Circle
from knee_contact_ros.core.levels import LEVELS
from knee_contact_ros.core.mechanisms import Hinge
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.core.regions import Regions
from knee_contact_ros.core.types import Fidelity, Status
from studies.report import Section, machine, save

Floats = NDArray[np.float64]
TICKS = 300
FINE = 1e-10
"""Tolerance [m] of the dynamic level that the others are compared with"""
KNOWN = 0.01
"""Ticks count where the fine solution's own estimate is below this part of the error"""
LEAST_ERROR = 1e-12
"""Errors below this [m] are rounding"""
TOLERANCES = (1e-5, 1e-6, 1e-8)
HEADER = (
    "level",
    "loads",
    "tolerance [m]",
    "ticks covered",
    "median estimate / error",
    "5 % and 95 %",
    "worst scene covered",
    "scenes with a median above 30",
    "ticks said right and wrong",
    "evaluations per tick",
    "changes of level per 100 ticks",
    "quasi-static, first-order, dynamic",
)
TEXT = (
    "Kelvin-Voigt and two layers (Eq. 12 as printed, and damped in both) on a circle; K 1e6 to 1e11 N/m^1.5, C 10 to "
    "1e5 N s/m, mass 10 g to 30 kg, ticks of 0.5 to 10 ms, loads of 30 N to 2 kN that swing at 0.3 to 10 Hz, some with "
    "a random walk on top. Loads `pull` where they pull the knee apart at times, else they `press`. The error is that "
    f"of the signed depth against level dynamic at {FINE:.0e} m (which the accuracy study holds against SciPy). Said "
    "right and wrong: status OK and an error beyond the tolerance. No constant of the estimate was set on these scenes "
    "(those of seeds 5 and 77 were looked at)."
)


class Scene(NamedTuple):
    """A knee and its load."""

    law: ContactLaw
    mass: float
    time: Floats
    load: Floats


class Result(NamedTuple):
    """What one scene says of one level."""

    ratios: Floats
    """Estimate over error, where the error is known and above rounding"""
    covered: float
    wrong: float
    """Share of ticks that claim to be within the tolerance and are not"""
    evaluations: float
    changes: float
    """Per 100 ticks"""
    shares: Floats
    """Of the three levels"""


def scene(random: np.random.Generator) -> Scene:
    """Draw a scene."""
    stiffness, damping, mass = 10 ** random.uniform(6, 11), 10 ** random.uniform(1, 5), 10 ** random.uniform(-2, 1.5)
    name = random.choice(["kelvin_voigt", "two_layer_viscoelastic"])
    arguments: dict[str, Any] = {"stiffness": stiffness, "exponent": 1.5, "damping": damping}
    if name == "two_layer_viscoelastic":
        arguments |= {
            "layer_depth": 10 ** random.uniform(-4.5, -3),
            "stiffness_2": stiffness * 10 ** random.uniform(0, 2),
            "damp_first_layer": bool(random.random() < 0.7),
        }
    time = np.arange(TICKS, dtype=np.float64) * 10 ** random.uniform(-3.3, -2)
    mean, depth, frequency = 10 ** random.uniform(1.5, 3.3), random.uniform(0, 1.2), 10 ** random.uniform(-0.5, 1)
    load = mean * (1.0 + depth * np.sin(math.tau * (frequency * time + random.random())))
    if random.random() < 0.3:
        load += 0.03 * mean * np.cumsum(random.standard_normal(TICKS))
    return Scene(CONTACT_LAWS[name](**arguments), mass, time.astype(np.float64), load)


def solve(drawn: Scene, level: str, tolerance: float) -> np.recarray[Any, Any]:
    """The answers of a level."""
    knee = KneeModel(
        pair=OnPlane(Circle(0.034)),
        mechanism=Hinge(),
        regions=Regions(drawn.law, allow_tension=False),
        mass=drawn.mass,
        tolerance=tolerance,
        budget=0,
        level=LEVELS[level],
    )
    return compiled(knee).run(drawn.time, np.zeros_like(drawn.time), drawn.load)


def measure(drawn: Scene, level: str, tolerance: float, fine: np.recarray[Any, Any]) -> Result:
    """Compare a level with the fine solution."""
    series = solve(drawn, level, tolerance)
    error = np.abs((series.penetration_depth - series.gap) - (fine.penetration_depth - fine.gap))
    known = fine.error_estimate < KNOWN * np.maximum(error, LEAST_ERROR)
    large = known & (error > LEAST_ERROR)
    right = series.status & Status.NOT_CONVERGED == 0
    return Result(
        series.error_estimate[large] / error[large],
        float(np.mean(~large | (error <= series.error_estimate))),
        float(np.mean(known & right & (error > tolerance))),
        float(series.evaluations.mean()),
        100.0 * float(np.mean(np.diff(series.fidelity.astype(int)) != 0)),
        np.bincount(series.fidelity, minlength=len(Fidelity)) / len(series),
    )


def row(level: str, loads: str, tolerance: float, results: list[Result]) -> list[str]:
    """One line of the table."""
    ratios = np.concatenate([result.ratios for result in results])
    low, middle, high = np.percentile(ratios, [5, 50, 95])
    medians = np.array([np.median(result.ratios) for result in results if len(result.ratios)])
    shares = np.mean([result.shares for result in results], axis=0)
    return [
        level, loads, f"{tolerance:.0e}", f"{100 * np.mean([result.covered for result in results]):.2f} %",
        f"{middle:.1f}", f"{low:.1f}, {high:.0f}", f"{100 * min(result.covered for result in results):.1f} %",
        f"{np.sum(medians > 30)} of {len(results)}", f"{100 * np.mean([result.wrong for result in results]):.3f} %",
        f"{np.mean([result.evaluations for result in results]):.1f}",
        f"{np.mean([result.changes for result in results]):.1f}", ", ".join(f"{100 * share:.0f} %" for share in shares),
    ]  # fmt: skip


@click.command()
@click.option("--scenes", default=1000, show_default=True)
@click.option("--seed", default=78, show_default=True)
@click.option("--output", type=click.Path(path_type=Path), default=Path("docs/studies/fidelity.md"))
def main(scenes: int, seed: int, output: Path) -> None:
    """Measure and write the table."""
    random = np.random.default_rng(seed)
    drawn = [scene(random) for _ in range(scenes)]
    fine = [solve(one, "dynamic", FINE) for one in drawn]
    rows = []
    for level in LEVELS:
        for loads in ("press", "pull"):
            chosen = [i for i, one in enumerate(drawn) if (one.load < 0.0).any() == (loads == "pull")]
            for tolerance in TOLERANCES:
                results = [measure(drawn[i], level, tolerance, fine[i]) for i in chosen]
                rows.append(row(level, loads, tolerance, results))
                click.echo(" | ".join(rows[-1]), err=True)
    command = f"python -m studies.fidelity --scenes {scenes} --seed {seed}"
    save(output, "How honest the error estimate is", command, [Section("", TEXT, HEADER, rows)], machine())


if __name__ == "__main__":
    main()

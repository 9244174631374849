"""Numerical stability at the extremes: a grid of scenes, what failed and what said that it missed its tolerance.

python -m studies.stability [--output FILE] [--scenes N] [--seed S]
"""

from __future__ import annotations

import functools
import signal
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import click
import numpy as np

from benchmarks import reference
from benchmarks import reference as laws
from benchmarks.reference import ByDepth, circle, ellipse
from benchmarks.report import Section, machine, save
from knee_contact_ros.model.types import Status
from studies import stability_families
from studies.stability_checks import FINE_BUDGET, FINER, ROUNDING, TRUSTED, Outcome, judge, signed_depth
from studies.stability_scenes import BUDGET, HALF_AXES, Scene, law_of, run

PATIENCE = 20
"""Time [s] after which the independent reference is given up"""
REFERENCE_SCENES = 40
HEADER = (
    "family", "scenes", "ticks", "failed", "ticks flagged NOT_CONVERGED", "of them settled", "ticks compared",
    "largest error / tolerance where not flagged", "worst energy balance",
)  # fmt: skip
REFERENCE_HEADER = (
    "scenes", "given up", "failed", "ticks", "flagged", "ticks compared", "largest error / tolerance where not flagged",
)  # fmt: skip
TEXT = f"""
A tick may cost {BUDGET} evaluations of the contact law; beyond, it is answered with the static solution
(settled), which is flagged, as are the ticks after it until the contact has forgotten the difference.
A scene fails if an answer is not finite, the contact pulls, depth and gap are
there at once, a tick is not flagged although its estimate exceeds the tolerance or it was settled, the error of
a tick that is not flagged exceeds the tolerance, energy is made, or anything is raised. The error is measured
against the same model at a tolerance {FINER:g} times smaller, at the ticks up to which that run stayed within
{FINE_BUDGET} evaluations, where its own estimate is below {TRUSTED:g} of the tolerance (ticks compared).

The energy balance is kinetic + elastic energy + the load's potential, for the circle, over each tick under
constant load: its gain over what is allowed. Allowed is what an error of the depth by the tolerance (or by the
published estimate, where that is larger) makes of the fastest motion that the energy at hand permits, plus
{ROUNDING:g} of the energies for rounding. 1 would be a failure; a value <= 0 says that no tick gained any.
""".strip()
REFERENCE_TEXT = f"""
Random scenes on a circle or an ellipse in closed form, from a static start, in ticks of at most 5 ms, against
SciPy (`benchmarks/reference.py`); given up after {PATIENCE} s each, or where SciPy finds no solution.
""".strip()


class Against(NamedTuple):
    """Comparison of a scene with the independent reference."""

    ticks: int
    flagged: int
    compared: int
    error: float | None
    """Largest error of unflagged ticks, in tolerances; None if the reference was given up"""


def families(scenes: int, seed: int) -> dict[str, Iterable[Scene]]:
    """All scenes, by the family that is their row of the table."""
    made = stability_families
    return {
        "stiffness x damping x mass x exponent x tick": made.grid(),
        "layers 1 µm to 5 mm x stiffness ratio": made.layers(),
        "impacts 0.01 to 5 m/s": made.impacts(),
        "load steps -5 to +20 kN": made.load_steps(),
        "flexion jumps": made.flexion_jumps(),
        "degenerate profiles": made.degenerate(),
        "curved tibiae, parallel mechanism": made.curved_tibiae(),
        "random, all ranges": made.random_scenes(seed, scenes),
    }


def row(family: str, outcomes: Sequence[Outcome]) -> list[str]:
    """Row of the table for a family."""
    counts = np.array([(one.ticks, one.flagged, one.settled, one.compared) for one in outcomes]).sum(axis=0)
    ticks, flagged, settled, compared = counts.tolist()
    failed = sum(bool(outcome.failures) for outcome in outcomes)
    error, energy = max(outcome.error for outcome in outcomes), max(outcome.energy for outcome in outcomes)
    balance = f"{energy:.1e}" if np.isfinite(energy) else "-"
    return [family, *map(str, (len(outcomes), ticks, failed, flagged, settled, compared)), f"{error:.2g}", balance]


def layers_of(scene: Scene) -> laws.Layers:
    """The law of a scene in the form that the reference takes."""
    constants = scene.arguments
    if scene.law == "elastic_foundation":
        return laws.kelvin_voigt(law_of(scene).static_force(1.0), 2.0, 0.0)
    spring = (constants["stiffness"], constants["exponent"])
    damping = constants.get("damping", 0.0)
    if scene.law.startswith("two_layer"):
        damped = bool(constants.get("damp_first_layer", False))
        return laws.two_layer(*spring, damping, constants["layer_depth"], constants["stiffness_2"], damped)
    if "restitution" not in constants:
        return laws.kelvin_voigt(*spring, damping)
    e = constants["restitution"]
    loss = {
        "hunt_crossley": 1.5 * (1.0 - e),
        "lankarani_nikravesh": 0.75 * (1.0 - e * e),
        "flores": 1.6 * (1.0 - e) / e,
        "gonthier": (1.0 - e * e) / e,
    }[scene.law]
    return laws.impact_damped(*spring, loss, constants["least_impact_speed"])


def against_reference(scene: Scene, budget: int = BUDGET) -> Against:
    """Compare with the independent solution, unless that takes too long."""
    series = run(scene, budget=budget)
    said = series.status & Status.NOT_CONVERGED != 0
    surface = circle if scene.femur == "circle" else ellipse(*HALF_AXES)
    stiff = scene.arguments.get("damping", 0.0) / scene.mass > 1e5
    time, angle, load = (np.array(column, dtype=np.float64) for column in (scene.time, scene.angle, scene.load))
    time = np.round(time * 1e9) * 1e-9  # stamps are whole nanoseconds: at 100 m/s one is 0.1 µm
    theirs = reference.Scene(time, angle, load, layers_of(scene), scene.mass, ByDepth(surface), stiff)
    previous = signal.signal(signal.SIGALRM, _give_up)
    signal.alarm(PATIENCE)
    try:
        with np.errstate(all="ignore"):  # trial steps of SciPy reach far
            depth = reference.solve(theirs)
    except (RuntimeError, ValueError, ArithmeticError):  # SciPy finds no step, or no root
        return Against(len(series), int(said.sum()), 0, None)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)
    error = np.abs(signed_depth(series) - depth)[~said] / scene.tolerance
    return Against(len(series), int(said.sum()), len(error), float(error.max(initial=0.0)))


def _give_up(_signal: int, _frame: FrameType | None) -> None:
    raise RuntimeError("the reference takes too long")


def reference_row(found: Sequence[Against]) -> list[str]:
    """The one row of the table of comparisons with the reference."""
    solved = [one for one in found if one.error is not None]
    errors = [one.error for one in found if one.error is not None]
    failed = sum(error > 1.0 for error in errors)
    sums = (sum(one.ticks for one in solved), sum(one.flagged for one in solved), sum(one.compared for one in solved))
    numbers = (len(found), len(found) - len(errors), failed, *sums)
    return [*map(str, numbers), f"{max(errors, default=0.0):.2g}"]


def report_failures(scenes: Sequence[Scene], outcomes: Sequence[Outcome], say: Callable[[str], None]) -> None:
    """Print what failed, ready to be run again."""
    for scene, outcome in zip(scenes, outcomes, strict=True):
        for failure in outcome.failures:
            say(f"  {failure}: {scene}")


@click.command()
@click.option("--output", type=click.Path(path_type=Path), default=Path("docs/studies/stability.md"))
@click.option("--scenes", default=400, show_default=True, help="Random scenes.")
@click.option("--seed", default=0, show_default=True)
def main(output: Path, scenes: int, seed: int) -> None:
    """Try all scenes, print failures and write the table; exit code 1 if any scene failed."""

    def say(line: str) -> None:
        click.echo(line, err=True)

    rows = []
    with ProcessPoolExecutor() as pool:
        checked = stability_families.reference_scenes(seed, REFERENCE_SCENES)
        pending = pool.map(against_reference, checked)
        random = "random, all ranges"
        given = [(family, "dynamic", list(tried)) for family, tried in families(scenes, seed).items()]
        given += [(f"{family}; quasi-static", "quasi_static", tried) for family, _, tried in given if family == random]
        for family, level, tried in given:
            outcomes = list(pool.map(functools.partial(judge, level=level, quick=True), tried, chunksize=2))
            rows.append(row(family, outcomes))
            say(" | ".join(rows[-1]))
            report_failures(tried, outcomes, say)
        found = list(pending)
    for scene, one in zip(checked, found, strict=True):
        if one.error is None or one.error > 1.0:
            say(f"  SciPy: {'given up' if one.error is None else one.error}: {scene}")
    second = reference_row(found)
    say(" | ".join(second))
    command = f"python -m studies.stability --scenes {scenes} --seed {seed}"
    sections = [
        Section("", TEXT, HEADER, rows),
        Section("Against an independent solution", REFERENCE_TEXT, REFERENCE_HEADER, [second]),
    ]
    save(output, "Stability at the extremes", command, sections, machine())
    sys.exit(any(int(line[3]) for line in rows) or int(second[2]) > 0)


if __name__ == "__main__":
    main()

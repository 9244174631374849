"""Numerical stability at the extremes: random scenes, what failed and what said that it missed its tolerance.

python -m studies.stability [--output FILE] [--scenes N] [--seed S]
"""

from __future__ import annotations

import functools
import math
import signal
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks import reference
from benchmarks.reference import ByDepth, circle, ellipse
from benchmarks.report import Section, machine, save
from knee_contact_ros.model.laws import ContactLaw
from knee_contact_ros.model.types import Fidelity, Status
from studies import stability_scenes
from studies.reference import LAWS
from studies.stability_scenes import BUDGET, HALF_AXES, Scene, law_of, run

FINER = 300.0
"""Ratio of the tolerance to that of the finer run that it is judged by"""
FINE_BUDGET = 25_000
"""Contact law evaluations that a tick of the finer run may cost"""
TRUSTED = 0.1
"""Share of the tolerance that the finer run's own estimate may reach where it is compared with"""
ROUNDING = 1e-11
"""Share of the energies involved that is rounding: some 1e4 steps, each of some 1e-16"""
FIELDS = (
    "contact_force",
    "penetration_depth",
    "gap",
    "penetration_rate",
    "femoral_height",
    "error_estimate",
)


class Outcome(NamedTuple):
    """Result of all checks on one scene."""

    ticks: int
    flagged: int
    settled: int
    compared: int
    """Number of unflagged ticks whose error is known"""
    error: float
    """Largest error of these ticks, in tolerances"""
    energy: float
    """Largest gain of energy in a tick, relative to what is allowed; < 0 if energy was lost in every tick"""
    failures: tuple[str, ...]


def judge(scene: Scene, level: str = "dynamic", quick: bool = False) -> Outcome:
    """Run a scene at a level, and check it against the dynamic level."""
    try:
        series = run(scene, level=level, quick=quick)
        finer = run(scene, scene.tolerance / FINER, FINE_BUDGET, quick=quick)
    except Exception as raised:  # any exception is the failure that is looked for
        return Outcome(
            len(scene.time), 0, 0, 0, 0.0, -math.inf, (f"{type(raised).__name__}: {raised}",)
        )
    failures = promises(series, scene.tolerance, level)
    said = series.status & Status.NOT_CONVERGED != 0
    settled = said & (series.fidelity == Fidelity.QUASI_STATIC)
    known = trusted(finer, scene.tolerance) & ~said
    error = np.abs(signed_depth(series) - signed_depth(finer))[known] / scene.tolerance
    gains = energy_gains(scene, series)
    if error.size and error.max() > 1.0:
        failures.append(f"error of {error.max():.3g} tolerances, not flagged")
    if gains.size and gains.max() > 1.0:
        failures.append(f"energy made: {gains.max():.3g} times what is allowed")
    return Outcome(
        len(series),
        int(said.sum()),
        int(settled.sum()),
        int(known.sum()),
        float(error.max(initial=0.0)),
        float(gains.max(initial=-math.inf)),
        tuple(failures),
    )


def promises(series: np.recarray[Any, Any], tolerance: float, level: str = "dynamic") -> list[str]:
    """Broken promises of a series of answers that are visible without the exact solution."""
    said = series.status & Status.NOT_CONVERGED != 0
    missed = series.error_estimate > tolerance
    if level == "dynamic":  # it answers quasi-statically only where it has given up
        missed |= series.fidelity == Fidelity.QUASI_STATIC
    found = [f"{field} not finite" for field in FIELDS if not np.isfinite(series[field]).all()]
    found += (
        ["contact_point not finite"]
        if not all(np.isfinite(series.contact_point[axis]).all() for axis in "xyz")
        else []
    )
    found += ["pulls"] if (series.contact_force < 0.0).any() else []
    found += (
        ["depth and gap at once"] if (series.penetration_depth * series.gap != 0.0).any() else []
    )
    found += ["a miss is not said"] if (missed & ~said).any() else []
    return found


def signed_depth(series: np.recarray[Any, Any]) -> NDArray[np.float64]:
    """Penetration depth, or less the gap [m]."""
    return np.asarray(series.penetration_depth - series.gap)


def trusted(finer: np.recarray[Any, Any], tolerance: float) -> NDArray[np.bool_]:
    """Ticks at which the finer run may stand for the exact solution: those before it ran out of budget."""
    dynamic = np.logical_and.accumulate(finer.fidelity == Fidelity.DYNAMIC)
    return np.asarray(dynamic & (finer.error_estimate <= TRUSTED * tolerance))


_nodes, _weights = np.polynomial.legendre.leggauss(24)
NODES, WEIGHTS = (0.5 * (_nodes + 1.0)).tolist(), (0.5 * _weights).tolist()
"""Nodes and weights of Gauss's rule between 0 and 1"""


class Energy:
    """Energy of a circular femur under a constant load; turning it does no work."""

    def __init__(self, scene: Scene) -> None:
        self.law: ContactLaw = law_of(scene)
        self.mass = scene.mass

    def elastic(self, depth: float) -> float:
        """Integral [J] of the static force of every layer up to a depth [m], by Gauss's rule.

        Over u with δ = u², in which a force that begins with δⁿ is smooth at its beginning: 24 nodes leave 1e-11 of it.
        """
        total = 0.0
        ends = [*(layer.begin for layer in self.law.layers[1:]), math.inf]
        for layer, end in zip(self.law.layers, ends, strict=True):
            inside = min(depth, end) - layer.begin
            if inside > 0.0:
                force = [layer.force_at(layer.begin + inside * u * u, 0.0)[0] for u in NODES]
                total += (
                    2.0
                    * inside
                    * sum(w * u * f for w, u, f in zip(WEIGHTS, NODES, force, strict=True))
                )
        return total

    def reach(self, start: float, load: float) -> float:
        """Depth [m] to which an energy [J] and a load [N] can press the femur, from above within a factor of 2."""
        depth = 1e-9
        while self.elastic(depth) < start + max(load, 0.0) * depth:
            depth *= 2.0
        return depth

    def allowed(self, energy: float, error: float, depth: float) -> float:
        """Change of energy [J] that an error of the depth [m] amounts to.

        A mass m that swings with an energy E on a stiffness k has a speed of at most v = √(2E/m). An error e of the
        depth is one of e√(k/m), or of e c/m where the dashpot c holds it back, in the speed (`model.error_estimate`).
        """
        slopes = [layer.force_at(depth, 0.0)[1:] for layer in self.law.layers]
        stiffness = max(
            slope[0]
            for slope, layer in zip(slopes, self.law.layers, strict=True)
            if layer.begin < depth
        )
        damping = max(slope[1] for slope in slopes)
        off = error * max(math.sqrt(stiffness / self.mass), damping / self.mass, 10.0)
        return self.mass * off * (math.sqrt(2.0 * energy / self.mass) + 0.5 * off)


def energy_gains(scene: Scene, series: np.recarray[Any, Any]) -> NDArray[np.float64]:
    """Gain of energy in every tick under constant load over what the tolerance and rounding allow; <= 1 if all is well.

    The balance is that of kinetic energy, elastic energy and the load's potential L y. The error that is allowed for is
    the tolerance, or the published estimate where that is the larger one. Ticks answered with the static solution
    have no balance.
    """
    if scene.femur != "circle" or scene.tibia != "plane":
        return np.array([])
    energy, gains = Energy(scene), []
    for i in range(1, len(series)):
        load = scene.load[i]
        if load != scene.load[i - 1] or series.fidelity[i] == Fidelity.QUASI_STATIC:
            continue
        parts = [
            (
                0.5 * scene.mass * row.penetration_rate**2,
                energy.elastic(row.penetration_depth),
                load * row.femoral_height,
            )
            for row in (series[i - 1], series[i])
        ]
        # What can turn into motion: all but the load's potential at the lowest point that can be reached.
        moving = max(kinetic + elastic for kinetic, elastic, _ in parts) + abs(
            parts[0][2] - parts[1][2]
        )
        moving += abs(load) * max(series.gap[i - 1], series.gap[i])
        reach = energy.reach(moving, load)
        swing = moving + max(load, 0.0) * reach
        error = max(scene.tolerance, series.error_estimate[i - 1], series.error_estimate[i])
        rounding = ROUNDING * (swing + abs(parts[0][2]) + abs(parts[1][2]))
        limit = energy.allowed(swing, error, reach) + rounding
        gains.append((sum(parts[1]) - sum(parts[0])) / limit)
    return np.array(gains)


PATIENCE = 20
"""Time [s] after which the independent reference is given up"""
REFERENCE_SCENES = 40
HEADER = (
    "level",
    "scenes",
    "ticks",
    "failed",
    "ticks flagged NOT_CONVERGED",
    "of them settled",
    "ticks compared",
    "largest error / tolerance where not flagged",
    "worst energy balance",
)
REFERENCE_HEADER = (
    "scenes",
    "given up",
    "failed",
    "ticks",
    "flagged",
    "ticks compared",
    "largest error / tolerance where not flagged",
)
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


def row(level: str, outcomes: Sequence[Outcome]) -> list[str]:
    """Row of the table for a level."""
    counts = np.array(
        [(one.ticks, one.flagged, one.settled, one.compared) for one in outcomes]
    ).sum(axis=0)
    ticks, flagged, settled, compared = counts.tolist()
    failed = sum(bool(outcome.failures) for outcome in outcomes)
    error, energy = (
        max(outcome.error for outcome in outcomes),
        max(outcome.energy for outcome in outcomes),
    )
    balance = f"{energy:.1e}" if np.isfinite(energy) else "-"
    return [
        level,
        *map(str, (len(outcomes), ticks, failed, flagged, settled, compared)),
        f"{error:.2g}",
        balance,
    ]


def layers_of(scene: Scene) -> reference.Layers:
    """The law of a scene in the form that the reference takes."""
    constants = scene.arguments
    if scene.law == "elastic_foundation":
        return reference.kelvin_voigt(law_of(scene).static_force(1.0), 2.0, 0.0)
    spring = (constants["stiffness"], constants["exponent"])
    damping = constants.get("damping", 0.0)
    if scene.law.startswith("two_layer"):
        damped = bool(constants.get("damp_first_layer", False))
        return reference.two_layer(
            *spring, damping, constants["layer_depth"], constants["stiffness_2"], damped
        )
    if "restitution" not in constants:
        return reference.kelvin_voigt(*spring, damping)
    loss = LAWS[scene.law](**constants).loss
    return reference.impact_damped(*spring, loss, constants["least_impact_speed"])


def against_reference(scene: Scene, budget: int = BUDGET) -> Against:
    """Compare with the independent solution, unless that takes too long."""
    series = run(scene, budget=budget)
    said = series.status & Status.NOT_CONVERGED != 0
    surface = circle if scene.femur == "circle" else ellipse(*HALF_AXES)
    stiff = scene.arguments.get("damping", 0.0) / scene.mass > 1e5
    time, angle, load = (
        np.array(column, dtype=np.float64) for column in (scene.time, scene.angle, scene.load)
    )
    time = np.round(time * 1e9) * 1e-9  # stamps are whole nanoseconds: at 100 m/s one is 0.1 µm
    theirs = reference.Scene(
        time, angle, load, layers_of(scene), scene.mass, ByDepth(surface), stiff
    )
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
    sums = (
        sum(one.ticks for one in solved),
        sum(one.flagged for one in solved),
        sum(one.compared for one in solved),
    )
    numbers = (len(found), len(found) - len(errors), failed, *sums)
    return [*map(str, numbers), f"{max(errors, default=0.0):.2g}"]


def report_failures(
    scenes: Sequence[Scene], outcomes: Sequence[Outcome], say: Callable[[str], None]
) -> None:
    """Print what failed, ready to be run again."""
    for scene, outcome in zip(scenes, outcomes, strict=True):
        for failure in outcome.failures:
            say(f"  {failure}: {scene}")


@click.command()
@click.option(
    "--output", type=click.Path(path_type=Path), default=Path("docs/studies/stability.md")
)
@click.option("--scenes", default=400, show_default=True, help="Random scenes.")
@click.option("--seed", default=0, show_default=True)
def main(output: Path, scenes: int, seed: int) -> None:
    """Try all scenes, print failures and write the table; exit code 1 if any scene failed."""

    def say(line: str) -> None:
        click.echo(line, err=True)

    rows = []
    with ProcessPoolExecutor() as pool:
        checked = stability_scenes.reference_scenes(seed, REFERENCE_SCENES)
        pending = pool.map(against_reference, checked)
        tried = stability_scenes.random_scenes(seed, scenes)
        for level in ("dynamic", "quasi_static"):
            outcomes = list(
                pool.map(functools.partial(judge, level=level, quick=True), tried, chunksize=2)
            )
            rows.append(row(level, outcomes))
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

"""Orders of convergence with steps of a fixed size: ours, ended on every event, and the same methods across them.

python -m studies.convergence [--output FILE]
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks import reference
from benchmarks.reference import ByDepth, circle
from benchmarks.report import Section, machine, save
from knee_contact_ros.model import laws as model_laws
from knee_contact_ros.model import solver
from knee_contact_ros.model.error_estimate import EXACT, spectral_radius
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import BEGIN, CONTACT_LAWS, ContactLaw
from knee_contact_ros.model.mechanisms import hinge
from knee_contact_ros.model.solver import NOWHERE, Femur, Interval, Stage, Step
from knee_contact_ros.model.surfaces import Circle, ContactPair, Plane
from knee_contact_ros.model.ticks import LEVELS

RADIUS, MASS, K1, K2, DAMPING, LAYER = 0.034, 9.3014, 7.905694e7, 3.112e9, 5000.0, 5e-4
LINEAR_K1, LINEAR_K2 = 2e6, 3e7
"""Linear stiffnesses [N/m], about the slopes of the other laws at walking loads"""
PERIOD = 0.02
"""Duration of a tick [s]"""
STEPS = (8, 16, 32, 64, 128, 256)
"""Steps per tick"""
REFERENCE_ERROR = 3e-14
"""Error [m] of the reference: 1e-12 of the depths, with room"""
TOLERANCES = (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
"""Tolerances [m] of the runs with error control"""
ORDERS = ("scene", "method", *(f"{PERIOD / n * 1e3:g} ms" for n in STEPS), "order")
EQUAL_STEPS = (
    "Largest error of the depth [m] at the ends of the ticks, over the size of the steps; the order is that of the "
    "last three halvings. The reference is that of `accuracy.md`.\n\n"
    "A step across a kink or a jump makes an error of first or second order, whatever the method's own order is, "
    "and how large it is depends on where the step happens to lie: these errors scatter. Ended on the events, both "
    "methods keep their 4th order at lift-off, and everywhere with an exponent of 1. With Hertz' exponent of 1.5 the "
    "force behind a touch, and behind the beginning of a layer, grows like the 1.5th power of the time: no method "
    "sees a smooth function there, and equal steps give an order of 2.5. The error control answers with small first "
    "steps: see below.\n\nThe implicit method ended on events is the one with step doubling (two half steps); stepped "
    "across it is a single step. The explicit one is not stable where a step is longer than some two of the contact's "
    "shortest times (0.4 ms in the second layer): its first columns there are far off, and the order that follows from "
    "them is too high. The model takes it for shorter steps only."
)
WORK = ("scene", *(f"{tolerance:.0e} m" for tolerance in TOLERANCES), "power")
CONTROLLED = (
    "Largest error [m] / contact law evaluations per tick, with error control, over the tolerance. The power p is "
    "that of error ~ tolerance^p between the first and the last column: 1 is what a user expects. A 20 ms tick is "
    "long; an event in it costs some hundred evaluations, for every try to end on it is a whole step."
)


class Case(NamedTuple):
    """Loads at the ends of the ticks, and a contact law in both forms."""

    name: str
    loads: tuple[float, ...]
    law: ContactLaw
    layers: reference.Layers


METHODS = {"implicit": 0.0, "explicit": math.inf}
"""Methods by the largest step times spectral radius that `solver.attempt` takes explicitly"""


def cases() -> list[Case]:
    """List the cases: smooth contact, lift-off and landing, and the layer crossed both ways."""
    return [
        one_layer("contact throughout", (300.0, 1200.0, 700.0), K1, 1.5),
        one_layer("lift-off", (600.0, -400.0), K1, 1.5),
        one_layer("lift-off and landing", (600.0, -400.0, 1500.0), K1, 1.5),
        one_layer("lift-off and landing, exponent 1", (600.0, -400.0, 1500.0), LINEAR_K1, 1.0),
        two_layers("into the second layer and back", (500.0, 1600.0, 500.0), K1, K2, 1.5),
        two_layers("into the second layer and back, exponent 1", (500.0, 1600.0, 500.0), LINEAR_K1, LINEAR_K2, 1.0),
    ]


def one_layer(name: str, loads: tuple[float, ...], stiffness: float, exponent: float) -> Case:
    """A case with a Kelvin-Voigt knee."""
    law = CONTACT_LAWS["kelvin_voigt"](stiffness=stiffness, exponent=exponent, damping=DAMPING)
    return Case(name, loads, law, reference.kelvin_voigt(stiffness, exponent, DAMPING))


def two_layers(name: str, loads: tuple[float, ...], stiffness: float, stiffness_2: float, exponent: float) -> Case:
    """A case with cartilage and bone, damped as printed in Eq. 12 of the paper."""
    law = CONTACT_LAWS["two_layer_viscoelastic"](
        stiffness=stiffness,
        exponent=exponent,
        damping=DAMPING,
        layer_depth=LAYER,
        stiffness_2=stiffness_2,
        damp_first_layer=False,
    )
    return Case(name, loads, law, reference.two_layer(stiffness, exponent, DAMPING, LAYER, stiffness_2, damped=False))


def model_of(case: Case, tolerance: float) -> KneeModel:
    """Model of a case with a tolerance [m]."""
    pair = ContactPair(Circle(RADIUS), Plane(0.0), hinge())
    return KneeModel(pair, case.law, MASS, tolerance, budget=0, level=LEVELS["dynamic"])


def intervals(case: Case) -> list[Interval]:
    """Intervals of the ticks of a case."""
    return [
        Interval(PERIOD, 0.0, 0.0, load, (following - load) / PERIOD, solver.FORCE_ROUNDING * max(abs(load), 1.0))
        for load, following in itertools.pairwise(case.loads)
    ]


def static_start(case: Case) -> Femur:
    """State of a case at rest under the first load."""
    return Femur(RADIUS - model_of(case, 1e-13).static_depth(case.loads[0]), 0.0, EXACT, math.inf, 0.0, 0.0)


def ended_on_events(case: Case, steps: int, method: str) -> list[float]:
    """Signed depths [m] after each tick by the model's own stepping, without error control."""

    def fixed_step(
        knee: solver.Knee, tick: Interval, layer: int, impact: float, s: float, y: float, v: float, begin: Stage,
        until: float, try_step: float, _landed: bool, room: int,
    ) -> tuple[Step, float, int, float, int, bool]:  # fmt: skip
        """Take a step of the fixed size, or of what is left, and end it on the first boundary that it crosses."""
        size, remaining, boundary = PERIOD / steps, until - s, NOWHERE
        h = remaining if remaining < 1.5 * size else size
        radius = spectral_radius(begin.stiffness, begin.damping, knee.mass)
        step = solver.attempt(knee, tick, layer, True, impact, NOWHERE, s, y, v, h, begin, radius, room)
        while step.boundary != NOWHERE and boundary == NOWHERE:
            high = step.fraction * h
            step, h, boundary, _ = solver.end_on_boundary(
                knee, tick, layer, True, impact, s, y, v, 0.0, high, begin, begin, step.boundary, room
            )
        return step, h, boundary, try_step, 0, False

    knee, femur, depths = model_of(case, 1e-13).knee, static_start(case), []
    with patch.object(solver, "EXPLICIT", METHODS[method]), patch.object(solver, "pressed_step", fixed_step):
        for tick in intervals(case):
            result = solver.advance(knee, tick, femur, knee.budget)
            if not result.converged:
                raise RuntimeError(f"given up in {case.name}")
            femur = result.femur
            depths.append(RADIUS - femur.height)
    return depths


def across(law: NDArray[np.float64], _layer: int, depth: float, rate: float, impact: float) -> tuple[float, ...]:
    """Return a whole contact law as one formula, clamped at zero force; see `reference.force_at`."""
    layer = int(np.sum(law[1:, BEGIN] < depth))
    answer = model_laws.force_at(law, layer, depth, rate, impact)
    return answer if layer > 0 and answer[0] > 0.0 else (0.0, 0.0, 0.0)


def stepped_across(case: Case, steps: int, method: str) -> list[float]:
    """Signed depths [m] after each tick by the same method with the law as one function, clamped at zero force."""
    knee, femur, h, depths = model_of(case, 1e-14).knee, static_start(case), PERIOD / steps, []
    y, v = femur.height, femur.velocity
    with patch.object(solver, "force_at", across):
        for tick in intervals(case):
            for i in range(steps):
                begin = solver.stage_at(knee, tick, 1, 0.0, i * h, y, v)
                if method == "explicit":
                    step = solver.explicit_step(knee, tick, 1, 0.0, NOWHERE, i * h, y, v, h, begin)
                else:
                    step = solver.implicit_step(knee, tick, 1, 0.0, NOWHERE, i * h, y, v, h, begin, knee.budget)
                y, v = step.height, step.velocity
            depths.append(RADIUS - y)
    return depths


def controlled(case: Case, tolerance: float) -> tuple[list[float], float]:
    """Signed depths [m] after each tick with error control, and the mean evaluations per tick."""
    time = PERIOD * np.arange(len(case.loads))
    answers = model_of(case, tolerance).run(time, np.zeros_like(time), np.array(case.loads))
    return list(answers.penetration_depth - answers.gap)[1:], float(answers.evaluations[1:].mean())


def exact(case: Case) -> NDArray[np.float64]:
    """Signed depths [m] of a case after each tick by the reference."""
    time = PERIOD * np.arange(len(case.loads), dtype=np.float64)
    scene = reference.Scene(
        time, np.zeros_like(time), np.array(case.loads, dtype=np.float64), case.layers, MASS, ByDepth(circle)
    )
    return reference.solve(scene)[1:]


def order(errors: list[float]) -> float:
    """Mean slope of the last three halvings whose errors are above the reference's own."""
    above = [error for error in errors if error > REFERENCE_ERROR][-4:]
    return math.log2(above[0] / above[-1]) / (len(above) - 1)


def work_row(case: Case, truth: NDArray[np.float64]) -> list[str]:
    """Row of the table of error and cost over the tolerance."""
    found = []
    for tolerance in TOLERANCES:
        depths, evaluations = controlled(case, tolerance)
        found.append((float(np.abs(np.array(depths) - truth).max()), evaluations))
    power = math.log(found[0][0] / found[-1][0]) / math.log(TOLERANCES[0] / TOLERANCES[-1])
    return [case.name, *(f"{error:.1e} / {evaluations:.0f}" for error, evaluations in found), f"{power:.1f}"]


@click.command()
@click.option("--output", type=click.Path(path_type=Path), default=Path("docs/studies/convergence.md"))
def main(output: Path) -> None:
    """Measure and write the table."""
    rows, work = [], []
    for case in cases():
        truth = exact(case)
        ways = (("ended on events", ended_on_events), ("stepped across", stepped_across))
        for method, (way, solve) in itertools.product(METHODS, ways):
            errors = [float(np.abs(np.array(solve(case, steps, method)) - truth).max()) for steps in STEPS]
            rows.append([case.name, f"{method}, {way}", *(f"{error:.1e}" for error in errors), f"{order(errors):.1f}"])
            click.echo(" | ".join(rows[-1]), err=True)
        work.append(work_row(case, truth))
        click.echo(" | ".join(work[-1]), err=True)
    sections = [
        Section("Steps of equal size", EQUAL_STEPS, ORDERS, rows),
        Section("Steps under error control", CONTROLLED, WORK, work),
    ]
    save(output, "Convergence", "python -m studies.convergence", sections, machine())


if __name__ == "__main__":
    main()

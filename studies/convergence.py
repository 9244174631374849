"""Orders of convergence with steps of a fixed size: ours, ended on every event, and the same methods across them.

python -m studies.convergence [--output FILE]
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.contact_laws import CONTACT_LAWS, ContactLaw, Layer
from knee_contact_ros.core.contact_modes import NOWHERE, ContactMode, ContactModes
from knee_contact_ros.core.contact_pairs.on_plane import OnPlane
from knee_contact_ros.core.error_estimate import EXACT
from knee_contact_ros.core.events import end_on_boundary
from knee_contact_ros.core.geometries import Circle
from knee_contact_ros.core.integrators.base import FemurState, Motion
from knee_contact_ros.core.integrators.esdirk4 import esdirk4_step
from knee_contact_ros.core.integrators.fehlberg import fehlberg_step
from knee_contact_ros.core.levels import LEVELS
from knee_contact_ros.core.levels.dynamic import accepted, begin_stretch, behind_boundary, dynamic_tick
from knee_contact_ros.core.mechanisms.hinge import Hinge
from knee_contact_ros.core.prescribed import Interval
from knee_contact_ros.core.scene import RunState, Scene, begin_with
from knee_contact_ros.core.statics import NO_LIMIT, static_depth
from knee_contact_ros.core.stepping import NO_LANDING, StepperState, attempt
from knee_contact_ros.tools.work_precision import reference
from knee_contact_ros.tools.work_precision import reference_laws as laws
from knee_contact_ros.tools.work_precision.reference_femur import ByDepth, circle
from studies.report import Section, machine, save

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
    layers: laws.Layers


class Across(NamedTuple):
    """A whole contact law as one formula, clamped at zero force."""

    law: ContactLaw

    def force_at(self, depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
        """See `LayerFormula`."""
        if depth <= 0.0:
            return 0.0, 0.0, 0.0
        layer = sum(layer.begin < depth for layer in self.law.layers) - 1
        answer = self.law.layers[layer].formula.force_at(depth, rate, impact_speed)
        return answer if answer[0] > 0.0 else (0.0, 0.0, 0.0)

    def remembers_impact(self) -> bool:
        """See `LayerFormula`."""
        return False


METHODS = {"implicit": math.inf, "explicit": 0.0}
"""Methods by the spectral radius [1/s] of the contact above which a step takes the implicit one"""


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
    return Case(name, loads, law, laws.kelvin_voigt(stiffness, exponent, DAMPING))


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
    return Case(name, loads, law, laws.two_layer(stiffness, exponent, DAMPING, LAYER, stiffness_2, damped=False))


def intervals(case: Case) -> list[Interval]:
    """Intervals of the ticks of a case."""
    pair, hinge = OnPlane(Circle(RADIUS)), Hinge()
    return [
        Interval(pair, hinge, PERIOD, 0.0, 0.0, load, (following - load) / PERIOD, math.nan)
        for load, following in itertools.pairwise(case.loads)
    ]


def scene_of(case: Case, tolerance: float) -> Scene:
    """Scene of a case with a tolerance [m]."""
    modes = ContactModes(case.law, allow_tension=False)
    return Scene(OnPlane(Circle(RADIUS)), Hinge(), modes, MASS, tolerance, 0.0, 0, LEVELS["dynamic"])


def ended_on_events(case: Case, steps: int, method: str) -> list[float]:
    """Signed depths [m] after each tick by the model's own stepping, without error control."""
    scene, size, state, impact_speed = scene_of(case, 1e-13), PERIOD / steps, static_start(case).state, 0.0
    depths = []
    for interval in intervals(case):
        going = StepperState(
            0.0, state, EXACT, size, 0.0, impact_speed, 0.0, 0, 0, given_up=False, most=NO_LIMIT, landing=NO_LANDING
        )  # fmt: skip
        going, region = begin_stretch(scene, interval, going, 0.0)
        while going.s < PERIOD:
            going, region = fixed_step(scene, interval, going._replace(spectral_radius=METHODS[method]), region, size)
        state, impact_speed = going.state, going.impact_speed
        depths.append(RADIUS - state.height)
    return depths


def fixed_step(
    scene: Scene, interval: Interval, going: StepperState, region: ContactMode, size: float
) -> tuple[StepperState, ContactMode]:
    """Take a step of the fixed size [s], or of what is left, and end it on the first boundary that it crosses."""
    remaining = PERIOD - going.s
    h = remaining if remaining < 1.5 * size else size
    going, step = attempt(scene, interval, going, region, h, NOWHERE)
    boundary = NOWHERE
    while h > 0.0 and step.crossing.boundary != NOWHERE and not going.given_up:
        going, step, h, boundary = end_on_boundary(scene, interval, going, region, step, h)
    if going.given_up:
        raise RuntimeError(f"given up at {going.s} s")
    going = accepted(scene, interval, going, region, step, h, PERIOD)
    return (going, region) if boundary == NOWHERE else behind_boundary(scene, interval, going, region, step, boundary)


def controlled(case: Case, tolerance: float) -> tuple[list[float], float]:
    """Signed depths [m] after each tick with error control, and the mean evaluations per tick."""
    scene = scene_of(case, tolerance)
    progress, answers = static_start(case), []
    for interval in intervals(case):
        answers.append(dynamic_tick(scene, interval, progress, 0))
        progress = answers[-1].run_state
    return [answer.depth for answer in answers], float(np.mean([answer.evaluations for answer in answers]))


def static_start(case: Case) -> RunState:
    """State of a case at rest under the first load."""
    depth = static_depth(case.law, case.loads[0], 0.0, 0.0, NO_LIMIT).depth
    state = FemurState(RADIUS - depth, 0.0)
    return begin_with(state, 0.0, 0.0)


def stepped_across(case: Case, steps: int, method: str) -> list[float]:
    """Signed depths [m] after each tick by the same method with the law as one function, clamped at zero force."""
    modes, region = (
        ContactModes(ContactLaw((Layer(-1.0, Across(case.law)),)), allow_tension=True),
        ContactMode(0, pressing=True),
    )
    state, h, depths = static_start(case).state, PERIOD / steps, []
    for interval in intervals(case):
        motion = Motion(interval, modes, region, 0.0, MASS, NOWHERE)
        for i in range(steps):
            if method == "explicit":
                state = fehlberg_step(motion, i * h, state, h).state
            else:
                state = esdirk4_step(motion, i * h, state, h, 1e-16, NO_LIMIT).state
        depths.append(RADIUS - state.height)
    return depths


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

"""The time step that the paper prints, and what the model needs."""

from __future__ import annotations

import math

from benchmarks.report import Section
from studies.reproduction.phases import CYCLE
from studies.reproduction.scenes import ARTHRITIC, HEALTHY, MRI, TOLERANCE, Changes, gait, model, run, static_depth

PAPER_STEP = 1e-12
"""Time step of the paper [s]"""
LOAD = 1600.0
"""Load [N] at which the contact is linearised"""
TOLERANCES = (1e-6, TOLERANCE)
"""Tolerances [m]"""


def section() -> Section:
    """Section on the evaluations per sample, by tolerance and knee."""
    rows = [_line(name, files, tolerance) for name, files in
            (("healthy, sphere", (HEALTHY,)), ("healthy, fitted curve", (HEALTHY, MRI)),
             ("osteoarthritis, fitted curve", (ARTHRITIC, MRI))) for tolerance in TOLERANCES]  # fmt: skip
    stiffness, frequency, damping = linearised()
    steps = (CYCLE[1] - CYCLE[0]) / PAPER_STEP
    period = 1e3 * math.tau / frequency
    text = (
        f"At {LOAD / 1e3:.1f} kN the healthy contact has a stiffness of {stiffness / 1e6:.1f}e6 N/m, a natural "
        f"frequency of {frequency:.0f} rad/s (a period of {period:.1f} ms) and a damping ratio of {damping:.2f}. The "
        f"printed step of 1e-12 s is {math.log10(period * 1e-3 / PAPER_STEP):.0f} orders of magnitude smaller than "
        f"that period, and a gait cycle would take {steps:.1e} steps. The model takes the steps that its error "
        "estimate asks for. The table counts evaluations of the contact law per sample (5 ms), rounded to two "
        "digits, over the right leg's bag."
    )
    header = ("knee", "tolerance [m]", "evaluations per sample, mean", "samples beyond tolerance")
    return Section("7. Time step", text, header, rows)


def linearised() -> tuple[float, float, float]:
    """Stiffness [N/m], natural frequency [rad/s] and damping ratio of the healthy contact at 1.6 kN."""
    knee = model(HEALTHY)
    _, stiffness, damping = knee.law.force_at(static_depth(LOAD, HEALTHY), 0.0)
    return stiffness, math.sqrt(stiffness / knee.mass), damping / (2.0 * math.sqrt(stiffness * knee.mass))


def evaluations() -> float:
    """Mean evaluations per sample for a tolerance of 1e-6 m, healthy knee and sphere, to two digits."""
    return float(f"{run(HEALTHY, changes=(('fidelity.tolerance', 1e-6),)).evaluations.mean():.1e}")


def _line(name: str, files: tuple[str, ...], tolerance: float) -> list[str]:
    changes: Changes = () if tolerance == TOLERANCE else (("fidelity.tolerance", tolerance),)
    series = run(*files, changes=changes)
    mean = float(f"{series.evaluations.mean():.1e}")
    missed = int((series.error_estimate > tolerance).sum())
    return [name, f"{tolerance:.0e}", f"{mean:.0f}", f"{missed} of {len(gait('right')[0])}"]

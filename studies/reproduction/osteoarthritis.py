"""The osteoarthritic knee, ringing, the time step, and what the paper says twice."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np

from benchmarks.gait import BODY_WEIGHT
from studies.reproduction.healthy import (
    PAPER_PEAKS,
)
from studies.reproduction.scenes import (
    ARTHRITIC,
    BOTH_LAYERS_DAMPED,
    CYCLE,
    FINE,
    HEALTHY,
    MM,
    MRI,
    PERCENT,
    TOLERANCE,
    Changes,
    Table,
    body_weights,
    compare,
    gait,
    led_run,
    model,
    parameters,
    passages,
    peak,
    run,
    second_stance,
    static_depth,
    static_force,
    thousands,
    unprinted,
    within,
)

DEPTH, CARTILAGE = 0.521, 0.5
"""Depth and cartilage thickness [mm] of the paper"""
LOSSES = (0.0, 0.1, 0.2, 0.25, 0.5)
"""Lost cartilage [mm] of the table; the two losses that answer a question are computed"""


def arthritic() -> list[list[str]]:
    """Rows on depth and force at the second peak with the load prescribed."""
    series, healthy = run(ARTHRITIC, MRI), run(HEALTHY, MRI)
    time = second_stance()[1]
    depth, sphere = (MM * peak(time, knee.penetration_depth) for knee in (series, run(ARTHRITIC)))
    force, healthy_force = (
        body_weights(peak(time, knee.contact_force)) for knee in (series, healthy)
    )
    return [
        compare(
            "maximum depth, osteoarthritis, fitted curve", DEPTH, depth, "mm", 4, _needed_text()
        ),
        compare(
            "of it bone",
            DEPTH - CARTILAGE,
            depth - CARTILAGE,
            "mm",
            4,
            "the same; the 0.5 mm are a parameter",
        ),
        unprinted(
            "maximum depth, osteoarthritis, sphere",
            f"{sphere:.4f} mm",
            "force-driven: the law alone",
        ),
        unprinted(
            "static depth at 2.19 BW, osteoarthritis",
            f"{MM * arthritic_depth():.6f} mm",
            "Eq. 12 at rest",
        ),
        unprinted(
            "second force peak, arthritic against healthy",
            f"{force:.3f} against {healthy_force:.3f} BW ({PERCENT * (force / healthy_force - 1):+.2f} %)",
            "paper: reduced, without a number; equilibrium fixes the force when the load is prescribed",
        ),
    ]


def cartilage_lost() -> Table:
    """Peak force with the path prescribed."""
    losses = sorted({*LOSSES, break_even(), loss_for_paper()})
    healthy = body_weights(float(run(HEALTHY, MRI).contact_force.max()))
    rows = []
    for lost in losses:
        series = led_run(lost / MM)
        force = largest_force(lost)
        rows.append(
            [
                f"{lost:.4f} mm{_name(lost)}",
                f"{MM * float(series.penetration_depth.max()):.4f} mm",
                f"{force:.2f} BW",
                f"{force / healthy:.2f}",
            ]
        )
    return ("cartilage lost", "largest depth", "largest force", "of the healthy knee's"), rows


def largest_force(lost: float) -> float:
    """Largest force [BW] on the healthy knee's path with some cartilage lost [mm]."""
    return body_weights(float(led_run(lost / MM).contact_force.max()))


def break_even() -> float:
    """Lost cartilage [mm] at which the depth is the one that the arthritic law needs for the same peak force."""
    return MM * float(
        run(HEALTHY, MRI).penetration_depth.max() - run(ARTHRITIC, MRI).penetration_depth.max()
    )


def loss_for_paper() -> float:
    """Lost cartilage [mm] with which the largest depth is the paper's."""
    return MM * float(run(HEALTHY, MRI).penetration_depth.max()) - DEPTH


def arthritic_depth() -> float:
    """Static depth [m] of the arthritic knee at 2.19 BW."""
    return static_depth(PAPER_PEAKS[1] * BODY_WEIGHT, ARTHRITIC)


def load_needed() -> float:
    """Load [BW] that leads to the paper's depth in the two-layer law."""
    return body_weights(static_force(DEPTH / MM, ARTHRITIC))


def bone_stiffness_needed() -> float:
    """K₂ [N/mm^1.5] with which the paper's depth carries 2.19 BW."""
    carried = static_force(CARTILAGE / MM, ARTHRITIC)
    return float((PAPER_PEAKS[1] * BODY_WEIGHT - carried) / (DEPTH - CARTILAGE) ** 1.5)


def _needed_text() -> str:
    stiffness = round(bone_stiffness_needed(), -3)
    return (
        f"Eq. 12 with Table 1; K₂ = {thousands(stiffness)} N/mm^1.5 "
        f"or a load of {load_needed():.4f} BW would be needed"
    )


def _name(lost: float) -> str:
    if lost == loss_for_paper():
        return " (gives the paper's depth)"
    return " (equal depth as force-driven)" if lost == break_even() else ""


LAWS: dict[str, Changes] = {
    "as printed (Eq. 12)": (),
    "dashpot in both layers": BOTH_LAYERS_DAMPED,
}
FEMORA = {"sphere": (ARTHRITIC,), "fitted curve": (ARTHRITIC, MRI)}
SHORT = 0.05
"""Time [s] after heel strike that is looked at"""


def ringing() -> Table:
    """Force against load in the first layer, and the jump at its end."""
    rows = []
    for (femur, files), (name, changes) in product(FEMORA.items(), LAWS.items()):
        series = run(*files, changes=changes, step=FINE)
        rows.append(
            [
                femur,
                name,
                f"{excess(series, passages()[0], CYCLE[1]):.0f} N",
                f"{excess(series, CYCLE[1], CYCLE[1] + SHORT):.0f} N",
                _jump(series, changes),
            ]
        )
    header = (
        "femur",
        "law",
        "largest deviation force - load, swing",
        "the same, 0.05 s after heel strike",
        "force jump at 0.5 mm",
    )
    return header, rows


def excess(series: np.recarray[Any, Any], start: float, end: float) -> float:
    """Largest deviation of the contact force from the load [N] in a time range [s]."""
    part = within(start, end, FINE)
    return float(np.abs(series.contact_force - gait("right", FINE)[2])[part].max())


def _jump(series: np.recarray[Any, Any], changes: Changes) -> str:
    """C times the largest rate at a crossing of the layers."""
    if changes:
        return "none"
    contact = parameters(ARTHRITIC).contact
    crossed = np.flatnonzero(np.diff(series.penetration_depth > contact.layer_depth))
    return f"up to {contact.damping * float(np.abs(series.penetration_rate[crossed]).max()):.0f} N"


PAPER_STEP = 1e-12
"""Time step of the paper [s]"""
LOAD = 1600.0
"""Load [N] at which the contact is linearised"""
TOLERANCES = (1e-6, TOLERANCE)
"""Tolerances [m]"""


def time_step() -> Table:
    """Evaluations of the law per sample, by tolerance and knee."""
    rows = [
        _numerics_line(name, files, tolerance)
        for name, files in (
            ("healthy, sphere", (HEALTHY,)),
            ("healthy, fitted curve", (HEALTHY, MRI)),
            ("osteoarthritis, fitted curve", (ARTHRITIC, MRI)),
        )
        for tolerance in TOLERANCES
    ]
    return (
        "knee",
        "tolerance [m]",
        "evaluations per sample, mean",
        "samples beyond tolerance",
    ), rows


def linearised() -> tuple[float, float, float]:
    """Stiffness [N/m], natural frequency [rad/s] and damping ratio of the healthy contact at 1.6 kN."""
    knee = model(HEALTHY)
    _, stiffness, damping = knee.law.force_at(static_depth(LOAD, HEALTHY), 0.0)
    return (
        stiffness,
        math.sqrt(stiffness / knee.mass),
        damping / (2.0 * math.sqrt(stiffness * knee.mass)),
    )


def evaluations() -> float:
    """Mean evaluations per sample for a tolerance of 1e-6 m, healthy knee and sphere, to two digits."""
    return float(f"{run(HEALTHY, changes=(('fidelity.tolerance', 1e-6),)).evaluations.mean():.1e}")


def _numerics_line(name: str, files: tuple[str, ...], tolerance: float) -> list[str]:
    changes: Changes = () if tolerance == TOLERANCE else (("fidelity.tolerance", tolerance),)
    series = run(*files, changes=changes)
    mean = float(f"{series.evaluations.mean():.1e}")
    missed = int((series.error_estimate > tolerance).sum())
    return [name, f"{tolerance:.0e}", f"{mean:.0f}", f"{missed} of {len(gait('right')[0])}"]

"""The osteoarthritic knee (Fig. 13), force-driven and on the healthy knee's path."""

from __future__ import annotations

from benchmarks.report import Section
from studies.gait import BODY_WEIGHT
from studies.reproduction.loads import PAPER_PEAKS
from studies.reproduction.page import COMPARISON, compare, figure, thousands, unprinted
from studies.reproduction.phases import peak, second_stance
from studies.reproduction.scenes import (
    ARTHRITIC,
    HEALTHY,
    MM,
    MRI,
    PERCENT,
    body_weights,
    led_run,
    run,
    static_depth,
    static_force,
)

DEPTH, CARTILAGE = 0.521, 0.5
"""Depth and cartilage thickness [mm] of the paper"""
LOSSES = (0.0, 0.1, 0.2, 0.25, 0.5)
"""Lost cartilage [mm] of the table; the two losses that answer a question are computed"""


def section() -> Section:
    """Section on depth and force at the second peak with the load prescribed."""
    series, healthy = run(ARTHRITIC, MRI), run(HEALTHY, MRI)
    time = second_stance()[1]
    depth, sphere = (MM * peak(time, knee.penetration_depth) for knee in (series, run(ARTHRITIC)))
    force, healthy_force = (body_weights(peak(time, knee.contact_force)) for knee in (series, healthy))
    rows = [
        compare("maximum depth, fitted curve", DEPTH, depth, "mm", 4, _needed_text()),
        compare("of it bone", DEPTH - CARTILAGE, depth - CARTILAGE, "mm", 4, "the same; the 0.5 mm are a parameter"),
        unprinted("maximum depth, sphere", f"{sphere:.4f} mm", "force-driven: the law alone"),
        unprinted("static depth at 2.19 BW", f"{MM * arthritic_depth():.6f} mm", "Eq. 12 at rest"),
        unprinted("second force peak, arthritic against healthy",
                  f"{force:.3f} against {healthy_force:.3f} BW ({PERCENT * (force / healthy_force - 1):+.2f} %)",
                  "paper: reduced, without a number; equilibrium fixes the force when the load is prescribed"),
    ]  # fmt: skip
    text = (
        f"Depth: cartilage carries {body_weights(static_force(CARTILAGE / MM, ARTHRITIC)):.2f} BW at 0.5 mm, and "
        "bone the rest. The paper's 0.021 mm of bone belong to a stiffer bone or to a smaller load than its own "
        "formula and its own peak give.\n\n"
        + figure("osteoarthritis", "Fitted curve. (a) Force and (b) depth, healthy and arthritic, with the load "
                 "prescribed, and arthritic on the healthy knee's path with as much cartilage lost as leads to a "
                 "depth of 0.521 mm. (c) Peak force on that path over the cartilage lost.")
    )  # fmt: skip
    return Section("6. Osteoarthritis (Fig. 13)", text, COMPARISON, rows)


def led_section() -> Section:
    """Section on the peak force with the path prescribed."""
    losses = sorted({*LOSSES, break_even(), loss_for_paper()})
    healthy = body_weights(float(run(HEALTHY, MRI).contact_force.max()))
    rows = []
    for lost in losses:
        series = led_run(lost / MM)
        force = largest_force(lost)
        rows.append([f"{lost:.4f} mm{_name(lost)}", f"{MM * float(series.penetration_depth.max()):.4f} mm",
                     f"{force:.2f} BW", f"{force / healthy:.2f}"])  # fmt: skip
    text = (
        "### The healthy knee's path prescribed\n\n"
        "The paper finds a lower contact force in osteoarthritis and explains it by the cartilage's thickness under "
        "identical kinematic input. With its Eq. 13 the input is a force, and the contact force cannot be lower (but "
        "for M ÿ). It can if the femoral height is the input (`drive: displacement`). Two readings:\n\n"
        "* The same depth as in the healthy knee (no loss): beyond 0.5 mm the femur now presses on bone, and the force "
        f"rises to {largest_force(0.0) / healthy:.0f} times the healthy one.\n"
        "* The same path of the bones, but cartilage is gone, so that the surfaces meet later: the prescribed "
        "height is raised by the lost thickness. The force is lower than the healthy one if more than "
        f"{break_even():.4f} mm are lost, and higher otherwise. A loss of {loss_for_paper():.4f} mm leads to the "
        f"paper's 0.521 mm, with a peak of {largest_force(loss_for_paper()):.2f} BW. If everything but 0.5 mm of the "
        "4.4 mm of cartilage were lost, the surfaces would not meet at all.\n\n"
        "So only the second reading lowers the force, and only with a loss that the paper does not state; the two "
        "losses marked are solved for backwards, to show what would be needed, and are used nowhere else. All runs: "
        "fitted curve, heights of the healthy run, largest values over the bag."
    )
    return Section("", text, ("cartilage lost", "largest depth", "largest force", "of the healthy knee's"), rows)


def largest_force(lost: float) -> float:
    """Largest force [BW] on the healthy knee's path with some cartilage lost [mm]."""
    return body_weights(float(led_run(lost / MM).contact_force.max()))


def break_even() -> float:
    """Lost cartilage [mm] at which the depth is the one that the arthritic law needs for the same peak force."""
    return MM * float(run(HEALTHY, MRI).penetration_depth.max() - run(ARTHRITIC, MRI).penetration_depth.max())


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
        f"Eq. 12 with Table 1; K₂ = {thousands(stiffness)} N/mm^1.5 or a load of {load_needed():.4f} BW would be needed"
    )


def _name(lost: float) -> str:
    if lost == loss_for_paper():
        return " (gives the paper's depth)"
    return " (equal depth as force-driven)" if lost == break_even() else ""

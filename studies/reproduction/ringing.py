"""Effects of Eq. 12 as printed, which damps the second layer only, in the first layer."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from benchmarks.report import Section
from studies.reproduction.page import figure
from studies.reproduction.phases import CYCLE, passages, within
from studies.reproduction.scenes import ARTHRITIC, BOTH_LAYERS_DAMPED, FINE, MRI, Changes, gait, parameters, run

LAWS: dict[str, Changes] = {"as printed (Eq. 12)": (), "dashpot in both layers": BOTH_LAYERS_DAMPED}
FEMORA = {"sphere": (ARTHRITIC,), "fitted curve": (ARTHRITIC, MRI)}
SHORT = 0.05
"""Time [s] after heel strike that is looked at"""


def section() -> Section:
    """Section on force against load in the first layer, and the jump at its end."""
    rows = []
    for (femur, files), (name, changes) in product(FEMORA.items(), LAWS.items()):
        series = run(*files, changes=changes, step=FINE)
        rows.append([femur, name, f"{excess(series, passages()[0], CYCLE[1]):.0f} N",
                     f"{excess(series, CYCLE[1], CYCLE[1] + SHORT):.0f} N", _jump(series, changes)])  # fmt: skip
    header = (
        "femur",
        "law",
        "largest deviation force - load, swing",
        "the same, 0.05 s after heel strike",
        "force jump at 0.5 mm",
    )
    text = (
        "### Damping in the second layer only\n\n"
        "Below 0.5 mm Eq. 12 as printed has no damping: whatever sets the knee ringing goes on until the next time "
        "that the second layer is reached. With the dashpot in both layers (`contact.damp_first_layer: true`) it "
        "dies out, and the depth's peaks do not change. As printed, the force also jumps by C δ̇ where the second "
        "layer begins. The input, linear between samples of 5 ms, has a kink at every sample. On the sphere this "
        "hardly matters; on the fitted curve a kink of the angle is a jump of the surface's velocity, and the "
        "dashpot answers it with a force of its own, which fades within milliseconds. These runs are read out every "
        "1 ms.\n\n"
        + figure("ringing", "Osteoarthritic knee, sphere, swing and second stance: force less load, and depth.")
    )
    return Section("", text, header, rows)


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

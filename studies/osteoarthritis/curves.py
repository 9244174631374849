"""Knees led along the healthy path, raised: peak force over the rise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from studies.osteoarthritis.grid import FIRST, LAYER, SECOND, SHIPPED, Floats
from studies.osteoarthritis.knees import Knees, along

RAISED = np.linspace(0.0, 0.8e-3, 81)
"""Rises of the path [m]"""
CHOSEN = ((0.5e-3, SHIPPED.stiffness_2), (0.3e-3, SHIPPED.stiffness_2), (0.5e-3, 5.0 * FIRST), (0.5e-3, FIRST))
"""Layer [m] and K₂ of the curves; the first is the shipped knee"""


class Curve(NamedTuple):
    """Peak force of a knee over the rise of its path."""

    layer: float
    second: float
    ratio: Floats
    """Ratio to the healthy knee's peak force, shape of `RAISED`"""


def curves(knees: Knees, share: int = 0) -> list[Curve]:
    """Curves of the chosen knees, at one share of the load."""
    layers, seconds = (np.array(column) for column in zip(*CHOSEN, strict=True))
    peaks = [along(knees.paths[share], {LAYER: layers, SECOND: seconds}, raised).peak_force for raised in RAISED]
    table = np.array(peaks) / knees.healthy.peak_force[share]
    return [Curve(layer, second, table[:, i]) for i, (layer, second) in enumerate(CHOSEN)]

"""The gait bags that come with the package, as arrays, and what is known about them."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros import solve
from knee_contact_ros.system.files import share_folder

BODY_WEIGHT = 75.16 * 9.80665
"""Body weight [N] that the paper divides by"""
HEEL_STRIKE = {"right": (0.618, 1.853), "left": (1.247, 2.460)}
"""Times of heel strike [s] in the bags, from the vertical ground reaction"""


@cache
def gait(side: str) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return time [s], flexion angle [rad] and half the axial load [N] of a side's bag, `right` or `left`.

    The arrays have shape (n,) and cannot be written: all callers share them.
    """
    bag = share_folder() / "bags" / f"gait2354_{side}"
    series = solve(bag, values={"fidelity.level": "quasi_static"}, compiled=False)
    columns = series.time, np.array(series.flexion_angle), np.array(series.load)
    for column in columns:
        column.flags.writeable = False
    return columns

"""Gait cycles from heel strike to heel strike: curves over percent of the cycle, and characteristic values."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.readouts import SPREAD
from knee_contact_ros.model.types import ContactState
from knee_contact_ros.streams.strides import Span, at_stamps, cut, integral, sliding_distance

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

PERCENT = np.arange(101.0)
"""Percent of the gait cycle at which curves are given, shape (101,)"""
ANSWERED = ("flexion_angle", "load", "contact_force", "penetration_depth", "contact_point_x", "bone_depth",
            "sliding_velocity")  # fmt: skip
"""Fields of the answers that become curves over the gait cycle"""
CURVES = ANSWERED + SPREAD
HELD = ("error_estimate", "force_error_estimate", "femoral_height", "contact_state")
"""Fields of the answers that are kept but not interpolated"""
COLUMNS = CURVES + HELD
"""All fields of the answers that are kept for cycles and moments, in the order of the columns"""
STATE, SLIDING = COLUMNS.index("contact_state"), COLUMNS.index("sliding_velocity")
FORCE, DEPTH = COLUMNS.index("contact_force"), COLUMNS.index("penetration_depth")
RISE_TIME = 0.02
"""Duration [s] over which the loading rate is taken"""
FEW = 12
"""Largest number of single cycles that are drawn"""


class Cycle(NamedTuple):
    """Characteristic values of a gait cycle."""

    span: Span
    impulse: float
    """Impulse of the contact force over the cycle [N s]"""
    stance_impulse: float
    """Impulse of the contact force from heel strike to toe-off [N s]"""
    loading_rate: float
    """Largest rise of the contact force over `RISE_TIME` in the first half of stance [N/s]"""
    largest_force: float
    """Largest contact force [N]"""
    largest_force_at: float
    """Percent of the cycle at which the contact force is largest"""
    largest_depth: float
    """Largest penetration depth [m]"""
    largest_depth_at: float
    """Percent of the cycle at which the depth is largest"""
    bone_time: float
    """Duration of contact in the second layer [s]"""
    apart_time: float
    """Duration without contact [s]"""
    sliding_distance: float
    """Distance [m] that the femur slides on the tibia, to and fro; NaN if the recording has no sliding velocity"""
    largest_sliding_velocity: float
    """Largest magnitude of the sliding velocity in contact [m/s]; NaN if the recording has none"""
    largest_half_width: float
    """Largest half-width of the contact patch [m]; NaN where the model is not known, as are the following"""
    largest_mean_pressure: float
    """Largest mean pressure of the contact patch [Pa]"""
    largest_peak_pressure: float
    """Largest peak pressure of the contact patch [Pa]"""
    largest_strain: float
    """Largest nominal strain of the cartilage"""


def curves(stamps: Stamps, values: Floats, span: Span) -> Floats:
    """Interpolate a cycle at every percent, shape (101, `CURVES`), from samples of shape (n, `COLUMNS`)."""
    at = span.start + np.round((span.end - span.start) * PERCENT / 100.0).astype(np.int64)
    return at_stamps(stamps, values, at, len(HELD))[:, : len(CURVES)]


def measured(stamps: Stamps, values: Floats, span: Span) -> Cycle:
    """Compute the characteristic values of a cycle from all its samples, shape (n, `COLUMNS`)."""
    time, cycle = cut(stamps, values, span.start, span.end, len(HELD))
    stance_time, stance = cut(stamps, values, span.start, span.toe_off, len(HELD))
    force, depth = cycle[:, FORCE], cycle[:, DEPTH]
    hardest, deepest = int(force.argmax()), int(depth.argmax())
    steps, state = np.diff(time), cycle[1:, STATE]
    sliding = np.abs(cycle[cycle[:, STATE] != ContactState.SEPARATED, SLIDING])
    return Cycle(
        span,
        impulse=integral(time, force),
        stance_impulse=integral(stance_time, stance[:, FORCE]),
        loading_rate=_loading_rate(stance_time, stance[:, FORCE]),
        largest_force=float(force[hardest]),
        largest_force_at=100.0 * float(time[hardest]) / span.duration,
        largest_depth=float(depth[deepest]),
        largest_depth_at=100.0 * float(time[deepest]) / span.duration,
        bone_time=float(steps[state == ContactState.BONE].sum()),
        apart_time=float(steps[state == ContactState.SEPARATED].sum()),
        sliding_distance=sliding_distance(time, cycle[:, SLIDING], cycle[:, STATE]),
        largest_sliding_velocity=float(sliding.max(initial=0.0)),
        **{f"largest_{name}": float(cycle[:, COLUMNS.index(name)].max()) for name in SPREAD},
    )


def _loading_rate(time: Floats, force: Floats) -> float:
    begins = np.arange(0.0, 0.5 * time[-1] - RISE_TIME, 0.25 * RISE_TIME)
    rises = np.interp(begins + RISE_TIME, time, force) - np.interp(begins, time, force)
    return float(rises.max(initial=0.0)) / RISE_TIME


class Mean:
    """Running mean and standard deviation of curves, in memory that does not grow with their number."""

    def __init__(self) -> None:
        self.count = 0
        self.mean = np.zeros((len(PERCENT), len(CURVES)))
        self._squares = np.zeros_like(self.mean)
        self.first: list[Floats] = []
        """The first `FEW` curves, shape (101, `CURVES`) each"""

    def add(self, curve: Floats) -> None:
        """Add the curves of a cycle, shape (101, `CURVES`), by Welford's update."""
        self.count += 1
        difference = curve - self.mean
        self.mean = self.mean + difference / self.count
        self._squares = self._squares + difference * (curve - self.mean)
        if len(self.first) < FEW:
            self.first.append(curve)

    @property
    def deviation(self) -> Floats | None:
        """Sample standard deviation over the cycles (n - 1), shape (101, `CURVES`); None for a single cycle."""
        return None if self.count < 2 else np.sqrt(self._squares / (self.count - 1))

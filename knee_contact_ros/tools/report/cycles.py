"""Gait cycles: from heel strike to heel strike, brought to percent, with what they amount to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.readouts import SPREAD
from knee_contact_ros.core.types import ContactState
from knee_contact_ros.pipeline.gait.strides import Span, at_stamps, cut, integral, sliding_distance

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

PERCENT = np.arange(101.0)
"""Where curves are given"""
ANSWERED = ("flexion_angle", "load", "contact_force", "penetration_depth", "contact_point_x", "bone_depth",
            "sliding_velocity")  # fmt: skip
"""Fields of the answers that become curves"""
CURVES = ANSWERED + SPREAD
HELD = ("error_estimate", "force_error_estimate", "femoral_height", "contact_state")
"""Those that are not interpolated"""
COLUMNS = CURVES + HELD
"""All that is kept of the answers for cycles and moments"""
STATE, SLIDING = COLUMNS.index("contact_state"), COLUMNS.index("sliding_velocity")
FORCE, DEPTH = COLUMNS.index("contact_force"), COLUMNS.index("penetration_depth")
RISE_TIME = 0.02
"""[s] over which the loading rate is taken"""
FEW = 12
"""Single cycles that are drawn"""


class Cycle(NamedTuple):
    """What a cycle amounts to."""

    span: Span
    impulse: float
    """[N s] of the contact force over the cycle"""
    stance_impulse: float
    """[N s] from heel strike to toe-off"""
    loading_rate: float
    """[N/s] largest rise of the contact force over `RISE_TIME` in the first half of stance"""
    largest_force: float
    """[N] of contact"""
    largest_force_at: float
    """[%]"""
    largest_depth: float
    """[m]"""
    largest_depth_at: float
    """[%]"""
    bone_time: float
    """[s] with contact in the second layer"""
    apart_time: float
    """[s] without contact"""
    sliding_distance: float
    """[m] that the femur slides on the tibia, to and fro; not a number if the recording does not tell"""
    largest_sliding_velocity: float
    """[m/s] of either sign, in contact; likewise"""
    largest_half_width: float
    """[m] of the contact patch; this and the following are not a number where the model is not known"""
    largest_mean_pressure: float
    """[Pa]"""
    largest_peak_pressure: float
    """[Pa]"""
    largest_strain: float
    """Nominal, of the cartilage"""


def curves(stamps: Stamps, values: Floats, span: Span) -> Floats:
    """A cycle at every percent, shape (101, `CURVES`)."""
    at = span.start + np.round((span.end - span.start) * PERCENT / 100.0).astype(np.int64)
    return at_stamps(stamps, values, at, len(HELD))[:, : len(CURVES)]


def measured(stamps: Stamps, values: Floats, span: Span) -> Cycle:
    """What a cycle amounts to, by all its samples."""
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
    """Mean and spread of curves that come one by one, in numbers that do not grow."""

    def __init__(self) -> None:
        self.count = 0
        self.mean = np.zeros((len(PERCENT), len(CURVES)))
        self._squares = np.zeros_like(self.mean)
        self.first: list[Floats] = []
        """The first `FEW`"""

    def add(self, curve: Floats) -> None:
        """Take a cycle, shape (101, `CURVES`); Welford's update."""
        self.count += 1
        difference = curve - self.mean
        self.mean = self.mean + difference / self.count
        self._squares = self._squares + difference * (curve - self.mean)
        if len(self.first) < FEW:
            self.first.append(curve)

    @property
    def deviation(self) -> Floats | None:
        """Standard deviation over the cycles (of the sample, n - 1), shape (101, `CURVES`); None of a single one."""
        return None if self.count < 2 else np.sqrt(self._squares / (self.count - 1))

"""What a run of the load estimator amounts to."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.types import Status
from knee_contact_ros.joint_reaction.estimator import Estimate
from knee_contact_ros.messages.ros_types import NANOSECONDS


@dataclass
class LoadSummary:
    """What there is to say of a bag's joint reactions: 16 B for each, and all of the largest one."""

    level: str
    calibrated: bool
    peak: Estimate | None = None
    """The one with the largest axial force"""
    flagged: Counter[str] = field(default_factory=Counter)
    """Estimates by the names of their status bits"""
    refused: Counter[str] = field(default_factory=Counter)
    """Samples by reason"""
    damage: list[str] = field(default_factory=list)
    """What is wrong with the bag"""
    _stamps: array[int] = field(default_factory=lambda: array("q"))
    _axial: array[float] = field(default_factory=lambda: array("d"))

    def add(self, stamp: int, estimate: Estimate) -> None:
        """Take an estimate at a stamp [ns] into account."""
        self._stamps.append(stamp)
        self._axial.append(estimate.axial_force)
        if self.peak is None or estimate.axial_force > self.peak.axial_force:
            self.peak = estimate
        if estimate.status:
            self.flagged.update(bit.name or "" for bit in Status if estimate.status & bit)

    @property
    def stamps(self) -> NDArray[np.int64]:
        """[ns], shape (n,)."""
        return np.array(self._stamps)

    @property
    def axial(self) -> NDArray[np.float64]:
        """[N], shape (n,)."""
        return np.array(self._axial)

    @property
    def duration(self) -> float:
        """From the first to the last estimate [s]."""
        return (self._stamps[-1] - self._stamps[0]) / NANOSECONDS if self._stamps else 0.0

"""The gait bags that come with the package, as arrays, and what is known about them."""

from __future__ import annotations

from benchmarks.gait import gait

__all__ = ["BODY_WEIGHT", "HEEL_STRIKE", "gait"]

BODY_WEIGHT = 75.16 * 9.80665
"""Body weight [N] that the paper divides by"""
HEEL_STRIKE = {"right": (0.618, 1.853), "left": (1.247, 2.460)}
"""Times of heel strike [s] in the bags, from the vertical ground reaction"""

"""A way to run a cohort, as the study sees it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import NamedTuple

from studies.cohorts.problem import Cohort, Floats

Run = Callable[[], Floats]
"""Runs the cohort it was prepared for: depth [m], shape (cases, ticks)"""
TOLERANCE, STEPS = "tolerance", "steps per tick"
"""What a method's setting is: of the error control, or a number of equal steps without error control"""
TOLERANCES = tuple(10.0 ** (-quarters / 4.0) for quarters in range(8, 45))
"""Relative; from coarse to fine in quarters of a decade"""
COUNTS = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)


class Method(NamedTuple):
    """A tool, one of its solvers and how it is led along the series."""

    tool: str
    name: str
    control: str
    """`TOLERANCE` or `STEPS`"""
    prepare: Callable[[Cohort, float, int], Run]
    """From cohort, setting and number of threads; what it does is set-up and not timed"""
    settings: tuple[float, ...]
    """From coarse to fine"""
    threads: bool = False
    """Whether it uses several cores itself; else every core gets a process and a share of the cohort"""
    most: int = sys.maxsize
    """Cases that it is given: fewer than asked for where every case takes the same time and that is long"""
    few: int = 16
    """Cases that a setting is first tried on"""

    @property
    def key(self) -> str:
        """What it is found by."""
        return f"{self.tool}: {self.name}"

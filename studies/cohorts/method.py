"""A way to run a cohort, in the form in which the study takes that of every tool."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import NamedTuple

from studies.cohorts.problem import Cohort, Floats

Run = Callable[[], Floats]
"""Runs the cohort that it was prepared for, and returns the depths [m], shape (cases, ticks)"""
TOLERANCE, STEPS = "tolerance", "steps per tick"
"""What a method's setting is: of the error control, or a number of equal steps without error control"""
TOLERANCES = tuple(10.0 ** (-quarters / 4.0) for quarters in range(8, 45))
"""Relative; from coarse to fine in quarters of a decade"""
COUNTS = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)


class Method(NamedTuple):
    """A tool, one of its solvers, and how it runs along the series."""

    tool: str
    name: str
    control: str
    """`TOLERANCE` or `STEPS`"""
    prepare: Callable[[Cohort, float, int], Run]
    """Prepares a run from cohort, setting and number of threads; its time counts as set-up"""
    settings: tuple[float, ...]
    """Settings to be tried, from coarse to fine"""
    threads: bool = False
    """Whether it uses several cores itself; else every core gets a process and a share of the cohort"""
    most: int = sys.maxsize
    """Largest number of cases that it runs: small where every case takes equally long"""
    few: int = 16
    """Number of cases that a setting is first tried on"""

    @property
    def key(self) -> str:
        """Name of the method in all tools: that of the tool and its own."""
        return f"{self.tool}: {self.name}"

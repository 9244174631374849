"""Problems as `/diagnostics` tells them, with a level and a sentence, and messages in the log that are not repeated."""

from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType

LOG_PERIOD = 5.0
"""Shortest time [s] between two warnings of one kind in the log, as of refused samples"""
STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""Clock that keeps running when simulated time stands still or the system's clock is set"""
OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR
STALE = DiagnosticStatus.STALE
Problem = tuple[bytes, str]
"""Level of a `DiagnosticStatus`, and its message, which is empty if nothing is wrong"""


def at_most_every(period: float) -> dict[str, Any]:
    """Keyword arguments with which a logger's call does nothing if it has logged within the last `period` [s]."""
    return {"throttle_duration_sec": period, "throttle_time_source_type": STEADY}


def first_problem(*table: tuple[Any, bytes, str]) -> Problem:
    """First row of a table (whether it applies, level, message) that applies."""
    return next(((level, text) for applies, level, text in table if applies), (OK, ""))


def warning_of(*texts: str) -> Problem:
    """Warning with all texts that are not empty."""
    text = "; ".join(filter(None, texts))
    return (WARN if text else OK), text

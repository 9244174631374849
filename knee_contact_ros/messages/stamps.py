"""Stamps of messages: times [ns] since the epoch."""

from __future__ import annotations

from typing import Any

NANOSECONDS = 1_000_000_000
"""Number of nanoseconds in a second"""


def stamp_to_ns(stamp: Any) -> int:
    """Convert the stamp of a message to nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def check_stamp(stamp: int) -> None:
    """Check that a message can hold a stamp [ns].

    Raises:
        ValueError: its seconds are not within int32.
    """
    if not -(2**31) <= stamp // NANOSECONDS < 2**31:
        raise ValueError(f"stamp {stamp} ns is beyond the int32 seconds of a ROS time")

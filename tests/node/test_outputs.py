"""What parameters ask of a recording, in SI units and bytes."""

from __future__ import annotations

import math

from knee_contact_ros.bags.writer import Limits, Settings
from knee_contact_ros.node.outputs import recording_settings
from knee_contact_ros.parameters.schema import Record


def test_megabytes_and_seconds_become_bytes_and_nanoseconds() -> None:
    record = Record(flush_period=0.5, sync_period=2.0, max_size=1.5, max_duration=3.0, min_free=7.0)
    assert recording_settings(record) == Settings(0.5, Limits(1_500_000, 3_000_000_000), 7_000_000, 2.0)


def test_what_is_off_has_no_limit() -> None:
    record = Record(sync_period=0.0, max_size=0.0, max_duration=0.0, min_free=0.0)
    assert recording_settings(record) == Settings(record.flush_period, Limits(math.inf, math.inf), 0.0, 0.0)

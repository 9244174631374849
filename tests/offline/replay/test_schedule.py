"""Due times: exact, and without anything that adds up."""

from __future__ import annotations

import pytest

from knee_contact_ros.commands.player import Lateness, Schedule

SECOND = 1_000_000_000
BEGIN = 1_700_000_000 * SECOND
"""As stamps since 1970"""


def test_a_pause_moves_what_follows_and_nothing_else() -> None:
    schedule = Schedule(BEGIN, 1.0, 100.0)
    schedule.pause(102.0)
    assert schedule.at(150.0) == BEGIN + 2 * SECOND
    schedule.resume(107.0)
    assert schedule.due(BEGIN + 3 * SECOND) == 108.0
    schedule.stood_still(10.0)
    assert schedule.due(BEGIN + 3 * SECOND) == 118.0


def test_after_a_step_the_bag_goes_on_from_there() -> None:
    schedule = Schedule(BEGIN, 1.0, 100.0, paused=True)
    schedule.step_to(BEGIN + 5 * SECOND, 200.0)
    assert schedule.at(250.0) == BEGIN + 5 * SECOND
    schedule.resume(300.0)
    assert schedule.due(BEGIN + 6 * SECOND) == 301.0


def test_lateness_is_counted_and_told() -> None:
    lateness = Lateness()
    for seconds in (0.0, 0.0005, 0.0021, None, 0.0003):
        lateness.add(seconds)
    lateness.end()
    for seconds in (0.0001, 0.0002):
        lateness.add(seconds)
    lateness.end()
    assert (lateness.messages, lateness.late, lateness.largest) == (7, 1, 0.0021)
    assert lateness.drift == pytest.approx(0.0003)
    assert str(lateness) == (
        "7 messages published, 1 (14.3 %) later than 1 ms, the latest by 2.10 ms; drift at the end 0.30 ms"
    )

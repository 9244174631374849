"""A loop at 200 Hz without ROS: flexion angle and load in, contact out. On a Raspberry Pi, or any computer with Python.

python examples/raspberry_pi.py [SECONDS]

Put your encoder and your load cell into `read_sensors`. The loop sleeps until the next sample is due, so that its rate
does not drift; if the computer was too slow, it goes on at once and counts the sample as late.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections.abc import Iterator

from knee_contact_ros import load_model
from knee_contact_ros.model.types import UNUSABLE

PERIOD = 0.005
"""Time [s] between two samples"""


def read_sensors(seconds: float) -> tuple[float, float]:
    """Return flexion angle [rad] and compressive load of the compartment [N]; here of somebody who steps in place."""
    stride = 0.5 - 0.5 * math.cos(2.0 * math.pi * seconds)
    return 0.1 + 0.8 * stride, 900.0 - 850.0 * stride


def samples(seconds: float) -> Iterator[tuple[float, bool]]:
    """Yield the times [s] at which samples are due, and whether each is late by more than a period."""
    begin = time.perf_counter()
    for number in range(round(seconds / PERIOD)):
        due = begin + number * PERIOD
        time.sleep(max(due - time.perf_counter(), 0.0))
        yield number * PERIOD, time.perf_counter() - due > PERIOD


def main(seconds: float) -> None:
    """Compute the contact for some seconds, and print what it took."""
    stream = load_model("healthy").stream()
    late = unusable = 0
    durations = []
    for now, is_late in samples(seconds):
        angle, load = read_sensors(now)
        begin = time.perf_counter()
        contact = stream.tick(now, angle, load)
        durations.append(time.perf_counter() - begin)
        late += is_late
        if contact.status & UNUSABLE:
            unusable += 1  # nothing may be controlled by this answer
    slowest = sorted(durations)[-1]
    print(f"{len(durations)} ticks, {late} late, {unusable} unusable")
    print(
        f"a tick: {1e6 * statistics.median(durations):.0f} us (median), {1e6 * slowest:.0f} us (slowest)"
    )
    print(f"last: {1e3 * contact.penetration_depth:.3f} mm under {contact.contact_force:.0f} N")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0)

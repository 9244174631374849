"""How long to wait for what must come: as many seconds as an idle machine never needs, more on a slow or busy one."""

import os
import time
from functools import cache

SECONDS = 90.0
"""[s] on an idle machine, where discovery and the start of a node take up to 5"""
COUNT = 1_000_000
"""Numbers that are added to measure the machine"""
USUAL = 0.009
"""Processor time [s] of that on a machine of 2026"""


@cache
def slowness():
    """How many times slower than usual this machine is; 1 for a faster one."""
    begin = time.process_time()
    sum(range(COUNT))
    return max(1.0, (time.process_time() - begin) / USUAL)


def patience(seconds=SECONDS):
    """How long [s] to wait for what an idle machine does in `seconds`: longer where more want each processor."""
    return seconds * slowness() * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def pause():
    """Let others work."""
    time.sleep(0.01)


def wait_until(done, act=pause):
    """Act again and again until something has happened."""
    begin = time.monotonic()
    while not done():
        assert time.monotonic() < begin + patience(), "it did not happen in time"
        act()

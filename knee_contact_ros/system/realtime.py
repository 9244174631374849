"""Real-time scheduling on Linux: all threads of this process go before ordinary processes, and its memory stays."""

import ctypes
import os
import sys
from contextlib import suppress

PRIORITY = 20
"""Priority among real-time threads, 1 to 99; the kernel's for devices have 50"""
LONGEST_RUN, LONGEST_WILD = 1, 5
"""Processor time [s] without a pause after which a thread's process gets SIGXCPU, and after which it is killed"""
LOCKED = 0b111
"""Flags of `mlockall`: present and future memory, from its first use on"""


def begin_realtime() -> str:
    """Schedule all threads of this process, and those that they start, as real-time ones.

    Returns:
        Sentence about what the system forbids, and what to set; empty if nothing.
    """
    if sys.platform != "linux":
        return "real-time scheduling needs Linux; the node runs as usual"
    from resource import RLIMIT_RTTIME, setrlimit

    setrlimit(RLIMIT_RTTIME, (LONGEST_RUN * 1_000_000, LONGEST_WILD * 1_000_000))
    forbidden = []
    try:
        _schedule(os.SCHED_FIFO, PRIORITY)
    except PermissionError:
        forbidden.append(f"rtprio {PRIORITY}")
    if ctypes.CDLL(None).mlockall(LOCKED):
        forbidden.append("memlock unlimited")
    if not forbidden:
        return ""
    lines = " and ".join(f"'{os.environ.get('USER', '*')} - {limit}'" for limit in forbidden)
    return (
        f"real-time scheduling is forbidden here, and the node runs as usual: write {lines} into "
        "/etc/security/limits.d/knee_contact.conf and log in again (systemd: LimitRTPRIO, LimitMEMLOCK)"
    )


def end_realtime() -> None:
    """Schedule all threads of this process as ordinary ones."""
    if sys.platform == "linux":
        _schedule(os.SCHED_OTHER, 0)


def start_ordinary() -> None:
    """Let the processes that this thread starts be ordinary ones; threads that it starts are, too."""
    if sys.platform == "linux" and os.sched_getscheduler(0) == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_getparam(0))


def leave_processor() -> None:
    """Leave the last processor to others, if this process may use more than one; threads that it starts do, too."""
    if sys.platform == "linux" and len(usable := os.sched_getaffinity(0)) > 1:
        os.sched_setaffinity(0, usable - {max(usable)})


def _schedule(policy: int, priority: int) -> None:
    """Give all threads a policy and a priority.

    Raises:
        PermissionError: the system forbids it.
    """
    if sys.platform == "linux":
        for _ in range(2):  # again for those that one of them has started meanwhile
            for thread in map(int, os.listdir("/proc/self/task")):  # noqa: PTH208  (names only)
                with suppress(ProcessLookupError):  # it has ended
                    kept = os.sched_getscheduler(thread) & os.SCHED_RESET_ON_FORK
                    os.sched_setscheduler(thread, policy | kept, os.sched_param(priority))

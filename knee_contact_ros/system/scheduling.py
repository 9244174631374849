"""How a process takes its share of a machine that others are busy on."""

from __future__ import annotations

import ctypes
import os
import struct

SLICE = 0.01
"""[s] Several times what the kernel gives a process in one go as a rule (0.7 to 3 ms)"""
SET_ATTRIBUTES = {"x86_64": 314, "aarch64": 274, "riscv64": 274}
"""Number of the system call `sched_setattr`, by machine: the C library has no function for it before 2025"""
ATTRIBUTES = struct.Struct("<IIQiIQQQ")
"""The kernel's `sched_attr`: its size, policy, flags, niceness, priority, runtime, deadline and period [ns]"""


def yield_to_others(niceness: int) -> None:
    """Have this process, whose niceness grows by so much, interrupt nobody and be interrupted by whoever wakes up.

    It gets its share all the same: it asks for that in few long slices. From Linux 6.12 on a process that wakes up
    interrupts another one that has asked for longer slices; others run on for some milliseconds. Where the kernel has
    no such slices, the policy alone counts.
    """
    if niceness:
        os.nice(niceness)
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    number = SET_ATTRIBUTES.get(os.uname().machine)
    if number is not None:
        own = os.getpriority(os.PRIO_PROCESS, 0)
        asked = ATTRIBUTES.pack(ATTRIBUTES.size, os.SCHED_BATCH, 0, own, 0, round(SLICE * 1e9), 0, 0)
        ctypes.CDLL(None).syscall(number, 0, asked, 0)  # refused: all stays as it is

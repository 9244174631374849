"""Real-time scheduling: of all threads of a process, not of what it starts; where it is forbidden, a line says so."""

import json
import os
import subprocess
import sys

import pytest

from knee_contact_ros.system import realtime

RUN = """
import json, os, subprocess, sys, threading
from resource import RLIMIT_MEMLOCK, RLIMIT_RTPRIO, RLIMIT_RTTIME, getrlimit, setrlimit
from knee_contact_ros.system.realtime import *

def policies():
    found = {os.sched_getscheduler(int(each)) for each in os.listdir("/proc/self/task")}
    return sorted({each & ~os.SCHED_RESET_ON_FORK for each in found})

threading.Thread(target=threading.Event().wait, daemon=True).start()
if sys.argv[1:]:
    setrlimit(RLIMIT_RTPRIO, (0, 0))
    setrlimit(RLIMIT_MEMLOCK, (0, 0))
    if not os.getuid():
        os.setuid(65534)
found = [begin_realtime(), policies()]
start_ordinary()
child = subprocess.Popen(["sleep", "10"])
found.append(os.sched_getscheduler(child.pid))
child.kill()
locked = [line.split() for line in open("/proc/self/status") if line.startswith("VmLck")]
found += [int(locked[0][1]) > 0, getrlimit(RLIMIT_RTTIME)]
end_realtime()
print(json.dumps([*found, policies()]))
"""


def outcome(*forbidden):
    command = [sys.executable, "-c", RUN, *forbidden]
    environment = os.environ | {"USER": "ann"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return json.loads(done.stdout)


def test_threads_are_real_time_and_what_they_start_is_not():
    said, *found = outcome()
    if said:
        pytest.skip(said)
    limits = [1e6 * realtime.LONGEST_RUN, 1e6 * realtime.LONGEST_WILD]
    assert found == [[os.SCHED_FIFO], os.SCHED_OTHER, True, limits, [os.SCHED_OTHER]]


def test_where_it_is_forbidden_a_line_says_what_to_set():
    said, threads, *_ = outcome("forbidden")
    assert threads == [os.SCHED_OTHER]
    assert (
        "write 'ann - rtprio 20' and 'ann - memlock unlimited' into /etc/security/limits.d" in said
    )


def test_other_systems_are_told(monkeypatch):
    monkeypatch.setattr("sys.platform", "darwin")
    assert "needs Linux" in realtime.begin_realtime()
    realtime.end_realtime()
    realtime.start_ordinary()
    realtime.leave_processor()

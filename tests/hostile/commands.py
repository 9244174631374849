"""Runs commands one after another, each in a process of its own with little memory and time, without importing anew.

Reads a line of JSON with the arguments, writes one with what came of them.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
from importlib import import_module
from pathlib import Path

from knee_contact_ros.commands.main import main
from tests.helpers.needs import HAS_VIEWER

for needed in (
    "lab.report.figures",
    "lab.report.page",
    "bags.recover",
    "offline.solve",
    "offline.estimate_load",
    *["commands.view"][:HAS_VIEWER],
):
    import_module(f"knee_contact_ros.{needed}")

MEMORY = 3 * 2**30
"""[B] of addresses"""
SECONDS = 20
"""Of a processor"""
PATIENCE = 60
"""[s] for one that waits for something"""


def limited(arguments: list[str], log: Path) -> int:
    """The exit code of a command in a process of its own that says what it says to `log`; negative: of a signal."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    code = 70
    try:
        descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for stream in (1, 2):
            os.dup2(descriptor, stream)
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        signal.alarm(PATIENCE)
        code = main(arguments)
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    for line in sys.stdin:
        asked = json.loads(line)
        told = limited(asked["arguments"], Path(asked["log"]))
        sys.stdout.write(f"{json.dumps(told)}\n")
        sys.stdout.flush()

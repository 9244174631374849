"""Commands that run in processes of their own which need not import much: they are forked."""

import multiprocessing
import os
import signal
import sys
from ctypes import CDLL
from pathlib import Path
from tempfile import NamedTemporaryFile

from tests.helpers.needs import HAS_REPORT, HAS_VIEWER

COMMAND = "knee_contact_ros.commands.main"
MODULES = (
    "pytest",
    "tests.helpers.kernel",
    *(
        f"knee_contact_ros.{name}"
        for name in (
            "commands.main",
            "commands.live",
            "bags.recover",
            "offline.estimate_load",
            "offline.solve",
            "view.anatomy",
            *["lab.report"][:HAS_REPORT],
            *["commands.view"][:HAS_VIEWER],
        )
    ),
)
"""What commands import; nothing of ROS, whose libraries begin threads"""
PROCESSES = multiprocessing.get_context("forkserver")
"""Imports are most of what a command's start costs: one process has imported what all of them need, and forks. There is
one such process for all tests of a pytest process"""
PROCESSES.set_forkserver_preload([__name__, *MODULES])
DEATH_SIGNAL = 1
"""Option of Linux's `prctl`: the signal that a process gets when its parent is gone"""


def forked(words, without, environment, log):
    """In a process of its own: run the command, `without` modules; what it says goes to `log`."""
    descriptor = os.open(log, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(descriptor, stream)
    CDLL(None).prctl(DEATH_SIGNAL, signal.SIGTERM)
    os.environ.clear()
    os.environ.update(environment)
    sys.modules.update(dict.fromkeys(without.split(","), None))  # type: ignore[arg-type]
    from knee_contact_ros.commands.main import main

    sys.exit(main(words))


class Forked:
    """A process that runs the command, used like a `Popen`."""

    def __init__(self, words, without):
        with NamedTemporaryFile(delete=False) as log:
            self._log = Path(log.name)
        self._process = PROCESSES.Process(
            target=forked, args=(words, without, dict(os.environ), self._log)
        )
        self._process.start()
        self.pid = int(self._process.pid or 0)

    def poll(self):
        """Return its code, if it has ended."""
        return self._process.exitcode

    def wait(self, timeout):
        """Wait for its end."""
        self._process.join(timeout)
        assert self._process.exitcode is not None, "it did not end in time"
        return self._process.exitcode

    def communicate(self, timeout):
        """Wait for its end; return what was said, and no errors."""
        self.wait(timeout)
        said = self._log.read_text() if self._log.exists() else ""
        self._log.unlink(missing_ok=True)
        return said, None

    def send_signal(self, number):
        """Send it a signal, if it still runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self):
        """Kill it."""
        self.send_signal(signal.SIGKILL)

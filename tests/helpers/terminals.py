"""A terminal of its own for a command, with a small shell that stops it, lets it go on, and looks at the modes."""

from __future__ import annotations

import os
import pty
import re
import select
import subprocess
import sys
import time
from contextlib import suppress

from tests.helpers.patience import patience

SHELL = """
import fcntl, os, signal, subprocess, sys, termios

def modes():
    flags = termios.tcgetattr(0)[3]
    return "usual" if flags & termios.ICANON and flags & termios.ECHO else "single keys"

fcntl.ioctl(0, termios.TIOCSCTTY, 0)
child = subprocess.Popen(sys.argv[1:], preexec_fn=os.setpgrp)
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTTOU])
signal.signal(signal.SIGHUP, signal.SIG_IGN)
os.tcsetpgrp(0, child.pid)
print(f"[started {child.pid}]", flush=True)
while True:
    _, status = os.waitpid(child.pid, os.WUNTRACED)
    os.tcsetpgrp(0, os.getpgrp())
    if not os.WIFSTOPPED(status):
        break
    print(f"[stopped, {modes()}]", flush=True)
    sys.stdin.readline()
    os.tcsetpgrp(0, child.pid)
    os.kill(child.pid, signal.SIGCONT)
print(f"[ended with {os.waitstatus_to_exitcode(status)}, {modes()}]", flush=True)
"""
"""What a shell with job control does: `fg` is any line"""


class Terminal:
    """A command in a terminal."""

    def __init__(self, *command):
        self.master, slave = pty.openpty()
        self.shell = subprocess.Popen(
            [sys.executable, "-c", SHELL, *command],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
        )
        os.close(slave)
        self.text = ""
        self.pid = int(self.wait_for(r"\[started (\d+)\]")[1])

    def press(self, keys):
        """Press keys."""
        os.write(self.master, keys)

    def wait_for(self, pattern):
        """Wait for words; what stood before them is forgotten."""
        begin = time.monotonic()
        while (found := re.search(pattern, self.text)) is None:
            assert time.monotonic() < begin + patience(), f"no {pattern!r} in {self.text!r}"
            if select.select([self.master], [], [], 0.1)[0]:
                try:
                    self.text += os.read(self.master, 65536).decode()
                except OSError:  # nobody is there any more
                    raise AssertionError(f"no {pattern!r} in {self.text!r}") from None
        self.text = self.text[found.end() :]
        return found

    def __enter__(self):
        return self

    def __exit__(
        self,
        kind,
        error,
        trace,
    ):
        if self.shell.poll() is None and kind is not None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, 9)
            self.shell.kill()
        os.close(self.master)
        self.shell.wait(patience())

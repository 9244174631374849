"""The progress bar: on a terminal, to its end, and nothing in a pipe."""

from __future__ import annotations

import subprocess
import sys

from tests.helpers.terminals import Terminal

PROGRAM = """
from knee_contact_ros.system.terminal import progress

with progress("Solving") as advance:
    for done in range(1, 300_001):
        advance(done, 300_000)
    advance.describe("Done with")
"""


def test_a_long_run_shows_a_bar_that_comes_to_its_end() -> None:
    with Terminal(sys.executable, "-c", PROGRAM) as terminal:
        terminal.wait_for("Solving")
        terminal.wait_for("Done with.*100%")
        terminal.wait_for(r"\[ended with 0, usual\]")


def test_there_is_none_in_a_pipe() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=60)
    assert (done.stdout, done.stderr) == ("", "")

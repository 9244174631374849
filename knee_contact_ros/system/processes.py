"""Another process of ours: started, watched, ended as a user would, and never left behind."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import NamedTuple

from knee_contact_ros.system.errors import UsageError

PATIENCE = 30.0
"""How long [s] a process may take to end, as a rule"""


class Child(NamedTuple):
    """A process, and what it says."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    def check(self) -> None:
        """Tell if it has died.

        Raises:
            UsageError: it has.
        """
        if self.process.poll() is not None:
            lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
            raise UsageError(
                f"{self.name} ended with code {self.process.returncode}: {lines[-1] if lines else 'it said nothing'}"
            )


@contextmanager
def child_process(name: str, arguments: Sequence[str], log: Path, patience: float = PATIENCE) -> Iterator[Child]:
    """`python` with these arguments and its output in `log`; at the end it gets SIGINT and `patience` [s].

    Raises:
        UsageError: it failed, or did not end.
    """
    command = [sys.executable, *arguments]
    process = None
    try:
        with log.open("wb") as output, signals_later():
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=output, stderr=output)
        child = Child(name, process, log)
        yield child
        process.send_signal(signal.SIGINT)
        process.wait(patience)
        if process.returncode:
            child.check()
    except subprocess.TimeoutExpired:
        raise UsageError(f"{name} did not end within {patience:g} s") from None
    finally:
        if process:
            end(process, patience)


@contextmanager
def signals_later() -> Iterator[None]:
    """Hold SIGINT and SIGTERM back meanwhile: one between a process's start and its being known would leave it behind.

    Of the main thread only, which alone has them.
    """
    came: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _frame: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for late in came:
            signal.raise_signal(late)


@contextmanager
def interrupted_by_sigterm() -> Iterator[None]:
    """Have SIGTERM do meanwhile what Ctrl-C does, so that what was begun is cleared away. Of the main thread only.

    Raises:
        KeyboardInterrupt: it came.
    """

    def on_terminate(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, on_terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)


def end(process: subprocess.Popen[bytes], patience: float) -> None:
    """End a process if it still runs, at once if it does not listen or the user is in a hurry."""
    try:
        if process.poll() is None:
            process.terminate()
            process.wait(patience)
    except subprocess.TimeoutExpired:
        pass
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()

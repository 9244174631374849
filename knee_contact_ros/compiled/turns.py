"""Of several processes that need the same kernel, one compiles it, and the others wait for what it keeps.

Without that, two nodes, or the workers of a study, would all compile the same code for a quarter of a minute.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from contextvars import ContextVar

from knee_contact_ros.compiled.kernel_folder import DoubtError, KernelFolder

PATIENCE = 60.0
"""The longest time [s] to wait: the process that compiles may be suspended"""
LOOK = 0.05
"""Period [s] of looking for the kernel while waiting"""
COLLECTED = 50_000, 20, 50
"""Thresholds of Python's garbage collector while something is compiled"""
Announce = Callable[[], AbstractContextManager[None]]
"""Makes the context in which something is compiled, and which tells a person so"""


class Turn:
    """This process's turn to compile something, from its first look for a kept kernel on."""

    def __init__(self, name: Callable[[], str], announce: Announce) -> None:
        self.name = name
        self.announce: Announce | None = announce
        self.begun = False
        self.end = ExitStack()


_TURN: ContextVar[Turn | None] = ContextVar("turn", default=None)


@contextmanager
def in_turn(name: Callable[[], str], announce: Announce = nullcontext) -> Iterator[None]:
    """Let code in this context wait for another process that compiles under the same name, before it compiles."""
    turn = Turn(name, announce)
    before = _TURN.set(turn)
    try:
        yield
    finally:
        _TURN.reset(before)
        turn.end.close()


def announce_compiling() -> None:
    """Announce within `in_turn`, once, that something has to be compiled, here or by another process."""
    turn = _TURN.get()
    if turn and turn.announce:
        announce, turn.announce = turn.announce, None
        turn.end.enter_context(announce())
        turn.end.enter_context(_rarely_collected())


@contextmanager
def _rarely_collected() -> Iterator[None]:
    """Collect garbage rarely: searching the compiler's millions of objects, which stay, took a sixth of its time."""
    before = gc.get_threshold()
    gc.set_threshold(*COLLECTED)
    try:
        yield
    finally:
        gc.set_threshold(*before)


def read_or_wait(folder: KernelFolder, name: str, start: str) -> bytes | None:
    """Read a kept file, after waiting for another process that may be compiling its content; None if there is none.

    Args:
        folder: The folder of the file.
        name: Name of the file.
        start: How the name begins whatever the processor is.

    Raises:
        DoubtError: the file cannot be used, or there are only files for other processors.
    """
    content = folder.read(name)
    if content is None:
        announce_compiling()
        wait_for_turn(folder, name)
        content = folder.read(name)
    if content is None and any(other.startswith(start) for other in folder.names()):
        raise DoubtError(folder.path, "is from another processor")
    return content


def wait_for_turn(folder: KernelFolder, file: str) -> None:
    """Wait, once within `in_turn`, until a file exists or no other process compiles it; elsewhere return at once.

    A process that has waited in vain compiles without a lock: otherwise, if the file cannot be kept, all processes
    would compile one after another.
    """
    turn, waited, deadline = _TURN.get(), False, time.monotonic() + PATIENCE
    if turn is None or turn.begun:
        return
    turn.begun = True
    with suppress(OSError, DoubtError):
        name = turn.name()
        while not (unlock := folder.lock(name)):
            waited = True
            if file in folder.names() or time.monotonic() > deadline:
                return
            time.sleep(LOOK)
        if waited:
            unlock()
        else:
            turn.end.callback(unlock)

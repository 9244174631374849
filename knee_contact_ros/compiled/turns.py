"""Of processes that need the same kernel at once, one compiles it, and the others wait for what it keeps.

Two nodes beside each other, or the workers of a study, would all be busy with the same for a quarter of a minute.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from contextvars import ContextVar

from knee_contact_ros.compiled.kernel_folder import DoubtError, KernelFolder

PATIENCE = 60.0
"""How long [s] to wait at most: who compiles may stand still"""
LOOK = 0.05
"""How often [s] to look meanwhile"""
COLLECTED = 50_000, 20, 50
"""Thresholds of Python's garbage collector while something is compiled"""
Told = Callable[[], AbstractContextManager[None]]
"""Tells a person, once something has to be compiled, for as long as that takes"""


class Turn:
    """This process's turn to compile something, from its first look on."""

    def __init__(self, name: Callable[[], str], told: Told) -> None:
        self.name = name
        self.told: Told | None = told
        self.begun = False
        self.end = ExitStack()


_TURN: ContextVar[Turn | None] = ContextVar("turn", default=None)


@contextmanager
def in_turn(name: Callable[[], str], told: Told = nullcontext) -> Iterator[None]:
    """Wait meanwhile, where something has to be compiled, for another process that does that under the same name."""
    turn = Turn(name, told)
    before = _TURN.set(turn)
    try:
        yield
    finally:
        _TURN.reset(before)
        turn.end.close()


def tell_of_compiling() -> None:
    """Something has to be compiled, here or by another process: within `in_turn` it is told, once."""
    turn = _TURN.get()
    if turn and turn.told:
        told, turn.told = turn.told, None
        turn.end.enter_context(told())
        turn.end.enter_context(_rarely_collected())


@contextmanager
def _rarely_collected() -> Iterator[None]:
    """The compiler makes millions of objects that stay: to look through them for garbage took a sixth of its time."""
    before = gc.get_threshold()
    gc.set_threshold(*COLLECTED)
    try:
        yield
    finally:
        gc.set_threshold(*before)


def wait_for_turn(folder: KernelFolder, file: str) -> None:
    """Wait until a file is there, or nobody else compiles; within `in_turn`, once. Else return at once.

    Who has waited in vain compiles, and keeps nobody waiting: what could not be kept would be compiled in a row.
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

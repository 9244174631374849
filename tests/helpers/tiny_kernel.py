"""A function that is compiled in no time, and kept as kernels are; each use of it is a process of its own."""

from __future__ import annotations

import importlib
import os
import resource
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import ExitStack, nullcontext
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from knee_contact_ros.compiled.functions import compiled_function
from knee_contact_ros.compiled.turns import Announce, in_turn

FORKS = get_context("forkserver")
FORKS.set_forkserver_preload([__name__, "tests.helpers.warm_compiler"])  # seconds, once for all of them
UNLIMITED = resource.RLIM_INFINITY


class Outcome(NamedTuple):
    """What a process has seen."""

    answer: Any
    loaded: bool
    said: list[str]


def twice(value: Any) -> Any:
    return value + value


def use(home: Path, value: Any = 21.0, **how: Any) -> Outcome:
    """Compile or load the function, with the cache in `home`."""
    with ExitStack() as stack:
        return begin(stack, home, value, **how).result()


def begin(stack: ExitStack, home: Path, value: Any, **how: Any) -> Future[Outcome]:
    """The same, begun."""
    pool = stack.enter_context(ProcessPoolExecutor(1, mp_context=FORKS))
    return pool.submit(_use, home, value, **how)


def use_all(home: Path, values: Sequence[Any], **how: Any) -> Outcome:
    """Compile or load the function for several values in one process, each in a turn of its own."""
    with ProcessPoolExecutor(1, mp_context=FORKS) as pool:
        return pool.submit(_use_all, home, values, **how).result()


def use_own(home: Path, folder: Path) -> Outcome:
    """Compile or load `own.ask` of a folder."""
    with ProcessPoolExecutor(1, mp_context=FORKS) as pool:
        return pool.submit(_use_own, home, folder).result()


def _use_own(home: Path, folder: Path) -> Outcome:
    sys.path.insert(0, str(folder))
    own = importlib.import_module("own")
    return alone(home, own.ask, own.Own(2.0))


def use_in_turn(home: Path, value: Any) -> Outcome:
    """Compile or load the function, in turn with others."""
    with in_turn(lambda: "twice"):
        return alone(home, twice, value)


def _use(home: Path, value: Any, largest_file: int = UNLIMITED, **environment: str) -> Outcome:
    limit_files(largest_file)
    os.environ.update(environment)
    return alone(home, twice, value)


def _use_all(
    home: Path, values: Sequence[Any], announce: Announce = nullcontext, largest_file: int = UNLIMITED
) -> Outcome:
    limit_files(largest_file)
    return alone(home, twice, *values, announce=announce)


def limit_files(largest: int) -> None:
    """Let no file that is written grow beyond a size [B]; bytecode of modules would be cut off, so none is written."""
    sys.dont_write_bytecode = largest != UNLIMITED
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, UNLIMITED))


def alone(home: Path, function: Any, *values: Any, announce: Announce | None = None) -> Outcome:
    """Compile or load a function in this process; in turns, if they are announced."""
    os.environ["XDG_CACHE_HOME"] = str(home)
    with tempfile.TemporaryFile("w+") as said:
        os.dup2(said.fileno(), 2)
        made: Any = compiled_function(function)
        answers = []
        for value in values:
            with in_turn(partial(str, value), announce) if announce else nullcontext():
                answers.append(made(value))
        said.seek(0)
        answer = answers if len(answers) > 1 else answers[0]
        return Outcome(answer, bool(made.stats.cache_hits), said.read().splitlines())

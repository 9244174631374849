"""Many knees of one kind through the same ticks, one after another in compiled code: the bits of `ticks.run`.

A call from Python takes a scene apart for microseconds and holds Python's lock. Here all scenes are laid down first,
and then one call takes them through, without the lock: several threads do several knees at once.
"""

from __future__ import annotations

import functools
import itertools
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import Any

import numba
import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from knee_contact_ros.compiled.by_address import scene_memory
from knee_contact_ros.compiled.cache import kernel_cache
from knee_contact_ros.compiled.functions import ENTRY, compiled_function
from knee_contact_ros.compiled.source_meaning import digest
from knee_contact_ros.compiled.turns import Told, in_turn
from knee_contact_ros.core import ticks
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.core.ticks import MEMORY
from knee_contact_ros.core.types import Rows

Floats = NDArray[np.float64]


def run_batch(
    scenes: Sequence[Scene], durations: Floats, angles: Floats, loads: Floats, heights: Floats, answers: Rows,
    *, threads: int = 1, told: Told = nullcontext,
) -> None:  # fmt: skip
    """Take each scene through n ticks from rest, as `ticks.run` does.

    Args:
        scenes: k of one kind: they differ in numbers alone.
        durations: [s], shape (n,), as angles and heights are.
        angles: [rad].
        loads: [N], shape (k, n).
        heights: [m], not a number where they are not prescribed.
        answers: Rows of shape (k, n), to be filled; all but stamp and latency are.
        threads: How many work at once; 0: as many as there are processors to use.
        told: The context in which is compiled.
    """
    kind = numba.typeof(scenes[0])
    memory_of = scene_memory(kind)
    with in_turn(lambda: digest(str(kind)), told):
        through = _through(kind)
        laid = np.zeros((len(scenes), memory_of.size), dtype=np.uint8)
        for scene, place in zip(scenes, laid, strict=True):
            memory_of.put(scene, place.ctypes.data)
        through(laid.ctypes.data, 0, 0, durations, angles, loads, heights, _memory(0), answers)

    def part(numbers: range) -> None:
        through(
            laid.ctypes.data, numbers.start, numbers.stop, durations, angles, loads, heights, _memory(len(numbers)),
            answers,
        )  # fmt: skip

    workers = min(threads or len(os.sched_getaffinity(0)), len(scenes))
    ends = [round(len(scenes) * i / workers) for i in range(workers + 1)]
    parts = [range(begin, end) for begin, end in itertools.pairwise(ends)]
    if len(parts) == 1:
        part(parts[0])
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(part, parts))


def _memory(number: int) -> ticks.Memory:
    """Of runs that have not begun."""
    return np.zeros(number, MEMORY)


@functools.cache
def _through(kind: types.Type) -> Any:
    """For a kind of scene: a function that takes those of a range of numbers through, given where they lie."""
    compiled_run, memory_of = compiled_function(ticks.run), scene_memory(kind)
    taken_up, size = memory_of.taken_up, memory_of.size

    def through(
        address: int, begin: int, end: int, durations: Any, angles: Any, loads: Any, heights: Any, memory: Any,
        answers: Any,
    ) -> None:  # fmt: skip
        for i in range(begin, end):
            own = memory[i - begin : i - begin + 1]
            compiled_run(taken_up(address + i * size), own, durations, angles, loads[i], heights, answers[i])

    made: Any = njit(**ENTRY, nogil=True)(through)
    made._cache = kernel_cache(through, kind)
    return made

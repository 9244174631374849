"""Many knees of one kind through the same ticks in compiled code, in step where they can be: the bits of `ticks.run`.

A call from Python takes a scene apart for microseconds and holds Python's lock. Here all scenes are laid down first,
and then one call takes them through, without the lock: several threads do several knees at once.
"""

from __future__ import annotations

import functools
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
from knee_contact_ros.compiled.lanes import Kernel, fits, lanes_kernel
from knee_contact_ros.compiled.source_meaning import digest
from knee_contact_ros.compiled.transposed import LANES, memory_of
from knee_contact_ros.compiled.turns import Told, in_turn
from knee_contact_ros.core import ticks
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.core.ticks import MEMORY
from knee_contact_ros.core.types import Rows

FEWEST = 3
"""Knees that are quicker in lanes, most of them empty, than one after the other"""
Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]
_NONE = np.zeros(0, dtype=np.int64)
"""No knees: a kernel is compiled by taking none through"""


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
    workers = min(threads or len(os.sched_getaffinity(0)), len(scenes))
    kind, columns = numba.typeof(scenes[0]), (durations, angles, loads, heights)
    memory, shares = scene_memory(kind), _shares([fits(scene) for scene in scenes], workers)
    with in_turn(lambda: digest(str(kind)), told):
        laid = np.zeros((len(scenes), memory.size), dtype=np.uint8)
        for scene, place in zip(scenes, laid, strict=True):
            memory.put(scene, place.ctypes.data)
        kernels = [
            kernel(kind) if any(len(share[i]) for share in shares) else None
            for i, kernel in enumerate((lanes_kernel, _one_by_one))
        ]
        for kernel in filter(None, kernels):
            kernel.through(0, _NONE, *columns, _memory(0), answers, 0)

    def part(share: tuple[Numbers, Numbers]) -> None:
        for kernel, numbers in zip(kernels, share, strict=True):
            if kernel:
                room = memory_of(kernel.rows)
                kernel.through(laid.ctypes.data, numbers, *columns, _memory(len(numbers)), answers, room.ctypes.data)

    if workers == 1:
        part(shares[0])
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(part, shares))


def _shares(in_lanes: Sequence[bool], workers: int) -> list[tuple[Numbers, Numbers]]:
    """For each worker, numbers of knees that go in lanes, and of those that go alone."""
    shares = []
    for able, others in zip(
        np.array_split(np.flatnonzero(in_lanes), workers),
        np.array_split(np.flatnonzero(np.logical_not(in_lanes)), workers),
        strict=True,
    ):
        rest = len(able) % LANES
        end = len(able) - rest if rest < FEWEST else len(able)
        shares.append((able[:end], np.concatenate([able[end:], others])))
    return shares


def _memory(number: int) -> ticks.Memory:
    """Of runs that have not begun."""
    return np.zeros(number, MEMORY)


@functools.cache
def _one_by_one(kind: types.Type) -> Kernel:
    """For a kind of scene: the kernel for knees that do not fit into lanes."""
    compiled_run, scenes = compiled_function(ticks.run), scene_memory(kind)
    taken_up, size = scenes.taken_up, scenes.size

    def through(
        address: int, numbers: Any, durations: Any, angles: Any, loads: Any, heights: Any, memory: Any, answers: Any,
        _rows: int,
    ) -> None:  # fmt: skip
        for i in range(len(numbers)):
            knee, own = numbers[i], memory[i : i + 1]
            compiled_run(taken_up(address + knee * size), own, durations, angles, loads[knee], heights, answers[knee])

    made: Any = njit(**ENTRY, nogil=True)(through)
    made._cache = kernel_cache(through, kind)
    return Kernel(0, made)

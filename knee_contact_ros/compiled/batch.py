"""Many knees of one kind through the same ticks in compiled code, in step where they can be: the bits of `ticks.run`.

A call from Python takes a scene apart for microseconds and holds Python's lock. Here all scenes are laid down first,
and then one call takes them through, without the lock: several threads do several knees at once.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import numba
import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.compiled.by_address import addresses_of, kernel_of
from knee_contact_ros.compiled.lanes import Kernel, OneTick, fits, lanes_kernel
from knee_contact_ros.compiled.layout import kind_of, laid_down
from knee_contact_ros.compiled.machine_code import Native
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
    columns = [np.ascontiguousarray(column, np.float64) for column in (durations, angles, loads, heights)]
    shares = _shares([fits(scene) for scene in scenes], workers)
    same = kind_of(scenes[0])
    laid = laid_down(scenes, same)
    native, kernel = kernel_of(scenes[0], same, told), None
    if any(len(share[0]) for share in shares):
        kind = numba.typeof(scenes[0])
        with in_turn(lambda: digest(str(kind)), told):
            kernel = lanes_kernel(kind)
            _in_lanes(kernel, native, laid, _NONE, columns, answers)

    def part(share: tuple[Numbers, Numbers]) -> None:
        in_lanes, others = share
        if kernel and len(in_lanes):
            _in_lanes(kernel, native, laid, in_lanes, columns, answers)
        memory = _memory(1)
        arrays = laid, memory, *columns, answers
        firsts, addresses = addresses_of(*arrays), np.zeros(len(arrays), np.uintp)
        rows = np.array([array.strides[0] if array.ndim > 1 else 0 for array in arrays], np.uintp)
        place = addresses.ctypes.data
        for knee in others.tolist():
            memory.fill(0)
            np.add(firsts, rows * knee, out=addresses)
            if native.run(place, len(durations), 0.0, 0.0, 0.0, 0.0):
                raise MemoryError("a run of ticks")

    if workers == 1:
        part(shares[0])
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(part, shares))


def _in_lanes(
    kernel: Kernel, native: Native, laid: NDArray[np.uint8], numbers: Numbers, columns: list[Floats], answers: Rows
) -> None:
    """Take knees that fit through by their numbers."""
    memory, room = _memory(len(numbers)), memory_of(kernel.rows)
    arrays = laid, memory, *columns, answers
    one_tick = OneTick(native.address, *[array.ctypes.data for array in arrays])
    kernel.through(numbers, *columns[:3], memory, answers, room.ctypes.data, one_tick, np.zeros(len(arrays), np.uintp))


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

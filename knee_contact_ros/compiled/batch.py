"""Many knees of one kind through the same ticks in compiled code, where possible in lanes; the bits of `ticks.run`.

A call from Python takes microseconds to unpack a scene, and holds Python's lock. Here all scenes are laid down first,
and one call computes them all without the lock: several threads compute several knees at once.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import numba
import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.compiled.kernel import addresses_of, kernel_of
from knee_contact_ros.compiled.lanes import LanesKernel, OneTick, fits, lanes_kernel
from knee_contact_ros.compiled.layout import kind_of, laid_down
from knee_contact_ros.compiled.machine_code import Native
from knee_contact_ros.compiled.source_meaning import digest
from knee_contact_ros.compiled.transposed import LANES, memory_of
from knee_contact_ros.compiled.turns import Announce, in_turn
from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.core.ticks import MEMORY
from knee_contact_ros.core.types import Rows

FEWEST = 3
"""The least number of knees that is faster in lanes, most of them empty, than one after the other"""
Numbers = NDArray[np.int64]
_NONE = np.zeros(0, dtype=np.int64)
"""No knees: a kernel is compiled by a call with none"""


def run_batch(
    scenes: Sequence[Scene], durations: Floats, angles: Floats, loads: Floats, heights: Floats, answers: Rows,
    *, threads: int = 1, announce: Announce = nullcontext,
) -> None:  # fmt: skip
    """Compute n ticks of each scene from rest, as `ticks.run` does.

    Args:
        scenes: k scenes of one kind: they differ in numbers alone.
        durations: Time since the tick before [s], shape (n,).
        angles: Flexion angle [rad], shape (n,).
        loads: Compressive load [N], shape (k, n).
        heights: Prescribed femoral height [m], shape (n,); not a number where it is not prescribed.
        answers: Rows of shape (k, n) to be filled; stamp and latency are left as they are.
        threads: Number of threads; 0: one for each processor.
        announce: Makes the context in which something is compiled.
    """
    workers = min(threads or len(os.sched_getaffinity(0)), len(scenes))
    columns = [np.ascontiguousarray(column, np.float64) for column in (durations, angles, loads, heights)]
    shares = _shares([fits(scene) for scene in scenes], workers)
    same = kind_of(scenes[0])
    laid = laid_down(scenes, same)
    native, kernel = kernel_of(scenes[0], same, announce), None
    if any(len(share[0]) for share in shares):
        kind = numba.typeof(scenes[0])
        with in_turn(lambda: digest(str(kind)), announce):
            kernel = lanes_kernel(kind)
            _in_lanes(kernel, native, laid, _NONE, columns, answers)

    def part(share: tuple[Numbers, Numbers]) -> None:
        in_lanes, others = share
        if kernel and len(in_lanes):
            _in_lanes(kernel, native, laid, in_lanes, columns, answers)
        memory = np.zeros(1, MEMORY)
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
    kernel: LanesKernel, native: Native, laid: NDArray[np.uint8], numbers: Numbers, columns: list[Floats], answers: Rows
) -> None:
    """Compute the knees of some numbers in lanes."""
    memory, room = np.zeros(len(numbers), MEMORY), memory_of(kernel.rows)
    arrays = laid, memory, *columns, answers
    one_tick = OneTick(native.address, *[array.ctypes.data for array in arrays])
    kernel.through(numbers, *columns[:3], memory, answers, room.ctypes.data, one_tick, np.zeros(len(arrays), np.uintp))


def _shares(in_lanes: Sequence[bool], workers: int) -> list[tuple[Numbers, Numbers]]:
    """Give each worker the numbers of the knees that it computes in lanes, and of those that it computes alone."""
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

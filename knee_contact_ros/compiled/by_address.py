"""A stream's tick, called by address.

A call with a scene as its argument spends microseconds on taking the scene apart. So a stream lays its scene down once,
as compiled code sees it, and ticks with the addresses of scene, memory and answer: as runs of one tick, so that runs
and streams share what is compiled.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any, NamedTuple

import numba
import numpy as np
from cffi import FFI
from numba import carray, njit, types
from numba.core.ccallback import CFunc
from numba.core.registry import cpu_target
from numba.extending import intrinsic

from knee_contact_ros.compiled.cache import kernel_cache
from knee_contact_ros.compiled.functions import ENTRY, compiled_function
from knee_contact_ros.compiled.source_meaning import digest
from knee_contact_ros.compiled.turns import Told, in_turn
from knee_contact_ros.core import ticks
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.core.ticks import MEMORY, Memory
from knee_contact_ros.core.types import ROW, Rows

TICK = "void (*)(uintptr_t, double, double, double, double)"
"""C type of the tick: address of the addresses of memory, sample, answer and scene; duration, angle, load and height"""
_KEPT: list[Any] = []
"""Compiled code that is called by address"""


def bind(
    scene: Scene, memory: Memory, answer: Rows, told: Told = nullcontext
) -> Callable[[float, float, float, float], None]:
    """See `Kernel.bind`."""
    kind = numba.typeof(scene)
    with in_turn(lambda: digest(str(kind)), told):
        size, put, call = _by_address(kind)
        block = np.zeros(size, dtype=np.uint8)
        put(scene, block.ctypes.data)
    sample = np.zeros(4)
    places = memory, sample, answer, block
    addresses = np.array([place.ctypes.data for place in places], dtype=np.uintp)
    tick = functools.partial(call, addresses.ctypes.data)
    tick.keeps = scene, addresses, places  # type: ignore[attr-defined]
    return tick


class SceneMemory(NamedTuple):
    """How scenes of a kind lie in memory, as compiled code sees them."""

    size: int
    """[B] of one"""
    put: Callable[..., None]
    """Lay a scene down at an address"""
    taken_up: Callable[..., Any]
    """For compiled code: the scene at an address"""


@functools.cache
def scene_memory(kind: types.Type) -> SceneMemory:
    """For a kind of scene, Numba's type of it."""
    context = cpu_target.target_context

    @intrinsic
    def laid_down(_typing: Any, scene: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            builder.store(arguments[0], _pointer(context, builder, kind, arguments[1]))
            return context.get_dummy_value()

        return types.void(scene, address), generate

    @intrinsic
    def taken_up(_typing: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return builder.load(_pointer(context, builder, kind, arguments[0]))

        return kind(address), generate

    def put(scene: Any, address: Any) -> None:
        laid_down(scene, address)

    # Numba's decorators do likewise, with its own cache or none.
    lay_down: Any = njit(**ENTRY)(put)
    lay_down._cache = kernel_cache(put, kind)
    return SceneMemory(context.get_abi_sizeof(context.get_value_type(kind)), lay_down, taken_up)


@functools.cache
def _by_address(kind: types.Type) -> tuple[int, Callable[..., None], Callable[..., None]]:
    """For a kind of scene: its size in bytes, a function that lays one down, and one that ticks with it."""
    compiled_run, memory_of = compiled_function(ticks.run), scene_memory(kind)
    taken_up = memory_of.taken_up

    def tick(addresses: Any, duration: float, angle: float, load: float, height: float) -> None:
        memory, sample = carray(addresses[0], 1, MEMORY), carray(addresses[1], 4, np.float64)
        sample[0], sample[1], sample[2], sample[3] = duration, angle, load, height
        answers = carray(addresses[2], 1, ROW)
        compiled_run(taken_up(addresses[3]), memory, sample[:1], sample[1:2], sample[2:3], sample[3:], answers)

    pointer: Any = CFunc(
        tick, ((types.CPointer(types.voidptr), *[types.float64] * 4), types.void), locals={}, options={}
    )
    pointer._cache = kernel_cache(tick, kind)
    pointer.compile()
    _KEPT.append(pointer)
    return memory_of.size, memory_of.put, FFI().cast(TICK, pointer.address)


def _pointer(context: Any, builder: Any, kind: types.Type, address: Any) -> Any:
    """An address, a number or a pointer to anything, as a pointer to a scene."""
    scene = context.get_value_type(kind).as_pointer()
    return builder.bitcast(address, scene) if address.type.is_pointer else builder.inttoptr(address, scene)

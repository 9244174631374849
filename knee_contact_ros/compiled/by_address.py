"""The kernel of a kind of scene, called by address: runs, and a stream's ticks, which are runs of one tick.

What was compiled before is loaded by LLVM alone, in a tenth of the time that the import of Numba takes. A scene is laid
down as compiled code sees it (`layout.py`), and the kernel gets the addresses of scene, memory, samples and answers.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import numpy as np
from cffi import FFI
from numpy.typing import NDArray

from knee_contact_ros.compiled.keeping import NOT_KEPT, kernel_folder, sources_elsewhere, tell
from knee_contact_ros.compiled.kernel_folder import DoubtError, KernelFolder
from knee_contact_ros.compiled.layout import kind_of, laid_down, named_tuples, words_of
from knee_contact_ros.compiled.machine_code import Native, loaded, processor
from knee_contact_ros.compiled.source_meaning import digest
from knee_contact_ros.compiled.turns import Told, in_turn, tell_of_compiling, wait_for_turn
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.core.ticks import Memory
from knee_contact_ros.core.types import Rows

_FFI = FFI()
_READY: dict[Any, Native] = {}
"""Kernels of this process, by kind of scene"""


def run(
    told: Told, scene: Scene, memory: Memory, durations: Any, angles: Any, loads: Any, heights: Any, answers: Rows
) -> None:
    """See `ticks.run`."""
    kind = kind_of(scene)
    native, block = kernel_of(scene, kind, told), laid_down([scene], kind)
    columns = [np.ascontiguousarray(column, np.float64) for column in (durations, angles, loads, heights)]
    filled = answers if answers.flags.c_contiguous else answers.copy()
    addresses = addresses_of(block, memory, *columns, filled)
    if native.run(addresses.ctypes.data, len(durations), 0.0, 0.0, 0.0, 0.0):
        raise MemoryError("a run of ticks")
    if filled is not answers:
        answers[...] = filled


def bind(
    scene: Scene, memory: Memory, answer: Rows, told: Told = nullcontext
) -> Callable[[float, float, float, float], None]:
    """See `Kernel.bind`."""
    kind, sample = kind_of(scene), np.zeros((4, 1))
    native, block = kernel_of(scene, kind, told), laid_down([scene], kind)
    addresses = addresses_of(block, memory, *sample, answer)
    tick = functools.partial(native.tick, addresses.ctypes.data)
    tick.keeps = scene, memory, answer, block, sample, addresses  # type: ignore[attr-defined]
    return tick


def addresses_of(*arrays: NDArray[Any]) -> NDArray[np.uintp]:
    """Where contiguous arrays lie, in the order that a kernel wants: scene, memory, columns, answers."""
    pointers = _FFI.new("void *[]", [_FFI.from_buffer(array) for array in arrays])  # a fourth of the time of NumPy's
    return np.frombuffer(_FFI.buffer(pointers), np.uintp)


def is_kept(scene: Scene, *, only_on_disk: bool = False) -> bool:
    """Whether the kernel for a kind of scene has been compiled: in this process, or on this machine and kept."""
    kind = kind_of(scene)
    if kind in _READY and not only_on_disk:
        return True
    try:
        names = _names(kind)
        return names is not None and names[0] in KernelFolder(kernel_folder()).names()
    except Exception:  # whoever loads it tells of it
        return False


def kernel_of(scene: Scene, kind: Any, told: Told = nullcontext) -> Native:
    """The kernel for a scene of a kind: known already, loaded, or compiled and kept."""
    native = _READY.get(kind)
    if native is None:
        with in_turn(lambda: digest(words_of(kind)), told):
            native = _READY[kind] = _kept(kind) or _compiled(scene, kind)
    return native


def _kept(kind: Any) -> Native | None:
    """What was kept for a kind of scene; None if there is nothing that can be used."""
    try:
        names = _names(kind)
        if names is not None:
            name, start = names
            folder = KernelFolder(kernel_folder())
            code = folder.read(name)
            if code is None:
                tell_of_compiling()
                wait_for_turn(folder, name)
                code = folder.read(name)
            if code is not None:
                return loaded(code)
            if any(other.startswith(start) for other in folder.names()):
                raise DoubtError(folder.path, "is from another processor")
    except Exception as error:  # what is whole and ours may still have been made by something else
        tell(error, "compiling again")
    tell_of_compiling()
    return None


def _compiled(scene: Scene, kind: Any) -> Native:
    """The kernel, compiled, and kept if that can be done."""
    from knee_contact_ros.compiled.compile_kernel import machine_code

    code = machine_code(scene)
    try:
        names = _names(kind)
        if names is not None:
            folder = KernelFolder(kernel_folder())
            folder.write(names[0], code)
            folder.remove_unused()
    except Exception as error:
        tell(error, NOT_KEPT)
    return loaded(code)


def _names(kind: Any) -> tuple[str, str] | None:
    """The name of a kind's file, and how it starts whatever the processor; None for what cannot be found again."""
    made_of = list(named_tuples(kind))
    sources = sources_elsewhere(made_of)
    if sources is None:
        return None
    start = f"knee-{digest((words_of(kind), sources))}-"
    return f"{start}{digest(processor())}.kernel", start

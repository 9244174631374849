"""The compiled kernel of a kind of scene, called by address: runs, and a stream's ticks, which are runs of one tick.

What was compiled before is loaded by LLVM alone, in a tenth of the time that the import of Numba takes; Numba is
imported where something is compiled. A scene is laid down as compiled code sees it (`layout.py`), and the kernel gets
the addresses of scene, memory, samples and answers.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
from cffi import FFI
from numpy.typing import NDArray

from knee_contact_ros.compiled import shipped
from knee_contact_ros.compiled.keeping import NOT_KEPT, file_names, kernel_folder, warn
from knee_contact_ros.compiled.kernel_folder import KernelFolder
from knee_contact_ros.compiled.layout import kind_of, laid_down, words_of
from knee_contact_ros.compiled.machine_code import Native, loaded, object_code, processor
from knee_contact_ros.compiled.source_meaning import digest
from knee_contact_ros.compiled.turns import Announce, announce_compiling, in_turn, read_or_wait
from knee_contact_ros.core.model import Kernel, KneeModel
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.core.ticks import Memory
from knee_contact_ros.core.types import Rows

_FFI = FFI()
_READY: dict[Any, Native] = {}
"""Kernels of this process, by kind of scene"""


def compiled(model: KneeModel, announce: Announce = nullcontext) -> KneeModel:
    """Give a model that computes the same answers with the compiled kernel.

    Compiling happens when the first run or stream of a new kind of scene begins and takes a quarter of a minute, but a
    second for kinds of scene whose kernels come with the package; what this machine has compiled before is loaded in a
    tenth of a second. `announce` makes the context in which something is compiled.
    """
    return replace(model, kernel=compiled_kernel(announce))


@functools.cache
def compiled_kernel(announce: Announce = nullcontext) -> Kernel:
    """Give the compiled kernel in the form in which a model has it."""
    return Kernel(functools.partial(_run, announce), functools.partial(_bind, announce))


def _run(
    announce: Announce, scene: Scene, memory: Memory, durations: Any, angles: Any, loads: Any, heights: Any,
    answers: Rows,
) -> None:  # fmt: skip
    """See `ticks.run`."""
    kind = kind_of(scene)
    native, block = kernel_of(scene, kind, announce), laid_down([scene], kind)
    columns = [np.ascontiguousarray(column, np.float64) for column in (durations, angles, loads, heights)]
    filled = answers if answers.flags.c_contiguous else answers.copy()
    addresses = addresses_of(block, memory, *columns, filled)
    if native.run(addresses.ctypes.data, len(durations), 0.0, 0.0, 0.0, 0.0):
        raise MemoryError("a run of ticks")
    if filled is not answers:
        answers[...] = filled


def _bind(
    announce: Announce, scene: Scene, memory: Memory, answer: Rows
) -> Callable[[float, float, float, float], None]:
    """See `Kernel.bind`."""
    kind, sample = kind_of(scene), np.zeros((4, 1))
    native, block = kernel_of(scene, kind, announce), laid_down([scene], kind)
    addresses = addresses_of(block, memory, *sample, answer)
    tick = functools.partial(native.tick, addresses.ctypes.data)
    tick.keeps = scene, memory, answer, block, sample, addresses  # type: ignore[attr-defined]
    return tick


def addresses_of(*arrays: NDArray[Any]) -> NDArray[np.uintp]:
    """Give the addresses of contiguous arrays, in the order that a kernel expects: scene, memory, columns, answers."""
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
    except Exception:  # whoever loads it warns of it
        return False


def is_shipped(scene: Scene) -> bool:
    """Whether the kernel for a kind of scene comes with the package."""
    return shipped.is_there(kind_of(scene))


def kernel_of(scene: Scene, kind: Any, announce: Announce = nullcontext) -> Native:
    """Give the kernel for a kind of scene: of this process, kept, shipped with the package, or newly compiled."""
    native = _READY.get(kind)
    if native is None:
        with in_turn(lambda: digest(words_of(kind)), announce):
            native = _READY[kind] = _kept(kind) or _shipped(kind) or _compiled(scene, kind)
    return native


def _kept(kind: Any) -> Native | None:
    """Load what was kept for a kind of scene; None if there is nothing that can be used."""
    try:
        if names := _names(kind):
            folder = KernelFolder(kernel_folder())
            code = folder.read(names[0]) if shipped.is_there(kind) else read_or_wait(folder, *names)
            return None if code is None else loaded(code)
    except Exception as error:  # what is whole and ours may still have been made by something else
        warn(error, "compiling again")
    return None


def _shipped(kind: Any) -> Native | None:
    """Make the kernel that comes with the package ready; None if there is none that can be used."""
    try:
        bitcode = shipped.bitcode(kind)
        return _keep(kind, object_code(bitcode)) if bitcode else None
    except Exception as error:  # it is damaged, or another version of LLVM cannot read it
        warn(error, "compiling")
        return None


def _compiled(scene: Scene, kind: Any) -> Native:
    """Compile the kernel."""
    announce_compiling()
    from knee_contact_ros.compiled.compile_kernel import bitcode_of

    return _keep(kind, object_code(bitcode_of(scene)))


def _keep(kind: Any, code: bytes) -> Native:
    """Keep the object code of a kernel if that is possible, and load it."""
    try:
        if names := _names(kind):
            folder = KernelFolder(kernel_folder())
            folder.write(names[0], code)
            folder.remove_unused()
    except Exception as error:
        warn(error, NOT_KEPT)
    return loaded(code)


def _names(kind: Any) -> tuple[str, str] | None:
    """See `file_names`."""
    return file_names(shipped.name_of_kind(kind), processor())

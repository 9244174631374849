"""Load machine code into this process by LLVM alone: Numba is not imported for what was compiled before."""

from __future__ import annotations

import ctypes
import functools
import os
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from cffi import FFI
from llvmlite import binding as llvm

RUN, TICK = "knee_contact_ros_run", "knee_contact_ros_tick"
"""Names of a kernel's functions in its object code"""
TYPES = {
    RUN: "int32_t (*)(uintptr_t, int64_t, double, double, double, double)",
    TICK: "void (*)(uintptr_t, double, double, double, double)",
}


class Native(NamedTuple):
    """A loaded kernel; its functions take the address of an array of addresses (see `kernel.addresses_of`)."""

    run: Callable[[int, int, float, float, float, float], int]
    """Compute a number of ticks; the four samples are ignored. Return 0, or another number if memory ran out"""
    tick: Callable[[int, float, float, float, float], None]
    """Compute one tick of duration [s], angle [rad], load [N] and height [m], which are written into the columns"""
    address: int
    """Address of `run`"""


SYMBOLS = np.dtype([
    ("name", np.uint32), ("kind", np.uint8), ("other", np.uint8), ("section", np.uint16), ("value", np.uint64),
    ("size", np.uint64),
])  # fmt: skip
"""A symbol of an ELF file; those in section 0 are defined elsewhere"""
ALLOCATES = "NRT_"
"""Prefix of Numba's functions that allocate and free arrays"""
FREES = "NRT_MemInfo_call_dtor"
"""A function that every kernel has calls of, which are never executed where nothing allocates"""
_LOADED: list[Any] = []
"""Engines that hold code, which is freed with them"""


def object_code(bitcode: bytes) -> bytes:
    """Make a kernel's object code of LLVM's code, for this processor or the one that NUMBA_CPU_NAME names.

    Raises:
        RuntimeError: it is not LLVM's code, or is for another kind of machine.
    """
    _initialise()
    module = llvm.parse_bitcode(bitcode)
    if module.triple != llvm.get_process_triple():
        raise RuntimeError(f"it is for {module.triple}")
    name = os.environ.get("NUMBA_CPU_NAME")
    features = os.environ.get("NUMBA_CPU_FEATURES", "" if name else llvm.get_host_cpu_features().flatten())
    target = llvm.Target.from_default_triple()
    relocation = "static" if target.name.startswith("x86") else "default"
    machine = target.create_target_machine(
        name or llvm.get_host_cpu_name(), features, opt=3, reloc=relocation, codemodel="jitdefault", jit=True
    )
    code: bytes = machine.emit_object(module)
    return code


def loaded(code: bytes) -> Native:
    """Load a kernel from its object code.

    Each kernel has an engine of its own: code is linked by names, and those of two kinds of scene may be the same.

    Raises:
        LookupError: it is no kernel, or calls an unknown function; LLVM would call the address 0.
    """
    _initialise()
    object_file = llvm.object_file.ObjectFileRef.from_data(code)
    for name in called_by(object_file):
        _make_known(name)
    machine = llvm.Target.from_default_triple().create_target_machine(jit=True)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(object_file)
    engine.finalize_object()
    addresses = [engine.get_function_address(name) for name in TYPES]
    if not all(addresses):
        raise LookupError("it has no kernel")
    _LOADED.append(engine)
    ffi = FFI()
    run, tick = (ffi.cast(kind, address) for kind, address in zip(TYPES.values(), addresses, strict=True))
    return Native(run, tick, addresses[0])


def _initialise() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()


def called_by(object_file: Any) -> list[str]:
    """Give the names of the functions that an object file calls but does not define."""
    parts = {part.name(): part.data() for part in object_file.sections()}
    names, symbols = parts[b".strtab"], np.frombuffer(parts[b".symtab"], SYMBOLS)
    begins = symbols["name"][(symbols["section"] == 0) & (symbols["name"] > 0)].tolist()
    return [names[begin : names.index(b"\0", begin)].decode() for begin in begins]


def _make_known(name: str) -> None:
    """Give LLVM the address of a function: one of C's, or of those by which Numba's code allocates arrays."""
    if name.startswith(ALLOCATES) and name != FREES:
        from numba.core.registry import cpu_target
        from numba.core.runtime import rtsys

        rtsys.initialize(cpu_target.target_context)
    if llvm.address_of_symbol(name) is not None:
        return
    for library in (None, "libm.so.6"):
        with suppress(AttributeError, OSError):
            function = ctypes.CDLL(library)["abort" if name == FREES else name]
            llvm.add_symbol(name, ctypes.cast(function, ctypes.c_void_p).value)
            return
    raise LookupError(f"it calls {name}, which is nowhere")


@functools.cache
def processor() -> tuple[str, ...]:
    """Describe the processor for which machine code is made, with settings of Numba's such as NUMBA_CPU_NAME."""
    settings = sorted(f"{name}={value}" for name, value in os.environ.items() if name.startswith("NUMBA_"))
    features = llvm.get_host_cpu_features().flatten()
    return llvm.get_process_triple(), llvm.get_host_cpu_name(), features, *settings

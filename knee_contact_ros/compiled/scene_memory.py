"""Access by address to scenes and kernels, for functions that Numba compiles."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.registry import cpu_target
from numba.extending import intrinsic

WORD, NUMBER = ir.IntType(64), ir.DoubleType()
CALLED = ir.FunctionType(ir.IntType(32), [WORD, WORD, *[NUMBER] * 4])
"""LLVM type of a kernel's function `run`; see `machine_code.TYPES`"""


def size_of(kind: types.Type) -> int:
    """Give the size [B] of a scene of a Numba type."""
    context = cpu_target.target_context
    size: int = context.get_abi_sizeof(context.get_value_type(kind))
    return size


@functools.cache
def scene_at(kind: types.Type) -> Callable[[Any], Any]:
    """Make a function for compiled code that reads a scene of a kind at an address, given as a number or a pointer."""

    @intrinsic
    def read(_typing: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            (address,), scene = arguments, context.get_value_type(kind).as_pointer()
            cast = builder.bitcast if address.type.is_pointer else builder.inttoptr
            return builder.load(cast(address, scene))

        return kind(address), generate

    scene: Callable[[Any], Any] = read
    return scene


@intrinsic
def run_at(_typing: Any, run: Any, addresses: Any) -> Any:
    """Compute one tick by the kernel at an address, given an array of addresses; for compiled code."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kernel = builder.inttoptr(arguments[0], CALLED.as_pointer())
        array = context.make_array(signature.args[1])(context, builder, arguments[1])
        place = builder.ptrtoint(array.data, WORD)
        builder.call(kernel, [place, WORD(1), *[NUMBER(0.0)] * 4])
        return context.get_dummy_value()

    return types.void(run, addresses), generate

"""Scenes and kernels at an address, for functions that Numba compiles."""

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
"""Type of a kernel; see `machine_code.TYPES`"""


def size_of(kind: types.Type) -> int:
    """Size [B] of scenes of a kind, Numba's type of it."""
    context = cpu_target.target_context
    size: int = context.get_abi_sizeof(context.get_value_type(kind))
    return size


@functools.cache
def scene_at(kind: types.Type) -> Callable[[Any], Any]:
    """For compiled code: what takes up a scene of a kind at an address, a number or a pointer to anything."""

    @intrinsic
    def taken_up(_typing: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            (address,), scene = arguments, context.get_value_type(kind).as_pointer()
            whither = builder.bitcast if address.type.is_pointer else builder.inttoptr
            return builder.load(whither(address, scene))

        return kind(address), generate

    scene: Callable[[Any], Any] = taken_up
    return scene


@intrinsic
def run_at(_typing: Any, run: Any, addresses: Any) -> Any:
    """For compiled code: take one tick with the kernel at an address, given an array of addresses."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kernel = builder.inttoptr(arguments[0], CALLED.as_pointer())
        array = context.make_array(signature.args[1])(context, builder, arguments[1])
        given = builder.ptrtoint(array.data, WORD)
        builder.call(kernel, [given, WORD(1), *[NUMBER(0.0)] * 4])
        return context.get_dummy_value()

    return types.void(run, addresses), generate

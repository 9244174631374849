"""Named tuples of several knees, transposed: a row for each number in them, with a place for each knee.

So a loop over the knees finds its numbers next to each other, as vector instructions need them. Each number has 8 B.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.registry import cpu_target
from numba.extending import intrinsic
from numpy.typing import NDArray

LANES = 8
"""Number of knees side by side: as many numbers as a vector of 64 B has"""
VECTOR = 8 * LANES
"""Size of a row [B]"""
WORD, FLAG = ir.IntType(64), ir.IntType(1)
NOTHING: Mapping[str, float] = MappingProxyType({})
"""No known numbers"""


class Transposed(NamedTuple):
    """Access to the named tuples of a kind in a memory of rows, for compiled code."""

    end: int
    """Number of the row after the last one"""
    put: Callable[[Any, Any, Any], None]
    """Write a value, given the memory's address and the lane"""
    get: Callable[[Any, Any], Any]
    """Read the value in a lane of the memory at an address"""


def memory_of(rows: int) -> NDArray[np.uint8]:
    """Allocate memory for so many rows, each at a multiple of its size."""
    room = np.zeros((rows + 1) * VECTOR, dtype=np.uint8)
    begin = -room.ctypes.data % VECTOR
    return room[begin : begin + rows * VECTOR]


def transposed(kind: types.Type, begin: int, known: Mapping[str, float] = NOTHING) -> Transposed:
    """Give access to tuples of a kind from the row `begin` on; fields whose names are `known` are read as constants."""
    whole = cpu_target.target_context.get_value_type(kind)
    numbers = list(_numbers(kind))

    @intrinsic
    def put(_typing: Any, value: Any, address: Any, lane: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            value, address, lane = arguments
            for row, (path, _) in enumerate(numbers, begin):
                number = builder.extract_value(value, path)
                stored = builder.zext(number, WORD) if number.type == FLAG else number
                builder.store(stored, _place(builder, address, lane, row, stored.type))
            return context.get_dummy_value()

        return types.void(value, address, lane), generate

    @intrinsic
    def get(_typing: Any, address: Any, lane: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            value, (address, lane) = ir.Constant(whole, ir.Undefined), arguments
            for row, (path, name) in enumerate(numbers, begin):
                number_type = builder.extract_value(value, path).type
                stored = WORD if number_type == FLAG else number_type
                number = builder.load(_place(builder, address, lane, row, stored))
                if name in known:
                    number = ir.Constant(number_type, known[name])
                elif number_type == FLAG:
                    number = builder.trunc(number, FLAG)
                value = builder.insert_value(value, number, path)
            return value

        return kind(address, lane), generate

    return Transposed(begin + len(numbers), put, get)


def numba_type_of(part: Any) -> types.Type:
    """Give Numba's type of a class of named tuples, from its type hints: numbers, and other such classes."""
    numbers = {float: types.float64, int: types.int64, bool: types.boolean}
    kinds = [numbers.get(hint) or numba_type_of(hint) for hint in get_type_hints(part).values()]
    return types.BaseTuple.from_types(kinds, part)


def _numbers(kind: Any, path: tuple[int, ...] = (), name: str = "") -> Iterator[tuple[tuple[int, ...], str]]:
    """Yield path and name of every number in a kind of tuple."""
    if not isinstance(kind, types.BaseTuple):
        yield path, name
        return
    names = getattr(kind, "fields", [name] * len(kind))
    for i, (part, own) in enumerate(zip(kind, names, strict=True)):
        yield from _numbers(part, (*path, i), own)


def _place(builder: Any, address: Any, lane: Any, row: int, number: ir.Type) -> Any:
    """Give a pointer to a lane's number in a row."""
    return builder.gep(builder.inttoptr(address, number.as_pointer()), [builder.add(lane, WORD(row * LANES))])

"""Named tuples of several knees, transposed: a row for each number in them, with a place for every knee's.

A loop over the knees then finds its numbers one after another, as vectors take them. Each number takes 8 B.
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
"""Knees beside each other: as many as a vector of 64 B has numbers"""
VECTOR = 8 * LANES
"""[B] of a row"""
WORD, FLAG = ir.IntType(64), ir.IntType(1)
NOTHING: Mapping[str, float] = MappingProxyType({})
"""No numbers that are known"""


class Transposed(NamedTuple):
    """Where named tuples of a kind lie in a memory of rows."""

    end: int
    """The row behind its last"""
    put: Callable[[Any, Any, Any], None]
    """For compiled code: lay a value down, given the memory's address and the lane"""
    taken_up: Callable[[Any, Any], Any]
    """For compiled code: the value in a lane of the memory at an address"""


def memory_of(rows: int) -> NDArray[np.uint8]:
    """Memory of so many rows, each of them at once in a vector."""
    room = np.zeros((rows + 1) * VECTOR, dtype=np.uint8)
    begin = -room.ctypes.data % VECTOR
    return room[begin : begin + rows * VECTOR]


def transposed(kind: types.Type, begin: int, known: Mapping[str, float] = NOTHING) -> Transposed:
    """A kind of tuple, from the row `begin` on. Fields that are `known` by their names are taken up as constants."""
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
    def taken_up(_typing: Any, address: Any, lane: Any) -> Any:
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

    return Transposed(begin + len(numbers), put, taken_up)


def kind_of(part: Any) -> types.Type:
    """Numba's type of a named tuple of numbers and others such, by its hints."""
    numbers = {float: types.float64, int: types.int64, bool: types.boolean}
    kinds = [numbers.get(hint) or kind_of(hint) for hint in get_type_hints(part).values()]
    return types.BaseTuple.from_types(kinds, part)


def _numbers(kind: Any, path: tuple[int, ...] = (), name: str = "") -> Iterator[tuple[tuple[int, ...], str]]:
    """Path and name of every number in a kind of tuple."""
    if not isinstance(kind, types.BaseTuple):
        yield path, name
        return
    names = getattr(kind, "fields", [name] * len(kind))
    for i, (part, own) in enumerate(zip(kind, names, strict=True)):
        yield from _numbers(part, (*path, i), own)


def _place(builder: Any, address: Any, lane: Any, row: int, number: ir.Type) -> Any:
    """Where a lane's number lies in a row."""
    return builder.gep(builder.inttoptr(address, number.as_pointer()), [builder.add(lane, WORD(row * LANES))])

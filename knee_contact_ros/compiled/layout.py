"""Layout of a scene in memory for compiled code, which is called by address: that of Numba's own structures.

Parts follow one another, each at a multiple of its alignment, as in C. No compiler is needed to lay a scene down.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

WORD = 8
"""Size and alignment [B] of all values but booleans"""
TRUTH = "?"
"""Code of a boolean in `struct`"""
NUMBERS = {float: "d", np.float64: "d", int: "q", np.int64: "q", bool: TRUTH, np.bool_: TRUTH}
"""Codes of numbers in `struct`, by their types"""
CODES = frozenset(NUMBERS.values())


def kind_of(part: Any) -> Any:
    """Give the kind of a scene or a part of one, which is hashable: its classes, kinds of numbers and of arrays."""
    if isinstance(part, tuple):
        return type(part), *[kind_of(inner) for inner in part]
    if isinstance(part, np.ndarray):
        flags = part.flags
        order = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
        return f"{part.dtype.str}, {part.ndim}, {order}, {flags.writeable}, {flags.aligned}"
    return NUMBERS[type(part)]


def named_tuples(kind: Any) -> Iterator[type]:
    """Yield the classes of the named tuples in a kind."""
    if isinstance(kind, tuple):
        if kind[0] is not tuple:
            yield kind[0]
        for inner in kind[1:]:
            yield from named_tuples(inner)


def words_of(kind: Any) -> str:
    """Write a kind as text, which is the same in every process."""
    if isinstance(kind, tuple):
        return f"{kind[0].__module__}.{kind[0].__qualname__}({', '.join(map(words_of, kind[1:]))})"
    return f"<{kind}>"


def laid_down(scenes: Sequence[Any], kind: Any) -> NDArray[np.uint8]:
    """Give the bytes of scenes of a kind, a row for each; they point to the scenes' arrays, which must live as long."""
    packing = _packing(kind)
    size = packing.size
    block = np.zeros(len(scenes) * size, np.uint8)
    for i, scene in enumerate(scenes):
        numbers: list[Any] = []
        _add_numbers(scene, numbers)
        packing.pack_into(block.data, i * size, *numbers)
    return block.reshape(len(scenes), size)


def _add_numbers(part: Any, numbers: list[Any]) -> None:
    """Append all numbers of a scene or a part of one, in their order."""
    for inner in part:
        if isinstance(inner, tuple):
            _add_numbers(inner, numbers)
        elif isinstance(inner, np.ndarray):  # the first two point to owners of the memory, of which there are none
            numbers += (0, 0, inner.size, inner.itemsize, inner.ctypes.data, *inner.shape, *inner.strides)
        else:
            numbers.append(inner)


@functools.cache
def _packing(kind: Any) -> struct.Struct:
    """Give the packing of the numbers of a kind of scene."""
    codes: list[str] = []
    _place(kind, 0, codes)
    return struct.Struct("=" + "".join(codes))


def _place(kind: Any, begin: int, codes: list[str]) -> int:
    """Append the codes of a part that begins at a multiple of its alignment; return its end."""
    if isinstance(kind, tuple):
        end = begin
        for inner in kind[1:]:
            end = _place(inner, _filled_up(end, _alignment(inner), codes), codes)
        return _filled_up(end, _alignment(kind), codes)
    count = 1 if kind in CODES else 5 + 2 * int(kind.split(", ")[1])
    codes.append(kind if kind in CODES else f"{count}q")
    return begin + count * _alignment(kind)


def _filled_up(place: int, alignment: int, codes: list[str]) -> int:
    """Append padding up to the next multiple of an alignment; return that place."""
    end = -(-place // alignment) * alignment
    codes.append(f"{end - place}x")
    return end


def _alignment(kind: Any) -> int:
    if isinstance(kind, tuple):
        return max(map(_alignment, kind[1:]), default=1)
    return 1 if kind == TRUTH else WORD

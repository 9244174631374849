"""How a scene lies in memory for compiled code, which is called by address: as Numba's own structures do.

Parts follow one another, each at a multiple of its alignment, as in C. To lay a scene down takes no compiler.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

WORD = 8
"""[B] of anything but a truth value, and its alignment"""
TRUTH = "?"
NUMBERS = {float: "d", np.float64: "d", int: "q", np.int64: "q", bool: TRUTH, np.bool_: TRUTH}
"""How numbers are packed, by their types"""
CODES = frozenset(NUMBERS.values())


def kind_of(part: Any) -> Any:
    """The kind of a scene or a part of one: its named tuples, kinds of numbers and of arrays; it can be a key."""
    if isinstance(part, tuple):
        return type(part), *[kind_of(inner) for inner in part]
    if isinstance(part, np.ndarray):
        flags = part.flags
        order = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
        return f"{part.dtype.str}, {part.ndim}, {order}, {flags.writeable}, {flags.aligned}"
    return NUMBERS[type(part)]


def named_tuples(kind: Any) -> Iterator[type]:
    """The classes of the named tuples in a kind."""
    if isinstance(kind, tuple):
        if kind[0] is not tuple:
            yield kind[0]
        for inner in kind[1:]:
            yield from named_tuples(inner)


def words_of(kind: Any) -> str:
    """A kind in words, the same in each process."""
    if isinstance(kind, tuple):
        return f"{kind[0].__module__}.{kind[0].__qualname__}({', '.join(map(words_of, kind[1:]))})"
    return f"<{kind}>"


def laid_down(scenes: Sequence[Any], kind: Any) -> NDArray[np.uint8]:
    """The bytes of scenes of a kind, a row for each. Their arrays stay where they are, and have to be kept as long."""
    packing = _packing(kind)
    size = packing.size
    block = np.zeros(len(scenes) * size, np.uint8)
    for i, scene in enumerate(scenes):
        numbers: list[Any] = []
        _add_numbers(scene, numbers)
        packing.pack_into(block.data, i * size, *numbers)
    return block.reshape(len(scenes), size)


def _add_numbers(part: Any, numbers: list[Any]) -> None:
    """Add all numbers of a scene or a part of one, in their order."""
    for inner in part:
        if isinstance(inner, tuple):
            _add_numbers(inner, numbers)
        elif isinstance(inner, np.ndarray):  # who owns its memory, twice: nobody here
            numbers += (0, 0, inner.size, inner.itemsize, inner.ctypes.data, *inner.shape, *inner.strides)
        else:
            numbers.append(inner)


@functools.cache
def _packing(kind: Any) -> struct.Struct:
    """How the numbers of a kind of scene are packed."""
    codes: list[str] = []
    _place(kind, 0, codes)
    return struct.Struct("=" + "".join(codes))


def _place(kind: Any, begin: int, codes: list[str]) -> int:
    """Add a part that begins at a multiple of its alignment; its end."""
    if isinstance(kind, tuple):
        end = begin
        for inner in kind[1:]:
            end = _place(inner, _filled_up(end, _alignment(inner), codes), codes)
        return _filled_up(end, _alignment(kind), codes)
    count = 1 if kind in CODES else 5 + 2 * int(kind.split(", ")[1])
    codes.append(kind if kind in CODES else f"{count}q")
    return begin + count * _alignment(kind)


def _filled_up(place: int, alignment: int, codes: list[str]) -> int:
    """The next multiple of an alignment; up to there nothing lies."""
    end = -(-place // alignment) * alignment
    codes.append(f"{end - place}x")
    return end


def _alignment(kind: Any) -> int:
    if isinstance(kind, tuple):
        return max(map(_alignment, kind[1:]), default=1)
    return 1 if kind == TRUTH else WORD

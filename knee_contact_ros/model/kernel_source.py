"""The mark of the functions that one tick consists of; nothing is compiled here.

A marked function runs as it stands, and `compiler.py` compiles it as it stands: numbers, named tuples and arrays in and
out, no closures, no exceptions, `math` and no NumPy functions. So both give the same bits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

_Function = TypeVar("_Function", bound=Callable[..., Any])

FUNCTIONS: list[Callable[..., Any]] = []
"""All marked functions"""
INLINED: list[Callable[..., Any]] = []
"""Those of them that become a part of their callers: what nearly every tick calls, from few places"""


def in_kernel(function: _Function) -> _Function:
    """Mark a function that a tick calls."""
    FUNCTIONS.append(function)
    return function


def inlined(function: _Function) -> _Function:
    """Mark a function that nearly every tick calls, from few places: passing arguments would take longer."""
    INLINED.append(function)
    return in_kernel(function)

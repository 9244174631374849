"""Marks for the functions and methods that the compiled kernel consists of; nothing is compiled here.

Functions marked `in_kernel`, and the methods of named tuples that a `kernel_interface` lists, are written so that they
run as they stand and can be compiled as they stand (`compiled`): numbers, named tuples and arrays in and out, no
closures, no exceptions. A named tuple is made with all of its fields, or changed by `_replace`. Named tuples are the
parts of a scene; their types decide what is compiled into its kernel.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, TypeVar

_Function = TypeVar("_Function", bound=Callable[..., Any])
_Interface = TypeVar("_Interface", bound=type)

FUNCTIONS: list[Callable[..., Any]] = []
"""All functions that are marked by any of the decorators below"""
ALWAYS_INLINED: list[Callable[..., Any]] = []
"""Marked functions that are compiled as a part of their callers"""
NEVER_INLINED: list[Callable[..., Any]] = []
"""Marked functions that are compiled once and called"""
ALLOCATING: list[Callable[..., Any]] = []
"""Marked functions that make arrays or lists; they are never inlined"""
METHODS: dict[str, inspect.Signature] = {}
"""Signatures of all marked methods by name; no field of a named tuple may have such a name"""


def in_kernel(function: _Function) -> _Function:
    """Mark a function that the kernel calls."""
    FUNCTIONS.append(function)
    return function


def always_inlined(function: _Function) -> _Function:
    """Mark a function that every tick calls: it is compiled as a part of its callers, which makes it quicker to run.

    That takes longer to compile, so it is for functions with few callers.
    """
    ALWAYS_INLINED.append(function)
    return in_kernel(function)


def never_inlined(function: _Function) -> _Function:
    """Mark a function that is large or that few ticks call: it is compiled once, and called.

    Otherwise the compiler copies the search for the contact into all of its callers, and takes minutes to optimise the
    result.
    """
    NEVER_INLINED.append(function)
    return in_kernel(function)


def allocating(function: _Function) -> _Function:
    """Mark a function that makes arrays or lists for its own use; it is compiled once, and called.

    All other functions must not make any. So they need not count references to the arrays of a scene, which would take
    as long as finding the contact. The function must neither return an array, alone or in a named tuple, nor call a
    function that does.
    """
    ALLOCATING.append(function)
    return never_inlined(function)


def kernel_interface(interface: _Interface) -> _Interface:
    """Mark a protocol whose methods the kernel calls, on named tuples that have them under the same signature."""
    for name, method in vars(interface).items():
        if inspect.isfunction(method) and not name.startswith("_"):
            METHODS[name] = inspect.signature(method)
    return interface

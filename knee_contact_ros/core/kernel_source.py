"""Marks what the compiled kernel is made of. Plain Python: nothing is compiled or imported here.

Functions marked `in_kernel`, and the methods of named tuples that a `kernel_interface` lists, are written so that they
run as they stand and can be compiled as they stand (`compiled`): numbers, named tuples and arrays in and out, no
closures, no exceptions. Named tuples are the parts of a scene; their types decide what is compiled into its kernel.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, TypeVar

_Function = TypeVar("_Function", bound=Callable[..., Any])
_Interface = TypeVar("_Interface", bound=type)

FUNCTIONS: list[Callable[..., Any]] = []
"""All marked functions"""
ALWAYS_INLINED: list[Callable[..., Any]] = []
"""Those of them that are made a part of their callers"""
NEVER_INLINED: list[Callable[..., Any]] = []
"""Those of them that are kept out of their callers"""
ALLOCATING: list[Callable[..., Any]] = []
"""Those of the latter that make arrays or lists"""
METHODS: dict[str, inspect.Signature] = {}
"""All marked methods by name; none may be the name of a named tuple's field, too"""


def in_kernel(function: _Function) -> _Function:
    """Mark a function that the kernel calls."""
    FUNCTIONS.append(function)
    return function


def always_inlined(function: _Function) -> _Function:
    """Mark a function of the way that every tick goes: compiled as a part of its callers, which is quicker to run.

    It takes longer to compile, so it is for functions with few callers.
    """
    ALWAYS_INLINED.append(function)
    return in_kernel(function)


def never_inlined(function: _Function) -> _Function:
    """Mark a function that is large, or off the way of most ticks: compiled once, and called.

    A compiler that is left to itself copies the search for the contact into all places that ask for it, and takes
    minutes over the result.
    """
    NEVER_INLINED.append(function)
    return in_kernel(function)


def allocating(function: _Function) -> _Function:
    """Mark a function that makes arrays or lists for its own use; it is kept out of its callers.

    No other function does. So the others need not count references to the arrays of a scene, which took as long as to
    find the contact. It must neither call what returns an array, alone or in a named tuple, nor return one.
    """
    ALLOCATING.append(function)
    return never_inlined(function)


def kernel_interface(interface: _Interface) -> _Interface:
    """Mark a protocol whose methods the kernel calls, on named tuples that have them under the same signature."""
    for name, method in vars(interface).items():
        if inspect.isfunction(method) and not name.startswith("_"):
            METHODS[name] = inspect.signature(method)
    return interface

"""Marks what the compiled kernel is made of. Plain Python: nothing is compiled or imported here.

Functions marked `in_kernel`, and the methods of named tuples that a `kernel_interface` lists, are written so that they
run as they stand and can be compiled as they stand (`kernel.py`): numbers, named tuples and arrays in and out, no
closures, no exceptions. Named tuples are the parts of a scene; their types decide what is compiled into its kernel.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, TypeVar

_Function = TypeVar("_Function", bound=Callable[..., Any])
_Interface = TypeVar("_Interface", bound=type)

FUNCTIONS: list[Callable[..., Any]] = []
METHODS: dict[str, inspect.Signature] = {}


def in_kernel(function: _Function) -> _Function:
    """Mark a function that the kernel calls."""
    FUNCTIONS.append(function)
    return function


def kernel_interface(interface: _Interface) -> _Interface:
    """Mark a protocol whose methods the kernel calls, on named tuples that have them under the same signature."""
    for name, method in vars(interface).items():
        if inspect.isfunction(method) and not name.startswith("_"):
            METHODS[name] = inspect.signature(method)
    return interface

"""The compiled kernel: the marked functions (`kernel_source.py`), compiled by Numba for the types of a scene.

Imported only where something is compiled; the rest of the package never waits for the compiler.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any

from numba import njit, types
from numba.extending import overload_method, register_jitable

from knee_contact_ros.core.kernel_source import FUNCTIONS, METHODS


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the compiled form of a function; compiling happens at its first call with new types."""
    _register()
    return njit(function)  # type: ignore[no-any-return]


@functools.cache
def _register() -> None:
    """Tell Numba about the marked functions and methods."""
    for function in FUNCTIONS:
        register_jitable(function)
    for name, signature in METHODS.items():
        _register_method(name, signature)


def _register_method(name: str, signature: inspect.Signature) -> None:
    """Let compiled code call a method of any named tuple that has it."""

    def method(self: Any, *_arguments: Any) -> Any:
        return getattr(self.instance_class, name, None)

    method.__signature__ = signature  # type: ignore[attr-defined]
    overload_method(types.BaseNamedTuple, name)(method)

"""The marked functions and methods (`core/kernel_source.py`), compiled by Numba for the types of a scene."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any

from numba import njit, types
from numba.extending import overload_method, register_jitable

from knee_contact_ros.compiled import replacing  # noqa: F401  (tells Numba of `_replace`)
from knee_contact_ros.compiled.cache import kernel_cache
from knee_contact_ros.compiled.inner import ApartCompiler, InnerCompiler
from knee_contact_ros.core import ticks  # noqa: F401  (marks what is registered)
from knee_contact_ros.core.kernel_source import ALLOCATING, ALWAYS_INLINED, FUNCTIONS, METHODS, NEVER_INLINED

OPTIONS = {"error_model": "numpy"}
"""Divisions are not checked: the functions are written so that none by zero happens"""
ENTRY = OPTIONS | {"forceinline": False, "_nrt": False, "no_cfunc_wrapper": False}
"""What Python calls borrows the arrays of its arguments: counting references to them took longer than the contact"""
INNER = OPTIONS | {"forceinline": False, "_nrt": False, "no_cfunc_wrapper": True, "pipeline_class": InnerCompiler}
"""Callers' options are inherited, so those of the others are said"""
INLINE = INNER | {"forceinline": True}
APART = INNER | {"pipeline_class": ApartCompiler}
MAKING = APART | {"_nrt": True}
"""With references to arrays and lists counted"""


@functools.cache
def compiled_function(function: Callable[..., Any]) -> Callable[..., Any]:
    """The compiled form of a function; compiling, or loading, happens at its first call with new types."""
    register()
    made: Callable[..., Any] = njit(**ENTRY)(function)
    made._cache = kernel_cache(function)  # type: ignore[attr-defined]  # Numba's own decorator sets it likewise
    return made


@functools.cache
def register() -> None:
    """Tell Numba about the marked functions and methods."""
    for function in FUNCTIONS:
        options = INLINE if function in ALWAYS_INLINED else APART if function in NEVER_INLINED else INNER
        options = MAKING if function in ALLOCATING else options
        register_jitable(**options)(function)
    for name, signature in METHODS.items():
        _register_method(name, signature)


def _register_method(name: str, signature: inspect.Signature) -> None:
    """Let compiled code call a method of any named tuple that has it."""

    def method(self: Any, *_arguments: Any) -> Any:
        return getattr(self.instance_class, name, None)

    method.__signature__ = signature  # type: ignore[attr-defined]
    overload_method(types.BaseNamedTuple, name, jit_options=INLINE)(method)

"""Let Numba compile the marked functions and methods (`core/kernel_source.py`) for the types of a scene."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any

from numba import njit, types
from numba.extending import overload_method, register_jitable

from knee_contact_ros.compiled.cache import kernel_cache
from knee_contact_ros.compiled.inner import ApartCompiler, InnerCompiler
from knee_contact_ros.core import ticks  # noqa: F401  (marks what is registered)
from knee_contact_ros.core.kernel_source import ALLOCATING, ALWAYS_INLINED, FUNCTIONS, METHODS, NEVER_INLINED

OPTIONS = {"error_model": "numpy"}
"""Common options: divisions are not checked, since the functions never divide by zero"""
ENTRY = OPTIONS | {"forceinline": False, "_nrt": False, "no_cfunc_wrapper": False}
"""Options of functions that Python calls: they count no references to arrays, which took longer than the contact"""
INNER = OPTIONS | {"forceinline": False, "_nrt": False, "no_cfunc_wrapper": True, "pipeline_class": InnerCompiler}
"""Options of functions that compiled code calls; they are complete, since missing ones are inherited from the caller"""
INLINE = INNER | {"forceinline": True}
"""Options of functions that become a part of their callers"""
APART = INNER | {"pipeline_class": ApartCompiler}
"""Options of functions that are kept out of their callers"""
MAKING = APART | {"_nrt": True}
"""Options of functions that make arrays or lists, to which references are counted"""


@functools.cache
def compiled_function(
    function: Callable[..., Any], scene: types.Type | None = None, *, nogil: bool = False
) -> Callable[..., Any]:
    """Give the compiled form of a function, which is compiled or loaded at its first call with new types.

    Args:
        function: The function.
        scene: The kind of scene for which it was made, see `kernel_cache`.
        nogil: Whether it runs without Python's lock.
    """
    register()
    made: Callable[..., Any] = njit(**ENTRY, nogil=nogil)(function)
    made._cache = kernel_cache(function, scene)  # type: ignore[attr-defined]  # Numba's own decorator sets it likewise
    return made


@functools.cache
def register() -> None:
    """Register the marked functions and methods with Numba, once."""
    for function in FUNCTIONS:
        options = INLINE if function in ALWAYS_INLINED else APART if function in NEVER_INLINED else INNER
        options = MAKING if function in ALLOCATING else options
        register_jitable(**options)(function)
    for name, signature in METHODS.items():
        _register_method(name, signature)


def _register_method(name: str, signature: inspect.Signature) -> None:
    """Register a method, so that compiled code can call it on any named tuple that has it."""

    def method(self: Any, *_arguments: Any) -> Any:
        return getattr(self.instance_class, name, None)

    method.__signature__ = signature  # type: ignore[attr-defined]
    overload_method(types.BaseNamedTuple, name, jit_options=INLINE)(method)

"""How the functions inside a kernel are compiled: nothing is optimised before it is linked into the kernel."""

from __future__ import annotations

from typing import Any

import pytest
from numba import njit
from numba.core.codegen import JITCodeLibrary
from numba.extending import register_jitable

from knee_contact_ros.compiled.functions import APART, ENTRY, INLINE, INNER
from knee_contact_ros.compiled.inner import _Linked


@register_jitable(**INNER)
def deepest(value: Any) -> Any:
    return 3.0 * value


@register_jitable(**APART)
def left(value: Any) -> Any:
    return deepest(value) + 1.0


@register_jitable(**INLINE)
def right(value: Any) -> Any:
    return deepest(value) + left(value)


def kernel(value: Any) -> Any:
    return left(value) * right(value)


def test_all_is_optimised_at_once_with_the_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    optimised = []
    optimise = JITCodeLibrary._optimize_final_module

    def watched(library: Any) -> None:
        optimised.append(library)
        optimise(library)

    monkeypatch.setattr(JITCodeLibrary, "_optimize_final_module", watched)
    made: Any = njit(**ENTRY)(kernel)
    assert made(2.0) == kernel(2.0)
    assert optimised
    assert not any(isinstance(library, _Linked) for library in optimised)

"""The compiled functions in place of the plain ones. The compiler is imported where something is compiled."""

from __future__ import annotations

import functools
from contextlib import nullcontext
from dataclasses import replace

from knee_contact_ros.compiled.by_address import bind, is_kept, run
from knee_contact_ros.compiled.keeping import kernel_folder
from knee_contact_ros.compiled.turns import Told
from knee_contact_ros.core.model import Kernel, KneeModel

__all__ = ["compiled", "compiled_kernel", "is_kept", "kernel_folder"]


def compiled(model: KneeModel, told: Told = nullcontext) -> KneeModel:
    """A model that computes what the given one does, with the compiled kernel.

    Compiling happens when the first run or stream of a new kind of scene begins and takes a quarter of a minute or half
    a minute; what this machine has compiled before is loaded in a tenth of a second. `told` makes the context in which
    is compiled.
    """
    return replace(model, kernel=compiled_kernel(told))


@functools.cache
def compiled_kernel(told: Told = nullcontext) -> Kernel:
    """The compiled functions."""
    return Kernel(functools.partial(run, told), functools.partial(bind, told=told))

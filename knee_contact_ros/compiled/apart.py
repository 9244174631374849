"""Compiling a function so that LLVM keeps it out of its callers: for those that are marked `never_inlined`.

Numba has an option that forces a function into its callers and none for the opposite. Its documented way to customise
the compiler is a pipeline of passes; this one differs in the pass that makes machine code, by one attribute.
"""

from __future__ import annotations

from typing import Any

from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.lowering import Lower
from numba.core.typed_passes import NativeLowering


class _LowerApart(Lower):
    """Makes machine code of a function that LLVM keeps out of its callers."""

    def setup_function(self, fndesc: Any) -> None:
        super().setup_function(fndesc)
        self.function.attributes.add("noinline")


@register_pass(mutates_CFG=True, analysis_only=False)
class _LoweringApart(NativeLowering):
    _name = "lowering_apart"

    @property
    def lowering_class(self) -> type[Lower]:
        return _LowerApart


class CompilerApart(CompilerBase):
    """Numba's compiler for functions that stay apart; a `pipeline_class`."""

    def define_pipelines(self) -> list[Any]:
        """Numba's passes with one exchanged."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [(_LoweringApart if step is NativeLowering else step, why) for step, why in passes.passes]
        passes._finalized = False
        passes.finalize()
        return [passes]

"""The compiler for functions inside a kernel, which only compiled code calls.

Numba would make each of them callable by Python, with machine code of it and of all functions that it calls. Nobody
runs that, and it took a fifth of the time; another tenth went into searching for what the source of a kernel does not
have. Numba would also link each function with all that it calls and have LLVM optimise that, the deepest functions a
hundred times; here that is done once, in the kernel. Numba's documented way to customise the compiler is a pipeline of
passes.
"""

from __future__ import annotations

from typing import Any

from llvmlite import binding as llvm
from numba.core import typed_passes, untyped_passes
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.lowering import Lower
from numba.core.typed_passes import NativeLowering

NOT_NEEDED = {
    untyped_passes.WithLifting, untyped_passes.InlineClosureLikes, untyped_passes.RewriteDynamicRaises,
    untyped_passes.MakeFunctionToJitFunction, untyped_passes.InlineInlinables, untyped_passes.FindLiterallyCalls,
    untyped_passes.LiteralUnroll, untyped_passes.LiteralPropagationSubPipelinePass, typed_passes.InlineOverloads,
    typed_passes.DumpParforDiagnostics,
}  # fmt: skip
"""Passes for contexts, closures, exceptions, and functions that Numba itself would inline"""


class _Linked(JITCodeLibrary):
    """Code that is only to be linked into that of its callers."""

    @property
    def codegen(self) -> Any:
        """The object with which Numba would register what Python code needs; its methods here do nothing."""
        return self

    def set_env(self, _name: str, _env: Any) -> None:
        """Do nothing: only functions that Python calls need their globals."""

    def get_pointer_to_function(self, _name: str) -> int:
        """Give 0, as there is no machine code."""
        return 0

    def finalize(self) -> None:
        """Close the library without linking and optimising, which is done once for the whole kernel."""
        self._raise_if_finalized()
        self._finalize_dynamic_globals()
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """Link this code with all that it calls, each part once, for a kernel."""
        self._ensure_finalized()
        whole, seen, waiting = self._final_module.clone(), {self}, list(self._linking_libraries)
        others = []
        while waiting:
            library = waiting.pop()
            if library in seen:
                continue
            seen.add(library)
            if isinstance(library, _Linked):
                whole.link_in(library._final_module, preserve=True)
                waiting += library._linking_libraries
            else:
                others.append(library)
        for library in others:  # of these LLVM takes only what code linked before calls
            whole.link_in(library._get_module_for_linking(), preserve=True)
        for function in whole.functions:
            if not function.is_declaration and function.linkage == llvm.Linkage.external:
                function.linkage = "linkonce_odr"
        return whole


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    _name = "lowering_inner"

    def run_pass(self, state: Any) -> bool:
        state.library = _Linked(state.targetctx.codegen(), state.func_id.func_qualname)
        done: bool = super().run_pass(state)
        return done


class _LowerApart(Lower):
    def setup_function(self, fndesc: Any) -> None:
        super().setup_function(fndesc)
        self.function.attributes.add("noinline")


@register_pass(mutates_CFG=True, analysis_only=False)
class _LoweringApart(_Lowering):
    _name = "lowering_apart"

    @property
    def lowering_class(self) -> type[Lower]:
        return _LowerApart


class InnerCompiler(CompilerBase):
    """Numba's compiler for functions inside a kernel; a `pipeline_class`."""

    lowering: type[_Lowering] = _Lowering

    def define_pipelines(self) -> list[Any]:
        """Give Numba's passes with another lowering, and without those that are not needed."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [
            (self.lowering if step is NativeLowering else step, why)
            for step, why in passes.passes
            if step not in NOT_NEEDED
        ]
        passes._finalized = False
        passes.finalize()
        return [passes]


class ApartCompiler(InnerCompiler):
    """Numba's compiler for functions that LLVM keeps out of their callers, those that are marked `never_inlined`."""

    lowering = _LoweringApart

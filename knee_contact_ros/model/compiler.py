"""The compiled tick: Numba compiles the marked functions once, unchanged, and the result is kept in a file.

A marked function also runs as plain Python: it takes and returns numbers, named tuples and arrays, and uses no
closures, no exceptions and no NumPy functions, only `math`. So both give the same bits. Marking compiles nothing, and
does not import Numba.

The file is stored with the model, in `__pycache__/compiled`, if this user can write there (installation,
`knee-contact warm`), else in `$XDG_CACHE_HOME/knee_contact_ros` or `~/.cache/knee_contact_ros`. Its name has digests of
the sources, the compiler and the processor. It contains a digest and a pickle. A pickle can run any code, so a file is
read only if this user or root wrote it, in a folder of theirs, and nobody else can write it. If anything is wrong with
the file, the cost is one line and a compilation.
"""

from __future__ import annotations

import gc
import hashlib
import importlib.util
import logging
import os
import pickle
import stat
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast

COMPILING = 6.0
"""Processor time [s] of compiling the model"""
MAX_FILES = 8
"""Number of newest files that stay in a folder, also those of other processors"""
FILE_SUFFIX = ".kernel"
DIGEST_SIZE = hashlib.sha256().digest_size
"""Bytes of the digest with which a file begins"""
SKIPPED_PASSES = (
    "InlineClosureLikes",
    "DeadBranchPrune",
    "ReconstructSSA",
    "PreLowerStripPhis",
    "InlineOverloads",
    "NopythonRewrites",
    "IRLegalization",
)
"""Numba's passes for closures, variables whose type changes, what Numba itself would inline, arrays as a whole, and
references: 1.1 of 7 s. Ten others that nothing here needs take 0.1 s together, and stay."""
NUMBA_OPTIONS = {
    "error_model": "numpy",
    "nogil": True,
    "_nrt": False,
    "no_cfunc_wrapper": True,
}
"""Numba's options: divisions are not checked, since no divisor is 0, and references to arrays are not counted"""

MARKED: list[Callable[..., Any]] = []
"""All marked functions, of which a tick consists"""
MARKED_INLINE: list[Callable[..., Any]] = []
"""Those of them that become a part of their callers: what nearly every tick calls, from few places"""
_Function = TypeVar("_Function", bound=Callable[..., Any])

_log = logging.getLogger(__name__)


def in_kernel(function: _Function) -> _Function:
    """Mark a function that a tick calls."""
    MARKED.append(function)
    return function


def inlined(function: _Function) -> _Function:
    """Mark a function that nearly every tick calls, from few places; passing its arguments would take longer."""
    MARKED_INLINE.append(function)
    return in_kernel(function)


def compiled(entry: Callable[..., Any], example: Sequence[Any]) -> Callable[..., Any] | None:
    """Load or compile a marked function for the types of example arguments; a call with other types raises TypeError.

    Returns:
        The compiled function; None, with a warning, if Numba cannot be used.
    """
    try:
        import numba
        from numba.core.serialize import dumps

        if numba.config.DISABLE_JIT:
            raise ImportError("NUMBA_DISABLE_JIT is set")
    # What Numba finds wrong with Python, NumPy or its own libraries has many names.
    except Exception as error:
        _log.warning(
            "knee_contact_ros: Numba cannot be used (%s); the model runs uncompiled and slowly",
            _reason(error),
        )
        return None
    _pass_by_reference(example)
    made = numba_form(entry)
    types = tuple(map(numba.typeof, example))
    target = _digest(made.targetctx.codegen().magic_tuple(), types)
    name = f"{source_digest(entry)}-{target}{FILE_SUFFIX}"
    paths = [folder / name for folder in cache_folders(entry)]
    there = [path for path in paths if os.path.lexists(path)]
    unusable = list[str]()
    if not any(_succeeds(partial(_load, made), path, unusable) for path in there):
        from knee_contact_ros.system.progress import announce

        with announce(f"knee_contact_ros: compiling the model, once (some {COMPILING:.0f} s)"):
            compile_whole(made, types)
        write = partial(_write, dumps(made.overloads[types]._reduce()))
        not_written = list[str]()
        kept = any(_succeeds(write, path, not_written) for path in paths)
        if unusable or not kept:
            then = "compiled again" if kept else "what was compiled is not kept"
            fault = [*not_written, *unusable][-1]
            _log.warning("knee_contact_ros: compiled code: %s; %s", fault, then)
    made.disable_compile()
    return cast("Callable[..., Any]", made)


def numba_form(entry: Callable[..., Any]) -> Any:
    """Return Numba's form of a marked function, for `compile_whole`; it calls such forms of other functions."""
    from numba import njit

    made, namespaces = dict[Any, Any](), dict[int, dict[str, Any]]()
    for function in _called_functions(entry):
        # A copy of the module's names, in which the marked functions are exchanged for Numba's forms of them.
        names = namespaces.setdefault(id(function.__globals__), dict(function.__globals__))
        compile_by = njit(
            **NUMBA_OPTIONS,
            pipeline_class=_shorter_pipeline(),
            forceinline=function in MARKED_INLINE,
            no_cpython_wrapper=function is not entry,
        )
        made[function] = compile_by(FunctionType(function.__code__, names, function.__name__))
    for names in namespaces.values():
        for name, value in names.items():
            if isinstance(value, FunctionType) and value in made:
                names[name] = made[value]
    return made[entry]


def _called_functions(entry: Any) -> list[FunctionType]:
    """Return a marked function and all marked functions that it may call."""
    reached = [entry]
    for function in reached:  # it grows meanwhile
        for name in function.__code__.co_names:
            value = function.__globals__.get(name)
            if isinstance(value, FunctionType) and value in MARKED and value not in reached:
                reached.append(value)
    return reached


@cache
def _shorter_pipeline() -> Any:
    """Return a compiler, in Numba's sense, without the passes that are not needed."""
    from numba.core.compiler import CompilerBase, DefaultPassBuilder

    class Pipeline(CompilerBase):
        def define_pipelines(self) -> list[Any]:
            passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
            passes.passes = [
                (one, why) for one, why in passes.passes if one.__name__ not in SKIPPED_PASSES
            ]
            passes._finalized = False
            passes.finalize()
            return [passes]

    return Pipeline


def compile_whole(made: Any, types: tuple[Any, ...]) -> None:
    """Compile what `numba_form` returns for the types of its arguments, in less than half of Numba's time.

    LLVM optimises all functions once, together with the entry. Numba alone would let it optimise and translate each
    function with all that it calls. As nothing else calls the inner functions, LLVM may also drop unused arguments and
    merge callers. Numba resolves a call with the same types once, instead of again for each of some thousand calls. It
    takes a constant as any number, or it would compile a function again for each constant argument. Python's garbage
    collector is off meanwhile.
    """
    from llvmlite.binding import Linkage
    from numba.core.codegen import JITCodeLibrary
    from numba.core.typeinfer import TypeVar as Variable
    from numba.core.types.functions import BaseFunction
    from numba.types import unliteral

    class Whole(JITCodeLibrary):
        def finalize(self) -> None:
            for library in self._linking_libraries:  # it grows meanwhile
                for one in getattr(library, "_linking_libraries", ()):
                    if one not in self._linking_libraries:  # each function is linked once
                        self._linking_libraries.append(one)
            super().finalize()

        def _optimize_final_module(self) -> None:
            entry = self.name.rpartition(".")[2]
            own = f"{len(entry)}{entry}B"  # as it is mangled
            for function in self._final_module.functions:
                ours = "_ZN" in function.name and not function.is_declaration
                if ours and own not in function.name:
                    function.linkage = Linkage.internal
            # Once, as there are no references to count, and without vectors, which gain nothing here.
            passes, builder = self._codegen._module_pass_manager(
                loop_vectorize=False, slp_vectorize=False, opt=2
            )
            passes.run(self._final_module, builder)

    class Linked(JITCodeLibrary):
        """An inner function, which is only linked into the whole: it needs no address and no codegen of its own."""

        def _optimize_functions(self, *_: Any) -> None: ...

        def finalize(self) -> None:
            self._finalized = True

        @property
        def codegen(self) -> Any:
            return self

        def set_env(self, *_: Any) -> None: ...

        def get_pointer_to_function(self, *_: Any) -> int:
            return 0

    call_type, known = BaseFunction.get_call_type, dict[Any, Any]()

    def known_call_type(function: Any, context: Any, args: Any, keywords: Any) -> Any:
        key = function, tuple(args), tuple(dict(keywords).items())
        if key not in known:
            known[key] = call_type(function, context, args, keywords)
        return known[key]

    add_type, codegen = Variable.add_type, made.targetctx.codegen()

    def add_number(variable: Any, kind: Any, loc: Any) -> Any:
        return add_type(variable, unliteral(kind), loc)

    def library_of(codegen: Any, name: str) -> Any:
        return (Whole if name == made.__name__ else Linked)(codegen, name)

    changed = {
        (BaseFunction, "get_call_type"): known_call_type,
        (Variable, "add_type"): add_number,
        (Variable, "lock"): lambda variable, kind, loc, **_: variable.add_type(kind, loc),
        (codegen, "_library_class"): library_of,
    }
    before = {(owner, name): getattr(owner, name) for owner, name in changed}
    collecting = gc.isenabled()
    gc.disable()
    try:
        for (owner, name), new in changed.items():
            setattr(owner, name, new)
        made.compile(types)
    finally:
        for (owner, name), old in before.items():
            setattr(owner, name, old)
        if collecting:
            gc.enable()


def _pass_by_reference(values: Iterable[Any]) -> None:
    """Let compiled code take the named tuples among values, and those in them, by address.

    Numba would pass each field as a separate argument, and of an array also each size: the knee, which nearly every
    function of a tick takes, has 90 of them.
    """
    from numba import typeof
    from numba.extending import typeof_impl

    for value in values:
        if hasattr(value, "_fields"):
            _pass_by_reference(value)
            typeof_impl.register(
                type(value), lambda one, _: _reference_to(tuple(map(typeof, one)), type(one))
            )


def _reference_to(fields: tuple[Any, ...], kind: type) -> Any:
    """Return Numba's type of the address of such a named tuple, which lies on the stack of the entry's caller."""
    return _reference_type()(fields, kind)


@cache
def _reference_type() -> Any:
    """Return the class of the types that `_reference_to` returns."""
    from numba.core import cgutils, types
    from numba.core.datamodel.models import PrimitiveModel
    from numba.core.imputils import lower_getattr_generic
    from numba.extending import NativeValue, register_model, unbox

    class Reference(types.NamedTuple):  # type: ignore[name-defined]  # Numba is not typed
        @property
        def whole(self) -> Any:
            return types.NamedTuple(self.types, self.instance_class)  # type: ignore[attr-defined]

        def __reduce__(self) -> Any:
            return _reference_to, (self.types, self.instance_class)

    @register_model(Reference)
    class Pointer(PrimitiveModel):
        def __init__(self, manager: Any, kind: Any) -> None:
            super().__init__(
                manager, kind, manager.lookup(kind.whole).get_value_type().as_pointer()
            )

    @unbox(Reference)
    def unboxed(kind: Any, value: Any, context: Any) -> Any:
        whole = context.unbox(kind.whole, value)
        return NativeValue(
            cgutils.alloca_once_value(context.builder, whole.value), whole.is_error, whole.cleanup
        )

    @lower_getattr_generic(Reference)
    def field(_context: Any, builder: Any, kind: Any, address: Any, name: str) -> Any:
        return builder.load(cgutils.gep_inbounds(builder, address, 0, kind.fields.index(name)))

    return Reference


def kept_files_of(entry: Callable[..., Any]) -> list[Path]:
    """Return the files in which a compiled function is kept, for any processor, without importing Numba."""
    pattern = f"{source_digest(entry)}-*{FILE_SUFFIX}"
    return [path for folder in cache_folders(entry) for path in folder.glob(pattern)]


def cache_folders(entry: Callable[..., Any]) -> list[Path]:
    """Return the folders in which a compiled function may be kept, the first choice first."""
    beside = Path(entry.__code__.co_filename).parent / "__pycache__" / "compiled"
    caches = Path(os.environ.get("XDG_CACHE_HOME", "")), Path(os.path.expanduser("~/.cache"))  # noqa: PTH111
    return [
        beside,
        *[path / "knee_contact_ros" for path in caches if path.is_absolute()][:1],
    ]  # there may be no home


@cache
def source_digest(entry: Callable[..., Any]) -> str:
    """Return a digest of everything but the processor that compiled code depends on, without importing Numba.

    The sources are all files in the folders of the functions, as constants may come from any of them.
    """
    beside = sorted(
        {Path(function.__code__.co_filename).parent for function in _called_functions(entry)}
    )
    files = [path for folder in beside for path in sorted(folder.glob("*.py"))]
    found = [importlib.util.find_spec(name) for name in ("numba", "llvmlite")]
    files += [Path(spec.origin).with_name("_version.py") for spec in found if spec and spec.origin]
    settings = sorted(item for item in os.environ.items() if item[0].startswith("NUMBA_"))
    sources = [path.read_bytes() for path in files]
    return _digest(
        entry.__module__, entry.__qualname__, sys.implementation.cache_tag, settings, sources
    )


def _digest(*parts: Any) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:32]


def _succeeds(step: Callable[[Path], None], path: Path, doubts: list[str]) -> bool:
    """Whether a step with a file succeeds; if not, the reason is added to the doubts."""
    try:
        step(path)
        return True
    except Exception as error:  # what is whole and ours may still have been made by something else
        doubts.append(f"{path}: {_reason(error)}")
        return False


def _reason(error: Exception) -> str:
    return " ".join(
        (getattr(error, "strerror", None) or str(error) or type(error).__name__).split()
    )


def _load(made: Any, path: Path) -> None:
    """Load compiled code into Numba's form of a function."""
    from numba.core.compiler import CompileResult

    _check_owner(path.parent.lstat())
    # Without O_NONBLOCK a pipe would keep us waiting.
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
        _check_owner(os.fstat(file.fileno()))
        data = file.read()
    if data[:DIGEST_SIZE] != hashlib.sha256(path.name.encode() + data[DIGEST_SIZE:]).digest():
        raise OSError("it is damaged")
    found = CompileResult._rebuild(made.targetctx, *pickle.loads(data[DIGEST_SIZE:]))  # noqa: S301
    made.targetctx.insert_user_function(found.entry_point, found.fndesc, [found.library])
    made.add_overload(found)


def _write(content: bytes, path: Path) -> None:
    """Write a file, which appears only when complete, and remove files that are no longer used."""
    path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
    _check_owner(path.parent.lstat())
    part = path.with_name(f"{path.name}.{os.urandom(8).hex()}")
    try:
        with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644), "wb") as file:
            file.write(hashlib.sha256(path.name.encode() + content).digest() + content)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    with suppress(OSError):
        for old in sorted(path.parent.glob(f"*{FILE_SUFFIX}*"), key=os.path.getmtime)[:-MAX_FILES]:
            old.unlink()


def _check_owner(status: os.stat_result) -> None:
    """Refuse a file or folder that another user than root can write."""
    if status.st_uid not in (os.geteuid(), 0):
        raise OSError("it belongs to another user, or its folder does")
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise OSError("others can write it or its folder (chmod go-w cures this)")

"""Build the kernel as a library: Numba translates the marked functions, LLVM makes an object, a linker a library.

A marked function also runs as plain Python: it takes and returns numbers, named tuples and arrays, and uses no
closures, no exceptions and no NumPy functions, only `math`. So both give the same bits. Marking builds nothing, and
does not import Numba, which no installed package needs: the library is built with the package.

Nothing may be optimised for this machine before the target is known. LLVM would turn the fields of a structure into
offsets in bytes, and code with offsets for 64 bits runs on 32 bits, without an error, and is wrong by a quarter.
"""

import importlib.util
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple, TypeVar

from .types import ROW

OPTIONS = {
    "error_model": "numpy",
    "_nrt": False,
    "no_cfunc_wrapper": True,
    "no_cpython_wrapper": True,
}
"""Numba's options: divisions are not checked, since no divisor is 0, references to arrays are not counted, and nothing
but compiled code calls the functions"""
HOST_SIZES = re.compile(
    r"getelementptr[a-z ]* i8, ptr [^,]+, i64 \d|@llvm\.mem[a-z]+\.[^\n]*i64 \d"
)
"""Pieces of LLVM's language that hold a size or an offset in bytes, which must be left to the target"""
HOST_NAMES = re.compile(r"inttoptr|declare .*@(?!llvm\.|sqrt\()\S+")
"""Pieces of optimised code that need this process: an address, Python, or Numba's run-time"""
MARKED: list[Callable[..., Any]] = []
"""All marked functions, of which a tick consists"""
MARKED_INLINE: list[Callable[..., Any]] = []
"""Those of them that become a part of their callers: what nearly every tick calls, from few places"""
_Function = TypeVar("_Function", bound=Callable[..., Any])


class Target(NamedTuple):
    """Kind of processor and system that a kernel is built for."""

    triple: str
    """LLVM's name. It must be the normalised one: "thumbv7em-none-eabihf" gives code for another float ABI"""
    cpu: str = "generic"
    linker: str = ""
    """Zig's name of the target, where a library can be linked for it"""
    suffix: str = ".so"
    """Suffix of a library"""
    relocation: str = "pic"
    fast_cpu: str = ""
    """LLVM's name of newer processors, for which a library has a second copy"""


TARGETS = {
    "x86-64": Target(
        "x86_64-unknown-linux-gnu", "x86-64", "x86_64-linux-gnu.2.17", fast_cpu="x86-64-v3"
    ),
    "aarch64": Target("aarch64-unknown-linux-gnu", "generic", "aarch64-linux-gnu.2.17"),
    "cortex-m7": Target("thumbv7em-unknown-none-eabihf", "cortex-m7", relocation="static"),
    "macos-arm64": Target("arm64-apple-macosx11.0.0", "generic", "aarch64-macos.11.0", ".dylib"),
    "macos-x86-64": Target("x86_64-apple-macosx11.0.0", "x86-64", "x86_64-macos.11.0", ".dylib"),
    "windows-x86-64": Target("x86_64-pc-windows-gnu", "x86-64", "x86_64-windows-gnu", ".dll"),
}
"""Targets by name"""
HOSTS = {
    ("Linux", "x86_64"): "x86-64",
    ("Linux", "aarch64"): "aarch64",
    ("Darwin", "arm64"): "macos-arm64",
    ("Darwin", "x86_64"): "macos-x86-64",
    ("Windows", "AMD64"): "windows-x86-64",
}
"""Name of the target of this machine, by system and processor"""


class BuildError(Exception):
    """The library cannot be built: a tool is missing, or the code is not portable."""


def host() -> Target:
    """Return the target of this machine.

    Raises:
        BuildError: it is not known.
    """
    machine = platform.system(), platform.machine()
    if machine not in HOSTS:
        raise BuildError(f"no target is known for {machine[0]} on {machine[1]}")
    return TARGETS[HOSTS[machine]]


def in_kernel(function: _Function) -> _Function:
    """Mark a function that a tick calls."""
    MARKED.append(function)
    return function


def inlined(function: _Function) -> _Function:
    """Mark a function that nearly every tick calls, from few places; passing its arguments would take longer."""
    MARKED_INLINE.append(function)
    return in_kernel(function)


def translate(entry: Callable[..., Any], knee: Any) -> str:
    """Do the work of `kernel.portable_code`, in a process that does nothing else; `knee` is an example of one.

    Numba alone would optimise and link each function with all that it calls, again for each caller. Here it only
    translates. It resolves a call with the same types once, instead of again for each of some thousand calls, and takes
    a constant as any number, or it would translate a function again for each constant argument. Together this takes
    5 s of processor time instead of 40 s.
    """
    import llvmlite.binding as llvm
    import numba
    from numba.core.codegen import JITCodeLibrary
    from numba.core.typeinfer import TypeVar as Variable
    from numba.core.types.functions import BaseFunction
    from numba.types import unliteral

    modules: list[Any] = []

    class Translated(JITCodeLibrary):
        codegen = property(lambda library: library)

        add_llvm_module = staticmethod(modules.append)

        def finalize(self) -> None:
            self._finalized = True

        def get_pointer_to_function(self, _name: str) -> int:
            return 0

        def set_env(self, *_: Any) -> None:
            """Leave out the link to Python's objects, which an exception would need."""

    call_type, add_type = BaseFunction.get_call_type, Variable.add_type
    resolve = cache(lambda self, context, args, named: call_type(self, context, args, dict(named)))
    BaseFunction.get_call_type = lambda self, context, args, named: resolve(  # type: ignore[method-assign, assignment]
        self, context, tuple(args), tuple(named.items())
    )
    Variable.add_type = lambda self, kind, loc: add_type(self, unliteral(kind), loc)
    Variable.lock = lambda self, kind, loc, **_: self.add_type(kind, loc)
    real = numba.float64
    _take_by_reference(knee)
    made = numba_functions(entry)
    made.targetctx.codegen()._library_class = Translated
    rows = [kind[:, ::1] for kind in (real, real, numba.uint8, numba.uint32)]
    types = numba.typeof(knee), real[::1], *rows
    made.compile(types)
    whole, *others = [llvm.parse_assembly(str(module)) for module in modules]
    for module in others:
        whole.link_in(module)
    own_name = re.escape(made.overloads[types].fndesc.llvm_func_name)
    text = re.sub(rf'@"?{own_name}"?(?=[\s(,])', "@kernel", str(whole))
    return re.sub(r"^target .*\n", "", text, flags=re.MULTILINE)


def numba_functions(entry: Callable[..., Any], **options: Any) -> Any:
    """Return Numba's form of a marked function; it calls such forms of all marked functions that it may call."""
    from numba import njit

    reached, made, spaces = [entry], dict[Any, Any](), dict[int, dict[str, Any]]()
    for function in reached:  # it grows meanwhile
        named = [function.__globals__.get(name) for name in function.__code__.co_names]
        reached += [one for one in named if one in MARKED and one not in reached]
        space = spaces.setdefault(id(function.__globals__), dict(function.__globals__))
        copied = FunctionType(function.__code__, space, function.__name__)
        made[function] = njit(**OPTIONS | options, forceinline=function in MARKED_INLINE)(copied)
    for space in spaces.values():
        for name, one in space.items():
            if isinstance(one, FunctionType) and one in made:
                space[name] = made[one]
    return made[entry]


def _take_by_reference(knee: Any) -> None:
    """Let compiled code take a named tuple, and those in it, by address.

    Numba would pass each field as a separate argument, and of an array also each size: the knee, which nearly every
    function of a tick takes, has 90 of them.
    """
    from numba import typeof
    from numba.extending import typeof_impl

    typeof_impl.register(type(knee), lambda one, _: _address()(tuple(map(typeof, one)), type(one)))
    for value in knee:
        if hasattr(value, "_fields"):
            _take_by_reference(value)


@cache
def _address() -> Any:
    """Return the class of the types of such named tuples."""
    from numba.core import cgutils, types
    from numba.core.datamodel.models import PrimitiveModel
    from numba.core.imputils import lower_getattr_generic
    from numba.extending import register_model

    class Address(types.NamedTuple):  # type: ignore[name-defined]  # Numba is not typed
        """Type of the address of a named tuple."""

    @register_model(Address)
    class Pointer(PrimitiveModel):
        def __init__(self, manager: Any, kind: Any) -> None:
            whole = types.NamedTuple(kind.types, kind.instance_class)  # type: ignore[attr-defined]
            super().__init__(manager, kind, manager.lookup(whole).get_value_type().as_pointer())

    @lower_getattr_generic(Address)
    def field(_context: Any, builder: Any, kind: Any, address: Any, name: str) -> Any:
        return builder.load(cgutils.gep_inbounds(builder, address, 0, kind.fields.index(name)))

    return Address


ENTRY = "knee_contact_run"
"""The function of a library: `int32_t (knee, state, samples, count, answers)`, pointers but for the int64 `count`"""
FAST_ENTRY = f"{ENTRY}_fast"
"""The same for newer processors, with the same bits: 4 % faster with their instructions"""


def _entry_code(entry: str) -> str:
    """Return the same in LLVM's language. `kernel` is called as Numba's functions are.

    They take where they put their result and what they raise, and each array as its owner, parent, number of items,
    size of an item, data, shape and strides. Nothing in a tick asks for the number of items or the size of the state.
    """

    def array(data: str, item: int, columns: int) -> str:
        return (
            f"ptr null, ptr null, i64 0, i64 {item}, ptr {data}, "
            f"i64 %count, i64 {columns}, i64 {item * columns}, i64 {item}"
        )

    answers = [array("%answers", item, ROW.itemsize // item) for item in (8, 1, 4)]
    state = "ptr null, ptr null, i64 0, i64 8, ptr %state, i64 0, i64 8"
    call = ", ".join(
        ["ptr %returned", "ptr %raised", "ptr %knee", state, array("%samples", 8, 4), *answers]
    )
    types = ", ".join(argument.split()[0] for argument in call.split(", "))
    return f"""
declare i32 @kernel({types})
define i32 @{entry}(ptr %knee, ptr %state, ptr %samples, i64 %count, ptr %answers) {{
  %returned = alloca ptr
  %raised = alloca ptr
  %code = call i32 @kernel({call})
  ret i32 %code
}}"""


def object_code(code: str, target: Target, entry: str = ENTRY) -> bytes:
    """Return the object of a kernel for a target, with one function. It needs functions of libm alone.

    All is optimised once, together with the entry, so LLVM may drop unused arguments and merge callers; without
    vectors, which gain nothing here.

    Raises:
        BuildError: the object would need something of this process.
    """
    import llvmlite.binding as llvm

    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=target.cpu, opt=2, reloc=target.relocation, codemodel="default"
    )
    head = f'target triple = "{target.triple}"\ntarget datalayout = "{machine.target_data}"\n'
    whole, entries = (llvm.parse_assembly(head + text) for text in (code, _entry_code(entry)))
    whole.link_in(entries)
    for one in [*whole.functions, *whole.global_variables]:
        if one.name == entry:
            one.storage_class = "dllexport" if target.suffix == ".dll" else "default"
        elif not one.is_declaration:
            one.linkage = llvm.Linkage.internal
    whole.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    options.loop_vectorization = options.slp_vectorization = False
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(whole, passes)
    if found := HOST_NAMES.search(str(whole)):
        raise BuildError(f"the object needs {found[0]}")
    return bytes(machine.emit_object(whole))


def linker(target: Target, *, portable: bool = False) -> list[str]:
    """Return the command that links libraries for a target: the compiler of this machine, or Zig's, from PyPI.

    Zig's alone makes a `portable` library, which runs on older systems than this one, too.

    Raises:
        BuildError: there is none.
    """
    own = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if own and not portable and host() == target:
        return [own]
    if target.linker and importlib.util.find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "cc", "-target", target.linker]
    raise BuildError("there is no linker: install a C compiler, or `pip install ziglang`")


def build(code: str, target: Target, library: Path, *, portable: bool = False) -> None:
    """Build a library from a kernel's code; the file appears only when it is complete. See `linker` for `portable`.

    Raises:
        BuildError: a tool is missing or fails.
        OSError: the file cannot be written.
    """
    copies = {ENTRY: target.cpu} | ({FAST_ENTRY: target.fast_cpu} if target.fast_cpu else {})
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=library.parent, prefix=".build-") as folder:
        made = Path(folder, f"made{target.suffix}")
        parts = [Path(folder, f"{entry}.o") for entry in copies]
        for part, (entry, cpu) in zip(parts, copies.items(), strict=True):
            part.write_bytes(object_code(code, target._replace(cpu=cpu), entry))
        command = [*linker(target, portable=portable), "-shared", "-o", str(made)]
        if target.suffix == ".dylib":  # which would hold the name of this machine's folder
            command.append("-Wl,-install_name,@rpath/kernel.dylib")
        linked = subprocess.run(
            [*command, *parts, "-lm"],
            capture_output=True,
            errors="replace",
            encoding="utf-8",
            check=False,
        )
        if linked.returncode:
            raise BuildError(f"{command[0]}: {' '.join(linked.stderr.split())[:300]}")
        made.replace(library)

"""The kernel of a run, in the library that was built from `ticks.run`, or as plain Python with the same bits.

The library lies beside the model, where the package was built with it, or in the user's cache. Its name has a digest of
the model's sources: after an edit it is built again at the next use, where Numba and a linker are installed.
"""

import ctypes
import hashlib
import importlib.util
import logging
import os
import struct
import subprocess
import sys
import sysconfig
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from . import ticks
from .compiler import ENTRY, FAST_ENTRY, HOST_SIZES, BuildError, build, host
from .contact import KneeConstants
from .laws import hertz
from .mechanisms import hinge
from .profiles import Circle
from .surfaces import ContactPair, Plane
from .types import ROW, Floats, Rows

KEPT_LIBRARIES = 4
"""Largest number of libraries in a folder"""
_log = logging.getLogger(__name__)


def example_knee() -> KneeConstants:
    """Return the constants of a knee; those of any law, surface and mechanism have the types of these."""
    from .knee import KneeModel  # which imports this module

    pair = ContactPair(Circle(0.034), Plane(), hinge())
    return KneeModel(pair, hertz(stiffness=1e7, exponent=1.5), mass=1.0).constants


class Constants:
    """A knee's constants in memory, as the library takes them: structures of C, which hold pointers to others."""

    def __init__(self, knee: KneeConstants) -> None:
        """Lay out the constants; see `structure` for the layout."""
        self._kept: list[Any] = []
        self.address = self._structure(knee)
        """Address of the outer structure, valid as long as this object lives"""

    def _structure(self, values: Any) -> int:
        layout, numbers = "", list[Any]()
        for value in values:
            letters, own = self._field(value)
            layout += letters
            numbers += own
        memory = ctypes.create_string_buffer(struct.pack(f"@{layout}", *numbers))
        self._kept.append(memory)
        return ctypes.addressof(memory)

    def _field(self, value: Any) -> tuple[str, list[Any]]:
        """Return the layout of a field in the letters of `struct`, and its numbers."""
        if isinstance(value, np.ndarray):  # owner, parent, number, item size, data, shape, strides
            self._kept.append(value)
            numbers = [0, 0, value.size, value.itemsize, value.ctypes.data]
            return f"PPqqP{2 * value.ndim}q", [*numbers, *value.shape, *value.strides]
        if hasattr(value, "_fields"):
            return "P", [self._structure(value)]
        return {bool: "?", int: "q", float: "d"}[type(value)], [value]


class Kernel:
    """Computes the ticks of a knee: by the library, if that is wanted and there, or plain."""

    def __init__(self, knee: KneeConstants, *, compiled: bool) -> None:
        """Hold a knee; see `library` for what happens without one."""
        self.knee = knee
        self._functions = library() if compiled else None
        self._constants = Constants(knee) if self._functions else None

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(Kernel, compiled=self._functions is not None), (self.knee,)

    def bind(self, state: Floats, samples: Floats, answers: Rows) -> Callable[[], object]:
        """Return a function that computes samples, shape (n, 4), from a state into answers, shape (n,).

        All arrays are contiguous. Their addresses are looked up once, which takes longer than a tick.
        """
        if self._functions is None or self._constants is None:
            count, kinds = len(answers), (np.float64, np.uint8, np.uint32)
            views: Any = [
                answers.view(kind).reshape(count, ROW.itemsize // np.dtype(kind).itemsize)
                for kind in kinds
            ]
            return partial(ticks.run, self.knee, state, samples, *views)
        places = [array.ctypes.data for array in (state, samples, answers)]
        knee, run, data, rows = map(ctypes.c_void_p, (self._constants.address, *places))
        function = self._functions[len(samples) == 1]
        bound = partial(function, knee, run, data, ctypes.c_int64(len(samples)), rows)
        vars(bound)["kept"] = self._constants, state, samples, answers  # they live as long as it
        return bound


@cache
def library() -> list[Callable[..., object]] | None:
    """Return the function of the library, which is built first if it is missing; None, with a warning, without it.

    It comes twice: other threads of Python run beside the first, and wait for the second, which takes less for a tick.
    """
    try:
        file, entry = str(library_file()), FAST_ENTRY if has_fast_processor() else ENTRY
        functions: list[Any] = [kind(file)[entry] for kind in (ctypes.CDLL, ctypes.PyDLL)]
    except (BuildError, OSError) as error:
        text = "knee_contact_ros: there is no compiled model (%s); the plain one computes, slowly"
        _log.warning(text, " ".join(str(error).split()))
        return None
    for function in functions:
        function.restype = None
    return functions


def has_fast_processor() -> bool:
    """Whether the library has a copy for this processor: x86-64-v3 on Linux, which most since 2013 and 2015 are."""
    if not host().fast_cpu:
        return False
    with Path("/proc/cpuinfo").open(encoding="utf-8") as file:
        flags = next((line for line in file if line.startswith("flags")), "").split()
    return {"avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"} <= set(flags)


@cache
def portable_code() -> str:
    """Translate `ticks.run`, and all that it calls, into LLVM's language, not optimised; it is named `kernel`.

    Numba is changed for it, and keeps what it has compiled before, so that happens in a process of its own.

    Raises:
        BuildError: Numba is missing, or the code depends on this machine.
    """
    if not importlib.util.find_spec("numba"):
        raise BuildError("Numba is not installed")
    sys.stderr.write("knee_contact_ros: building the compiled model, once (some 8 s)\n")
    # By its full name: this module may be the one that was started. No cycles are worth looking for.
    code = (
        "from knee_contact_ros.model import compiler, kernel, ticks; import gc; gc.disable(); "
        "print(compiler.translate(ticks.run, kernel.example_knee()))"
    )
    made = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=False
    )
    if made.returncode:
        raise BuildError(f"Numba: {made.stderr.strip().splitlines()[-1]}")
    if fixed := HOST_SIZES.search(made.stdout):
        raise BuildError(f"the code has a size of this machine: {fixed[0]}")
    return made.stdout


def library_file() -> Path:
    """Return the file of the library for this machine; it is built if there is none.

    Raises:
        BuildError: it cannot be built.
        OSError: it cannot be written anywhere.
    """
    if found := found_library():
        return found
    for file in _files():
        try:
            build_in(file.parent)
        except OSError as error:
            refused = error
        else:
            return file
    raise refused


def build_in(folder: str | Path) -> None:
    """Build the library for this machine in a folder.

    Raises:
        BuildError: a tool is missing or fails.
        OSError: the folder cannot be written.
    """
    file = Path(folder, _file_name())
    build(portable_code(), host(), file)
    _remove_old(file)


def _remove_old(file: Path) -> None:
    """Remove libraries of earlier sources beside a new one, but for the newest ones: other checkouts may use them."""
    with suppress(OSError):
        others = file.parent.glob(f"knee_contact-*{file.suffix}")
        for old in sorted(others, key=os.path.getmtime)[:-KEPT_LIBRARIES]:
            old.unlink()


@cache
def digest_of_sources() -> str:
    """Return a digest of all files of the model, by which a library belongs to its sources.

    Constants may come from any of them.
    """
    files = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def _files() -> list[Path]:
    """Return the places of the library, the first choice first: beside the model, or in the user's cache."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111  (there may be no home)
    return [Path(__file__).with_name(_file_name()), Path(home, "knee_contact_ros", _file_name())]


def _file_name() -> str:
    return f"knee_contact-{digest_of_sources()}{host().suffix}"


def found_library() -> Path | None:
    """Return the file of the library for this machine; None if there is none, or the machine is not known.

    Python in a folder of sources takes those: then it may be the library of the installed package.
    """
    installed = sysconfig.get_path("platlib"), "knee_contact_ros", "model"
    try:
        return next(filter(Path.is_file, [*_files(), Path(*installed, _file_name())]), None)
    except BuildError:
        return None


if __name__ == "__main__":
    with suppress(BuildError, OSError):  # `library` says it to who needs one
        library_file()

"""Folder and names of the files in which compiled code is kept: they have digests of all that the code depends on.

Keeping can only help: if a kept file cannot be used, there is one line about it, and the code is compiled again.
Nothing here imports the compiler.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import inspect
import logging
import os
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import knee_contact_ros.core
from knee_contact_ros.compiled.kernel_folder import PREFIX, DoubtError, KernelFolder
from knee_contact_ros.compiled.source_meaning import digest, source_meaning
from knee_contact_ros.core.kernel_source import FUNCTIONS

COVERED = tuple(f"{name}." for name in (knee_contact_ros.core.__name__, __package__))
"""Prefixes of the modules that the fingerprint covers"""
CORE, COMPILED = Path(knee_contact_ros.core.__file__).parent, Path(__file__).parent
KEEPING = ("ahead.py", "cache.py", "choice.py", "keeping.py", "kernel_folder.py", "shipped.py", "turns.py")
"""Files in `compiled` that have no part in compiling: kept code stays valid when they are edited"""

NOT_KEPT = "what was compiled is not kept"

_log = logging.getLogger(__name__)
_warned: set[str] = set()


def file_names(start: str | None, processor: Any) -> tuple[str, str] | None:
    """Give the name of the file for compiled code, and how it begins whatever the processor is.

    Args:
        start: Beginning of the name; see `name_of`.
        processor: What describes the processor.

    Returns:
        Name and beginning; None if there is no beginning.
    """
    return None if start is None else (f"{start}{digest(processor)}.kernel", start)


def name_of(prefix: str, made_of: Iterable[Any], *key: Any) -> str | None:
    """Give the beginning of the names of files for compiled code, whatever the model and the processor are.

    Args:
        prefix: Beginning of the name.
        made_of: Functions and classes from which the code is compiled.
        key: What else the code depends on, in a form whose `repr` is the same in every process.

    Returns:
        The beginning; None if another process could not find the sources again.
    """
    sources = _sources_elsewhere(made_of)
    return None if sources is None else f"{prefix}-{digest((*key, sources))}-"


def _sources_elsewhere(made_of: Iterable[Any]) -> list[Any] | None:
    """Give what compiled code depends on outside the model, a contact law of the user's for instance.

    That is the files of its modules, the numbers in them (others may have defined those), and the marked functions that
    they import. None if something is not in a module and file that another process finds under its name.
    """
    sources, waiting, seen = [], list(made_of), set[str]()
    while waiting:
        one = waiting.pop()
        name = one.__module__
        if name in seen or name.startswith(COVERED):
            continue
        seen.add(name)
        module = sys.modules.get(name)
        path = getattr(module, "__file__", None)
        if name == "__main__" or "<locals>" in one.__qualname__ or not path or not Path(path).is_file():
            return None
        numbers = {key: value for key, value in vars(module).items() if isinstance(value, int | float)}
        sources.append((name, source_meaning(Path(path).read_bytes()), numbers))
        waiting += [value for value in vars(module).values() if inspect.isfunction(value) and value in FUNCTIONS]
    return sources


def _caches() -> Path:
    """Give the folder of all that this package keeps."""
    caches = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not caches.is_absolute():  # as the XDG specification says
        caches = Path.home() / ".cache"
    return caches / "knee_contact_ros"


def kernel_folder() -> Path:
    """Give the folder for what is compiled from this version of the model by this version of the compiler."""
    return _caches() / f"{PREFIX}{fingerprint()}"


@functools.cache
def fingerprint() -> str:
    """Give a digest of what all compiled code depends on: the model and the compiler."""
    versions = [_version_of(name) for name in ("numba", "llvmlite")], sys.implementation.cache_tag
    return digest((versions, model_meaning()))


@functools.cache
def model_meaning() -> str:
    """Give a digest of the model's source and of how it is compiled.

    Comments and docstrings do not count. To parse a file takes 25 times as long as to read it, so the result for the
    last files is kept.
    """
    model = sorted(CORE.rglob("*.py"))
    if not model:
        raise FileNotFoundError(f"{CORE} has no Python files")
    paths = [*model, *sorted(path for path in COMPILED.rglob("*.py") if path.name not in KEEPING)]
    files = digest([_file_digest(path) for path in paths])
    with suppress(DoubtError, RuntimeError):  # there may be no home
        known, _, meaning = (KernelFolder(_caches() / "meaning").read("model") or b"").decode().partition(" ")
        if known == files:
            return meaning
    meaning = digest([source_meaning(path.read_bytes()) for path in paths])
    with suppress(DoubtError, RuntimeError):
        KernelFolder(_caches() / "meaning").write("model", f"{files} {meaning}".encode())
    return meaning


def _version_of(package: str) -> str:
    """Give a digest of a package's version; to import the compiler for it would take longer than all else here."""
    spec = importlib.util.find_spec(package)
    return _file_digest(Path(spec.origin).with_name("_version.py")) if spec and spec.origin else "not installed"


def _file_digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def warn(error: Exception, then: str) -> None:
    """Log a warning in one line: once for each file, folder or error, and once in all that something is not kept.

    If a file cannot be read, there is no second warning that it cannot be replaced either.
    """
    places = [str(error.path), str(error.path.parent)] if isinstance(error, DoubtError) else [repr(error)]
    once = [then] if then == NOT_KEPT else []
    if _warned.isdisjoint(places + once):
        words = str(error) if isinstance(error, DoubtError) else f"{type(error).__name__}: {error}"
        _log.warning("knee_contact_ros: compiled code: %s; %s", " ".join(words.split()), then)
    _warned.update([places[0], *once])

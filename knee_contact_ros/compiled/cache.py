"""Compiled functions are kept in the user's cache folder, a file for each function and types of its arguments.

Keeping can only help: if a kept file cannot be used, there is one line about it, and the function is compiled again.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Any

from numba import types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache, _CacheLocator
from numba.core.serialize import dumps

from knee_contact_ros.compiled.keeping import NOT_KEPT, file_names, fingerprint, kernel_folder, name_of, warn
from knee_contact_ros.compiled.kernel_folder import KernelFolder
from knee_contact_ros.compiled.turns import announce_compiling, read_or_wait


def kernel_cache(function: Callable[..., Any], scene: types.Type | None = None) -> FunctionCache | NullCache:
    """Make the cache in which Numba looks for the compiled form of a function, and keeps it after compiling.

    A function that was made for a kind of `scene`, and has it in its closure, is kept for that kind.
    """
    try:
        return _KernelCache(function, scene)
    except (OSError, RuntimeError) as error:  # no home, no source
        warn(error, "compiling without keeping")
        return _NoCache()


class _NoCache(NullCache):
    """A cache that keeps nothing."""

    def load_overload(self, _sig: Any, _target_context: Any) -> None:
        """Find nothing."""
        announce_compiling()


class _Place(_CacheLocator):
    """Tells Numba the folder of a function; Numba would make it, but ours is checked at each read and write."""

    def get_cache_path(self) -> str:
        return str(kernel_folder())

    def ensure_cache_path(self) -> None:
        pass

    def get_source_stamp(self) -> str:
        return fingerprint()

    def get_disambiguator(self) -> str:
        return ""

    @classmethod
    def from_function(cls, _function: Any, _file: str) -> _Place:
        return cls()


class _Compiled(CompileResultCacheImpl):
    _locator_classes = (_Place,)


class _KernelCache(FunctionCache):
    """Numba's cache of a function, with files of our own; whatever is wrong with them is only warned of."""

    _impl_class = _Compiled

    def __init__(self, function: Callable[..., Any], scene: types.Type | None) -> None:
        super().__init__(function)
        self._scene = scene
        self._cache_file = _Kernels(function, KernelFolder(kernel_folder()))

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        """Give a key for `_Kernels`: types whose sources count, the processor, and what else determines the code."""
        if self._scene is None:
            return super()._index_key(sig, codegen)
        return (self._scene,), codegen.magic_tuple(), str(sig)

    def flush(self) -> None:
        """Ignore from now on what was kept, so that all is compiled again."""
        self.disable()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load what was kept for a signature; None if there is nothing that can be used."""
        try:
            kept = super().load_overload(sig, target_context)
        except Exception as error:  # what is whole and ours may still have been made by something else
            warn(error, "compiling again")
            kept = None
        if kept is None:
            announce_compiling()
        return kept

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled for a signature, if that is possible."""
        try:
            super().save_overload(sig, data)
        except Exception as error:
            warn(error, NOT_KEPT)


class _Kernels:
    """The files of one function, with the methods that Numba expects.

    Numba itself has an index of all signatures beside numbered files: two processes that add to it at once can give two
    signatures one file. Here the name of a file has a digest of all that its content depends on.
    """

    def __init__(self, function: Callable[..., Any], folder: KernelFolder) -> None:
        self._function = function
        self._folder = folder

    def load(self, key: Any) -> Any:
        """Load what was kept under a key; None if nothing was."""
        names = self._names(key)
        content = read_or_wait(self._folder, *names) if names else None
        return None if content is None else pickle.loads(content)  # noqa: S301  it is whole, and written by this user

    def save(self, key: Any, data: Any) -> None:
        """Keep something under a key, and remove what nobody uses any more."""
        if names := self._names(key):
            self._folder.write(names[0], dumps(data))
            with suppress(OSError):
                self._folder.remove_unused()

    def _names(self, key: Any) -> tuple[str, str] | None:
        """See `file_names`."""
        signature, processor, code = key
        made_of: list[Any] = [self._function, *_named_tuples(signature)]
        names = [(one.__module__, one.__qualname__) for one in made_of]
        return file_names(name_of(self._function.__name__, made_of, names, str(signature), code), processor)


def _named_tuples(kinds: Iterable[Any]) -> Iterator[type]:
    """Yield the classes of the named tuples in a signature, those inside others too."""
    for kind in kinds:
        if isinstance(kind, types.BaseNamedTuple):
            yield kind.instance_class
        if isinstance(kind, types.BaseTuple):
            yield from _named_tuples(kind.types)

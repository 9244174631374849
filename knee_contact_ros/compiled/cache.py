"""Where compiled functions are kept: in the user's cache folder, a file for each function and kind of arguments.

Keeping can only help: whatever is odd about what was kept is told in one line, and the function compiled again.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Any

from numba import types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache, _CacheLocator
from numba.core.serialize import dumps

from knee_contact_ros.compiled.keeping import NOT_KEPT, fingerprint, kernel_folder, sources_elsewhere, tell
from knee_contact_ros.compiled.kernel_folder import DoubtError, KernelFolder
from knee_contact_ros.compiled.source_meaning import digest
from knee_contact_ros.compiled.turns import tell_of_compiling, wait_for_turn


def kernel_cache(function: Callable[..., Any], scene: types.Type | None = None) -> FunctionCache | NullCache:
    """What Numba asks for the compiled form of a function before it compiles it, and gives it to afterwards.

    A function that was made for a kind of `scene`, and has it in its closure, is kept for that one.
    """
    try:
        return _KernelCache(function, scene)
    except (OSError, RuntimeError) as error:  # no home, no source
        tell(error, "compiling without keeping")
        return _NoCache()


class _NoCache(NullCache):
    """Keeps nothing."""

    def load_overload(self, _sig: Any, _target_context: Any) -> None:
        """There is nothing."""
        tell_of_compiling()

    def holds(self, _sig: Any, _target_context: Any) -> bool:
        """Nothing is kept."""
        return False


class _Place(_CacheLocator):
    """Numba wants to know a function's folder, and makes it; ours is looked at when something is read or written."""

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
    """Numba's cache of a function, with files of our own, and calm about all that goes wrong with them."""

    _impl_class = _Compiled

    def __init__(self, function: Callable[..., Any], scene: types.Type | None) -> None:
        super().__init__(function)
        self._scene = scene
        self._cache_file = _Kernels(function, KernelFolder(kernel_folder()))

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        """What `_Kernels` calls a key: types whose sources count, the processor, and what else names the code."""
        if self._scene is None:
            return super()._index_key(sig, codegen)
        return (self._scene,), codegen.magic_tuple(), str(sig)

    def flush(self) -> None:
        """Compile all again: what was kept is not looked at any more."""
        self.disable()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was kept for a signature; None if there is nothing that can be used."""
        try:
            kept = super().load_overload(sig, target_context)
        except Exception as error:  # what is whole and ours may still have been made by something else
            tell(error, "compiling again")
            kept = None
        if kept is None:
            tell_of_compiling()
        return kept

    def holds(self, sig: Any, target_context: Any) -> bool:
        """Whether there is something under a signature; that it can be used is not looked at."""
        try:
            return self._cache_file.holds(self._index_key(sig, target_context.codegen()))
        except Exception:  # as above, which tells of it
            return False

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled for a signature, if that can be done."""
        try:
            super().save_overload(sig, data)
        except Exception as error:
            tell(error, NOT_KEPT)


class _Kernels:
    """The files of one function, in the form in which Numba asks for them.

    Numba itself has an index of all signatures beside numbered files: two processes that add to it at once can give two
    signatures one file. Here the name of a file says all that its content depends on.
    """

    def __init__(self, function: Callable[..., Any], folder: KernelFolder) -> None:
        self._function = function
        self._folder = folder

    def load(self, key: Any) -> Any:
        """What was kept under a key; None if nothing was."""
        names = self._names(key)
        if names is None:
            return None
        name, start = names
        content = self._folder.read(name)
        if content is None:
            tell_of_compiling()
            wait_for_turn(self._folder, name)
            content = self._folder.read(name)
        if content is not None:
            return pickle.loads(content)  # noqa: S301  it is whole, and written by this user
        if any(other.startswith(start) for other in self._folder.names()):
            raise DoubtError(self._folder.path, "is from another processor")
        return None

    def holds(self, key: Any) -> bool:
        """Whether something was kept under a key."""
        names = self._names(key)
        return names is not None and names[0] in self._folder.names()

    def save(self, key: Any, data: Any) -> None:
        """Keep something under a key; what nobody uses any more goes."""
        names = self._names(key)
        if names is not None:
            self._folder.write(names[0], dumps(data))
            with suppress(OSError):
                self._folder.remove_unused()

    def _names(self, key: Any) -> tuple[str, str] | None:
        """The name of a file, and how it starts whatever the processor; None for what cannot be found again."""
        signature, processor, code = key
        made_of: list[Any] = [self._function, *_named_tuples(signature)]
        sources = sources_elsewhere(made_of)
        if sources is None:
            return None
        names = [(one.__module__, one.__qualname__) for one in made_of]
        start = f"{self._function.__name__}-{digest((names, str(signature), code, sources))}-"
        return f"{start}{digest(processor)}.kernel", start


def _named_tuples(kinds: Iterable[Any]) -> Iterator[type]:
    """The classes of the named tuples in a signature, those inside others too."""
    for kind in kinds:
        if isinstance(kind, types.BaseNamedTuple):
            yield kind.instance_class
        if isinstance(kind, types.BaseTuple):
            yield from _named_tuples(kind.types)

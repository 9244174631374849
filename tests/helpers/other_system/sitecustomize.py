"""Make the package believe that it runs on Windows or macOS, in each Python process that finds this on PYTHONPATH.

Modules and names that the system lacks are absent for modules of the package. The libraries that they use keep those
of Linux, as they have their own code for each system. On Windows, too: a file that this process has open cannot be
renamed, replaced or deleted; renaming replaces no file; nobody may make links; folders cannot be opened; an unnamed
temporary file has a name. A text file must name its encoding.
"""

import builtins
import errno
import json
import os
import sys
import tempfile
import types
import warnings
from contextlib import suppress
from typing import Any

PACKAGE = "knee_contact_ros"
LIBRARIES = ("pathlib", "shutil", "tempfile", "contextlib", "os", __name__)
"""Modules that call others for the package"""
FAR = 1 << 31
"""Offset [B] from which on a locked byte hinders no reader"""


class Lacking(types.ModuleType):
    """A module without some of its names, and with others in their place."""

    def __init__(self, real, absent, own):
        super().__init__(real.__name__)
        vars(self).update(_real=real, _absent=absent, **own)

    def __getattr__(self, name):
        if name in self._absent:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r} here")
        return getattr(self._real, name)

    def __setattr__(self, name, value):
        setattr(self._real, name, value)


def of_package(name):
    return bool(name) and (name == PACKAGE or str(name).startswith(f"{PACKAGE}."))


def called_by_package():
    frame = sys._getframe(1)
    while frame and frame.f_globals.get("__name__") in LIBRARIES:
        frame = frame.f_back  # type: ignore[assignment]
    return bool(frame) and of_package(frame.f_globals.get("__name__"))


def refusal(number, path):
    return OSError(number, os.strerror(number), os.fspath(path))


def open_files():
    """Yield what this process has open."""
    with os.scandir("/proc/self/fd") as entries:
        for each in entries:
            with suppress(OSError):
                yield os.stat(each)  # noqa: PTH116


def check_closed(path, folder=None):
    """Refuse a file that is open, or a folder with one in it."""
    with suppress(FileNotFoundError):
        own = os.stat(path, dir_fd=folder, follow_symlinks=False)
        inside = [own]
        for place, _, names in os.walk(path) if folder is None else ():
            inside += [os.lstat(f"{place}/{name}") for name in names]
        there = {(one.st_dev, one.st_ino) for one in open_files()}
        if any((one.st_dev, one.st_ino) in there for one in inside):
            raise refusal(errno.EACCES, path)


def on_windows(function, targets, replaces):
    """Return a function that removes or renames as Windows lets it."""

    def refused(path, *others, dir_fd=None, **more):
        if called_by_package():
            check_closed(path, dir_fd)
            if targets and os.path.lexists(others[0]):
                if not replaces:
                    raise refusal(errno.EEXIST, others[0])
                check_closed(others[0])
        if dir_fd is not None:
            more["dir_fd"] = dir_fd
        return function(path, *others, **more)

    return refused


def no_link(function):
    def refused(source, target, *others, **more):
        if called_by_package():
            raise refusal(errno.EPERM, target)
        return function(source, target, *others, **more)

    return refused


def open_no_folder(path, *others, **more):
    if os.path.isdir(path):  # noqa: PTH112
        raise refusal(errno.EACCES, path)
    return os.open(path, *others, **more)


def fake_msvcrt():
    """Return a stand-in for Windows' locks of bytes, which also keep others from reading."""
    import fcntl

    def locking(descriptor, mode, number):
        assert (mode, number) == (module.LK_NBLCK, 1)
        assert os.lseek(descriptor, 0, os.SEEK_CUR) >= FAR, "the locked byte cannot be read"
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PermissionError(errno.EACCES, "Permission denied") from None

    module: Any = types.ModuleType("msvcrt")
    module.LK_NBLCK, module.locking = 2, locking
    return module  # type: ignore[no-any-return]


def hide(system, lacking, absent):
    """Hide names of modules, and modules, from the package."""
    own: dict[str, dict[str, Any]] = {"sys": {"platform": system}}
    msvcrt = fake_msvcrt()  # which tells libraries that this is Windows
    if system == "win32":
        own["os"] = {"name": "nt", "open": open_no_folder}
    real_import = builtins.__import__
    proxies: dict[str, types.ModuleType] = {}

    def import_(name, globals_=None, *others, **more):
        if not of_package((globals_ or {}).get("__name__")):
            return real_import(name, globals_, *others, **more)
        top = name.partition(".")[0]
        if top in absent:
            raise ModuleNotFoundError(f"No module named {top!r} here", name=top)
        if name == "msvcrt":
            return msvcrt
        found = real_import(name, globals_, *others, **more)
        if name not in {*lacking, *own}:
            return found
        if name not in proxies:
            proxies[name] = Lacking(found, set(lacking.get(name, ())), own.get(name, {}))
        return proxies[name]

    builtins.__import__ = import_


def become(system, lacking, absent):
    if system == "win32":
        tempfile.TemporaryFile = tempfile.NamedTemporaryFile  # type: ignore[assignment]
        for names, targets, replaces in (
            (("unlink", "remove", "rmdir"), False, False),
            (("rename",), True, False),
            (("replace",), True, True),
        ):
            for name in names:
                setattr(os, name, on_windows(getattr(os, name), targets, replaces))
        os.symlink = no_link(os.symlink)
    warnings.filterwarnings("ignore", category=EncodingWarning)
    warnings.filterwarnings("error", category=EncodingWarning, module=PACKAGE)
    hide(system, lacking, absent)


become(**json.loads(os.environ["KNEE_CONTACT_TEST_SYSTEM"]))

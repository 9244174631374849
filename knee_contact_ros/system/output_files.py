"""Output files appear under their names when they are complete; until then they carry the suffix `.partial`.

Who writes a recording holds a lock (`flock`) on its unfinished file, which ends with the process, whatever it dies of.
So a file that is being written is told from one that was cut off. Nothing that lies in the way is opened but a plain
file: a link would lead elsewhere, and a pipe waits for ever.
"""

from __future__ import annotations

import errno
import fcntl
import itertools
import os
import shlex
import stat
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO

from knee_contact_ros.system.errors import UsageError

PARTIAL = ".partial"
STAMP = "{stamp}"
"""In a path: when it was opened"""
FIRST = "_0"
"""How rosbag2 ends the name of a recording's first file"""
MENDS = {".mcap": "knee-contact recover {} OUT.mcap", ".rrd": "rerun rrd merge {} -o OUT.rrd"}
"""What makes a recording whole that was cut off"""
LATER = "_99999"
"""For so much there must be room in an output's name: it may have to go on"""
LOCK_TRIES, LOCK_PAUSE = 5, 0.01
"""How often to try to lock a file, and how long [s] to wait in between: others may just be looking"""
NEW = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
"""How to open a file that is not there yet"""
THERE = os.O_NONBLOCK | os.O_CLOEXEC
"""How to open one that is"""


def partial_name(path: Path) -> Path:
    """The name of an output until it is complete."""
    return path.with_name(path.name + PARTIAL)


def is_taken(path: Path) -> bool:
    """Whether there is something of an output's name, or unfinished."""
    return os.path.lexists(path) or os.path.lexists(partial_name(path))


def later_names(path: Path) -> Iterator[Path]:
    """The names behind the first one, as rosbag2 counts a recording's files; those that are taken are left out.

    `run_0.mcap` goes on as `run_1.mcap`, and `run.mcap` likewise.
    """
    stem = path.stem.removesuffix(FIRST)
    names = (path.with_name(f"{stem}_{number}{path.suffix}") for number in itertools.count(1))
    return (name for name in names if not is_taken(name))


def all_names(path: Path) -> Iterator[Path]:
    """A path, unless it is taken, and its later names."""
    return itertools.chain([] if is_taken(path) else [path], later_names(path))


def stamped(path: str) -> str:
    """A path with the local time in the place of `{stamp}`, spelled as rosbag2 names its bags."""
    return path.replace(STAMP, time.strftime("%Y_%m_%d-%H_%M_%S"))


def refuse_impossible(path: Path) -> None:
    """Refuse an output that cannot be written wherever it is; only looks, and quickly.

    Raises:
        UsageError: it names no file, or a folder, is too long, or its folder is none, can neither be written nor made.
    """
    try:
        reason = _obstacle(path)
    except OSError as error:
        reason = error.strerror or str(error)
    except ValueError as error:  # characters that no name can have
        reason = str(error)
    if reason:
        raise UsageError(f"cannot write {path}: {reason}")


def _obstacle(path: Path) -> str:
    """Why an output cannot be written; raises OSError or ValueError with the reason likewise."""
    if path.name in ("", "..") or "\0" in path.name:
        return "it names no file"
    if path.is_dir():
        return os.strerror(errno.EISDIR)
    folder = path.absolute().parent
    while not _exists(folder):
        folder = folder.parent
    if not stat.S_ISDIR(folder.stat().st_mode):
        return os.strerror(errno.ENOTDIR)
    longest = os.pathconf(folder, "PC_NAME_MAX")
    if any(len(os.fsencode(part)) > longest for part in (*path.parent.parts, partial_name(path).name + LATER)):
        return os.strerror(errno.ENAMETOOLONG)
    if os.statvfs(folder).f_flag & os.ST_RDONLY:
        return os.strerror(errno.EROFS)
    return "" if os.access(folder, os.W_OK | os.X_OK) else os.strerror(errno.EACCES)


def _exists(folder: Path) -> bool:
    try:
        folder.stat()
    except FileNotFoundError:
        return False
    return True


def checked_output(path: Path, label: str, *suffixes: str) -> Path:
    """The path of an output to be: its folder is there, as a misspelt one is not made, and its name tells what it is.

    Raises:
        UsageError: its folder is not there, or its name ends with none of `suffixes`, if there are any.
    """
    if suffixes and path.suffix.lower() not in suffixes:
        raise UsageError(f"{label} {path}: its name must end with {' or '.join(suffixes)}")
    try:
        there = path.absolute().parent.is_dir()
    except OSError as error:
        raise UsageError(f"{label} {path}: {error.strerror}") from None
    if not there:
        raise UsageError(f"{label} {path}: there is no folder {path.parent}; make it first")
    return path


def refuse_existing(path: Path) -> None:
    """Refuse an output whose name is taken.

    Raises:
        UsageError: the output or an unfinished one of its name exists.
    """
    if os.path.lexists(path):
        raise UsageError(f"{path} exists already; choose another name, or --overwrite")
    partial = partial_name(path)
    if not os.path.lexists(partial):
        return
    if is_being_written(partial):
        raise UsageError(being_written(partial))
    if path.suffix not in MENDS:
        raise UsageError(f"{partial} exists: it was cut off, or is being written; move it away first")
    raise UsageError(f"{cut_off(partial)}; then move it away, or choose another name")


def being_written(partial: Path) -> str:
    """What there is to say of an unfinished file that is locked."""
    return f"{partial} is being written by another process; choose another name"


def cut_off(partial: Path) -> str:
    """What there is to say of a recording that was cut off."""
    command = MENDS[partial.with_suffix("").suffix].format(shlex.quote(str(partial)))
    return f"{partial} is a recording that was cut off: `{command}` makes it whole"


def claim(path: Path, overwrite: bool = False) -> Path:
    """Make the folder of an output and its unfinished file, and return the latter's name.

    With `overwrite`, what is there gives way; a link itself does, and not what it leads to.

    Raises:
        UsageError: the output or an unfinished one of its name exists, or the folder cannot be written.
    """
    refuse_impossible(path)
    partial = partial_name(path)
    if not overwrite:
        refuse_existing(path)
    elif is_being_written(partial):
        raise UsageError(being_written(partial))
    try:
        make_folder(path.parent)
        if overwrite:
            partial.unlink(missing_ok=True)
        os.close(os.open(partial, NEW, 0o666))
    except FileExistsError:
        raise UsageError(being_written(partial)) from None
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from None
    return partial


def claim_first(names: Iterable[Path]) -> tuple[Path, Path]:
    """Claim an output under the first of these names that is free; that name, and the unfinished file's.

    Raises:
        UsageError: the folder cannot be written.
    """
    for name in names:
        try:
            return name, claim(name)
        except UsageError:
            if not is_taken(name):  # otherwise somebody was quicker
                raise
    raise UsageError("all names are taken")


def open_claimed(partial: Path) -> IO[bytes]:
    """Open a claimed file for writing, empty and locked.

    Raises:
        UsageError: another process writes it, or it is not what was claimed.
    """
    try:
        file = open(partial, "r+b", opener=lambda name, _: os.open(name, os.O_RDWR | os.O_NOFOLLOW | THERE))  # noqa: SIM115
    except OSError as error:
        raise UsageError(f"cannot write {partial}: {error.strerror}") from None
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise UsageError(f"cannot write {partial}: it is no plain file")
    for _ in range(LOCK_TRIES):
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(LOCK_PAUSE)
            continue
        except OSError:
            break  # a file system without locks: nobody can be told that it is being written
        break
    else:
        file.close()
        raise UsageError(being_written(partial))
    file.truncate()
    return file


def take_name(partial: Path, path: Path, overwrite: bool) -> Path:
    """Give a complete file its final name: the first free one of its names, unless it may `overwrite`; that name.

    Raises:
        OSError: it cannot have one.
    """
    if overwrite:
        partial.replace(path)
        return path
    for name in itertools.chain([path], later_names(path)):
        try:
            rename_new(partial, name)
        except FileExistsError:
            continue
        return name
    raise AssertionError("names have no end")


def rename_new(partial: Path, name: Path) -> None:
    """Rename without overwriting.

    Raises:
        FileExistsError: the name is taken.
        OSError: it cannot be renamed.
    """
    try:
        os.link(partial, name, follow_symlinks=False)
    except FileExistsError:
        raise
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK):
            raise
        if os.path.lexists(name):  # a file system without links, as on memory cards: looking is all that can be done
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(name)) from None
        partial.rename(name)
    else:
        partial.unlink()


def write_new(path: Path, data: bytes) -> None:
    """Write a file in place of whatever has its name, down to the disk.

    Raises:
        OSError: it cannot be written; it is not there then.
    """
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, NEW, 0o666), "wb") as file:
        try:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        except OSError:
            with suppress(OSError):
                path.unlink()
            raise


def make_folder(folder: Path) -> None:
    """Make a folder, and have it on the disk.

    Raises:
        OSError: it cannot be made.
    """
    missing = list(itertools.takewhile(lambda parent: not parent.exists(), [folder, *folder.absolute().parents]))
    folder.mkdir(parents=True, exist_ok=True)
    for made in missing:
        sync_folder(made.absolute().parent)


def sync_folder(folder: Path) -> None:
    """Have the names in a folder on the disk, where the file system can."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def is_being_written(partial: Path) -> bool:
    """Whether somebody holds the lock of an unfinished file."""
    with suppress(OSError), os.fdopen(os.open(partial, os.O_RDONLY | THERE), "rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def leftovers(folder: Path, suffix: str) -> list[Path]:
    """Unfinished recordings in a folder, `.mcap` or `.rrd` files, that nobody writes any more."""
    found = sorted(folder.glob(f"*{suffix}{PARTIAL}"))
    return [path for path in found if _is_plain(path) and not is_being_written(path)]


def _is_plain(path: Path) -> bool:
    with suppress(OSError):
        return stat.S_ISREG(path.lstat().st_mode)
    return False

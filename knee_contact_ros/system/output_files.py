"""Output files get their names when they are complete; until then they have the suffix `.partial`.

The writer of a recording holds a lock (`flock`) on its unfinished file, which ends with the process in any case. This
distinguishes a file that is being written from one that was cut off. Only plain files are opened: a link would lead
elsewhere, and a pipe would block.

A command with a folder of results writes them into a `work_folder` first: they appear when all are done, and an
interrupted command leaves nothing there.
"""

from __future__ import annotations

import errno
import fcntl
import itertools
import os
import shlex
import shutil
import stat
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from knee_contact_ros.system.errors import UsageError

PARTIAL = ".partial"
STAMP = "{stamp}"
"""Placeholder in a path for the time of opening"""
FIRST = "_0"
"""Suffix of the name of the first file of a recording of rosbag2"""
MENDS = {".mcap": "knee-contact recover {} OUT.mcap", ".rrd": "rerun rrd merge {} -o OUT.rrd"}
"""Commands that repair a recording that was cut off, by suffix"""
LATER = "_99999"
"""Longest suffix that an output may get if it has to be continued in further files"""
LOCK_TRIES, LOCK_PAUSE = 5, 0.01
"""Number of attempts to lock a file, and pause between them [s]: others may hold the lock for a moment to check it"""
NEW = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
"""Flags to create and open a new file"""
THERE = os.O_NONBLOCK | os.O_CLOEXEC
"""Flags to open an existing file"""


def partial_name(path: Path) -> Path:
    """Name of an output until it is complete."""
    return path.with_name(path.name + PARTIAL)


def is_taken(path: Path) -> bool:
    """Whether the name of an output or of its unfinished file exists."""
    return os.path.lexists(path) or os.path.lexists(partial_name(path))


def later_names(path: Path) -> Iterator[Path]:
    """Names after the first one, numbered as the files of a recording of rosbag2, without those that are taken.

    `run_1.mcap` follows `run_0.mcap` as well as `run.mcap`.
    """
    stem = path.stem.removesuffix(FIRST)
    names = (path.with_name(f"{stem}_{number}{path.suffix}") for number in itertools.count(1))
    return (name for name in names if not is_taken(name))


def all_names(path: Path) -> Iterator[Path]:
    """A path, unless it is taken, and the names that follow it; see `later_names`."""
    return itertools.chain([] if is_taken(path) else [path], later_names(path))


def stamped(path: str) -> str:
    """Path with the local time in place of `{stamp}`, in the format of rosbag2."""
    return path.replace(STAMP, time.strftime("%Y_%m_%d-%H_%M_%S"))


def refuse_impossible(path: Path) -> None:
    """Refuse an output that cannot be written, by a quick check that changes nothing.

    Raises:
        UsageError: the path names no file, or a folder, is too long, or its folder is no folder or can neither be
            written nor made.
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
    """Reason why an output cannot be written, or empty; OSError and ValueError hold a reason, too."""
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
    """Check the path of a future output, and return it. A missing folder is not made, as it may be misspelt.

    Raises:
        UsageError: its folder does not exist, or its name ends with none of `suffixes`, if there are any.
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
    """Message for an unfinished file that is locked."""
    return f"{partial} is being written by another process; choose another name"


def cut_off(partial: Path) -> str:
    """Message for the unfinished file of a recording that was cut off."""
    command = MENDS[partial.with_suffix("").suffix].format(shlex.quote(str(partial)))
    return f"{partial} is a recording that was cut off: `{command}` makes it whole"


def claim(path: Path, overwrite: bool = False) -> Path:
    """Make the folder of an output and its unfinished file, and return the name of the latter.

    With `overwrite`, an existing file is replaced; of a link the link itself, and not its target.

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
    """Claim an output under the first of these names that is free; return that name and the unfinished file's.

    Raises:
        UsageError: the folder cannot be written.
    """
    for name in names:
        try:
            return name, claim(name)
        except UsageError:
            if not is_taken(name):  # if it is, somebody was faster
                raise
    raise UsageError("all names are taken")


def open_claimed(partial: Path) -> IO[bytes]:
    """Open a claimed file for writing, empty and locked.

    Raises:
        UsageError: another process writes it, or it is not the file that was claimed.
    """
    try:
        file = open(partial, "r+b", opener=lambda name, _: os.open(name, os.O_RDWR | os.O_NOFOLLOW | THERE))  # noqa: SIM115
    except OSError as error:
        raise UsageError(f"cannot write {partial}: {error.strerror}") from None
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise UsageError(f"cannot write {partial}: it is not a regular file")
    for _ in range(LOCK_TRIES):
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(LOCK_PAUSE)
            continue
        except OSError:
            break  # a file system without locks: others cannot see that it is being written
        break
    else:
        file.close()
        raise UsageError(being_written(partial))
    file.truncate()
    return file


def take_name(partial: Path, path: Path, overwrite: bool) -> Path:
    """Give a complete file its final name, the first free one unless it may `overwrite`, and return it.

    Raises:
        OSError: the file cannot be renamed.
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
        if os.path.lexists(name):  # a file system without links, as on memory cards: a check is all that can be done
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(name)) from None
        partial.rename(name)
    else:
        partial.unlink()


def write_new(path: Path, data: bytes) -> None:
    """Write a file and sync it to the disk; an existing file of its name is replaced.

    Raises:
        OSError: it cannot be written; it does not exist then.
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


def write_complete(contents: Mapping[Path, bytes]) -> None:
    """Write files, which get their names when all of them are complete, and replace others.

    Raises:
        UsageError: one cannot be written.
    """
    try:
        for path, content in contents.items():
            write_new(partial_name(path), content)
        for path in contents:
            partial_name(path).replace(path)
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from None
    finally:
        for path in contents:
            with suppress(OSError):  # its folder may be what cannot be used
                partial_name(path).unlink()


def make_folder(folder: Path) -> None:
    """Make a folder with its parents, and sync them to the disk.

    Raises:
        OSError: it cannot be made.
    """
    missing = list(itertools.takewhile(lambda parent: not parent.exists(), [folder, *folder.absolute().parents]))
    folder.mkdir(parents=True, exist_ok=True)
    for made in missing:
        sync_folder(made.absolute().parent)


def sync_folder(folder: Path) -> None:
    """Sync the entries of a folder to the disk, where the file system can."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def is_being_written(partial: Path) -> bool:
    """Whether a process holds the lock of an unfinished file."""
    with suppress(OSError), os.fdopen(os.open(partial, os.O_RDONLY | THERE), "rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def leftovers(folder: Path, suffix: str) -> list[Path]:
    """Unfinished recordings in a folder, with the suffix `.mcap` or `.rrd`, that no process writes any more."""
    paths = sorted(folder.glob(f"*{suffix}{PARTIAL}"))
    return [path for path in paths if _is_plain(path) and not is_being_written(path)]


def _is_plain(path: Path) -> bool:
    with suppress(OSError):
        return stat.S_ISREG(path.lstat().st_mode)
    return False


@contextmanager
def work_folder(output: Path) -> Iterator[Path]:
    """Make a temporary folder inside `output`, which is removed at the end, also after SIGTERM.

    Raises:
        UsageError: it cannot be made.
    """
    from knee_contact_ros.system.processes import interrupted_by_sigterm  # a third of the time of --help

    work = output / f".incomplete-{os.getpid()}"
    made = not output.exists()
    try:
        work.mkdir(parents=True)
    except OSError as error:
        raise UsageError(f"cannot write to {output}: {error.strerror}") from None
    try:
        with interrupted_by_sigterm():
            yield work.resolve()
    finally:
        shutil.rmtree(work, ignore_errors=True)
        if made and not any(output.iterdir()):
            output.rmdir()


def replace(source: Path, target: Path) -> None:
    """Move a result, if there is one, to its place; an earlier result there is removed."""
    if target.is_dir():
        shutil.rmtree(target)
    else:
        target.unlink(missing_ok=True)
    if source.exists():
        source.rename(target)

"""Output files get their names when they are complete; until then they have the suffix `.partial`.

The writer of a recording holds a lock on its unfinished file; the lock always ends with the process. So a
file that is being written differs from one that was cut off. Only plain files are opened: a link would lead elsewhere,
and a pipe would block.

A command with a folder of results first writes into a `work_folder`. The results appear when all are done, and an
interrupted command leaves nothing.
"""

import errno
import itertools
import os
import shutil
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from .errors import IncompleteError, UsageError
from .files import expand_user, is_file
from .portable import READ_FLAGS, lock, quoted

PARTIAL = ".partial"
STAMP_PLACEHOLDER = "{stamp}"
"""Placeholder in a path for the time of opening"""
FIRST_FILE = "_0"
"""Suffix of the name of the first file of a recording of rosbag2"""
REPAIR_COMMANDS = {
    ".mcap": "knee-contact recover {} OUT.mcap",
    ".rrd": "rerun rrd merge {} -o OUT.rrd",
}
"""Commands that repair a recording that was cut off, by suffix"""
LOCK_TRIES = 5
"""Number of attempts to lock a file, as others may briefly hold the lock to check it"""
LOCK_PAUSE = 0.01
"""Pause between two of them [s]"""
DISK_FULL_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
"""Errors of a full disk, or of a file that became too large for it or for its user"""


def partial_name(path: Path) -> Path:
    """Return the name of an output until it is complete."""
    return path.with_name(path.name + PARTIAL)


def is_taken(path: Path) -> bool:
    """Return whether the name of an output or of its unfinished file exists."""
    return os.path.lexists(path) or os.path.lexists(partial_name(path))


def later_names(path: Path) -> Iterator[Path]:
    """Yield free names after the first one, numbered as the files of a recording of rosbag2.

    `run_1.mcap` follows `run_0.mcap` as well as `run.mcap`.
    """
    stem = path.stem.removesuffix(FIRST_FILE)
    names = (path.with_name(f"{stem}_{number}{path.suffix}") for number in itertools.count(1))
    return (name for name in names if not is_taken(name))


def free_names(path: Path) -> Iterator[Path]:
    """Yield a path, unless it is taken, and the names that follow it; see `later_names`."""
    return itertools.chain([] if is_taken(path) else [path], later_names(path))


def expand_stamp(path: str) -> str:
    """Return a path with the local time for `{stamp}`, as rosbag2 writes it, and with `~` expanded; or empty."""
    return path and str(
        expand_user(path.replace(STAMP_PLACEHOLDER, time.strftime("%Y_%m_%d-%H_%M_%S")))
    )


def check_writable(path: Path) -> None:
    """Refuse an output that cannot be written; checking it leaves no file.

    Raises:
        UsageError: the path is a folder or is too long, or nothing can be written to its folder, or to the nearest one
            that exists.
    """
    from tempfile import TemporaryFile

    try:
        _check_not_folder(path)
        with suppress(FileNotFoundError):
            partial_name(path).lstat()
        folders = path.absolute().parents
        TemporaryFile(dir=next(filter(os.path.lexists, folders), folders[-1])).close()
    except (OSError, ValueError) as error:
        raise _not_writable(path, error) from None


def _check_not_folder(path: Path) -> None:
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))


def _not_writable(path: Path, error: OSError | ValueError) -> UsageError:
    """Return the error for an output that cannot be written; a ValueError means characters that no name can have."""
    return UsageError(f"cannot write {path}: {getattr(error, 'strerror', None) or error}")


def _not_written(path: Path, error: OSError) -> UsageError | IncompleteError:
    """Return the error for an output that could not be written, or not completely, as the disk is full."""
    return (IncompleteError if error.errno in DISK_FULL_ERRORS else UsageError)(
        f"cannot write {path}: {error.strerror}"
    )


def check_output(path: Path, label: str, *suffixes: str) -> Path:
    """Check the path of a future output, and return it. A missing folder is not created, as it may be misspelt.

    Raises:
        UsageError: its folder does not exist, or its name ends with none of `suffixes`, if there are any.
    """
    if suffixes and path.suffix.lower() not in suffixes:
        raise UsageError(f"{label} {path}: its name must end with {' or '.join(suffixes)}")
    if not os.path.isdir(path.absolute().parent):  # noqa: PTH112  (never raises)
        raise UsageError(f"{label} {path}: there is no folder {path.parent}; make it first")
    return path


def check_not_input(output: Path, inputs: Iterable[Path]) -> None:
    """Refuse an output that would replace an input.

    Raises:
        UsageError: it would.
    """
    if is_file(output) and any(is_file(path) and output.samefile(path) for path in inputs):
        raise UsageError(f"{output} is the input, which is never changed; choose another name")


def check_name_free(path: Path) -> None:
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
        raise UsageError(being_written_message(partial))
    if path.suffix not in REPAIR_COMMANDS:
        raise UsageError(
            f"{partial} exists: it was cut off, or is being written; move it away first"
        )
    raise UsageError(f"{cut_off_message(partial)}; then move it away, or choose another name")


def being_written_message(partial: Path) -> str:
    """Return the message for an unfinished file that is locked."""
    return f"{partial} is being written by another process; choose another name"


def cut_off_message(partial: Path) -> str:
    """Return the message for the unfinished file of a recording that was cut off."""
    command = REPAIR_COMMANDS[partial.with_suffix("").suffix].format(quoted(partial))
    return f"{partial} is a recording that was cut off: `{command}` makes it whole"


def claim(path: Path, overwrite: bool = False) -> IO[bytes]:
    """Make the folder of an output, and open its unfinished file, locked, for writing.

    With `overwrite`, an existing file is replaced at the end; a link is replaced itself, not its target.

    Raises:
        UsageError: the output or an unfinished one of its name exists, or it cannot be written.
    """
    partial = partial_name(path)
    if not overwrite:
        check_name_free(path)
    elif is_being_written(partial):
        raise UsageError(being_written_message(partial))
    try:
        _check_not_folder(path)
        if not path.parent.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            for folder in path.absolute().parents:
                sync_folder(folder)
        if overwrite:
            partial.unlink(missing_ok=True)
        file = partial.open("x+b")  # which follows no link
    except FileExistsError:
        raise UsageError(being_written_message(partial)) from None
    except (OSError, ValueError) as error:
        raise _not_writable(path, error) from None
    if not _lock(file):
        file.close()
        raise UsageError(being_written_message(partial))
    return file


def _lock(file: IO[bytes], shared: bool = False) -> bool:
    """Lock a file, and return whether that worked; where the file system has no locks, nobody else can hold one."""
    for _ in range(LOCK_TRIES):
        try:
            lock(file, shared)
        except BlockingIOError:
            time.sleep(LOCK_PAUSE)
        except OSError:
            return True
        else:
            return True
    return False


def claim_first(names: Iterable[Path]) -> tuple[Path, IO[bytes]]:
    """Claim an output under the first of these names that is free; return that name and the unfinished file.

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


def take_name(partial: Path, path: Path, overwrite: bool) -> Path:
    """Give a complete file its final name, the first free one unless it may `overwrite`, and return it.

    Raises:
        OSError: the file cannot be renamed.
    """
    if overwrite:
        partial.replace(path)
        return path
    for name in itertools.chain([path], later_names(path)):
        with suppress(FileExistsError):
            rename_new(partial, name)
            return name
    raise AssertionError("names have no end")


def rename_new(partial: Path, name: Path) -> None:
    """Rename without overwriting.

    Raises:
        FileExistsError: the name is taken.
        OSError: it cannot be renamed.
    """
    if sys.platform == "win32":
        partial.rename(name)  # which overwrites on other systems
        return
    try:
        os.link(partial, name, follow_symlinks=False)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK):
            raise
        # A file system without links, as on memory cards: a check is all that can be done.
        if os.path.lexists(name):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(name)) from None
        partial.rename(name)
    else:
        partial.unlink()


def write_new(path: Path, data: bytes) -> None:
    """Write a file and sync it to the disk; an existing file of its name is replaced.

    Raises:
        OSError: it cannot be written; no file is left then.
    """
    path.unlink(missing_ok=True)
    file = path.open("xb")
    try:
        with file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        with suppress(OSError):
            path.unlink()
        raise


def write_complete(contents: Mapping[Path, bytes]) -> None:
    """Write files, which get their names when all of them are complete; existing files are replaced.

    Raises:
        UsageError: one cannot be written.
        IncompleteError: the disk is full.
    """
    try:
        for path, content in contents.items():
            write_new(partial_name(path), content)
        for path in contents:
            partial_name(path).replace(path)
    except OSError as error:
        raise _not_written(path, error) from None
    finally:
        for path in contents:
            with suppress(OSError):  # its folder may be what cannot be used
                partial_name(path).unlink()


def sync_folder(folder: Path) -> None:
    """Sync the entries of a folder to the disk, where the file system can."""
    with suppress(OSError):
        handle = os.open(folder, READ_FLAGS)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def is_being_written(partial: Path) -> bool:
    """Return whether a process holds the lock of an unfinished file."""
    try:
        with os.fdopen(os.open(partial, READ_FLAGS), "rb") as file:
            return not _lock(file, shared=True)
    except (OSError, ValueError):  # it cannot even be opened
        return False


def unfinished_files(folder: Path, suffix: str) -> list[Path]:
    """Find unfinished recordings in a folder, with the suffix `.mcap` or `.rrd`, that no process writes any more."""
    paths = sorted(folder.glob(f"*{suffix}{PARTIAL}"))
    return [
        path
        for path in paths
        if path.is_file() and not path.is_symlink() and not is_being_written(path)
    ]


@contextmanager
def work_folder(output: Path) -> Iterator[Path]:
    """Make a temporary folder inside `output`, which is removed at the end, also after SIGTERM.

    Raises:
        UsageError: it cannot be made.
        IncompleteError: the disk is full; also if it becomes full while the results are written.
    """
    # Imported here, as subprocess takes a third of the time of --help.
    from .processes import interrupted_by_sigterm

    work = output / f".incomplete-{os.getpid()}"
    made = not output.exists()
    try:
        work.mkdir(parents=True)
    except OSError as error:
        raise _not_written(output, error) from None
    try:
        with interrupted_by_sigterm():
            yield work.resolve()
    except OSError as error:
        if error.errno not in DISK_FULL_ERRORS:
            raise
        raise _not_written(output, error) from None
    finally:
        for _ in range(
            2
        ):  # an output that is just being ended may have renamed its file meanwhile
            shutil.rmtree(work, ignore_errors=True)
        if made and not any(output.iterdir()):
            output.rmdir()


def replace(source: Path, target: Path) -> None:
    """Move a result, if there is one, to its place; an earlier result there, or a link to one, is removed."""
    if target.is_dir() and not target.is_symlink():
        shutil.rmtree(target)
    else:
        target.unlink(missing_ok=True)
    if source.exists():
        source.rename(target)

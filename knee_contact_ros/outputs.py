"""Output files appear under their names when they are complete; until then they carry the suffix `.partial`.

Who writes a recording holds a lock (`flock`) on its unfinished file, which ends with the process, whatever it dies of.
So a file that is being written is told from one that was cut off.
"""

from __future__ import annotations

import fcntl
import shlex
import time
from contextlib import suppress
from pathlib import Path
from typing import IO

from knee_contact_ros.errors import UsageError

PARTIAL = ".partial"
LOCK_TRIES, LOCK_PAUSE = 5, 0.01
"""How often to try to lock a file, and how long [s] to wait in between: others may just be looking"""


def partial_name(path: Path) -> Path:
    """The name of an output until it is complete."""
    return path.with_name(path.name + PARTIAL)


def refuse_existing(path: Path) -> None:
    """Refuse an output whose name is taken.

    Raises:
        UsageError: the output or an unfinished one of its name exists.
    """
    if path.exists():
        raise UsageError(f"{path} exists already, and recordings are not overwritten")
    partial = partial_name(path)
    if not partial.exists():
        return
    if is_being_written(partial):
        raise UsageError(f"{partial} is being written by another process; choose another name")
    if path.suffix != ".mcap":
        raise UsageError(f"{partial} exists: it was cut off, or is being written; move it away first")
    raise UsageError(f"{cut_off(partial)}; then move it away, or choose another name")


def cut_off(partial: Path) -> str:
    """What there is to say of a recording that was cut off."""
    command = f"knee-contact recover {shlex.quote(str(partial))} OUT.mcap"
    return f"{partial} is a recording that was cut off: `{command}` makes it whole"


def claim(path: Path, overwrite: bool = False) -> Path:
    """Make the folder of an output and its unfinished file, and return the latter's name.

    With `overwrite`, what is there gives way.

    Raises:
        UsageError: the output or an unfinished one of its name exists, or the folder cannot be written.
    """
    partial = partial_name(path)
    if not overwrite:
        refuse_existing(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.touch()
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from None
    return partial


def open_claimed(partial: Path) -> IO[bytes]:
    """Open a claimed file for writing, empty and locked.

    Raises:
        UsageError: another process writes it.
    """
    file = partial.open("r+b")
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
        raise UsageError(f"{partial} is being written by another process; choose another name")
    file.truncate()
    return file


def is_being_written(partial: Path) -> bool:
    """Whether somebody holds the lock of an unfinished file."""
    with suppress(OSError), partial.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def leftovers(folder: Path) -> list[Path]:
    """Unfinished recordings in a folder that nobody writes any more."""
    return [partial for partial in sorted(folder.glob(f"*.mcap{PARTIAL}")) if not is_being_written(partial)]

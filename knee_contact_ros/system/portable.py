"""What Windows and macOS lack, or have under other names: locks of files, limits, processors, links.

Other modules that need no ROS name nothing that one of these systems lacks. `processes.py` has signals and sockets.
"""

import errno
import os
import shlex
import shutil
import sys
from contextlib import suppress
from pathlib import Path
from typing import IO

READ_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""Flags of `os.open` for reading bytes; a pipe does not block"""
sync_data = getattr(os, "fdatasync", os.fsync)
"""Sync the content of a file, given by its descriptor, to the disk"""


def data_from(file: IO[bytes], offset: int, end: int) -> int:
    """Offset [B] of the next data of an open file, from `offset` on; what a system has not stored is zeros.

    `end` if no data follow, and `offset` on a system that does not say.
    """
    descriptor = file.fileno()
    place = os.lseek(descriptor, 0, os.SEEK_CUR)
    try:
        return min(os.lseek(descriptor, offset, os.SEEK_DATA), end)
    except OSError as error:
        return end if error.errno == errno.ENXIO else offset
    except AttributeError:
        return offset
    finally:
        os.lseek(descriptor, place, os.SEEK_SET)


if sys.platform == "win32":
    import msvcrt

    CAN_RENAME_OPEN_FILES = False
    LOCKED_BYTE = 1 << 40
    """Offset of the byte that is locked: others cannot read it, so it lies beyond the end of a file"""

    def lock(file: IO[bytes], shared: bool = False) -> None:  # noqa: ARG001
        """Lock an open file until it is closed, or its process ends; on Windows no lock is shared.

        Raises:
            BlockingIOError: another one holds the lock.
            OSError: the file system has no locks.
        """
        descriptor = file.fileno()
        place = os.lseek(descriptor, 0, os.SEEK_CUR)
        os.lseek(descriptor, LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(*error.args) from None
        finally:
            os.lseek(descriptor, place, os.SEEK_SET)

    def allow_open_files(_number: int) -> None:
        """Let this process open so many files; Windows has no limit."""

else:
    import fcntl
    from resource import RLIMIT_NOFILE, getrlimit, setrlimit

    CAN_RENAME_OPEN_FILES = True

    def lock(file: IO[bytes], shared: bool = False) -> None:
        """Lock an open file until it is closed, or its process ends; others may share a `shared` lock.

        Raises:
            BlockingIOError: another one holds the lock.
            OSError: the file system has no locks.
        """
        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)

    def allow_open_files(number: int) -> None:
        """Let this process open so many more files, if it may: 1024 are usual on Linux, and 256 on macOS."""
        soft, hard = getrlimit(RLIMIT_NOFILE)
        if number > soft // 2:  # others are open already
            with suppress(ValueError, OSError):  # macOS has a lower limit beside its `hard`
                setrlimit(
                    RLIMIT_NOFILE, (min(soft + number, hard) if hard >= 0 else soft + number, hard)
                )


def usable_processors() -> int:
    """Return how many processors this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def link_or_copy(source: Path, target: Path) -> None:
    """Give a file another name: by a link, or by a copy where Windows allows no link.

    Raises:
        OSError: not even the copy can be made.
    """
    try:
        target.symlink_to(source.resolve())
    except OSError:
        shutil.copyfile(source, target)


def quoted(path: Path) -> str:
    """Return a path as it is typed in a shell."""
    return f'"{path}"' if sys.platform == "win32" else shlex.quote(str(path))

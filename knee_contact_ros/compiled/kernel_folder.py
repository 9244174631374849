"""A folder of files with machine code, which is read only if it is complete and no other user could have written it.

A file has a line, a digest of its name and content, and the content. It gets its name when it is complete, so that
processes that read and write at once never see half of one. Nothing here knows the compiler.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import secrets
import shutil
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

HEAD = b"knee_contact_ros kernel 1\n"
"""First line of a file, with the version of the format"""
DIGEST = hashlib.sha256().digest_size
LARGEST = 100_000_000
"""Largest size [B] of a file that is read; kernels have some 1e6"""
PREFIX = "kernel-"
"""Prefix of the names of folders with kernels"""
ROOT = 0
"""Number of the user who may do anything"""
KEPT = 8
"""Number of folders that are kept however old they are"""
UNUSED = 3 * 86400.0
"""Time [s] that any other folder is kept after its last use"""


class DoubtError(Exception):
    """A file is not used, or not written; `path` is that of the file, or of a folder that it would lie in."""

    def __init__(self, path: Path, words: str) -> None:
        super().__init__(f"{path} {words}")
        self.path = path


class KernelFolder:
    """Reads and writes files by name; the folder is made with the first file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self, name: str) -> bytes | None:
        """Read the content of a file; None if there is no such file.

        Raises:
            DoubtError: this class has not written it, other users can write it, or it cannot be read.
        """
        try:
            with self._opened() as folder:
                data = self._bytes(folder, name)
                with suppress(OSError):  # a folder that cannot be written may still be used
                    os.utime(folder)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise DoubtError(self.path / name, f"cannot be read: {error.strerror}") from None
        content = data[len(HEAD) + DIGEST :]
        if data != self._file(name, content):
            raise DoubtError(self.path / name, "is damaged")
        return content

    def write(self, name: str, content: bytes) -> None:
        """Write a file that also survives a loss of power; it replaces an earlier one of the same name.

        Raises:
            DoubtError: it cannot be written, or other users can write the folder.
        """
        try:
            self._make()
            with self._opened() as folder:
                self._put(folder, name, self._file(name, content))
        except OSError as error:
            raise DoubtError(self.path / name, f"cannot be written: {error.strerror}") from None

    def lock(self, name: str) -> Callable[[], None] | None:
        """Lock a name, which need not be that of a file; the lock ends with this process at the latest.

        Returns:
            A function that releases the lock; None if another process holds it.

        Raises:
            OSError, DoubtError: the name cannot be locked.
        """
        self._make()
        with self._opened() as folder:
            flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
            file = os.open(f".{name}.lock", flags, 0o600, dir_fd=folder)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            return None
        except OSError:
            os.close(file)
            raise

        def unlock() -> None:
            fcntl.flock(file, fcntl.LOCK_UN)  # a process that was forked meanwhile has the file, too
            os.close(file)

        return unlock

    def names(self) -> list[str]:
        """Names of all files in the folder, complete or not."""
        try:
            return [path.name for path in self.path.iterdir()]
        except OSError:
            return []

    def remove_unused(self) -> None:
        """Remove unfinished files here, and those folders beside this one that nobody uses any more.

        Folders that were used in the last days stay, and so do the newest. What is missed later is compiled again.
        """
        before = time.time() - UNUSED
        for part in self.path.glob(".*"):
            with suppress(OSError):
                if part.lstat().st_mtime < before:
                    part.unlink()
        others = [path for path in self.path.parent.glob(f"{PREFIX}*") if path != self.path and path.is_dir()]
        by_use = sorted(((_last_use(path), path) for path in others if not path.is_symlink()), reverse=True)
        for last_use, path in by_use[KEPT - 1 :]:
            if last_use < before:
                shutil.rmtree(path, ignore_errors=True)

    def _make(self) -> None:
        self.path.parent.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        for made in (self.path.parent, self.path):
            with suppress(FileExistsError):
                made.mkdir(mode=0o700)

    def _file(self, name: str, content: bytes) -> bytes:
        """Give all bytes of a file; its name is in the digest, since a kernel under another name is damage as well."""
        return HEAD + hashlib.sha256(f"{self.path.name}/{name}\n".encode() + content).digest() + content

    @contextmanager
    def _opened(self) -> Iterator[int]:
        """Open a descriptor of the folder, which stays ours if somebody changes the path to it meanwhile."""
        # Where all that a user makes can be written by his group, the folder above may be older than this class. Who
        # can write there can remove our folder, but cannot make one that is ours; so a group may write there.
        _refuse_others(self.path.parent, self.path.parent.stat(), stat.S_IWOTH)
        try:
            folder = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except NotADirectoryError:
            raise DoubtError(self.path, "is no folder") from None
        try:
            _refuse_others(self.path, os.fstat(folder))
            yield folder
        finally:
            os.close(folder)

    def _bytes(self, folder: int, name: str) -> bytes:
        """Read all bytes of a file, which must be ours."""
        path = self.path / name
        file = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder)  # a pipe would keep us waiting
        try:
            status = os.fstat(file)
            if not stat.S_ISREG(status.st_mode):
                raise DoubtError(path, "is no file")
            _refuse_others(path, status)
            if status.st_size > LARGEST:
                raise DoubtError(path, "is damaged")
            with os.fdopen(file, "rb", closefd=False) as opened:
                return opened.read()
        finally:
            os.close(file)

    @staticmethod
    def _put(folder: int, name: str, data: bytes) -> None:
        """Write a file, which gets its name when all of it is on the disk."""
        part = f".{name}.{secrets.token_hex(8)}"
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
        try:
            with os.fdopen(os.open(part, flags, 0o600, dir_fd=folder), "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            with suppress(OSError):  # only an empty folder in the file's place goes
                os.rmdir(name, dir_fd=folder)
            os.replace(part, name, src_dir_fd=folder, dst_dir_fd=folder)
        except BaseException:
            with suppress(OSError):
                os.unlink(part, dir_fd=folder)
            raise
        with suppress(OSError):  # some file systems do not take that for a folder
            os.fsync(folder)


def _refuse_others(path: Path, status: os.stat_result, bits: int = stat.S_IWGRP | stat.S_IWOTH) -> None:
    """Refuse a file or folder that another user can write, except for the system administrator."""
    if status.st_uid not in (os.geteuid(), ROOT):
        raise DoubtError(path, "belongs to another user")
    if status.st_mode & bits:
        raise DoubtError(path, "can be written by other users (chmod go-w makes it ours)")


def _last_use(folder: Path) -> float:
    """Give the time [s] of the system's clock at which a folder was last written or read."""
    times = [0.0]
    for path in (folder, *folder.rglob("*")):
        with suppress(OSError):
            times.append(path.lstat().st_mtime)
    return max(times)

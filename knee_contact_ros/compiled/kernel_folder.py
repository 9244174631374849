"""A folder of files that hold machine code: what is read from it is whole, and nobody else's.

A file is a line, a digest of its name and content, and the content. It appears under its name when it is complete, so
that processes that read and write at once never see half of one. Nothing here knows the compiler.
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
"""Another number for another way of keeping kernels"""
DIGEST = hashlib.sha256().digest_size
LARGEST = 100_000_000
"""[B] that are read of a file; kernels have some 1e6"""
PREFIX = "kernel-"
ROOT = 0
"""The user who may do anything"""
KEPT = 8
"""Folders that stay however old they are"""
UNUSED = 3 * 86400.0
"""How long [s] any other folder stays after its last use"""


class DoubtError(Exception):
    """Why a file is not used, or not kept; `path` is that of the file or folder where it lies."""

    def __init__(self, path: Path, words: str) -> None:
        super().__init__(f"{path} {words}")
        self.path = path


class KernelFolder:
    """Reads and writes files by name; the folder is made by the first that is written."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self, name: str) -> bytes | None:
        """The content of a file; None if there is none.

        Raises:
            DoubtError: it is not what this class has written, others can write it, or it cannot be read.
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
        """Keep a content under a name, also over a loss of power; an earlier one gives way.

        Raises:
            DoubtError: it cannot be written, or others can write the folder.
        """
        try:
            self._make()
            with self._opened() as folder:
                self._put(folder, name, self._file(name, content))
        except OSError as error:
            raise DoubtError(self.path / name, f"cannot be written: {error.strerror}") from None

    def lock(self, name: str) -> Callable[[], None] | None:
        """Lock a name, which has nothing to do with a file's; gives what unlocks it, or None if another one has it.

        It is unlocked when this process ends, too. The file that is locked stays.

        Raises:
            OSError, DoubtError: it cannot be locked.
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
        """What there is, whole or not."""
        try:
            return [path.name for path in self.path.iterdir()]
        except OSError:
            return []

    def remove_unused(self) -> None:
        """Remove what interrupted writing has left here, and the folders beside this one that nobody uses any more.

        What was used in the last days stays, and so do the newest. What is removed all the same is compiled again.
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
        """All bytes of a file. Its name is in the digest: one kernel under the name of another is damage as well."""
        return HEAD + hashlib.sha256(f"{self.path.name}/{name}\n".encode() + content).digest() + content

    @contextmanager
    def _opened(self) -> Iterator[int]:
        """A descriptor of the folder, which is ours: who changes the way to it meanwhile changes nothing."""
        # Where all that a user makes can be written by his group, the folder above may be older than this class. Who
        # can write there can take ours away, and not make one that is ours; so a group is not minded there.
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
        """All that stands in a file, which is ours."""
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
        """Write a file; it has its name when all of it is on the disk."""
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
    """Refuse what is not ours alone to write, or the system administrator's, who may do anything here anyway."""
    if status.st_uid not in (os.geteuid(), ROOT):
        raise DoubtError(path, "belongs to another user")
    if status.st_mode & bits:
        raise DoubtError(path, "can be written by other users (chmod go-w makes it ours)")


def _last_use(folder: Path) -> float:
    """When a folder was last written or read from, in the seconds of the system's clock."""
    times = [0.0]
    for path in (folder, *folder.rglob("*")):
        with suppress(OSError):
            times.append(path.lstat().st_mtime)
    return max(times)

"""Paths on this machine, and addresses that fsspec opens (`s3://...`, `zip://gait.mcap::https://...`)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

import fsspec

from knee_contact_ros.bags.provenance import bag_digest
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.resources import expanded


def is_elsewhere(name: str) -> bool:
    """Whether a name is an address for fsspec, and not a path on this machine."""
    return "://" in name or "::" in name


def absolute(name: str) -> str:
    """Make a path absolute, so that it means the same in every process; an address stays as it is.

    Raises:
        UsageError: the name is empty, or has a zero byte.
    """
    if not name or "\0" in name:
        raise UsageError(f"{name!r} is not allowed; a path, or an address as s3://bucket/folder")
    return name if is_elsewhere(name) else str(expanded(name).absolute())


@contextmanager
def here(bag: str) -> Iterator[Path]:
    """Give the path of a bag on this machine; a bag behind an address is copied for the time of the context.

    Raises:
        UsageError: the bag cannot be fetched.
    """
    if not is_elsewhere(bag):
        yield Path(bag)
        return
    with TemporaryDirectory(prefix="knee_contact_bag_") as folder:
        try:
            files, path = fsspec.core.url_to_fs(bag)
            copy = Path(folder) / (PurePosixPath(str(path)).name or "bag")
            files.get(path, str(copy), recursive=bool(files.isdir(path)))
        except Exception as error:  # a boundary: each kind of store has errors of its own
            raise UsageError(f"bag {bag}: cannot be fetched: {reason(error)}") from None
        yield copy


def digest_of(bag: str, path: Path) -> str:
    """Give the SHA-256 of the content of a bag.

    Args:
        bag: Name of the bag, for error messages.
        path: Where the bag, or a copy of it, lies on this machine.

    Raises:
        UsageError: the bag cannot be read.
    """
    try:
        return bag_digest(path)
    except OSError as error:
        raise UsageError(f"bag {bag}: {reason(error)}") from None


def reason(error: BaseException) -> str:
    """Describe an error in few words."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__

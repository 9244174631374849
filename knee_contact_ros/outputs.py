"""Output files appear under their names when they are complete; until then they carry the suffix `.partial`."""

from __future__ import annotations

from pathlib import Path

from knee_contact_ros.errors import UsageError

PARTIAL = ".partial"


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
    if partial.exists():
        raise UsageError(f"{partial} exists: a recording that was cut off, or is being written; move it away first")


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

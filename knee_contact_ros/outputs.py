"""Output files appear under their names when they are complete; until then they carry the suffix `.partial`."""

from __future__ import annotations

from pathlib import Path

from knee_contact_ros.errors import UsageError

PARTIAL = ".partial"


def claim(path: Path, overwrite: bool = False) -> Path:
    """Make the folder of an output and its unfinished file, and return the latter's name.

    With `overwrite`, what is there gives way.

    Raises:
        UsageError: the output or an unfinished one of its name exists, or the folder cannot be written.
    """
    if path.exists() and not overwrite:
        raise UsageError(f"{path} exists already, and recordings are not overwritten")
    partial = path.with_name(path.name + PARTIAL)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if partial.exists() and not overwrite:
            raise UsageError(f"{partial} exists: a recording that was cut off, or is being written; move it away first")
        partial.touch()
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from None
    return partial

"""Results of a command appear in its output folder when all are done; an interrupted command leaves nothing there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.processes import interrupted_by_sigterm


@contextmanager
def work_folder(output: Path) -> Iterator[Path]:
    """Make a temporary folder inside `output`, which is removed at the end, also after SIGTERM.

    Raises:
        UsageError: it cannot be made.
    """
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

"""Results of a command appear in its output folder when all are done; an interrupted one leaves nothing behind."""

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
    """A folder inside `output` that is gone afterwards, also after SIGTERM."""
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
    """Move a result, if there is one, to its place; an earlier one gives way."""
    if target.is_dir():
        shutil.rmtree(target)
    else:
        target.unlink(missing_ok=True)
    if source.exists():
        source.rename(target)

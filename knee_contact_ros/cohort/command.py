"""`knee-contact sweep`: a study computed, and what came of it in a few lines."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.extras import not_installed
from knee_contact_ros.system.terminal import progress, say, warn

NEEDED = ("pyarrow", "distributed", "fsspec")


def run_sweep(study: Path, output: str, workers: int, scheduler: str) -> None:
    """Compute what is missing of a study, and say how it went.

    Raises:
        UsageError: see `run_study`; or a library of the extra `sweep` is not there.
    """
    for library in NEEDED:
        if find_spec(library) is None:
            raise UsageError(not_installed(library, "sweep"))
    from knee_contact_ros.cohort.engine import run_study
    from knee_contact_ros.cohort.study import read_study

    asked = read_study(study)
    with progress("Computing") as advance:
        done = run_study(asked, output, workers=workers, scheduler=scheduler, advance=advance)
    warn(f"damaged, and computed as far as it can be read: {sentence}" for sentence in done.damage)
    say(f"{asked.number} cases: {done.computed} computed, {done.there} were there, {done.failed} failed")
    say(f"table: {output} (pandas.read_parquet)")

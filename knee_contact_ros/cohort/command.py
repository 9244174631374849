"""The work of `knee-contact sweep`: compute a study, and report in a few lines."""

from __future__ import annotations

from pathlib import Path

from knee_contact_ros.system.extras import require
from knee_contact_ros.system.terminal import progress, say, warn


def run_sweep(study: Path, output: str, workers: int, scheduler: str) -> None:
    """Compute the missing cases of a study file, and print how many were computed and failed.

    Args:
        study: Study file (YAML).
        output: Folder of the results, local or as fsspec spells it.
        workers: Processes on this machine; 0: one for each processor.
        scheduler: Address of a Dask scheduler whose workers compute instead; empty for this machine.

    Raises:
        UsageError: see `run_study`; or a library of the extra `sweep` is not installed.
        IncompleteError: see `run_study`.
    """
    require("sweep", "pyarrow", "distributed", "fsspec")
    from knee_contact_ros.cohort.engine import run_study
    from knee_contact_ros.cohort.study import read_study

    cases = read_study(study)
    with progress("Computing") as advance:
        done = run_study(cases, output, workers=workers, scheduler=scheduler, advance=advance)
    warn(f"damaged, and computed as far as it can be read: {sentence}" for sentence in done.damage)
    say(f"{cases.number} cases: {done.computed} computed, {done.there} were there, {done.failed} failed")
    say(f"table: {output} (pandas.read_parquet)")

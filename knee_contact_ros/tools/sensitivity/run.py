"""The work of `knee-contact sensitivity`: compute the missing cases, analyse, draw figures, and write the page."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from knee_contact_ros.system.errors import IncompleteError
from knee_contact_ros.system.extras import require
from knee_contact_ros.system.terminal import progress, say

if TYPE_CHECKING:
    from knee_contact_ros.tools.sensitivity.gather import Combination
    from knee_contact_ros.tools.sensitivity.study_file import SensitivityStudy

CASES = "cases"
"""Name of the folder with the results of all cases, inside the command's output folder"""
PAGE, TABLE = "sensitivity.html", "indices.csv"
UNFINISHED = "_unfinished-"
FIGURES = ("bars_", "convergence_", "plane_")
"""Prefixes of the names of figures, of which those of an earlier run are removed"""


def run_sensitivity(study_file: Path, output: str, workers: int, scheduler: str) -> None:
    """Compute the missing cases of a study's design, and write its indices, figures and page.

    Args:
        study_file: Study file (YAML).
        output: Folder of the results, local or as fsspec spells it.
        workers: Processes on this machine; 0: one for each processor.
        scheduler: Address of a Dask scheduler whose workers compute instead; empty for this machine.

    Raises:
        UsageError: study, bags, parameters, folder or scheduler cannot be used, or a library is not installed.
        IncompleteError: a disk is full, or workers died again and again.
    """
    require("sweep", "pyarrow", "distributed", "fsspec", "SALib", "matplotlib")
    require("report", "jinja2")
    from knee_contact_ros.cohort.engine import run_study
    from knee_contact_ros.cohort.shards import Shards
    from knee_contact_ros.tools.sensitivity.gather import gather
    from knee_contact_ros.tools.sensitivity.study_file import read_sensitivity_study
    from knee_contact_ros.tools.sensitivity.words import remarks, what_matters

    study = read_sensitivity_study(study_file)
    folder = f"{output.rstrip('/') or output}/{CASES}"
    with progress("Computing") as advance:
        done = run_study(study.cases, folder, workers=workers, scheduler=scheduler, advance=advance)
    say(f"{study.cases.number} cases: {done.computed} computed, {done.there} were there, {done.failed} failed")
    with progress("Analysing") as advance:
        combinations = gather(study, Shards(folder), advance)
        advance.describe("Drawing")
        write_files(output, make_files(study, combinations))
    for outcome, where, leading, _ in what_matters(study.design, combinations).rows:
        say(f"{outcome}, {where}: {leading}", hang=2)
    for sentence in remarks(study.design, combinations):
        if ": no index: " not in sentence:  # printed above
            say(f"knee-contact: warning: {sentence}", err=True, hang=2)
    say(f"page: {output.rstrip('/')}/{PAGE}")


def make_files(study: SensitivityStudy, combinations: list[Combination]) -> dict[str, bytes]:
    """Make figures, table and page: contents of files by name, the page last."""
    from knee_contact_ros.tools.sensitivity.figures import figures
    from knee_contact_ros.tools.sensitivity.gather import as_csv
    from knee_contact_ros.tools.sensitivity.page import page

    drawn = [figures(study.design, combinations, place) for place in range(len(study.outcomes))]
    files = {f"{figure.name}.png": figure.png for of_outcome in drawn for figure in of_outcome}
    files[TABLE] = as_csv(combinations).encode()
    return files | {PAGE: page(study, combinations, drawn).encode()}


def write_files(output: str, files: Mapping[str, bytes]) -> None:
    """Write files into a folder, each whole or not at all, and remove other figures that an earlier run has written.

    Raises:
        UsageError: the folder cannot be written.
        IncompleteError: the disk is full.
    """
    import fsspec

    system, folder = fsspec.core.url_to_fs(output)
    unfinished = f"{folder}/{UNFINISHED}{uuid.uuid4().hex}"
    try:
        for name, content in files.items():
            system.pipe_file(unfinished, content)
            system.mv(unfinished, f"{folder}/{name}")
        for path in system.ls(folder, detail=False):
            name = Path(path).name
            if name.startswith(FIGURES) and name.endswith(".png") and name not in files:
                system.rm_file(path)
    except BaseException as error:
        with suppress(OSError):
            system.rm_file(unfinished)
        if isinstance(error, OSError):
            raise IncompleteError(f"{error.filename or output}: {error.strerror or error}") from None
        raise

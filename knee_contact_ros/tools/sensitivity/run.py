"""The work of `knee-contact sensitivity`: compute what is missing, analyse, draw, write."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from knee_contact_ros.system.errors import IncompleteError, UsageError
from knee_contact_ros.system.extras import not_installed
from knee_contact_ros.system.terminal import progress, say

if TYPE_CHECKING:
    from knee_contact_ros.tools.sensitivity.asked import Asked
    from knee_contact_ros.tools.sensitivity.gather import Combination

NEEDED = {"pyarrow": "sweep", "distributed": "sweep", "fsspec": "sweep", "SALib": "sweep", "matplotlib": "sweep",
          "jinja2": "report"}  # fmt: skip
"""Libraries, and the extra that brings each"""
CASES = "cases"
"""Folder of the study's results, in that of the command"""
PAGE, TABLE = "sensitivity.html", "indices.csv"
UNFINISHED = "_unfinished-"
EARLIER = ("bars_", "convergence_", "plane_")
"""What the names of an earlier run's pictures begin with"""


def run_sensitivity(study: Path, output: str, workers: int, scheduler: str) -> None:
    """Compute what is missing of a study's design, and write its indices into a folder, local or as fsspec spells it.

    Raises:
        UsageError: study, bags, parameters, folder or scheduler cannot be used, or a library is not there.
        IncompleteError: a disk is full, or workers died again and again.
    """
    for library, extra in NEEDED.items():
        if find_spec(library) is None:
            raise UsageError(not_installed(library, extra))
    from knee_contact_ros.cohort.engine import run_study
    from knee_contact_ros.cohort.shards import Shards
    from knee_contact_ros.tools.sensitivity.asked import read_asked
    from knee_contact_ros.tools.sensitivity.gather import gather
    from knee_contact_ros.tools.sensitivity.words import remarks, what_matters

    asked = read_asked(study)
    cases = f"{output.rstrip('/') or output}/{CASES}"
    with progress("Computing") as advance:
        done = run_study(asked.study, cases, workers=workers, scheduler=scheduler, advance=advance)
    say(f"{asked.study.number} cases: {done.computed} computed, {done.there} were there, {done.failed} failed")
    with progress("Analysing") as advance:
        combinations = gather(asked, Shards(cases), advance)
        advance.describe("Drawing")
        put(output, written(asked, combinations))
    for outcome, where, who, _ in what_matters(asked.design, combinations).rows:
        say(f"{outcome}, {where}: {who}", hang=2)
    for sentence in remarks(asked.design, combinations):
        if ": no index: " not in sentence:  # said already
            say(f"knee-contact: warning: {sentence}", err=True, hang=2)
    say(f"page: {output.rstrip('/')}/{PAGE}")


def written(asked: Asked, combinations: list[Combination]) -> dict[str, bytes]:
    """The files by name; the page comes last."""
    from knee_contact_ros.tools.sensitivity.data import as_csv
    from knee_contact_ros.tools.sensitivity.figures import figures
    from knee_contact_ros.tools.sensitivity.page import page

    drawn = [figures(asked.design, combinations, place) for place in range(len(asked.outcomes))]
    files = {f"{each.name}.png": each.png for own in drawn for each in own}
    files[TABLE] = as_csv(combinations).encode()
    return files | {PAGE: page(asked, combinations, drawn).encode()}


def put(output: str, files: Mapping[str, bytes]) -> None:
    """Put files into a folder, each whole or not at all; pictures of an earlier run that are none of these go.

    Raises:
        UsageError: the folder cannot be written.
        IncompleteError: the disk is full.
    """
    import fsspec

    there, folder = fsspec.core.url_to_fs(output)
    unfinished = f"{folder}/{UNFINISHED}{uuid.uuid4().hex}"
    try:
        for name, content in files.items():
            there.pipe_file(unfinished, content)
            there.mv(unfinished, f"{folder}/{name}")
        for path in there.ls(folder, detail=False):
            name = Path(path).name
            if name.startswith(EARLIER) and name.endswith(".png") and name not in files:
                there.rm_file(path)
    except OSError as error:
        with suppress(OSError):
            there.rm_file(unfinished)
        raise IncompleteError(f"{error.filename or output}: {error.strerror or error}") from None
    except BaseException:
        with suppress(OSError):
            there.rm_file(unfinished)
        raise

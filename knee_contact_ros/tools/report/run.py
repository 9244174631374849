"""The work of `knee-contact report`: gather the runs, draw the figures, write all files and move them into place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from knee_contact_ros.bags.bag_files import in_a_line
from knee_contact_ros.system.errors import IncompleteError, UsageError
from knee_contact_ros.system.files import how_to_get, require
from knee_contact_ros.system.output_files import replace, work_folder
from knee_contact_ros.system.terminal import progress, warn
from knee_contact_ros.tools.report.runs import ReportOptions, Run, collect
from knee_contact_ros.tools.report.uncertain import (
    COLUMNS,
    uncertainty_figures,
    uncertainty_rows,
    with_uncertainty,
)

OLDEST = (3, 7)
"""Oldest version of matplotlib that places legends outside of axes; Ubuntu 24.04 has 3.6"""
EXTRA = "report"
PAGE = "report.html"
TABLES = ("cycles.csv", "events.csv", "peaks.csv", "strides.csv")
FIGURES = (
    "knee_[0-9]*",
    "flexion",
    "contact_force",
    "depth",
    "peak_pressure",
    "patch_half_width",
    "contact_point",
    "contact_point_flexion",
    "over_time_[0-9]*",
    "uncertainty_[0-9]*",
)
"""Patterns of the names of the pictures, without their suffix"""
UNCERTAINTY = "uncertainty.csv"
EARLIER = (*(f"{name}.png" for name in FIGURES), UNCERTAINTY)
"""Patterns of the files of an earlier report that are removed"""


def run_report(options: ReportOptions, output: Path) -> list[Path]:
    """Write the report into the folder `output`; return the paths of its files, the page first.

    Raises:
        UsageError: a file, parameter or the folder cannot be used, or a library is missing.
        IncompleteError: the report is there, but a bag was damaged and could be taken in part only.
    """
    require(EXTRA, "matplotlib", "jinja2")
    import matplotlib as mpl

    if mpl.__version_info__[:2] < OLDEST:
        raise UsageError(f"matplotlib {mpl.__version__} is too old; {how_to_get(EXTRA)}")
    if options.labels and len(options.labels) != len(options.files):
        raise UsageError(f"--label: {len(options.labels)} given for {len(options.files)} FILEs; give one each, or none")
    with work_folder(output) as work:
        with progress("Reading") as bar:

            def say(what: str) -> Callable[[int, int], None]:
                bar.describe(what)
                return bar

            runs = with_uncertainty(collect(options, work, say), options, say)
            bar.describe("Drawing")
            names = write(runs, work)
        for pattern in EARLIER:
            for earlier in output.glob(pattern):
                earlier.unlink()
        for name in names:
            replace(work / name, output / name)
    damage = [sentence for run in runs if run.beside is None for sentence in run.damage]
    if damage:
        raise IncompleteError(f"{output / PAGE} tells what can be read of a damaged bag: {in_a_line(damage)}")
    warn(
        f"--compare: {line}" for line in sorted({f"{run.name} keeps {', '.join(run.kept)}" for run in runs if run.kept})
    )
    return [output / name for name in names]


def write(runs: Sequence[Run], folder: Path) -> list[str]:
    """Write all files of the report into a folder; return their names, the page first."""
    from knee_contact_ros.tools.report.data import as_csv, tables
    from knee_contact_ros.tools.report.knees import knees
    from knee_contact_ros.tools.report.over_cycle import over_cycle
    from knee_contact_ros.tools.report.over_time import over_time
    from knee_contact_ros.tools.report.page import page

    cyclic = [run for run in runs if run.gathered.cycles]
    cycle_figures, time_figures = over_cycle(runs, cyclic) if cyclic else [], over_time(runs)
    knee_figures, uncertain = knees(runs), uncertainty_figures(runs)
    (folder / PAGE).write_text(page(runs, knee_figures, cycle_figures, time_figures, uncertain), encoding="utf-8")
    files = tables(runs)
    if uncertain:
        files[UNCERTAINTY] = as_csv(COLUMNS, uncertainty_rows(runs))
    for name, content in files.items():
        (folder / name).write_text(content, encoding="utf-8")
    pictures = {
        f"{figure.name}.png": figure.png for figure in (*knee_figures, *cycle_figures, *time_figures, *uncertain)
    }
    for name, png in pictures.items():
        (folder / name).write_bytes(png)
    return [PAGE, *files, *pictures]

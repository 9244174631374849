"""Count what many runs are worth, group by group, and keep the counts in a table."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from studies.honesty.judging import Judged

COLUMNS = (
    "study",
    "group",
    "runs",
    "ticks",
    "flagged",
    "known",
    "covered",
    "wrong without a flag",
    "in runs",
    "not finite",
    "forces known",
    "forces covered",
    "forces wrong without a flag",
    "estimate over error",
    "evaluations per tick",
    "falsely flagged",
)
"""Columns of the table. Shares are of the ticks (flagged, known) and of the known ones (covered); the estimate over the
error is the median over runs of their medians, in contact and apart. Falsely flagged is what is known to be right."""
FIELDS = (
    "penetration_depth",
    "gap",
    "contact_force",
    "femoral_height",
    "error_estimate",
    "force_error_estimate",
)


class Row(NamedTuple):
    """What a run is worth."""

    groups: tuple[str, ...]
    """Groups that it counts in"""
    name: str
    """Names the run, so that it can be done again"""
    ticks: int
    flagged: int
    known: int
    covered: int
    wrong: int
    """Ticks with status OK that are known to be beyond the tolerance, or whose estimate is not finite"""
    not_finite: int
    forces: tuple[int, int, int]
    """Known, covered and wrong ones"""
    ratio: float
    """Median of the estimate over the error, where that is above rounding; NaN if there is no such tick"""
    evaluations: int
    off: float
    """Largest error [m] that is wrong without a flag"""
    falsely: int
    """Flagged ticks that are known to be right"""


def not_finite(series: np.recarray[Any, Any]) -> int:
    """Count the ticks with a number that is not finite."""
    return int(np.sum(~np.all([np.isfinite(series[field]) for field in FIELDS], axis=0)))


def row(groups: Sequence[str], name: str, series: np.recarray[Any, Any], judged: Judged) -> Row:
    """Count a run."""
    depth, force = judged.depth, judged.force
    forces = (0, 0, 0)
    if force is not None:
        forces = int(force.known.sum()), int(force.covered.sum()), int(force.wrong.sum())
    ratio = float(np.median(depth.ratio[depth.large])) if depth.large.any() else np.nan
    return Row(
        tuple(groups),
        name,
        len(series),
        int((~judged.said_right).sum()),
        int(depth.known.sum()),
        int(depth.covered.sum()),
        int(depth.wrong.sum()),
        not_finite(series),
        forces,
        ratio,
        int(judged.evaluations.sum()),
        float(depth.error[depth.wrong].max(initial=0.0)),
        int(judged.falsely.sum()),
    )


def table(study: str, rows: Iterable[Row]) -> list[tuple[str, ...]]:
    """Add rows up by their groups, and write the counts as `COLUMNS`."""
    groups: dict[str, list[Row]] = {}
    for one in rows:
        for group in ("all", *one.groups):
            groups.setdefault(group, []).append(one)

    def share(part: int, whole: int) -> str:
        return f"{100.0 * part / whole:.3f} %" if whole else ""

    lines: list[tuple[str, ...]] = []
    for group, found in groups.items():
        ticks, known = sum(one.ticks for one in found), sum(one.known for one in found)
        forces = [sum(one.forces[i] for one in found) for i in range(3)]
        ratios = [one.ratio for one in found if np.isfinite(one.ratio)]
        lines.append(
            (
                study,
                group,
                str(len(found)),
                str(ticks),
                share(sum(one.flagged for one in found), ticks),
                share(known, ticks),
                share(sum(one.covered for one in found), known),
                str(sum(one.wrong for one in found)),
                str(sum(one.wrong > 0 for one in found)),
                str(sum(one.not_finite for one in found)),
                share(forces[0], ticks),
                share(forces[1], forces[0]),
                str(forces[2]),
                f"{np.median(ratios):.3g}" if ratios else "",
                f"{sum(one.evaluations for one in found) / ticks:.1f}",
                share(sum(one.falsely for one in found), ticks),
            )
        )
    return lines


def save(path: Path, lines: Sequence[tuple[str, ...]]) -> None:
    """Put the lines of a study into a table, in the place of those that it had there."""
    old = []
    if path.exists():
        with path.open(encoding="utf-8", newline="") as file:
            old = [tuple(one) for one in csv.reader(file)][1:]
    with path.open("w", encoding="utf-8", newline="") as file:
        kept = [one for one in old if one[0] != lines[0][0]]
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *kept, *lines])

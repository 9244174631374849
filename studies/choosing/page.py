"""The part of docs/choosing-fidelity.md that is measured: tables in Markdown, and the CSV behind them."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tabulate import tabulate

from studies.choosing import words
from studies.choosing.geometries import CIRCLE, MRI_KNEE
from studies.choosing.inputs import Effect
from studies.choosing.study import Left, Row, Study

BEGIN, END = "<!-- made by python -m studies.choosing: begin -->", "<!-- made by python -m studies.choosing: end -->"
"""Lines around the measured part of the page"""
DEFAULT_LEVEL, DEFAULT_TOLERANCE = "dynamic", 1e-6
NODE, ALL_ROUNDS = "this node", "all"
"""Rows of `latency.csv` that are shown: of the node, over all rounds"""


class Latency(NamedTuple):
    """Latency from a published force to its answer, as `benchmarks.latency` measured it."""

    rate: float
    """Rate of the samples [Hz]"""
    median: float
    """Median latency [µs]"""
    p99: float
    """99th percentile of the latency [µs]"""


def read_latency(path: Path) -> Latency:
    """Read the node's latency from `latency.csv`."""
    with path.open(encoding="utf-8", newline="") as file:
        row = next(row for row in csv.DictReader(file) if (row["candidate"], row["round"]) == (NODE, ALL_ROUNDS))
    return Latency(float(row["rate"]), 1e3 * float(row["median_ms"]), 1e3 * float(row["p99_ms"]))


def with_block(page: str, block: str) -> str:
    """Replace the measured part of a page.

    Raises:
        ValueError: the page has no such part.
    """
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"the page lacks the lines {BEGIN} and {END}")
    return f"{before}{BEGIN}\n\n{block.strip()}\n\n{END}{after}"


def block(study: Study, latency: Latency, picture: str, command: str, machine: str) -> str:
    """Text of the measured part: picture, tables and scenes."""
    parts = [
        f"Made by `{command}` on {machine}.",
        f"![Error of depth, force and contact point over the cost of a tick, beside geometry and inputs]({picture})",
        "### Level and tolerance", level_words(study, latency), level_table(study, latency),
        "### Geometry", geometry_words(study), geometry_table(study.left),
        "### Inputs", INPUT_WORDS, input_table([each for each in study.effects if each.scene == study.scenes[0].name]),
        "### Scenes", SCENE_WORDS, table(("scene", ""), [(scene.name, scene.about) for scene in study.scenes]),
    ]  # fmt: skip
    return "\n\n".join(parts)


def level_words(study: Study, latency: Latency) -> str:
    """Conclusions from the table of levels."""
    wrong, ticks = sum(row.wrong for row in study.rows), sum(row.ticks for row in study.rows)
    spread = np.percentile([row.spread_percent for row in study.rows], 50)
    return (
        "Against the same geometry solved exactly by other code (SciPy's DOP853, event by event). Every cell: the "
        "largest error of depth, of contact force and of the contact point's x on the plateau at any tick; time per "
        f"tick, compiled: the median of {study.turns} turns of all combinations in one run on one processor (from the "
        f"fastest to the slowest turn: {spread:.0f} % in the median); behind that the ticks that say `NOT_CONVERGED`, "
        f"if any do. {wrong} of all {ticks} ticks say that they are within the tolerance and are not. Tolerances that "
        "give the same to two digits share a line. End to end: from a published force to its answer on gait at "
        f"{latency.rate:g} Hz: the node's median of {latency.median:.0f} µs with the circle at the default "
        f"([99th percentile {latency.p99:.0f} µs](studies/latency.md), another run), plus what this line costs more."
    )


INPUT_WORDS = (
    "On the recorded gait with the MRI knee, one input changed at a time: change of the largest depth and force, and "
    "the largest move of the contact point at any tick."
)
SCENE_WORDS = (
    "All with the constants of [healthy.yaml](../config/healthy.yaml) (Kelvin-Voigt, 9.3 kg); defined in "
    "[scenes.py](../studies/choosing/scenes.py)."
)


def level_table(study: Study, latency: Latency) -> str:
    """Table of levels: a row per geometry, level and tolerance."""
    gait = study.scenes[0].name
    base = next(row.microseconds for row in study.rows
                if row[:4] == (CIRCLE, DEFAULT_LEVEL, DEFAULT_TOLERANCE, gait))  # fmt: skip
    lines: list[list[str]] = []
    for (geometry, level), rows in groupby(study.rows, key=lambda row: row[:2]):
        by_tolerance = [list(group) for _, group in groupby(rows, key=lambda row: row.tolerance)]
        for same in merged(by_tolerance):
            tolerances = [words.power(each[0].tolerance) for each in same]
            costs = np.median([[row.microseconds for row in each] for each in same], axis=0)
            said = tolerances[0] if len(same) == 1 else f"{tolerances[0]} to {tolerances[-1]}"
            cells = [cell(row, cost) for row, cost in zip(same[0], costs, strict=True)]
            end_to_end = latency.median + costs[0] - base
            lines.append([geometry, level, said, *cells, f"{end_to_end:.0f} µs"])
    header = ("geometry", "level", "tolerance [m]", *(scene.name for scene in study.scenes), "end to end")
    return table(header, lines)


def merged(by_tolerance: Sequence[Sequence[Row]]) -> list[list[Sequence[Row]]]:
    """Merge neighbouring tolerances whose rows would be printed with the same digits."""
    groups: list[list[Sequence[Row]]] = []
    for rows in by_tolerance:
        if groups and all(printed(a) == printed(b) for a, b in zip(groups[-1][-1], rows, strict=True)):
            groups[-1].append(rows)
        else:
            groups.append([rows])
    return groups


def printed(row: Row) -> tuple[str, str]:
    """Cells of a row that the tolerance may change."""
    return words.differences(row.error), said_missed(row)


def cell(row: Row, cost: float) -> str:
    """Cell with errors, cost [µs], and the share of ticks that are flagged."""
    return ", ".join(filter(None, (words.differences(row.error), words.microseconds(cost), said_missed(row))))


def said_missed(row: Row) -> str:
    """Share of the ticks that are flagged, in words; empty if none is."""
    if row.flagged == 0.0:
        return ""
    return f"{100.0 * row.flagged:.0f} % flagged" if row.flagged >= 0.01 else "< 1 % flagged"


def geometry_words(study: Study) -> str:
    """Conclusions from the table of geometries."""
    own = max(each.own.depth for each in study.left)
    return (
        f"Each solved exactly, against the {MRI_KNEE}: what a simpler surface leaves out, whatever the level. Largest "
        "differences of depth, force and contact point at any tick. The exact solutions are good to "
        f"{words.length(own)} (the largest difference from a second solution with 100 times the tolerance)."
    )


def geometry_table(left: Sequence[Left]) -> str:
    """Table of geometries: a row per geometry, a column per scene."""
    scenes = list(dict.fromkeys(each.scene for each in left))
    lines = [[geometry, *(words.differences(each.error) for each in group)]
             for geometry, group in groupby(left, key=lambda each: each.geometry) if geometry != MRI_KNEE]  # fmt: skip
    return table(("geometry", *scenes), lines)


def input_table(effects: Sequence[Effect]) -> str:
    """Table of inputs: a row per change."""
    lines = [
        [each.change.name, each.change.why, f"{signed(each.peak_depth, 1e-6)} µm ({each.peak_depth_percent:+.0f} %)",
         f"{signed(each.peak_force, 1.0)} N ({each.peak_force_percent:+.0f} %)", words.length(each.worst.x)]
        for each in effects
    ]  # fmt: skip
    return table(("input", "", "peak depth", "peak force", "contact point"), lines)


def signed(value: float, unit: float) -> str:
    """Format a value with its sign and two digits."""
    return ("+" if value >= 0.0 else "−") + words.two_digits(abs(value) / unit)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a table in Markdown."""
    return tabulate(rows, header, tablefmt="pipe", disable_numparse=True)


def write_csv(study: Study, path: Path) -> None:
    """Write all numbers behind the page to a CSV file."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("what", "geometry", "level", "tolerance_m", "scene", "depth_m", "force_n", "contact_x_m",
                         "flagged", "ok_and_wrong", "ticks", "microseconds_per_tick", "spread_percent"))  # fmt: skip
        for row in study.rows:
            writer.writerow(["level", row.geometry, row.level, words.power(row.tolerance), row.scene, *plain(row.error),
                             f"{row.flagged:.6g}", row.wrong, row.ticks, *plain(row[-2:])])  # fmt: skip
        for left in study.left:
            writer.writerow(["geometry", left.geometry, "", "", left.scene, *plain(left.error)])
            writer.writerow(["reference", left.geometry, "", "", left.scene, *plain(left.own)])
        for effect in study.effects:
            writer.writerow([f"input: {effect.change.name}", MRI_KNEE, "", "", effect.scene, *plain(effect.worst)])


def plain(values: Sequence[float]) -> list[str]:
    """Format numbers with six digits."""
    return [f"{value:.6g}" for value in values]

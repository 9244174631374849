"""All knees of the study, computed under the load and led along the healthy knee's path."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

import knee_contact_ros
from knee_contact_ros.lab.sweep import Cohort
from studies.osteoarthritis.grid import ARTHRITIC, BAG, HEALTHY, LAYER, SECOND, SHARE, Floats, Grid

Table = np.recarray[Any, Any]
TOLERANCE = {"fidelity.tolerance": 1e-9}
"""Tolerance [m] of single runs, as in the study file"""
LED: list[str | dict[str, Any]] = [ARTHRITIC, {"drive": "displacement", **TOLERANCE}]
NANOSECOND = 1e-9


class Knees(NamedTuple):
    """Outcomes: of the healthy knee for each share, of the others in tables of the grid's shape."""

    grid: Grid
    paths: Table
    """The healthy knee's answers under the load, shape (shares, n)"""
    healthy: Table
    """Outcomes of the healthy knee, shape (shares,)"""
    forced: Table
    """Outcomes with the load prescribed"""
    led: Table
    """Outcomes with the height of the healthy knee of the same share prescribed"""
    processor: float
    """Processor time [s] of all computations"""
    elapsed: float
    """Clock time [s] of all computations"""


def compute(grid: Grid) -> Knees:
    """Compute every knee of a grid under both drives."""
    begun = os.times()
    paths, healthy = healthy_knees(grid.shares)
    forced = under_load(grid.values())
    led = [along(paths[i], grid.values(i)) for i in range(len(grid.shares))]
    ended = os.times()
    return Knees(
        grid, paths, healthy, forced.reshape(grid.shape).view(np.recarray),
        np.stack(led).reshape(grid.shape).view(np.recarray),
        ended.user + ended.system - begun.user - begun.system, ended.elapsed - begun.elapsed,
    )  # fmt: skip


def healthy_knees(shares: Floats) -> tuple[Table, Table]:
    """Answers and outcomes of the healthy knee under its shares of the load."""
    found = done(knee_contact_ros.sweep(BAG, {SHARE: shares, **TOLERANCE}, HEALTHY, series=True))
    assert found.series is not None  # noqa: S101  # asked for
    return found.series.view(np.recarray), found.outcomes


def under_load(values: Mapping[str, ArrayLike], **others: Any) -> Table:
    """Outcomes of arthritic knees with the load prescribed; others: of `contact`."""
    return done(knee_contact_ros.sweep(BAG, {**values, **TOLERANCE, **_contact(others)}, ARTHRITIC)).outcomes


def along(path: Table, values: Mapping[str, ArrayLike], raised: float = 0.0, **others: Any) -> Table:
    """Outcomes of arthritic knees whose height is that of a healthy run, `raised` [m]; others: of `contact`."""
    gait = {
        "time": path.stamp * NANOSECOND,
        "flexion_angle": path.flexion_angle,
        "femoral_height": path.femoral_height + raised,
    }
    own = {name: values[name] for name in (LAYER, SECOND)}
    return done(knee_contact_ros.sweep(gait, {**own, **_contact(others)}, LED)).outcomes


def done(cohort: Cohort) -> Cohort:
    """Return the outcomes of a cohort whose cases have all succeeded.

    Raises:
        ValueError: one has failed.
    """
    for reason in cohort.failed[cohort.failed != ""]:
        raise ValueError(str(reason))
    return cohort


def _contact(others: dict[str, Any]) -> dict[str, Any]:
    return {f"contact.{name}": value for name, value in others.items()}

"""The grid of knees, their answers, and what theory says of them."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import knee_contact_ros
from knee_contact_ros.lab.study import read_study
from knee_contact_ros.lab.sweep import Cohort
from knee_contact_ros.parameters.files import load_parameters

MM = 1e3
Floats = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
STUDY = Path(__file__).with_name("study.yaml")
BAG = ROOT / "bags" / "gait2354_right"
HEALTHY, ARTHRITIC = "healthy", "osteoarthritis"
SHARE, LAYER, SECOND = "load.share", "contact.layer_depth", "contact.stiffness_2"
SHIPPED = load_parameters(ARTHRITIC).contact
"""The arthritic knee's contact as it is shipped: 0.5 mm on bone"""
FIRST = SHIPPED.stiffness
"""K₁ [N/m^1.5], the healthy knee's stiffness too"""


class Grid(NamedTuple):
    """Values that are all combined; tables of outcomes have their shape."""

    shares: Floats
    layers: Floats
    """Thicknesses of the first layer [m]"""
    seconds: Floats
    """Stiffnesses of the second layer, K₂ [N/m^1.5]"""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of shares, layers and second stiffnesses."""
        return len(self.shares), len(self.layers), len(self.seconds)

    def values(self, share: int | None = None) -> dict[str, Floats]:
        """Parameters of all cases, or of one share, in the order of a table's cells."""
        shares = self.shares if share is None else self.shares[[share]]
        columns = np.meshgrid(shares, self.layers, self.seconds, indexing="ij")
        return {name: column.ravel() for name, column in zip((SHARE, LAYER, SECOND), columns, strict=True)}


def whole() -> Grid:
    """The grid of the study file."""
    grid = read_study(STUDY).grid
    return Grid(*(np.array(grid[name]) for name in (SHARE, LAYER, SECOND)))


RAISED = np.linspace(0.0, 0.8e-3, 81)
"""Rises of the path [m]"""
CHOSEN = ((0.5e-3, SHIPPED.stiffness_2), (0.3e-3, SHIPPED.stiffness_2), (0.5e-3, 5.0 * FIRST), (0.5e-3, FIRST))
"""Layer [m] and K₂ of the curves; the first is the shipped knee"""


class Curve(NamedTuple):
    """Peak force of a knee over the rise of its path."""

    layer: float
    second: float
    ratio: Floats
    """Ratio to the healthy knee's peak force, shape of `RAISED`"""


def curves(knees: Knees, share: int = 0) -> list[Curve]:
    """Curves of the chosen knees, at one share of the load."""
    layers, seconds = (np.array(column) for column in zip(*CHOSEN, strict=True))
    peaks = [along(knees.paths[share], {LAYER: layers, SECOND: seconds}, raised).peak_force for raised in RAISED]
    table = np.array(peaks) / knees.healthy.peak_force[share]
    return [Curve(layer, second, table[:, i]) for i, (layer, second) in enumerate(CHOSEN)]


def equal_second(layers: Floats, depth: float) -> Floats:
    """K₂ [N/m^1.5] with which a layer h at a depth gives the healthy knee's force; infinite if h is not passed.

    K₁ hⁿ + K₂ (δ - h)ⁿ = K₁ δⁿ.
    """
    n = SHIPPED.exponent
    over = np.maximum(depth - layers, 0.0) ** n
    missing = FIRST * (depth**n - layers**n)
    return np.asarray(np.divide(missing, over, out=np.full_like(layers, np.inf), where=over > 0.0))


def rest_force(layers: Floats, seconds: Floats, depth: Floats | float) -> Floats:
    """Force at rest [N] of the two-layer law."""
    n = SHIPPED.exponent
    first, over = np.minimum(depth, layers), np.maximum(depth - layers, 0.0)
    return np.asarray(FIRST * first**n + seconds * over**n)


def ratio(knees: Knees, table: Table) -> Floats:
    """Peak force over the healthy knee's of the same share, in the grid's shape."""
    return np.asarray(table.peak_force / knees.healthy.peak_force[:, None, None])


def needed_depth(layers: Floats, seconds: Floats, force: Floats) -> Floats:
    """Depth [m] at which the two-layer law carries a force [N] at rest."""
    n = SHIPPED.exponent
    over = np.maximum(force - FIRST * layers**n, 0.0)
    return np.asarray(np.where(over > 0.0, layers + (over / seconds) ** (1.0 / n), (force / FIRST) ** (1.0 / n)))


def turning_loss(knees: Knees) -> Floats:
    """How much higher than the healthy path [m] a knee must be led for the healthy peak force, in the grid's shape.

    That is the healthy knee's largest depth less the one at which the other law carries the same force: the depth that
    it would have under the load.
    """
    _, layers, seconds = np.meshgrid(*knees.grid, indexing="ij")
    force, depth = (column[:, None, None] for column in (knees.healthy.peak_force, knees.healthy.peak_depth))
    return np.asarray(depth - needed_depth(layers, seconds, np.broadcast_to(force, layers.shape)))


def turning(knees: Knees, layer: float, second: float, share: int = 0) -> float:
    """Rise [m] of the healthy path as by `turning_loss`, for one knee."""
    force, depth = float(knees.healthy.peak_force[share]), float(knees.healthy.peak_depth[share])
    return depth - float(needed_depth(np.array(layer), np.array(second), np.array(force)))


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


HEADER = (
    "share", "layer_mm", "stiffness_2", "force_drive_peak_n", "force_drive_over_healthy", "force_drive_depth_mm",
    "force_drive_second_layer_s", "force_drive_pressure_mpa", "displacement_peak_n", "displacement_over_healthy",
)  # fmt: skip


def write_csv(knees: Knees, path: Path) -> None:
    """Write the table to a file, with five digits."""
    forced, led, grid = ratio(knees, knees.forced), ratio(knees, knees.led), knees.grid
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(HEADER)
        for cell in np.ndindex(grid.shape):
            if cell[0] in (0, len(grid.shares) - 1):
                numbers = (
                    grid.shares[cell[0]], MM * grid.layers[cell[1]], grid.seconds[cell[2]],
                    knees.forced.peak_force[cell], forced[cell], MM * knees.forced.peak_depth[cell],
                    knees.forced.bone_time[cell], 1e-6 * knees.forced.peak_pressure[cell], knees.led.peak_force[cell],
                    led[cell],
                )  # fmt: skip
                rows.writerow([f"{number:.5g}" for number in numbers])

"""The medial share of the axial load as a table over load and flexion, measured on a knee.

An instrumented implant shows that the share is not constant: it depends on flexion and on the axial load. The table is
interpolated between its points (bilinear), and held at its edges beyond them: nothing is extrapolated, and the shares
stay between 0 and 1 as they are at the points.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.knee import LARGEST_ANGLE
from knee_contact_ros.parameters.columns import not_columns, read_columns
from knee_contact_ros.system.errors import UsageError

PARAMETER = "load.share_file"
"""Parameter that names the file with the table"""
COLUMNS = ("flexion_angle", "axial_load", "medial_share")
"""Columns of the file, in rad, body weights and 1"""
LARGEST_LOAD_IN_BW = 30.0
"""Largest axial load of a knee [BW]; larger numbers must be in N"""


class ShareTable(NamedTuple):
    """Medial shares on a grid."""

    flexion: NDArray[np.float64]
    """Flexion angles [rad], increasing, shape (m,), two or more"""
    load: NDArray[np.float64]
    """Axial loads [BW], increasing, shape (n,), two or more"""
    share: NDArray[np.float64]
    """Medial shares from 0 to 1, shape (m, n)"""


class MeasuredShare:
    """Rule for the medial compartment's load by a table, as `load.compartment: measured_share` selects it."""

    def __init__(self, table: ShareTable, body_weight: float) -> None:
        """Prepare the rule for a person with this body weight [N]."""
        self._body_weight = body_weight
        self._flexion, self._load = table.flexion, table.load
        self._cells = _cells(table)
        self._inner_flexion, self._inner_load = table.flexion[1:-1].tolist(), table.load[1:-1].tolist()
        self._edges = *table.flexion[[0, -1]].tolist(), *table.load[[0, -1]].tolist()
        self._places = [table.flexion.tolist(), table.load.tolist(), self._cells.tolist()]

    def __call__(self, axial: Any, _moment: Any, flexion: Any) -> Any:
        """Medial load [N] from axial compression [N] and flexion [rad].

        Takes numbers or arrays of one shape; the results are the same bits.
        """
        return self.share(axial, flexion) * axial

    def share(self, axial: Any, flexion: Any) -> Any:
        """Medial share, from 0 to 1, at axial compression [N] and flexion [rad]: numbers, or arrays of one shape."""
        if isinstance(axial, np.ndarray):
            return self._shares(axial, flexion)
        first, last, least, most = self._edges
        angle, load = min(max(flexion, first), last), min(max(axial / self._body_weight, least), most)
        row, column = bisect_right(self._inner_flexion, angle), bisect_right(self._inner_load, load)
        flexions, loads, cells = self._places
        constant, by_angle, by_load, by_both = cells[row][column]
        right, up = angle - flexions[row], load - loads[column]
        return min(max(constant + by_angle * right + (by_load + by_both * right) * up, 0.0), 1.0)

    def _shares(self, axial: NDArray[np.float64], flexion: NDArray[np.float64]) -> NDArray[np.float64]:
        first, last, least, most = self._edges
        angle = np.minimum(np.maximum(flexion, first), last)
        load = np.minimum(np.maximum(axial / self._body_weight, least), most)
        row = np.searchsorted(self._inner_flexion, angle, "right")
        column = np.searchsorted(self._inner_load, load, "right")
        constant, by_angle, by_load, by_both = np.moveaxis(self._cells[row, column], -1, 0)
        right, up = angle - self._flexion[row], load - self._load[column]
        shares: NDArray[np.float64] = constant + by_angle * right + (by_load + by_both * right) * up
        return np.minimum(np.maximum(shares, 0.0), 1.0)

    def beyond(self, axial: Any, flexion: Any) -> Any:
        """Whether load or flexion lie beyond the table, so that its edge is taken: numbers, or arrays of one shape."""
        first, last, least, most = self._edges
        load = axial / self._body_weight
        return (flexion < first) | (flexion > last) | (load < least) | (load > most)


def _cells(table: ShareTable) -> NDArray[np.float64]:
    """Share at the lower corner of every cell and its slopes along flexion, load and both, shape (m-1, n-1, 4)."""
    wide, high = np.diff(table.flexion)[:, None], np.diff(table.load)[None, :]
    corner = table.share[:-1, :-1]
    by_angle, by_load = (table.share[1:, :-1] - corner) / wide, (table.share[:-1, 1:] - corner) / high
    both = (table.share[1:, 1:] - table.share[1:, :-1] - table.share[:-1, 1:] + corner) / (wide * high)
    return np.stack((corner, by_angle, by_load, both), axis=-1)


def read_share_table(name: str, text: str) -> ShareTable:
    """Read the table from the text of the file that `load.share_file` names.

    Comments begin with #; then come rows of flexion angle [rad], axial load [BW] and medial share [1], every angle with
    every load once, with one line of column names or none.

    Raises:
        UsageError: the text holds anything else, or a value that no knee has, as an angle in degrees or a load in N.
    """
    rows = read_columns(PARAMETER, name, text, COLUMNS, further_columns=False)
    if not len(rows) or not np.isfinite(rows).all():
        raise not_columns(PARAMETER, name, COLUMNS)
    if np.abs(rows[:, 0]).max() > LARGEST_ANGLE:
        reached = np.abs(rows[:, 0]).max()
        raise _unusable(name, f"reaches {reached:g} rad; flexion angles must be in rad, not deg")
    least, most = rows[:, 1].min(), rows[:, 1].max()
    if least < 0.0 or most > LARGEST_LOAD_IN_BW:
        raise _unusable(
            name, f"has loads from {least:g} to {most:g} BW; allowed: 0 to {LARGEST_LOAD_IN_BW:g} body weights, not N"
        )
    wrong = rows[(rows[:, 2] < 0.0) | (rows[:, 2] > 1.0), 2]
    if len(wrong):
        raise _unusable(name, f"has a share of {wrong[0]:g}; allowed: 0 to 1")
    flexion, load = np.unique(rows[:, 0]), np.unique(rows[:, 1])
    if min(len(flexion), len(load)) < 2:
        raise _unusable(name, "must have two or more flexion angles, and two or more loads")
    order = np.lexsort((rows[:, 1], rows[:, 0]))
    grid = np.stack(np.meshgrid(flexion, load, indexing="ij"), axis=-1).reshape(-1, 2)
    if len(grid) != len(rows) or (rows[order, :2] != grid).any():
        raise _unusable(
            name, f"has {len(rows)} rows; every one of its {len(flexion)} angles needs every one of its {len(load)} "
            "loads once"
        )  # fmt: skip
    return ShareTable(flexion, load, rows[order, 2].reshape(len(flexion), len(load)))


def _unusable(name: str, reason: str) -> UsageError:
    return UsageError(f"parameter {PARAMETER}: {name} {reason}")

"""The load of a compartment, as its part of the joint reaction.

The joint reaction acts on the tibia, in the tibia frame (x anterior, y superior, z to the right; left legs are mirrored
to this): an axial compression F = -F_y and a frontal moment M_x. Two compartments a spacing 2d apart, the medial one
at z = -d, carry both if the medial one bears (d F - M_x) / 2d.

In an instrumented implant the medial share was not constant: it depends on flexion and axial load. A table of measured
shares is interpolated bilinearly; beyond its edges the edge values are kept. So shares stay between 0 and 1.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

RULES = ("total", "fixed_share", "moment_balance", "measured_share")
"""Names of the rules by which a compartment's load follows from the joint reaction; see `LoadRule`"""
SPLITS = RULES[1:]
"""Names of the rules that also give the lateral compartment a load"""
_MAX_AXIAL_LOAD = 30.0
"""Largest axial load of a knee [BW]; larger numbers must be in N"""
STANDING_LOAD = 0.5
"""Axial compression [BW] above which a leg counts as standing; below it a share says little"""
BOTH = "both"
"""Value of `load.compartment` for medial and lateral contact at once; a rule of `SPLITS` gives the medial load"""


class ShareTable(NamedTuple):
    """Medial shares on a grid."""

    flexion: NDArray[np.float64]
    """Flexion angles [rad], increasing, shape (m,), two or more"""
    load: NDArray[np.float64]
    """Axial loads [BW], increasing, shape (n,), two or more"""
    share: NDArray[np.float64]
    """Medial shares from 0 to 1, shape (m, n)"""

    @staticmethod
    def of(rows: NDArray[np.float64]) -> ShareTable:
        """Make a table from rows of flexion angle [rad], axial load [BW] and share, shape (k, 3), at least one.

        Raises:
            ValueError: an angle lacks a load, or a value is impossible for a knee, such as a load in N.
        """
        least, most = rows[:, 1].min(), rows[:, 1].max()
        if least < 0.0 or most > _MAX_AXIAL_LOAD:
            allowed = f"allowed: 0 to {_MAX_AXIAL_LOAD:g} body weights, not N"
            raise ValueError(f"has loads from {least:g} to {most:g} BW; {allowed}")
        wrong = rows[(rows[:, 2] < 0.0) | (rows[:, 2] > 1.0), 2]
        if len(wrong):
            raise ValueError(f"has a share of {wrong[0]:g}; allowed: 0 to 1")
        flexion, load = np.unique(rows[:, 0]), np.unique(rows[:, 1])
        if min(len(flexion), len(load)) < 2:
            raise ValueError("must have two or more flexion angles, and two or more loads")
        order = np.lexsort((rows[:, 1], rows[:, 0]))
        grid = np.stack(np.meshgrid(flexion, load, indexing="ij"), axis=-1).reshape(-1, 2)
        if len(grid) != len(rows) or (rows[order, :2] != grid).any():
            count = f"every one of its {len(flexion)} angles needs every one of its {len(load)} loads once"
            raise ValueError(f"has {len(rows)} rows; {count}")
        return ShareTable(flexion, load, rows[order, 2].reshape(len(flexion), len(load)))


class MeasuredShare:
    """Medial share of the axial load of a person, from a table."""

    def __init__(self, table: ShareTable, body_weight: float) -> None:
        """Prepare the table for a person with this body weight [N]."""
        self._body_weight = body_weight
        self._places = table.flexion.tolist(), table.load.tolist(), _cells(table).tolist()

    def share_at(self, axial: Any, flexion: Any) -> Any:
        """Return the medial share, from 0 to 1, at axial compression [N] and flexion [rad].

        Takes numbers or arrays of one shape, with the same bits.
        """
        if isinstance(axial, np.ndarray):
            pairs = zip(axial.tolist(), flexion.tolist(), strict=True)
            return np.array([self.share_at(*pair) for pair in pairs])
        flexions, loads, cells = self._places
        angle = min(max(flexion, flexions[0]), flexions[-1])
        load = min(max(axial / self._body_weight, loads[0]), loads[-1])
        row = bisect_right(flexions, angle, 1, len(flexions) - 1) - 1
        column = bisect_right(loads, load, 1, len(loads) - 1) - 1
        constant, by_angle, by_load, by_both = cells[row][column]
        right, up = angle - flexions[row], load - loads[column]
        return min(max(constant + by_angle * right + (by_load + by_both * right) * up, 0.0), 1.0)

    def is_beyond_table(self, axial: Any, flexion: Any) -> Any:
        """Whether load or flexion lie beyond the table, so that its edge is used: numbers, or arrays of one shape."""
        flexions, loads, _ = self._places
        load = axial / self._body_weight
        bent = (flexion < flexions[0]) | (flexion > flexions[-1])
        return bent | (load < loads[0]) | (load > loads[-1])


def _cells(table: ShareTable) -> NDArray[np.float64]:
    """Return every cell's share at the lower corner, and slopes along flexion, load and both, shape (m-1, n-1, 4)."""
    wide, high = np.diff(table.flexion)[:, None], np.diff(table.load)[None, :]
    corner = table.share[:-1, :-1]
    right, above, opposite = table.share[1:, :-1], table.share[:-1, 1:], table.share[1:, 1:]
    by_angle = (right - corner) / wide
    by_load = (above - corner) / high
    by_both = (opposite - right - above + corner) / (wide * high)
    return np.stack((corner, by_angle, by_load, by_both), axis=-1)


@dataclass(frozen=True)
class LoadRule:
    """Rule by which the load of the medial (or only) compartment follows from the joint reaction."""

    name: str
    """One of `RULES`"""
    share: float
    """Medial share, for fixed_share"""
    spacing: float
    """Distance between the compartments [m], for moment_balance"""
    table: MeasuredShare | None
    """Medial share by load and flexion, for measured_share; None for the other rules"""
    body_weight: float
    """Body weight [N]"""

    def __call__(self, axial: Any, moment: Any, flexion: Any) -> Any:
        """Return the compartment's load [N] from axial compression [N], frontal moment [N m] and flexion angle [rad].

        Takes numbers or arrays of one shape, with the same bits.
        """
        if self.table:
            return self.table.share_at(axial, flexion) * axial
        if self.name == "fixed_share":
            return self.share * axial
        if self.name == "total":
            return axial
        return 0.5 * axial - moment / self.spacing

    @property
    def by_moment(self) -> bool:
        """Whether the rule needs the moment, and may give a share above 1 or below 0."""
        return self.name == "moment_balance"

    @property
    def share_varies(self) -> bool:
        """Whether the share varies from tick to tick."""
        return self.by_moment or self.table is not None

    def is_impossible(self, axial: Any, load: Any) -> Any:
        """Whether a compartment would have to pull while the leg stands, from axial compression and medial load [N].

        Takes numbers or arrays of one shape.
        """
        return (axial >= STANDING_LOAD * self.body_weight) & ((load < 0.0) | (load > axial))

    def is_beyond_table(self, axial: Any, flexion: Any) -> Any:
        """Whether load or flexion lie beyond the table of shares: numbers, or arrays of one shape."""
        return self.table is not None and self.table.is_beyond_table(axial, flexion)

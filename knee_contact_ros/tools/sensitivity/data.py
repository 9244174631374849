"""The indices as a table: a row for each, tidy."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence

from knee_contact_ros.tools.sensitivity.gather import Combination

BEFORE = ("bag", "params")
BEHIND = ("outcome", "parameter", "index", "n", "value", "low", "high")
"""Columns; those of the grid stand between. S1, ST, S2: parts of the variance; mu_star, mu, sigma: in the outcome's SI
unit, over the whole range of the parameter"""


def as_csv(combinations: Sequence[Combination]) -> str:
    """All indices; numbers with nine digits, nothing where there is none."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow((*BEFORE, *combinations[0].grid, *BEHIND))
    for each in combinations:
        where = (each.bag, each.params, *each.grid.values())
        for one in each.analysed:
            for index in one.indices:
                numbers = ("" if math.isnan(value) else f"{value:.9g}" for value in index[3:])
                writer.writerow((*where, one.outcome, index.parameter, index.kind, index.n, *numbers))
    return file.getvalue()

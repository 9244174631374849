"""Paired differences between two conditions: of strides of one gait, or of the same subjects."""

from __future__ import annotations

from numbers import Real
from typing import TYPE_CHECKING

import numpy as np

from ..system.errors import UsageError
from ..system.files import require

if TYPE_CHECKING:
    import pandas as pd


def paired(first: pd.DataFrame, second: pd.DataFrame, level: float = 0.95) -> pd.DataFrame:
    """Return means and standard deviations of two conditions, and their paired difference with its interval.

    Row i of both tables is the same stride, or the same subject: of `Gait.strides()`, or of `sweep`'s table, sorted by
    subject. Columns of numbers that both tables have are compared. The interval is Student's, of a difference that is
    normally distributed. It covers the spread between pairs only, and neither inputs nor the model.

    Args:
        first: Table of the first condition, k >= 2 rows.
        second: Table of the second condition, k rows.
        level: Probability of the interval, between 0 and 1.

    Returns:
        A row for each column, with `first`, `first_sd`, `second`, `second_sd`, `difference` (second minus first),
        `difference_sd`, the interval `low` to `high`, and the number `n` of pairs in which both are known.

    Raises:
        UsageError: the tables have different numbers of rows, or fewer than two, or the level is not allowed;
            or pandas is not installed.

    Example:
        >>> import pandas as pd
        >>> from knee_contact_ros import paired
        >>> healthy, worn = pd.DataFrame({"depth": [0.70, 0.75, 0.80]}), pd.DataFrame({"depth": [0.50, 0.56, 0.59]})
        >>> paired(healthy, worn).loc["depth", ["difference", "low", "high"]].round(3).tolist()
        [-0.2, -0.225, -0.175]
    """
    require("notebook", "pandas")
    import pandas as pd
    from scipy.stats import t

    if not (isinstance(first, pd.DataFrame) and isinstance(second, pd.DataFrame)):
        raise UsageError("paired: first and second must be data frames of pandas")
    if len(first) != len(second) or len(first) < 2:
        raise UsageError(
            f"paired: {len(first)} and {len(second)} rows are not allowed; as many of each, and at least two"
        )
    if not (isinstance(level, Real) and 0.0 < level < 1.0):
        raise UsageError(f"paired: level {level!r} is not allowed; between 0 and 1")
    rows = {}
    for name in first.select_dtypes("number"):
        if name not in second.select_dtypes("number"):
            continue
        one, other = first[name].to_numpy(float), second[name].to_numpy(float)
        known = np.isfinite(one) & np.isfinite(other)
        one, other, count = one[known], other[known], int(known.sum())
        apart = other - one
        deviations = [each.std(ddof=1) if count > 1 else np.nan for each in (one, other, apart)]
        half = (
            t.ppf(0.5 + 0.5 * level, count - 1) * deviations[2] / np.sqrt(count)
            if count > 1
            else np.nan
        )
        means = [each.mean() if count else np.nan for each in (one, other, apart)]
        rows[name] = {
            "first": means[0],
            "first_sd": deviations[0],
            "second": means[1],
            "second_sd": deviations[1],
            "difference": means[2],
            "difference_sd": deviations[2],
            "low": means[2] - half,
            "high": means[2] + half,
            "n": count,
        }
    return pd.DataFrame.from_dict(rows, orient="index")

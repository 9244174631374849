"""`knee_contact_ros.sweep`: many knees through one gait, from arrays to a table of outcomes, on all processors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from knee_contact_ros.bags.topic_names import names_in_bag
from knee_contact_ros.cohort.computing import Computed, compute, outcomes_of
from knee_contact_ros.cohort.knees import Files, Knees, Recording, checked_names, knees_in
from knee_contact_ros.cohort.outcomes import OF_A_RUN
from knee_contact_ros.model.types import NANOSECOND, ROW
from knee_contact_ros.offline.in_memory import Name, in_python_words
from knee_contact_ros.parameters.reading import Source, check_value, dotted, load_parameters
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.resources import DEFAULT_PARAMETERS, expanded

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Cohort:
    """Results of `sweep`: k cases, in the order of the values."""

    values: dict[str, NDArray[Any]]
    """Values of the varied parameters, by name, shape (k,)"""
    outcomes: np.recarray[Any, Any]
    """Outcomes of each case, shape (k,), by the names in docs/cohorts.md; not a number where the case failed"""
    lateral: np.recarray[Any, Any] | None
    """Outcomes of the lateral compartment, shape (k,); None unless both compartments are modelled"""
    failed: NDArray[Any]
    """Why a case has no outcomes, shape (k,); empty texts for the others"""
    series: NDArray[Any] | None = None
    """All answers of the only or the medial compartment, rows of `Contact`, shape (k, n); None unless requested"""
    lateral_series: NDArray[Any] | None = None
    """All answers of the lateral compartment, shape (k, n); None unless requested and both compartments are modelled

    A case without answers has zeros.
    """

    def to_pandas(self) -> pd.DataFrame:
        """Give a data frame with a row for each case: values, outcomes, lateral outcomes and why it failed."""
        import pandas as pd

        columns: dict[str, Any] = dict(self.values)
        for prefix, rows in (("", self.outcomes), ("lateral_", self.lateral)):
            columns |= {prefix + name: rows[name] for name in OF_A_RUN.names or ()} if rows is not None else {}
        return pd.DataFrame(columns | {"failed": self.failed})


def sweep(
    gait: Name | Mapping[str, ArrayLike],
    values: Mapping[str, ArrayLike],
    params: Source = DEFAULT_PARAMETERS,
    *,
    remap: Mapping[str, str] | None = None,
    namespace: str = "",
    series: bool = False,
    threads: int = 0,
) -> Cohort:
    """Compute many knees through one gait; the answers are the same bits as those of a run of each knee.

    Args:
        gait: A bag; or arrays of shape (n,): `time` [s], increasing, `flexion_angle` [rad], and `axial_load` [N], of
            which the compartment bears its share as the parameters `load.*` say (with `frontal_moment` [N m] where
            they need it). With the displacement drive `femoral_height` [m] instead of the load.
        values: Values of the varied parameters by name: arrays of shape (k,), or one value for all cases.
        params: The knee, as for `load_model`.
        remap: Other names of the input topics in a bag.
        namespace: Namespace of the input topics in a bag.
        series: Whether to keep all answers, 330 B a tick.
        threads: Number of threads; 0: one for each processor. Compiled code runs without Python's lock.

    Raises:
        UsageError: a parameter is unknown or may not be varied, arrays do not fit, or the bag cannot be used. Values
            that are allowed alone but not together are no error: the case fails.
    """
    with in_python_words():
        cases = _cases(values)
        parameters = load_parameters(params)
        if isinstance(gait, Mapping):
            knees = Knees(_recording(gait), parameters, Files())
        else:
            names = names_in_bag([f"{ours}:={theirs}" for ours, theirs in (remap or {}).items()], namespace)
            knees = knees_in(expanded(str(gait)), parameters, Files(), names)
    computed = compute(knees, cases, series=series, threads=threads)
    sides = range(max([1, *(len(one.sides) for one in computed)]))
    medial, *lateral = (outcomes_of(computed, side).view(np.recarray) for side in sides)
    answers = [_series(computed, side, len(knees.recording.steps)) for side in sides if series]
    varied = {name: np.array([case[name] for case in cases]) for name in dotted(values)}
    failed = np.array([one.failed for one in computed])
    return Cohort(varied, medial, lateral[0] if lateral else None, failed, *answers)


def _series(computed: Sequence[Computed], side: int, number: int) -> NDArray[Any]:
    """Collect the answers of all cases in a compartment, shape (k, number); zeros where a case has none."""
    rows = np.zeros((len(computed), number), ROW)
    for own, one in zip(rows, computed, strict=True):
        if side < len(one.series):
            own[:] = one.series[side]
    return rows


def _cases(values: Mapping[str, ArrayLike]) -> list[dict[str, Any]]:
    """Give the values of each case by name; refuse arrays of different lengths, and values that are never allowed."""
    flat = {name: np.atleast_1d(np.asarray(column)) for name, column in dotted(values).items()}
    checked_names(list(flat))
    lengths = {len(column) for column in flat.values() if column.shape != (1,)} or {1}
    if len(lengths) > 1 or any(column.ndim != 1 for column in flat.values()) or not flat:
        shapes = ", ".join(f"{name} {column.shape}" for name, column in flat.items()) or "none"
        raise UsageError(f"values: {shapes} is not allowed; arrays of one length, or single values")
    (number,) = lengths
    columns = {name: np.broadcast_to(column, number).tolist() for name, column in flat.items()}
    for name, column in columns.items():
        ends = [min(column), max(column)] if column and not isinstance(column[0], str) else sorted(set(column))
        for value in ends:
            check_value(name, value)
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _recording(gait: Mapping[str, ArrayLike]) -> Recording:
    """Make a recording from arrays; refuse those that are missing or do not fit."""
    known = {"time", "flexion_angle", "axial_load", "frontal_moment", "femoral_height"}
    unknown = sorted(set(gait) - known)
    if unknown or not {"time", "flexion_angle"} <= set(gait):
        raise UsageError(f"gait: {', '.join(gait) or 'nothing'} is not allowed; time, flexion_angle, axial_load")
    columns = {name: np.array(column, dtype=float) for name, column in gait.items()}
    time = columns["time"]
    if any(column.shape != time.shape or column.ndim != 1 for column in columns.values()) or not len(time):
        raise UsageError("gait: the arrays must be one-dimensional and of equal length")
    if not all(np.isfinite(column).all() for column in columns.values()):
        raise UsageError("gait: the arrays must be finite")
    stamps = np.rint(time / NANOSECOND).astype(np.int64)
    if (np.diff(stamps) <= 0).any():
        raise UsageError("gait: time must increase")
    steps = np.diff(stamps, prepend=stamps[:1]) * NANOSECOND
    zeros, unknown_heights = np.zeros(len(time)), np.full(len(time), np.nan)
    return Recording(
        stamps, steps, columns["flexion_angle"], columns.get("axial_load", zeros),
        columns.get("frontal_moment", zeros), columns.get("femoral_height", unknown_heights),
    )  # fmt: skip

"""Many knees through the same gait: the function `sweep`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..bags.bag import Bag
from ..bags.names import names_in_bag
from ..model.ringing import ringing_sentence
from ..offline.bag_parameters import parameters_for
from ..offline.notebooks import Name, in_python_words, remap_rules, warn_of
from ..parameters.files import (
    ParameterSource,
    check_value,
    dotted,
    load_parameters,
)
from ..results import Records, missing_attribute
from ..system.arguments import checked
from ..system.errors import UsageError
from ..system.files import DEFAULT_PARAMETERS, expand_user, require
from .knees import Knees, check_may_vary, compute, file_texts, idle_doubt
from .outcomes import LATERAL_OUTCOME, OUTCOMES, units_of
from .recordings import read_recording, recorded_doubt, recording_from_arrays

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Cohort:
    """Results of `sweep`: k cases, in the order of the values.

    Example:
        >>> from knee_contact_ros import sweep
        >>> cohort = sweep("bags/gait2354_right", {"contact.damping": [2e3, 5e3]})
        >>> cohort.to_pandas()[["contact.damping", "peak_force"]].round()
           contact.damping  peak_force
        0           2000.0      1614.0
        1           5000.0      1614.0
    """

    values: dict[str, NDArray[Any]]
    """Values of the varied parameters, by name, shape (k,)"""
    outcomes: np.recarray[Any, Any]
    """Outcomes of each case, shape (k,), by the names in docs/how-to/many-knees.md; NaN where the case failed"""
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

    def __repr__(self) -> str:
        varied = ", ".join(
            f"{name} {np.min(own)} to {np.max(own)}" for name, own in self.values.items()
        )
        return f"<Cohort: {len(self.failed)} cases, {np.count_nonzero(self.failed)} failed; varied: {varied}>"

    def __getattr__(self, name: str) -> Any:
        raise missing_attribute(self, name)

    def to_pandas(self) -> pd.DataFrame:
        """Return a data frame with a row for each case: values, outcomes, lateral outcomes and why it failed.

        Its `attrs["varied"]` are the names of the parameters that were varied, which are the first columns, and
        `attrs["units"]` the SI units of its columns.

        Raises:
            UsageError: pandas is not installed.
        """
        require("sweep", "pandas")
        import pandas as pd

        columns: dict[str, Any] = dict(self.values)
        columns |= {name: self.outcomes[name] for name in OUTCOMES}
        if self.lateral is not None:
            columns |= {LATERAL_OUTCOME + name: self.lateral[name] for name in OUTCOMES}
        table = pd.DataFrame(columns | {"failed": self.failed})
        table.attrs["varied"] = list(self.values)
        table.attrs["units"] = units_of(table)
        return table


@checked
def sweep(
    gait: Name | Mapping[str, ArrayLike],
    values: Mapping[str, ArrayLike],
    params: ParameterSource = DEFAULT_PARAMETERS,
    *,
    remap: Mapping[str, str] | None = None,
    namespace: str = "",
    series: bool = False,
    threads: int = 0,
) -> Cohort:
    """Compute many knees through one gait; the answers have the same bits as a run of each knee alone.

    Args:
        gait: A bag; or arrays of shape (n,): `time` [s], increasing, `flexion_angle` [rad], and `axial_load` [N], which
            the parameters `load.*` divide between the compartments (with `frontal_moment` [N m] where they need it).
            The displacement drive needs `femoral_height` [m] instead of the load.
        values: Values of the varied parameters by name: arrays of shape (k,), or one value for all cases.
        params: The knee, as for `load_model`.
        remap: Other names of the input topics in a bag.
        namespace: Namespace of the input topics in a bag.
        series: Whether to keep all answers, 224 B a tick.
        threads: Number of threads; 0: one for each processor. Compiled code runs without Python's lock.

    An implausible or damaged bag causes warnings.

    Raises:
        UsageError: a parameter is unknown or may not be varied, arrays do not fit, or the bag cannot be used. Values
            that are allowed alone but not together are no error: the case fails.

    Example:
        >>> import numpy as np
        >>> from knee_contact_ros import sweep
        >>> time = np.linspace(0.0, 1.0, 101)
        >>> gait = {
        ...     "time": time,
        ...     "flexion_angle": 0.3 + 0.2 * np.sin(6.3 * time),
        ...     "axial_load": 1400.0 + 800.0 * np.sin(12.6 * time),
        ... }
        >>> cohort = sweep(gait, {"contact.stiffness": [4e7, 8e7, 16e7]})
        >>> (1e3 * cohort.outcomes.peak_depth).round(2)
        array([0.91, 0.57, 0.36])
    """
    with in_python_words():
        cases = _cases(values)
        files = dict[str, str]()
        if isinstance(gait, Mapping):
            parameters = load_parameters(params)
            recording = recording_from_arrays(gait, parameters)
            for sentence in recording.doubts:
                warnings.warn(sentence, stacklevel=3)  # with `checked`
        else:
            sources = params if isinstance(params, (list, tuple)) else [params]
            with Bag(expand_user(str(gait))) as bag:
                parameters = parameters_for(bag, sources)
                names = names_in_bag(remap_rules(remap), namespace)
                texts = file_texts(parameters, files)
                recording, _ = read_recording(bag, parameters, texts, names)
                doubts = recorded_doubt(bag) if params == DEFAULT_PARAMETERS else []
            warn_of(bag.path, "solved", [*doubts, *recording.doubts], recording.damage)
        knees = Knees(recording, parameters, files)
    computed = compute(knees, cases, series=series, threads=threads)
    rings = [f"of some cases {ringing_sentence(computed.ringing)}"] if computed.ringing else []
    idle = idle_doubt(parameters, [name for name in dotted(values) if len(cases) > 1])
    for sentence in [*rings, *idle]:
        warnings.warn(sentence, stacklevel=3)  # with `checked`
    medial, lateral = (rows.view(Records) for rows in computed.outcomes)
    varied = {name: np.array([case[name] for case in cases]) for name in dotted(values)}
    both = computed.has(1).any()
    return Cohort(
        varied, medial, lateral if both else None, np.array(computed.failed), *computed.series
    )


def _cases(values: Mapping[str, ArrayLike]) -> list[dict[str, Any]]:
    """Return the values of each case by name; refuse arrays of different lengths, and values that are never allowed."""
    try:
        columns = {name: np.asarray(column) for name, column in dotted(values).items()}
    except ValueError:  # rows of several lengths
        raise UsageError("values: arrays of one length, or single values are allowed") from None
    strange = [
        name
        for name, column in columns.items()
        if column.dtype.kind not in "biufU"
        and not all(isinstance(each, str | Real) for each in column.ravel())
    ]
    if strange:
        raise UsageError(f"values: {', '.join(strange)}: numbers or texts are allowed")
    check_may_vary(columns)
    try:
        (count,) = np.broadcast_shapes((1,), *(column.shape for column in columns.values()))
    except ValueError:  # several lengths, or more than one dimension
        count = 0
    if not columns or not count:
        shapes = ", ".join(f"{name} {column.shape}" for name, column in columns.items()) or "none"
        raise UsageError(
            f"values: {shapes} is not allowed; arrays of one length, or single values"
        )
    lists = {name: np.broadcast_to(column, count).tolist() for name, column in columns.items()}
    for name, column in lists.items():
        ends = set(column) if isinstance(column[0], str) else {min(column), max(column)}
        for value in ends:
            check_value(name, value)
    return [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]

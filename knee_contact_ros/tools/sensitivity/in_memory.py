"""`knee_contact_ros.sensitivity`: sensitivity indices of one knee in one gait, given as arrays or a bag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from numpy.typing import ArrayLike
from pydantic import ValidationError

from knee_contact_ros.cohort.in_memory import Cohort, sweep
from knee_contact_ros.cohort.table import LATERAL
from knee_contact_ros.offline.in_memory import Name
from knee_contact_ros.parameters.reading import Source
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.resources import DEFAULT_PARAMETERS
from knee_contact_ros.tools.sensitivity.analysis import Analysed, analyse
from knee_contact_ros.tools.sensitivity.design import SalibDesign
from knee_contact_ros.tools.sensitivity.gather import AFTER, BOUNDS, bound_of
from knee_contact_ros.tools.sensitivity.study_file import USUAL, checked_outcomes, first_fault
from knee_contact_ros.tools.sensitivity.words import not_converged

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Sensitivity:
    """Results of `sensitivity`."""

    outcomes: dict[str, Analysed]
    """Analysis of each outcome, by name: indices for n/8, n/4, n/2 and n; or the reason why there are none"""
    remarks: dict[str, list[str]]
    """What has not converged of each outcome, a sentence each, by the outcome's name"""
    cohort: Cohort
    """The knees that were computed, in the order of the design"""

    def to_pandas(self) -> pd.DataFrame:
        """Give a data frame with a row for each index: outcome, parameter, index, n, value, low, high; SI units."""
        import pandas as pd

        rows = [(name, *index) for name, analysed in self.outcomes.items() for index in analysed.indices]
        return pd.DataFrame(rows, columns=list(AFTER))


def sensitivity(
    gait: Name | Mapping[str, ArrayLike],
    ranges: Mapping[str, Any],
    params: Source = DEFAULT_PARAMETERS,
    *,
    method: Literal["sobol", "morris"] = "sobol",
    n: int = 256,
    seed: int = 1,
    second_order: bool = False,
    confidence: float = 0.95,
    outcomes: Sequence[str] = USUAL,
    remap: Mapping[str, str] | None = None,
    namespace: str = "",
    threads: int = 0,
) -> Sensitivity:
    """Compute a knee at the points of a design by SALib, and find out which of its parameters matter.

    Args:
        gait: A bag or arrays, as for `sweep`.
        ranges: Ranges of two or more parameters, by name: two numbers, or a mapping of `from`, `to` and `scale`
            (linear or log).
        params: The knee, as for `load_model`.
        method: Sobol (shares of the variance) or Morris (effects over the whole range).
        n: Number of base samples, a power of two, or of trajectories; 8 to 65536.
        seed: Seed of the random numbers of design and bootstrap.
        second_order: Whether to compute Sobol's indices of pairs of parameters, too, from twice the cases.
        confidence: Confidence level of the intervals.
        outcomes: Outcomes to analyse, named as in the table of a sweep.
        remap: Other names of the input topics in a bag.
        namespace: Namespace of the input topics in a bag.
        threads: Number of threads; 0: one for each processor.

    Raises:
        UsageError: a range, outcome, parameter or gait is not allowed. Cases that fail are no error: see `spoilt` and
            `reason` of the outcomes.
    """
    options = {"method": method, "n": n, "seed": seed, "second_order": second_order, "confidence": confidence}
    try:
        design = SalibDesign.model_validate(options | {"ranges": dict(ranges)})
    except ValidationError as error:
        raise UsageError(first_fault(error)) from None
    names = checked_outcomes(list(outcomes))
    values = dict(zip(design.names, design.points().T, strict=True))
    cohort = sweep(gait, values, params, remap=remap, namespace=namespace, threads=threads)
    analysed = {}
    for name in names:
        rows = {one: _column(cohort, one) for one in {name, BOUNDS.get(name, name)}}
        analysed[name] = analyse(design, name, rows[name], bound_of(name, rows))
    return Sensitivity(analysed, {name: not_converged(design, one) for name, one in analysed.items()}, cohort)


def _column(cohort: Cohort, name: str) -> Any:
    """Give an outcome of all cases, shape (k,); refuse one of a compartment that is not modelled."""
    own = name.removeprefix(LATERAL)
    rows = cohort.outcomes if own == name else cohort.lateral
    if rows is None:
        raise UsageError(f"outcomes: {name} is not allowed; load.compartment is not both")
    return rows[own]

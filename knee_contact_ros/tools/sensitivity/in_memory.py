"""`knee_contact_ros.sensitivity`: indices of one knee through one gait, from arrays or a bag, on all processors."""

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
from knee_contact_ros.tools.sensitivity.asked import USUAL, checked_outcomes, first_of
from knee_contact_ros.tools.sensitivity.design import SalibDesign
from knee_contact_ros.tools.sensitivity.gather import BOUNDS, bound_of
from knee_contact_ros.tools.sensitivity.words import not_converged

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Sensitivity:
    """What `sensitivity` gives."""

    outcomes: dict[str, Analysed]
    """Indices of each outcome, of n/8, n/4, n/2 and n; or the reason why there are none"""
    remarks: dict[str, list[str]]
    """Of each outcome: what has not converged, a sentence each"""
    cohort: Cohort
    """The knees that were computed, in the order of the design"""

    def to_pandas(self) -> pd.DataFrame:
        """A row for each index: outcome, parameter, index, n, value, low, high; SI units."""
        import pandas as pd

        rows = [(name, *index) for name, found in self.outcomes.items() for index in found.indices]
        return pd.DataFrame(rows, columns=["outcome", "parameter", "index", "n", "value", "low", "high"])


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
    """Compute a knee where SALib asks for it, and which of its parameters matter.

    Args:
        gait: A bag or arrays, as for `sweep`.
        ranges: Parameters by name: two numbers, or a mapping of `from`, `to` and `scale`, linear or log. Two at least.
        params: The knee, as for `load_model`.
        method: Sobol (shares of the variance) or Morris (effects over the whole range).
        n: Base samples, a power of two, or trajectories; 8 to 65536.
        seed: Of the design and the bootstrap.
        second_order: Sobol: of pairs, too; twice the cases.
        confidence: Of the intervals.
        outcomes: Names as in the table of a sweep.
        remap: Other names of the inputs in a bag.
        namespace: Of the inputs in a bag.
        threads: That work at once; 0: one for each processor.

    Raises:
        UsageError: a range, outcome, parameter or gait that is not allowed. Cases that fail are no error:
            `outcomes[...].spoilt` and `reason` tell what they cost.
    """
    told = {"method": method, "n": n, "seed": seed, "second_order": second_order, "confidence": confidence}
    try:
        design = SalibDesign.model_validate(told | {"ranges": dict(ranges)})
    except ValidationError as error:
        raise UsageError(first_of(error)) from None
    wanted = checked_outcomes(list(outcomes))
    points = design.points()
    values = {name: points[:, i] for i, name in enumerate(design.names)}
    cohort = sweep(gait, values, params, remap=remap, namespace=namespace, threads=threads)
    analysed = {}
    for name in wanted:
        rows = {one: _column(cohort, one) for one in {name, BOUNDS.get(name, name)}}
        analysed[name] = analyse(design, name, rows[name], bound_of(name, rows))
    return Sensitivity(analysed, {name: not_converged(design, one) for name, one in analysed.items()}, cohort)


def _column(cohort: Cohort, name: str) -> Any:
    """An outcome of all cases, shape (k,).

    Raises:
        UsageError: it is of a compartment that is not modelled.
    """
    own = name.removeprefix(LATERAL)
    rows = cohort.outcomes if own == name else cohort.lateral
    if rows is None:
        raise UsageError(f"outcomes: {name} is not allowed; load.compartment is not both")
    return rows[own]

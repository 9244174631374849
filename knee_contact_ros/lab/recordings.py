"""Inputs of all ticks of a gait, read from a bag or made from arrays."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..bags.bag import Bag
from ..bags.names import OWN_NAMES, Names
from ..bags.provenance import Provenance
from ..model.arrays import InputError, plain_array
from ..model.inputs import InputCheck
from ..model.types import NANOSECOND, Floats, Rows, Status
from ..offline.bag_parameters import resolved_parameters
from ..offline.solve import solve
from ..offline.solve_blocks import AnswerBlock
from ..parameters.schema import Parameters
from ..streams.output import PROVENANCE
from ..system.errors import UsageError
from ..system.files import DEFAULT_PARAMETERS
from ..system.progress import OnProgress, no_progress


class Recording(NamedTuple):
    """Inputs of all ticks of a recording, arrays of shape (n,)."""

    stamps: NDArray[np.int64]
    """Stamps [ns]"""
    steps: Floats
    """Time since the tick before [s]; 0 where a run begins"""
    angles: Floats
    """Flexion angle [rad]"""
    axial: Floats
    """Axial joint reaction [N], positive in compression"""
    moment: Floats
    """Frontal moment [N m]"""
    heights: Floats
    """Prescribed femoral height [m]; NaN where it is not prescribed"""
    damage: tuple[str, ...] = ()
    """Parts of the recording that cannot be read, a sentence each"""
    doubts: tuple[str, ...] = ()
    """What is implausible in it, a sentence each"""
    share: float = 0.0
    """Fraction of the axial load that is added to the medial compartment's share"""

    @property
    def begins(self) -> list[int]:
        """Indices of the first tick of each run, followed by the number of ticks."""
        return [*np.flatnonzero(self.steps == 0.0).tolist(), len(self.steps)]


def read_recording(
    bag: Bag,
    basis: Parameters | Provenance,
    texts: Mapping[str, str],
    names: Names = OWN_NAMES,
    advance: OnProgress = no_progress,
    *,
    compiled: bool | None = None,
) -> tuple[Recording, tuple[Rows, ...]]:
    """Read the inputs of all ticks from a bag.

    Args:
        bag: The bag.
        basis: Parameters, or the provenance of a recording.
        texts: Contents of the files that the parameters name, by parameter.
        names: Names of the input topics.
        advance: As for `solve`.
        compiled: As for `solve`.

    Returns:
        The inputs, and the answers of each compartment, shape (n,): 300 B a tick.

    Raises:
        UsageError: the bag cannot be used, see `solve`.
    """
    blocks: list[AnswerBlock] = []
    summary = solve(
        bag, basis, None, advance, names=names, compiled=compiled, keep=blocks.append, curves=texts
    )
    axial = np.concatenate([block.axial for block in blocks])
    moment = np.concatenate([block.moment for block in blocks])
    angles = np.concatenate([block.angle for block in blocks])
    compartments = zip(*[block.rows for block in blocks], strict=True)
    rows = tuple(np.concatenate(parts) for parts in compartments)
    stamps, height = rows[0]["stamp"].copy(), rows[0]["femoral_height"].copy()
    steps = np.diff(stamps, prepend=stamps[:1]) * NANOSECOND
    steps[(rows[0]["status"] & Status.TIME_RESET) != 0] = 0.0
    if resolved_parameters(basis).drive != "displacement":
        height[:] = np.nan
    rings = [side.ringing.sentence for side in (summary, summary.lateral) if side and side.ringing]
    warnings = [sentence for sentence in summary.warnings if sentence not in rings]  # of each case
    doubts = tuple(filter(None, (*warnings, summary.unanswered)))
    return Recording(
        stamps, steps, angles, axial, moment, height, tuple(summary.damage), doubts
    ), rows


def recorded_doubt(bag: Bag) -> list[str]:
    """Sentence that a recording is computed with other parameters than its own; empty list if the bag is none."""
    if bag.first_metadata(PROVENANCE) is None:
        return []
    doubt = f"without params its own parameters are not used, but {DEFAULT_PARAMETERS}"
    return [f"it is a recording; {doubt}"]


def recording_from_arrays(gait: Mapping[str, ArrayLike], parameters: Parameters) -> Recording:
    """Make a recording from arrays by name, see `sweep`.

    Raises:
        UsageError: arrays are missing for the parameters, are not allowed, or do not fit.
    """
    needed = ["time", "flexion_angle"]
    allowed = ["time", "flexion_angle", "axial_load", "frontal_moment"]
    if parameters.drive == "displacement":
        needed += ["femoral_height"]
        allowed += ["femoral_height"]
        unknown = 0.0
    else:
        needed += ["axial_load"]
        needed += ["frontal_moment"] if parameters.load.rule == "moment_balance" else []
        unknown = np.nan
    if not {*needed} <= {*gait} <= {*allowed}:
        inputs = f"these parameters need {', '.join(needed)} and allow {', '.join(allowed)}"
        raise UsageError(f"gait: {', '.join(gait) or 'nothing'} is not allowed; {inputs}")
    try:
        columns = {name: plain_array(name, column) for name, column in gait.items()}
    except InputError as error:
        raise UsageError(f"gait: {error}") from None
    time = columns["time"]
    if len({len(column) for column in columns.values()}) > 1 or not len(time):
        raise UsageError("gait: the arrays must be one-dimensional and of equal length")
    if not all(np.isfinite(column).all() for column in columns.values()):
        raise UsageError("gait: the arrays must be finite")
    stamps = np.rint(time / NANOSECOND).astype(np.int64)
    if (np.diff(stamps) <= 0).any():
        raise UsageError("gait: time must increase")

    def column(name: str) -> Floats:
        return columns.get(name, np.full(len(time), unknown))

    force = parameters.drive != "displacement"
    where = "axial_load > 0"
    check = InputCheck(parameters.body_weight, force, share=1.0, compression=where)
    loads = column("axial_load")
    check.add_samples(stamps, columns["flexion_angle"], loads if check.load_driven else 0.0 * time)
    return Recording(
        stamps,
        np.diff(stamps, prepend=stamps[:1]) * NANOSECOND,
        columns["flexion_angle"],
        loads,
        column("frontal_moment"),
        column("femoral_height"),
        doubts=tuple(check.sentences),
    )

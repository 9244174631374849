"""What a walk and a stand tell about a leg's sensors without a measured load: zero and clock of the knee, and weight.

In level walking knees bend alike: the mean of other people's knees, laid from heel strike to toe-off and on, shows how
late the angles are and how far off their zero is. It tells no more than people differ by, and what is within that is
kept as given (docs/explanation/validation.md). A stand on straight knees tells the zero itself.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bags.bag import Bag
from ...bags.folder import bag_digest
from ...bags.names import Names
from ...joint_reaction.walking import LONGEST_SWING, STANCES, UNLOADED
from ...model.types import UNUSABLE, Floats
from ...parameters.load_schema import LoadParameters
from ...streams.topics import NANOSECONDS
from ...system.errors import UsageError
from ...system.progress import OnProgress
from .fit import Data
from .intervals import Interval
from .load_problem import read_sensors
from .unknowns import Unknown

ZERO, CLOCK, MASS = "knee.offset", "pairing.angle_delay", "person.mass"
FOUND = (ZERO, CLOCK, MASS)
"""Parameters that sensors tell alone"""
FLEXION = "flexion_angle"


class StrideFlexion(NamedTuple):
    """Flexion of a knee [rad] over a stride, at equal distances in time."""

    stance: tuple[float, ...]
    """From heel strike to toe-off"""
    swing: tuple[float, ...]
    """From toe-off to heel strike"""


MEAN_FLEXION = StrideFlexion(
    stance=(
        0.124, 0.171, 0.220, 0.279, 0.294, 0.287, 0.266, 0.235, 0.198, 0.162,
        0.130, 0.105, 0.089, 0.085, 0.090, 0.112, 0.159, 0.255, 0.411, 0.621, 0.833,
    ),
    swing=(0.833, 1.052, 1.108, 1.019, 0.811, 0.509, 0.199, 0.028, 0.075),
)  # fmt: skip
"""Mean of four sessions of three persons. `python -m studies.validation` makes it"""
DEVIATIONS: Mapping[str, float] = {ZERO: 0.08, CLOCK: 0.009, MASS: 0.08}
"""How far a person's walk differs from other people's (standard deviation): flexion [rad], its clock [s], and twice the
mean force on a leg relative to the weight. Measured in those sessions with the mean of the other persons, and in
gait2354's walk, whose clock is the farthest off: 14 ms"""
KEPT = 2.0
"""What is found within so many standard deviations is kept as given"""
_LONGEST_DELAY = 0.15
"""Longest delay [s] that is tried in both directions, a quarter of a stance"""
_DELAY_STEP = 0.001
_LEAST_CORRELATION = 0.9
"""Correlation with the mean flexion below which it is no level walk; it was 0.98 to 0.99"""
_BEGINS = 0.3
"""Ground force [body weights] of a first sample up to which a stance begins with the recording"""
_STILL = math.radians(1.5)
"""Range of flexion [rad] of a stand within `_STAND`"""
_STEADY = 0.1
"""Range of the ground force [body weights] of a stand"""
_STAND = 1.0
"""Shortest stand [s]"""
_STANDS = 0.3
"""Ground force [body weights] that a standing foot bears at least"""
_ON_ONE_LEG = 0.75
"""Part of the weight that a foot bears on which a person stands alone"""


class Recorded(NamedTuple):
    """What a leg's sensors recorded, at n samples."""

    time: Floats
    """Times [s], shape (n,)"""
    flexion: Floats
    """Flexion [rad], shape (n,); NaN where it is flagged"""
    force: Floats
    """Upward ground force [body weights], shape (n,)"""


class StrideTimes(NamedTuple):
    """Times [s] of a stride."""

    strike: float
    toe_off: float
    next_strike: float


class Stand(NamedTuple):
    """A leg that stands still."""

    flexion: float
    """Mean flexion [rad]"""
    force: float
    """Mean ground force [body weights]"""


class Walked(NamedTuple):
    """How a walk differs from other people's."""

    delay: float
    """Time [s] by which the angles are late"""
    offset: float
    """Flexion [rad] beyond theirs"""
    rms: float
    """RMS [rad] of what is left"""
    correlation: float


class WalkFound(NamedTuple):
    """What was found; see `Calibration`."""

    measured: Data
    """The flexion"""
    values: dict[str, float]
    intervals: dict[str, Interval]
    rms: dict[str, float]
    remarks: list[str]
    doubts: list[str]


def find_in_walk(
    bags: Sequence[Path],
    parameters: LoadParameters,
    unknowns: Sequence[Unknown],
    names: Names,
    level: float,
    advance: OnProgress,
) -> WalkFound:
    """Find zero, clock and weight from bags of one person who walks, and may stand.

    Args:
        bags: Paths of the bags.
        parameters: Parameters of the load node, with which they are read.
        unknowns: What is wanted, of `FOUND`.
        names: Names of the bags' topics.
        level: Probability of the intervals.
        advance: Called with the amount read of a bag, and the whole amount.

    Raises:
        UsageError: a bag cannot be used, it has too few strides and no stand, or a knee that does not bend as in
            walking; or a value lies outside of its range.
    """
    source = f"bag {', '.join(map(str, bags))}"
    if parameters.ground.components == "net":
        raise UsageError(
            f"{source}: ground.components net is no ground force, which tells strides"
        )
    recordings, doubts = [], list[str]()
    for bag in bags:
        recorded, damage = _read(bag, parameters, names, advance)
        recordings.append(recorded)
        doubts += damage
    found, remarks, rms = _told_by(recordings, parameters, source)
    values, intervals = {}, {}
    half = NormalDist().inv_cdf(0.5 + 0.5 * level)
    for unknown in unknowns:
        name, unit = unknown.name, unknown.unit
        if name not in found:
            raise UsageError(f"{source}: {remarks[0]}, which do not tell {name}; {_NEEDED[name]}")
        value, deviation, how = found.pop(name)
        kept = abs(value - unknown.start) <= KEPT * deviation
        values[name] = unknown.start if kept else value
        if not unknown.least <= values[name] <= unknown.most:
            allowed = f"allowed: {unknown.least:g} to {unknown.most:g}"
            raise UsageError(f"{source}: {name} is {value:.4g} {unit}, {allowed}; {how}")
        if deviation:
            ends = value - half * deviation, value + half * deviation
            intervals[name] = Interval(*ends, low_open=False, high_open=False)
        why = f"; people differ by {deviation:.2g} {unit}, so it is kept as given" if kept else ""
        remarks.append(f"{name}: {how}{why}")
    if MASS in found:
        remarks.append(f"not set: {found[MASS].how}")
    digest = ", ".join(bag_digest(bag) for bag in bags)
    flexion = np.concatenate([each.flexion for each in recordings])
    return WalkFound(
        Data(source, digest, {FLEXION: flexion}), values, intervals, rms, remarks, doubts
    )


class _Found(NamedTuple):
    """A parameter by a walk or a stand."""

    value: float
    deviation: float
    """Standard deviation from person to person; 0: it is so by definition"""
    how: str


_NEEDED = {
    ZERO: "level walking is needed, from heel strike to heel strike, better five times, or a stand of a second",
    CLOCK: "level walking is needed, from heel strike to heel strike, better five times",
    MASS: "level walking is needed, from heel strike to heel strike, or a stand on this leg alone",
}
"""What tells a parameter"""


def _told_by(
    recordings: Sequence[Recorded], parameters: LoadParameters, source: str
) -> tuple[dict[str, _Found], list[str], dict[str, float]]:
    """Tell all that can be found, how much it rests on, and the RMS [rad] by which the flexion is other people's."""
    stands = [stand for each in recordings for stand in stands_of(each)]
    number = sum(len(strides_of(each)) for each in recordings)
    found, remarks, rms = (
        dict[str, _Found](),
        [f"whole strides: {number}, stands: {len(stands)}"],
        {},
    )
    part, deviation, where = (
        weight_walked(recordings),
        DEVIATIONS[MASS],
        "by twice the mean force of the strides",
    )
    if number:
        delay, offset, rms[FLEXION], correlation = compare_walk(recordings)
        if not correlation >= _LEAST_CORRELATION:
            why = f"the knee does not bend as in level walking (r {correlation:.2f} with other people's)"
            raise UsageError(
                f"{source}: {why}: is knee.sign right, and are angle and force of one leg?"
            )
        if abs(delay) > _LONGEST_DELAY - _DELAY_STEP:
            why = f"the angles fit best at the longest delay tried, {delay:g} s"
            raise UsageError(f"{source}: {why}: are both of one clock?")
        beyond = f"in walking it bends {math.degrees(offset):.1f} deg more than other people's"
        found[ZERO] = _Found(parameters.knee.offset - offset, DEVIATIONS[ZERO], beyond)
        late = (
            f"the angles are {1e3 * delay:.0f} ms late (r {correlation:.3f} with other people's)"
        )
        found[CLOCK] = _Found(parameters.pairing.angle_delay + delay, DEVIATIONS[CLOCK], late)
    if stands:
        flexion = min(stands).flexion
        how = f"{math.degrees(flexion):.1f} deg in the straightest stand, which is 0"
        found[ZERO] = _Found(parameters.knee.offset - flexion, 0.0, how)
        most = max(stand.force for stand in stands)
        if most > _ON_ONE_LEG * (part if number else 1.0):
            part, deviation, where = most, 0.0, "in a stand on this leg"
    if math.isfinite(part):
        mass = parameters.person.mass
        how = f"the ground bears {part:.3f} of {mass:g} kg {where}"
        found[MASS] = _Found(part * mass, deviation * mass, how)
    return found, remarks, rms


def _read(
    path: Path, parameters: LoadParameters, names: Names, advance: OnProgress
) -> tuple[Recorded, list[str]]:
    """Read a bag, and what is damaged in it."""
    with Bag(path) as bag:
        samples, summary, doubts = read_sensors(bag, parameters, names, advance)
    stamps = summary.stamps
    flexion = np.array(
        [math.nan if each.status & UNUSABLE else each.joints.flexion for each in samples]
    )
    force = np.array([each.ground.force[1] for each in samples])
    later = np.flatnonzero(np.diff(np.maximum.accumulate(stamps), prepend=-1) > 0)
    time = (stamps[later] - stamps[0]) / NANOSECONDS
    return Recorded(
        time, flexion[later], force[later] / parameters.person.constants.weight
    ), doubts


def strides_of(recorded: Recorded) -> list[StrideTimes]:
    """Find the whole strides of a walk by the ground force."""
    time, force = recorded.time, recorded.force
    stances = list(_runs(force > UNLOADED))
    found = []
    for (first, last), (following, _) in pairwise(stances):
        stride = StrideTimes(time[first], time[last], time[following])
        stance, swing = np.diff(stride)
        began = first > 0 or force[0] <= _BEGINS
        if began and STANCES[0] <= stance <= STANCES[1] and swing <= LONGEST_SWING:
            found.append(stride)
    return found


def _runs(flags: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """First places of all runs, and the first ones behind them."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False]))))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def stride_points(stride: StrideTimes, shape: StrideFlexion) -> Floats:
    """Times [s] of the values of a shape in a stride."""
    return np.concatenate(
        (
            np.linspace(stride.strike, stride.toe_off, len(shape.stance)),
            np.linspace(stride.toe_off, stride.next_strike, len(shape.swing)),
        )
    )


def compare_walk(recordings: Sequence[Recorded], shape: StrideFlexion = MEAN_FLEXION) -> Walked:
    """Compare the flexion of strides with a shape: the delay and the offset that leave least of the difference."""
    expected = np.concatenate((shape.stance, shape.swing))
    places = [
        (each, np.array([stride_points(stride, shape) for stride in strides]))
        for each in recordings
        if (strides := strides_of(each))
    ]
    found = []
    for delay in np.arange(-_LONGEST_DELAY, _LONGEST_DELAY + 0.5 * _DELAY_STEP, _DELAY_STEP):
        rows = np.concatenate(
            [
                np.interp(points + delay, each.time, each.flexion, left=np.nan, right=np.nan)
                for each, points in places
            ]
        )
        known = np.isfinite(rows)
        difference = (rows - expected)[known]
        if not len(difference):
            continue
        offset = float(difference.mean())
        rms = float(np.sqrt(np.mean((difference - offset) ** 2)))
        found.append(
            (rms, float(delay), offset, rows[known], np.broadcast_to(expected, rows.shape)[known])
        )
    rms, delay, offset, one, other = min(found, key=lambda each: each[0])
    with np.errstate(invalid="ignore"):
        correlation = float(np.corrcoef(one, other)[0, 1])
    return Walked(delay, offset, rms, correlation)


def stands_of(recorded: Recorded) -> list[Stand]:
    """Find where the leg stands still."""
    time = recorded.time
    still = np.zeros(len(time), dtype=bool)
    begins = np.arange(time[0], time[-1] - _STAND, 0.1 * _STAND)
    for first, last in np.searchsorted(time, (begins, begins + _STAND)).T.tolist():
        flexion, force = recorded.flexion[first:last], recorded.force[first:last]
        if last == first:
            continue
        if np.ptp(flexion) < _STILL and np.ptp(force) < _STEADY and force.min() > _STANDS:
            still[first:last] = True
    return [
        Stand(
            float(recorded.flexion[first:behind].mean()),
            float(recorded.force[first:behind].mean()),
        )
        for first, behind in _runs(still)
    ]


def weight_walked(recordings: Sequence[Recorded]) -> float:
    """Twice the mean force over strides [body weights], which is 1 if both legs bear the same; NaN without strides."""
    means = []
    for each in recordings:
        for stride in strides_of(each):
            inside = (each.time >= stride.strike) & (each.time <= stride.next_strike)
            impulse = np.trapezoid(each.force[inside], each.time[inside])
            means.append(2.0 * float(impulse) / (stride.next_strike - stride.strike))
    return float(np.mean(means)) if means else math.nan

"""The estimated total force: constants, errors, peaks, and whether the standard deviations that are told hold."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations, product
from statistics import fmean
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from knee_contact_ros import estimate_load
from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS, AxialDeviation, Estimator
from knee_contact_ros.joint_reaction.leg import GRAVITY, NOT_MEASURED, Ground
from knee_contact_ros.joint_reaction.muscles import Person as Constants
from knee_contact_ros.joint_reaction.walking import MEASURED_LOADS, StrideLoads, StridePhase
from knee_contact_ros.parameters.load_schema import PersonSection
from knee_contact_ros.streams.topics import JOINT_REACTION_FORCE, MESSAGE_TYPES, stamp_to_ns
from studies.validation.data import SECOND, SENSOR_LEVELS, WALKING, Flags, Floats, Walk, of

LANDING, MIDDLE = 0.1, 0.5
"""Parts of a stance: in the first one the force still falls from the heel strike's own peak, and has no peak"""
LEAST_CHANGE = 0.1
"""Change of a peak [body weights] from which its sign is asked for"""
LEAST, MOST = (0.5, 0.0, 0.0), (2.5, 2.0, 1.0)
"""Bounds of moment_arm_scale, co_contraction and tone in a fit"""
DEFAULT = PersonSection()
LATE = np.arange(-0.06, 0.0601, 0.005)
"""Delays [s] of an implant that are tried"""
STANCE_POINTS = len(MEASURED_LOADS.stance)
SWING_POINTS = len(MEASURED_LOADS.swing)
LONGEST_SWING = 0.6
"""Longest swing [s] that counts in a mean curve; a longer one is a step that was left out"""
FREE = ("moment_arm_scale", "co_contraction", "tone")


def constants(walk: Walk, values: Sequence[float] = ()) -> Constants:
    """Constants of a walk's person: `values` of `FREE`, or the defaults."""
    person = DEFAULT.constants._replace(mass=walk.person.mass, height=walk.person.height)
    return person._replace(**dict(zip(FREE, values, strict=bool(values))))


def axial(
    walk: Walk, level: str, person: Constants, loads: StrideLoads = MEASURED_LOADS
) -> Floats:
    """Joint reaction [N] of a walk by a level, shape (n,), with the code of the node."""
    estimator, stamps = Estimator(level, person, loads=loads), stamps_of(walk)
    rows = zip(stamps, walk.joints, walk.nets[level], walk.vertical.tolist(), strict=True)
    return np.array(
        [
            estimator.react(stamp, joints, Ground((0.0, force, 0.0), (NOT_MEASURED,) * 3), net, 0)[
                0
            ].axial
            for stamp, joints, net, force in rows
        ]
    )


def stamps_of(walk: Walk) -> list[int]:
    """Stamps [ns] of a walk's samples."""
    return list(np.rint(walk.time * SECOND).astype(np.int64).tolist())


def by_sensors(walk: Walk, level: str, values: Sequence[float]) -> float:
    """RMS error [body weights] of `estimate-load` on the bag of a walk, with our own inverse dynamics."""
    assert walk.sensors  # noqa: S101  (the caller chooses such walks)
    given = {"level": level} | {
        f"person.{name}": value for name, value in zip(FREE, values, strict=True)
    }
    body = {"person.mass": walk.person.body_weight / GRAVITY, "person.height": walk.person.height}
    found = estimate_load(str(walk.sensors), ["load/inverse_dynamics", given | body])
    measured = [
        (stamp_to_ns(each.message.header.stamp), -each.message.wrench.force.y)
        for each in read_bag(
            walk.sensors, {f"/{JOINT_REACTION_FORCE}": MESSAGE_TYPES[JOINT_REACTION_FORCE]}
        )
    ]
    stamps, forces = (np.array(column, dtype=np.float64) for column in zip(*measured, strict=True))
    error = found["axial_force"] - np.interp(found["stamp"].astype(np.float64), stamps, forces)
    return float(np.sqrt(np.mean(error**2))) / walk.person.body_weight


def weights(walks: Sequence[Walk]) -> list[float]:
    """Weight of each walk by which persons count the same, sessions of a person do, and walks of a session do."""
    names = {walk.person.name for walk in walks}
    keys = [walk.key for walk in walks]
    sessions = {name: len({walk.key for walk in of(list(walks), name)}) for name in names}
    return [
        1.0 / (len(names) * sessions[walk.person.name] * keys.count(walk.key)) for walk in walks
    ]


def clocks(walks: Sequence[Walk]) -> dict[str, float]:
    """Time [s] by which the implant of each session is late, by where it fits the sensors' estimate best.

    Implants, plates and cameras do not share a clock.
    """
    alone = DEFAULT.constants._replace(expected_load=0.0)
    found = {}
    for key in dict.fromkeys(walk.key for walk in walks):
        mine = [walk for walk in walks if walk.key == key]
        guesses = [
            (
                walk,
                axial(
                    walk, level, alone._replace(mass=walk.person.mass, height=walk.person.height)
                ),
            )
            for walk in mine
            for level in SENSOR_LEVELS
        ]
        errors = [
            fmean(
                rms(walk, np.interp(walk.time - late, walk.time, force)) for walk, force in guesses
            )
            for late in LATE
        ]
        found[key] = float(LATE[int(np.argmin(errors))])
    return found


def on_time(walks: Sequence[Walk], late: Mapping[str, float]) -> list[Walk]:
    """Walks whose implants have the sensors' clock."""
    return [
        walk._replace(
            total=np.interp(walk.time + late[walk.key], walk.time, walk.total),
            medial=np.interp(walk.time + late[walk.key], walk.time, walk.medial),
        )
        for walk in walks
    ]


def mean_loads(walks: Sequence[Walk]) -> StrideLoads:
    """Mean load [body weights] over stance and swing of the whole stances of walks, and of the swings behind them."""
    curves, parts = [], []
    for walk, part in zip(walks, weights(walks), strict=True):
        steps = walk.steps()
        for place, (first, last) in enumerate(steps):
            rest = [begin for begin, _ in steps[place + 1 :]] or [len(walk.time)]
            swing = walk.time[last - 1 : rest[0]]
            swing = swing[swing - swing[0] < LONGEST_SWING]
            times = np.concatenate(
                (
                    np.linspace(walk.time[first], walk.time[last - 1], STANCE_POINTS),
                    np.linspace(swing[0], swing[-1], SWING_POINTS),
                )
            )
            curves.append(np.interp(times, walk.time, walk.total) / walk.person.body_weight)
            parts.append(part / len(steps))
    mean = np.average(curves, axis=0, weights=parts)
    return StrideLoads(tuple(mean[:STANCE_POINTS].tolist()), tuple(mean[STANCE_POINTS:].tolist()))


def curve(walk: Walk, loads: StrideLoads) -> Floats:
    """Force [N] of a mean curve over the strides of a walk, shape (n,); NaN where the leg does not walk."""
    stride = StridePhase(loads)
    rows = zip(stamps_of(walk), (walk.vertical / walk.person.body_weight).tolist(), strict=True)
    found = [stride.expect_load(*row) for row in rows]
    return np.array(
        [each.load * walk.person.body_weight if each.certainty else np.nan for each in found]
    )


def fitted(
    walks: Sequence[Walk], levels: Sequence[str], scale: float | None = None
) -> tuple[float, ...]:
    """Fit `FREE` to the sensors' estimate at levels by least squares; `scale` is that of the moment arms, if given."""
    given = () if scale is None else (scale,)

    def misfit(numbers: Floats) -> Floats:
        values = (*given, *numbers.tolist())
        return np.concatenate(
            [
                np.sqrt(weight / walk.used.sum())
                / walk.person.body_weight
                * (alone(walk, level, values) - walk.total)[walk.used]
                for walk, weight in zip(walks, weights(walks), strict=True)
                for level in levels
            ]
        )

    begin = len(given)
    found = least_squares(
        misfit,
        (1.2, 0.4, 0.3)[begin:],
        bounds=(LEAST[begin:], MOST[begin:]),
        xtol=1e-4,
        ftol=1e-4,
        diff_step=1e-3,
    )
    return (*given, *(round(float(each), 3) for each in found.x))


def alone(walk: Walk, level: str, values: Sequence[float]) -> Floats:
    """Joint reaction [N] by the sensors alone, shape (n,)."""
    return axial(walk, level, constants(walk, values)._replace(expected_load=0.0))


def line(walks: Sequence[Walk]) -> Callable[[Walk], Floats]:
    """Line in the ground force, a + k F, fitted to walks: gives the axial force [N] of another one."""
    rows = [
        (
            np.sqrt(weight / walk.used.sum()),
            walk.vertical[walk.used] / walk.person.body_weight,
            walk.total[walk.used] / walk.person.body_weight,
        )
        for walk, weight in zip(walks, weights(walks), strict=True)
    ]
    known = np.concatenate(
        [np.stack((np.full(len(force), part), part * force), axis=1) for part, force, _ in rows]
    )
    offset, slope = np.linalg.lstsq(
        known, np.concatenate([part * total for part, _, total in rows]), rcond=None
    )[0]
    return lambda walk: np.asarray(offset * walk.person.body_weight + slope * walk.vertical)


def rms(walk: Walk, force: Floats, within: Flags | None = None) -> float:
    """RMS error [body weights] of an axial force [N], shape (n,), over the samples that are used and known."""
    used = walk.used & np.isfinite(force)
    error = (force - walk.total)[used if within is None else used & within]
    return float(np.sqrt(np.mean(error**2))) / walk.person.body_weight


def peaks(walk: Walk, force: Floats) -> Floats:
    """Largest force [body weights] in both halves of every whole stance, shape (m, 2)."""
    found = []
    for first, last in walk.steps():
        phase = (walk.time - walk.time[first]) / (walk.time[last] - walk.time[first])
        halves = ((phase >= LANDING) & (phase < MIDDLE), (phase >= MIDDLE) & (phase < 1.0))
        found.append([force[half].max() / walk.person.body_weight for half in halves])
    return np.array(found).reshape(-1, 2)


def peak_errors(walk: Walk, force: Floats) -> Floats:
    """Error of both peaks of every stance, as a part of the measured one, shape (m, 2)."""
    return peaks(walk, force) / peaks(walk, walk.total) - 1.0


def same_signs(found: Sequence[Estimate]) -> list[tuple[int, int]]:
    """How often the estimate tells which of two strides of a session has the larger peak, and of how many pairs.

    Asked for pairs whose measured peaks differ by `LEAST_CHANGE` or more; first peak, then second.
    """
    counts = [[0, 0], [0, 0]]
    for key in dict.fromkeys(each.walk.key for each in found):
        mine = [each for each in found if each.walk.key == key]
        truth = np.concatenate([peaks(each.walk, each.walk.total) for each in mine])
        guess = np.concatenate([peaks(each.walk, each.force) for each in mine])
        for which in (0, 1):
            for one, two in combinations(range(len(truth)), 2):
                difference = truth[one, which] - truth[two, which]
                if abs(difference) >= LEAST_CHANGE:
                    counts[which][0] += int(
                        difference * (guess[one, which] - guess[two, which]) > 0
                    )
                    counts[which][1] += 1
    return [(right, asked) for right, asked in counts]


class Estimate(NamedTuple):
    """An axial force that was estimated without what it is judged by."""

    walk: Walk
    level: str
    how: str
    """`OTHERS`, `SENSORS`, `CURVE` or `OWN`"""
    values: tuple[float, ...]
    """Constants, see `FREE`"""
    force: Floats
    """Axial force [N], shape (n,)"""


OTHERS = "others"
"""As shipped, with constants and mean curve of the other persons"""
SENSORS = "others, sensors alone"
"""The same without the expected load"""
OWN = "own trials"
"""As shipped, with constants of the person's other trials, and the mean curve of the other persons"""
CURVE = "mean curve"
"""The mean curve of the other persons alone"""
WAYS = (SENSORS, OTHERS, OWN)
CALIBRATED_AT = "knee_moment"
"""Level at which a person's own constants are fitted"""


def estimates(walks: Sequence[Walk]) -> list[Estimate]:
    """Estimates of all walks at all levels; nothing is chosen on the person that it is judged on."""
    timed = on_time(walks, clocks(walks))
    found = []
    for name in dict.fromkeys(walk.person.name for walk in walks):
        others = [each for each in timed if each.person.name != name and each.movement == WALKING]
        loads = mean_loads(others)
        values = fitted(others, SENSOR_LEVELS, DEFAULT.moment_arm_scale)
        for walk in of(list(walks), name):
            own = [
                each
                for each in timed
                if (each.person.name, each.movement) == (name, walk.movement)
                and each.name != walk.name
            ]
            mine = fitted(own, [CALIBRATED_AT]) if own else ()
            found.append(Estimate(walk, "", CURVE, (), curve(walk, loads)))
            for level in LOAD_LEVELS:
                shared = constants(walk, values)
                found += [
                    Estimate(walk, level, SENSORS, values, alone(walk, level, values)),
                    Estimate(walk, level, OTHERS, values, axial(walk, level, shared, loads)),
                ]
                if mine:
                    force = axial(walk, level, constants(walk, mine), loads)
                    found.append(Estimate(walk, level, OWN, mine, force))
    return found


def by_session(found: Sequence[Estimate], value: Callable[[Estimate], float]) -> dict[str, float]:
    """Mean of a value over the walks of each person's session."""
    keys = dict.fromkeys(each.walk.key for each in found)
    return {key: fmean(value(each) for each in found if each.walk.key == key) for key in keys}


def person_mean(sessions: Mapping[str, float]) -> float:
    """Mean over persons of the mean over each person's sessions."""
    names = dict.fromkeys(key.split()[0] for key in sessions)
    return fmean(
        fmean(value for key, value in sessions.items() if key.split()[0] == name) for name in names
    )


def errors_of(found: Sequence[Estimate]) -> dict[str, float]:
    """RMS errors [BW] of estimates by session."""
    return by_session(found, lambda each: rms(each.walk, each.force))


def covered(each: Estimate, deviation: AxialDeviation, stance: bool) -> tuple[float, float]:
    """Parts of the used samples, in stance or in swing, whose error is within one and two standard deviations."""
    weight = each.walk.person.body_weight
    told = np.hypot(deviation.floor * weight, deviation.part * each.force)
    within = each.walk.used & (each.walk.stance == stance)
    off = (np.abs(each.force - each.walk.total) / told)[within]
    return float(np.mean(off < 1.0)), float(np.mean(off < 2.0))


WANTED = (0.68, 0.95)
"""Parts of the samples that one and two standard deviations shall cover"""
FLOORS, PARTS = np.arange(0.05, 0.61, 0.025), np.arange(0.0, 0.31, 0.025)


def deviation_of(found: Sequence[Estimate]) -> AxialDeviation:
    """Smallest deviation that covers `WANTED` in stance and in swing, on average over persons."""

    def short(deviation: AxialDeviation) -> float:
        parts = [
            person_mean(
                by_session(found, lambda each, s=stance, w=which: covered(each, deviation, s)[w])  # type: ignore[misc]
            )
            for stance in (True, False)
            for which in (0, 1)
        ]
        return sum(
            max(want - part, 0.0) for part, want in zip(parts, (*WANTED, *WANTED), strict=True)
        )

    def size(deviation: AxialDeviation) -> float:
        return sum(
            float(
                np.mean(
                    np.hypot(
                        deviation.floor, deviation.part * each.force / each.walk.person.body_weight
                    )
                )
            )
            for each in found
        )

    tried = [AxialDeviation(float(floor), float(part)) for floor, part in product(FLOORS, PARTS)]
    return min(tried, key=lambda each: (round(float(short(each)), 4), size(each)))

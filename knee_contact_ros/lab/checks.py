"""Limits on imported values: a value beyond them points to a wrong unit, sign, column or frame.

OpenSim's files say what they contain, so a contradiction raises a UsageError. For other files the user's map says what
they contain: an `impossible` value is never imported, and one that raises `doubts` is imported only if the user
insists. Both come as sentences, which `outside` writes.
"""

import math
from pathlib import Path

import numpy as np

from ..joint_reaction.conventions import LegCheck
from ..joint_reaction.estimator import (
    MAX_LOAD_PEAK,
    MAX_PULL,
    MIN_BODY_WEIGHT,
    MIN_LOAD_PEAK,
    MIN_RANGE_OF_MOTION,
    body_weight_doubt,
)
from ..joint_reaction.leg import Ground, Joints
from ..model.inputs import (
    CLEAR_RATIO,
    MAX_RANGE_OF_MOTION,
    STEP_FLEXION,
    InputCheck,
)
from ..model.knee import LARGEST_ANGLE, LARGEST_LOAD
from ..model.types import MAX_FLEXION, MIN_FLEXION, Floats, Stamps
from ..streams.topics import NANOSECONDS, NET_LOAD
from ..system.errors import UsageError
from .gait_bag import ImportedGait
from .tables import Table, TimeSeries
from .units import (
    BODY_WEIGHTS,
    PERCENT_BODY_WEIGHT,
    TYPICAL_BODY_WEIGHT,
    unit_factor,
)

Limits = tuple[float, float]
"""Smallest and largest plausible value"""

_LARGEST_RADIANS = 3.5
"""No knee reaches this angle in rad; a range in deg below it could also be in rad"""
_LEAST_FLEXION = (math.degrees(MIN_FLEXION), 90.0)
"""Limits of the smallest flexion [deg]: a knee is less bent than that at some time in every step"""
_MOST_FLEXION = (math.degrees(MIN_FLEXION), 160.0)
"""Limits of the largest flexion [deg]: no knee under load is bent further"""
_LARGEST_BODY_WEIGHT = 2500.0
"""Largest body weight [N] that is possible"""
_LOAD_PEAKS = (MIN_LOAD_PEAK, MAX_LOAD_PEAK)
"""Limits of the peak load [BW]"""
_USUAL_LOAD_PEAKS = (1.5, 4.0)
"""The narrower range [BW] of a peak load by which the right unit is guessed"""
GROUND_PEAKS = (0.4, 5.0), (0.9, 1.6)
"""The same two ranges for the ground's force on a foot, and for the net force of the knee"""
_NET_MOMENTS = (5.0, 300.0)
"""Limits of the largest net moment [N m] of the knee: in N m/kg it is less, and so is that of a contact force"""
_FOOT_STANDS = 100.0
"""Vertical force [N] that a walking foot exceeds"""


def angle_unit_of(table: Table, column: str, requested: str) -> str:
    """Return the unit of an angle's column, `deg` or `rad`: the requested one, or the header's if the values fit it.

    Raises:
        UsageError: header and values contradict each other, or the unit is not clear.
    """
    if requested != "auto":
        return requested
    values = table.column(column)
    span = f"{column} goes from {values.min():.3g} to {values.max():.3g}"
    likely = "deg" if np.abs(values).max() > _LARGEST_RADIANS else "rad"
    if table.degrees is None and likely == "rad":
        raise UsageError(
            f"{table.path} does not say inDegrees, and {span}; give --angle-unit deg or rad"
        )
    if table.degrees not in (None, likely == "deg"):
        entry, like = ("yes", "rad") if table.degrees else ("no", "degrees")
        raise UsageError(
            f"{table.path} says inDegrees={entry}, but {span}, like {like}; give --angle-unit deg or rad"
        )
    return likely


def flexion_sign_of(
    angle: Floats, where: str, requested: int | None, bounds: tuple[float, float] | None
) -> int:
    """Return the sign that makes an angle [rad] positive in flexion, 1 or -1.

    A requested sign wins. Otherwise it follows from the data, as a walking knee flexes far more than it extends, and
    failing that from `bounds`, the coordinate's range [rad] in the model. `where` names file and column in messages.

    Raises:
        UsageError: the sign is impossible for a knee, or is not clear.
    """
    low, high = float(angle.min()), float(angle.max())
    span = f"{where} goes from {math.degrees(low):.1f} to {math.degrees(high):.1f} deg"
    sign = requested or _clear_sign(low, high) or (_clear_sign(*bounds) if bounds else 0)
    if not sign:
        raise UsageError(f"{span}: which sign is flexion? Give --angle-sign 1 or -1, or --model")
    lowest, highest = (low, high) if sign > 0 else (-high, -low)
    if lowest < MIN_FLEXION or highest > MAX_FLEXION:
        raise UsageError(
            f"{span}; with sign {sign:+d} that is {math.degrees(lowest):.1f} to {math.degrees(highest):.1f} deg of "
            f"flexion, and a knee has {math.degrees(MIN_FLEXION):.0f} to {math.degrees(MAX_FLEXION):.0f}: "
            "see --angle-sign and --angle-unit"
        )
    return sign


def _clear_sign(low: float, high: float) -> int:
    """Return the sign of flexion: 1 or -1 if a range of angles [rad] reaches clearly further to one side, else 0."""
    if high >= STEP_FLEXION and high >= -CLEAR_RATIO * low:
        return 1
    return -1 if -low >= STEP_FLEXION and -low >= CLEAR_RATIO * high else 0


def outside(
    where: object, what: str, value: float, unit: str, limits: Limits, cure: str
) -> list[str]:
    """Write that a value is outside its limits: file and column, quantity, value, what is plausible, and a cure."""
    if limits[0] <= value <= limits[1]:
        return []
    low, high = (f"{limit:.5g}" for limit in limits)
    if limits[1] == math.inf:
        plausible = f"{low} or more"
    else:
        plausible = f"{high} or less" if limits[0] == -math.inf else f"{low} to {high}"
    number = f"{value:.5g} {unit}".rstrip()
    return [f"{where}: {what} is {number}, plausible is {plausible}: {cure}"]


def refuse(sentences: list[str], anyway: bool | None = None) -> None:
    """Raise a UsageError with the first sentence, if any, unless `anyway` (None: the user cannot override it)."""
    if sentences and not anyway:
        hint = " (--anyway imports it as it is)" if anyway is False else ""
        raise UsageError(sentences[0] + hint)


def refuse_outside(
    where: object, what: str, value: float, unit: str, limits: Limits, cure: str
) -> None:
    """Refuse a value that is outside its limits; arguments as for `outside`."""
    refuse(outside(where, what, value, unit, limits, cure))


def check_rate(given: Floats, derived: Floats, where: str) -> None:
    """Refuse a given rate [rad/s] that disagrees with the one derived from the angle; shapes (n,)."""
    power = float(derived @ derived)
    # A rate below 0.1 rad/s RMS is not checked.
    if power <= 0.1**2 * len(derived):
        return
    ratio = float(given @ derived) / power
    cure = "another unit than its inDegrees says, or another coordinate's?"
    refuse_outside(where, "its ratio to the rate of the angle", ratio, "", (0.5, 2.0), cure)


def check_upright(up: Floats, where: str) -> None:
    """Refuse a vertical ground force, shape (n,), that does not act upwards as on a walking foot."""
    limits = (max(_FOOT_STANDS, -float(up.min())), math.inf)
    cure = "it must be in N, upwards, and the force of the ground on the foot"
    refuse_outside(where, "the peak", float(up.max()), "", limits, cure)


def check_near(arm: Floats, up: Floats, where: str) -> None:
    """Refuse centres of pressure that are not near the foot.

    `arm` [m] is from the ankle to each, shape (n, 3), and `up` the vertical force [N], shape (n,).
    """
    standing = arm[up >= _FOOT_STANDS]
    away = float(np.median(np.hypot(standing[:, 0], standing[:, 2]))) if len(standing) else 0.0
    what = "the median distance to the ankle of a standing foot"
    cure = "is it the other foot's, not in m, or in other axes than the model's?"
    # The centre of pressure is under the foot, so it is less than a foot's length from the ankle.
    refuse_outside(where, what, away, "m", (0.0, 0.30), cure)


def check_heading(forward: Floats, path: Path) -> None:
    """Refuse a person who does not face towards x; `forward` is the direction of the pelvis, shape (n, 3)."""
    ahead = float(forward[:, 0].mean())
    what = "the mean x component of the pelvis's direction"
    cure = "turn markers and ground reactions about y, so that the person walks towards x"
    # The person walks within about 45 degrees of x.
    refuse_outside(path, what, ahead, "", (0.7, 1.0), cure)


def impossible(
    angle: TimeSeries, load: TimeSeries | None = None, *, mapped: bool = True
) -> list[str]:
    """Return why these cannot be an angle and a load at all; empty if they can. OpenSim's are not `mapped`."""
    cure = f"is {angle.name}.unit right, and is it a knee's angle?"
    low, high = np.degrees([angle.values.min(), angle.values.max()])
    widest = (0.0, math.degrees(MAX_RANGE_OF_MOTION))
    largest = (0.0, math.degrees(LARGEST_ANGLE))
    sentences = outside(angle.where, "the range of motion", high - low, "deg", widest, cure)
    sentences += outside(angle.where, "the largest angle", max(-low, high), "deg", largest, cure)
    if load:
        least = float(load.values.min())
        most = float(load.values.max())
        if most < -least:
            direction = (
                "positive as the map's load.direction says" if mapped else "and not on the femur"
            )
            sentences.append(
                f"{load.where} pulls the knee apart by up to {-least:.0f} N, and presses with {most:.4g} N at most: "
                f"is it the force on the tibia, {direction}?"
            )
        cure = "is load.unit right?"
        sentences += outside(load.where, "the peak", most, "N", (0.0, LARGEST_LOAD), cure)
    return sentences


def gait_doubts(
    angle: TimeSeries,
    load: TimeSeries | None,
    unit: str | None,
    weight: float | None,
    max_gap: float,
    moment: TimeSeries | None = None,
    *,
    mapped: bool = True,
) -> list[str]:
    """List what is likely a mistake.

    `unit` is the load's in the map, `weight` the body's [N]; a longer time between rows than `max_gap` [s] is a gap.
    OpenSim's results are not `mapped`.
    """
    where = angle.where
    ask = "are its times in s, and not in milliseconds?"
    cure = "is it the included angle?"
    if mapped:
        ask = "is time.unit right (s, milliseconds), or does it count frames (time.rate)?"
        cure = (
            f"is {angle.name}.sign right, or has the sensor an offset ({angle.name}.offset, or knee-contact align)? "
            "The included angle has sign: -1, offset: 180 (in deg)"
        )
    found = [body_weight_doubt(weight)] if weight is not None and body_weight_doubt(weight) else []
    found += _rate_doubts(angle.path, angle.stamps, ask)
    if load:
        found += _rate_doubts(load.path, load.stamps, ask)
    if mapped:
        found += joint_doubts(angle)
    low, high = np.degrees([angle.values.min(), angle.values.max()])
    found += outside(where, "the least flexion", low, "deg", _LEAST_FLEXION, cure)
    found += outside(where, "the largest flexion", high, "deg", _MOST_FLEXION, cure)
    # After a gap, any angle is possible.
    no_gap = np.diff(angle.stamps) <= max_gap * NANOSECONDS
    steps = np.degrees(np.abs(np.diff(angle.values)) * no_gap)
    worst = int(np.argmax(steps))
    step = f"the step at {angle.stamps[worst + 1] / NANOSECONDS:.13g} s"
    cure = "a loose contact, or an encoder's turn?"
    found += outside(where, step, float(steps[worst]), "deg", (0.0, 30.0), cure)
    turning = InputCheck(load_driven=False)
    turning.add_samples(angle.stamps, angle.values, np.zeros(len(angle.stamps)))
    if turning.about_turning:
        found.append(f"{where}: {turning.about_turning}")
    if load:
        found += _net_force_doubts(angle, load, weight)
        least = float(load.values.min())
        limits = (-MAX_PULL * (weight or TYPICAL_BODY_WEIGHT), math.inf)
        cure = "does it stand for a missing one?"
        found += outside(load.where, "the least load", least, "N", limits, cure)
        found += _spike_doubts(load, weight or TYPICAL_BODY_WEIGHT)
        found += peak_doubts(load, unit, weight)
    if moment:
        most = float(np.abs(moment.values).max())
        # The body weight at 12 cm from the middle; larger moments are spikes where feet change plates.
        limits = (0.0, 0.12 * (weight or _LARGEST_BODY_WEIGHT))
        cure = "is moment.unit right, or a spike?"
        found += outside(moment.where, "the largest moment", most, "N m", limits, cure)
    return list(dict.fromkeys(found))


def _net_force_doubts(angle: TimeSeries, load: TimeSeries, weight: float | None) -> list[str]:
    """Doubt about a load that has no muscle forces in it; the angle is interpolated at its stamps."""
    first = angle.stamps[0]
    inside = (load.stamps >= first) & (load.stamps <= angle.stamps[-1])
    stamps, loads = load.stamps[inside], load.values[inside]
    if not len(stamps):
        return []
    seen = InputCheck(weight, share=1.0)
    seen.add_samples(stamps, np.interp(stamps - first, angle.stamps - first, angle.values), loads)
    return [f"{load.where}: {seen.about_net_force}"] if seen.about_net_force else []


def _rate_doubts(where: object, stamps: Stamps, cure: str) -> list[str]:
    """Doubt about the number of rows a second, from increasing stamps [ns], shape (n,)."""
    if len(stamps) < 2:
        return []
    rate = NANOSECONDS / float(np.median(np.diff(stamps)))
    return outside(where, "the number of rows a second", rate, "", (5.0, 1e4), cure)


def joint_doubts(series: TimeSeries) -> list[str]:
    """List what is likely a mistake of a joint's angle."""
    span = math.degrees(np.ptp(series.values))
    limits = (math.degrees(MIN_RANGE_OF_MOTION), math.inf)
    return outside(series.where, "the range of motion", span, "deg", limits, _joint_cure(series))


def torque_doubts(series: TimeSeries) -> list[str]:
    """List what is likely a mistake of an actuator's torque."""
    most = float(np.abs(series.values).max())
    limits = (0.0, 300.0)
    return outside(series.where, "the largest torque", most, "N m", limits, _joint_cure(series))


def net_doubts(
    force: TimeSeries, moment: TimeSeries, unit: str | None, weight: float | None
) -> list[str]:
    """List what is likely a mistake of the knee's net load; see `peak_doubts`."""
    most = float(np.abs(moment.values).max())
    cure = "are its unit and column right, and is it of inverse dynamics, without muscles?"
    return [
        *peak_doubts(force, unit, weight, *GROUND_PEAKS),
        *outside(moment.where, "the largest net moment", most, "N m", _NET_MOMENTS, cure),
    ]


def _joint_cure(series: TimeSeries) -> str:
    return f"is {series.name}.unit right, and is it this joint's?"


def unusual(load: TimeSeries, weight: float | None) -> list[str]:
    """List what may be a mistake if no body weight [N] is given to judge the load by."""
    if weight:
        return []
    peak = float(load.values.max())
    cure = "percent of body weight, kN, or a spike? Give a body weight to be sure"
    # A person whose weight is not known may be light or heavy.
    return outside(load.where, "the peak", peak, "N", (400.0, 8000.0), cure)


def _spike_doubts(load: TimeSeries, weight: float) -> list[str]:
    """Doubt about rows that are far above both neighbours."""
    inner = load.values[1:-1]
    beside = np.maximum(load.values[:-2], load.values[2:])
    # A spike is more than twice as high as both neighbouring rows, and above them by 1.5 body weights. Both are tuned.
    above = np.where(inner > 2.0 * beside, inner - beside, 0.0)
    if not above.size:
        return []
    row = int(np.argmax(above))
    what = f"the step up to {inner[row]:.5g} N at {load.stamps[row + 1] / NANOSECONDS:.13g} s"
    limits = (0.0, 1.5 * weight)
    return outside(load.where, what, float(above[row]), "N", limits, "a spike?")


def peak_doubts(
    load: TimeSeries,
    unit: str | None,
    weight: float | None,
    limits: Limits = _LOAD_PEAKS,
    usual: Limits = _USUAL_LOAD_PEAKS,
) -> list[str]:
    """Doubt about a peak that is not of the order of the body weight, with the unit in which it would be right.

    `unit` is the map's, None for OpenSim's files. `limits` and `usual` [BW] are where the peak may be, and where it
    is if a hint at another unit is right.
    """
    peak = float(load.values.max())
    if unit is None:
        cure = "is it of this person (model), in N, and without spikes?"
    else:
        cure = f"is {load.name}.unit {unit} right, and is it a load's column?"
    if weight is None:
        in_newtons = (limits[0] * MIN_BODY_WEIGHT, limits[1] * _LARGEST_BODY_WEIGHT)
        return outside(load.where, "the peak", peak, "N", in_newtons, cure)
    if unit is not None:
        in_unit = peak / unit_factor(unit, "force", "load", weight)
        for other in (PERCENT_BODY_WEIGHT, BODY_WEIGHTS, "kN", "kgf", "N", "lbf", "N/kg"):
            body_weights = in_unit * unit_factor(other, "force", "load", weight) / weight
            if usual[0] <= body_weights <= usual[1]:
                cure = f"is {load.name}.unit {unit} right? In {other} it would be {body_weights:.2g} body weights"
    what = f"the peak of {peak:.4g} N"
    return outside(load.where, what, peak / weight, "body weights", limits, cure)


def convention_doubts(gait: ImportedGait, weight: float | None) -> list[str]:
    """Doubt about conventions of the leg's angles and of the ground force; see `LegCheck`."""
    net = "ground_force" not in gait.wrenches
    if weight is None or (net and NET_LOAD not in gait.wrenches):
        return []
    stamps, wrenches = gait.wrenches[NET_LOAD if net else "ground_force"]
    knee, *others = gait.joints.values()
    unknown = knee._replace(values=np.full((len(knee.stamps), 1), np.nan))
    named = dict(zip(list(gait.joints)[1:], others, strict=True))
    joints = [knee, named.get("hip", unknown), named.get("ankle", unknown)]
    angles = np.column_stack([joint.at(stamps).values[:, 0] for joint in joints])
    seen = LegCheck(weight, net)
    rows = zip(stamps.tolist(), angles.tolist(), wrenches.tolist(), strict=True)
    for stamp, of_joints, (x, y, z, *torque) in rows:
        ground = Ground((x, -y if net else y, z), tuple(torque))
        seen.add_sample(stamp, Joints(*of_joints), ground)
    return seen.sentences

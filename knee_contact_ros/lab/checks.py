"""Limits on imported values: a value beyond them points to a wrong unit, sign, column or frame.

OpenSim's files say what they contain, so a contradiction raises a UsageError. For other files the user's map says what
they contain: an `impossible` value is never imported, and one that raises `doubts` is imported only if the user
insists. Both come as sentences, which `outside` writes.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from knee_contact_ros.joint_reaction.estimator import (
    LARGEST_PULL,
    LEAST_PEAK,
    LIGHTEST,
    MOST_PEAK,
    STIFF,
    weight_doubt,
)
from knee_contact_ros.lab.tables import (
    BODY_WEIGHT,
    FORCE,
    MIDDLE_WEIGHT,
    PERCENT,
    Series,
    Table,
    factor,
)
from knee_contact_ros.model.inputs import CLEAR, TIMES_MORE, WIDEST
from knee_contact_ros.model.knee import LARGEST_ANGLE, LARGEST_LOAD
from knee_contact_ros.model.types import MAX_FLEXION, MIN_FLEXION, Floats, Stamps
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError

Range = tuple[float, float]
LARGEST_RADIANS = 3.5
"""No knee reaches this angle in rad; a range in deg below it could also be in rad"""
EXTENDED, BENT, FOLDED = math.degrees(MIN_FLEXION), 90.0, 160.0
"""Flexion [deg]: never less; less at some time in every step; never more under load"""
SPIKE, ALONE = 1.5, 2.0
"""A row is a spike if it exceeds both neighbours by this load [BW], and by this factor"""
JUMP = 30.0
"""Step [deg] between rows that points to a loose contact, or to an encoder that begins a new turn"""
RATES = (5.0, 1e4)
"""Plausible rates of rows [Hz]"""
IN_SECONDS = "are its times in s, and not in milliseconds?"
MOVES, FITS = 0.1, (0.5, 2.0)
"""RMS of the rate [rad/s] below which a given rate is not checked; plausible ratios of given to derived rate"""
HEAVIEST = 2500.0
"""Largest body weight [N] that is possible"""
USUAL_LOAD = (400.0, 8000.0)
"""Peak loads [N] outside which the user is asked for a body weight"""
PEAK, RIGHT_PEAK = (LEAST_PEAK, MOST_PEAK), (1.5, 4.0)
"""Plausible peaks of the load [BW], and the narrower range by which the right unit is guessed"""
OF_GROUND = (0.4, 5.0), (0.9, 1.6)
"""The same for the ground's force on a foot"""
LARGEST_MOMENT = 0.12
"""Largest frontal moment [m times the body weight]; larger ones are spikes where feet change plates"""
MOST_TORQUE = 300.0
"""Largest plausible torque [N m] of an actuator"""
STANDS, NEAR = 100.0, 0.30
"""Vertical force [N] that a walking foot exceeds, and the largest median horizontal distance [m] from the ankle to the
centre of pressure during such times: more than a foot's length"""
AHEAD = 0.7
"""Smallest mean x component of the pelvis's forward direction: within 45 degrees of x"""


def unit_of(table: Table, column: str, requested: str) -> str:
    """Unit of an angle's column, `deg` or `rad`: the requested one, or with `auto` the header's if the values allow it.

    Raises:
        UsageError: header and values contradict each other, or the unit is not clear.
    """
    if requested != "auto":
        return requested
    values = table.column(column)
    reach, span = (
        float(np.abs(values).max()),
        f"{column} goes from {values.min():.3g} to {values.max():.3g}",
    )
    likely = "deg" if reach > LARGEST_RADIANS else "rad"
    if table.degrees is None and likely == "rad":
        raise UsageError(
            f"{table.path} does not say inDegrees, and {span}; give --angle-unit deg or rad"
        )
    if table.degrees not in (None, likely == "deg"):
        says, like = ("yes", "rad") if table.degrees else ("no", "degrees")
        raise UsageError(
            f"{table.path} says inDegrees={says}, but {span}, like {like}; give --angle-unit deg or rad"
        )
    return likely


def sign_of(
    angle: Floats, where: str, requested: int | None, bounds: tuple[float, float] | None
) -> int:
    """Sign that makes an angle [rad] positive in flexion, 1 or -1.

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
    """Sign of flexion: 1 or -1 if a range of angles [rad] reaches clearly further to one side, else 0."""
    if high >= CLEAR and high >= -TIMES_MORE * low:
        return 1
    return -1 if -low >= CLEAR and -low >= TIMES_MORE * high else 0


def outside(
    where: object, what: str, value: float, unit: str, limits: Range, cure: str
) -> list[str]:
    """Write that a value is outside its limits: file and column, quantity, value, what is plausible, and a cure."""
    if limits[0] <= value <= limits[1]:
        return []
    low, high = (f"{limit:.5g}" for limit in limits)
    plausible = f"{low} or more" if limits[1] == math.inf else f"{high} or less"
    if np.isfinite(limits).all():
        plausible = f"{low} to {high}"
    return [
        f"{where}: {what} is {value:.5g}{unit and ' '}{unit}, plausible is {plausible}: {cure}"
    ]


def refuse(sentences: list[str], anyway: bool | None = None) -> None:
    """Raise a UsageError with the first sentence, if any, unless `anyway` (None: the user cannot override it)."""
    if sentences and not anyway:
        raise UsageError(sentences[0] + " (--anyway imports it as it is)" * (anyway is False))


def check_rate(given: Floats, derived: Floats, where: str) -> None:
    """Refuse a given rate [rad/s] that disagrees with the one derived from the angle; shapes (n,)."""
    power = float(derived @ derived)
    slope = float(given @ derived) / power if power > MOVES**2 * len(derived) else 1.0
    cure = "another unit than its inDegrees says, or another coordinate's?"
    refuse(outside(where, "its ratio to the rate of the angle", slope, "", FITS, cure))


def check_upright(up: Floats, where: str) -> None:
    """Refuse a vertical ground force, shape (n,), that does not act upwards as on a walking foot."""
    limits = (max(STANDS, -float(up.min())), math.inf)
    cure = "it must be in N, upwards, and the force of the ground on the foot"
    refuse(outside(where, "the peak", float(up.max()), "", limits, cure))


def check_near(arm: Floats, up: Floats, where: str) -> None:
    """Refuse centres of pressure that are not near the foot.

    `arm` [m] is from the ankle to each, shape (n, 3), and `up` the vertical force [N], shape (n,).
    """
    standing = arm[up >= STANDS]
    away = float(np.median(np.hypot(standing[:, 0], standing[:, 2]))) if len(standing) else 0.0
    cure = "is it the other foot's, not in m, or in other axes than the model's?"
    refuse(
        outside(
            where,
            "the median distance to the ankle of a standing foot",
            away,
            "m",
            (0.0, NEAR),
            cure,
        )
    )


def check_heading(forward: Floats, path: Path) -> None:
    """Refuse a person who does not face towards x; `forward` is the direction of the pelvis, shape (n, 3)."""
    cure = "turn markers and ground reactions about y, so that the person walks towards x"
    ahead = float(forward[:, 0].mean())
    refuse(
        outside(
            path, "the mean x component of the pelvis's direction", ahead, "", (AHEAD, 1.0), cure
        )
    )


def impossible(angle: Series, load: Series | None = None, *, mapped: bool = True) -> list[str]:
    """Return why these cannot be an angle and a load at all; empty if they can. OpenSim's are not `mapped`."""
    cure = f"is {angle.name}.unit right, and is it a knee's angle?"
    direction = "positive as the map's load.direction says" if mapped else "and not on the femur"
    low, high = np.degrees([angle.values.min(), angle.values.max()])
    sentences = outside(
        angle.where, "the range of motion", high - low, "deg", (0.0, math.degrees(WIDEST)), cure
    )
    largest = (0.0, math.degrees(LARGEST_ANGLE))
    sentences += outside(angle.where, "the largest angle", max(-low, high), "deg", largest, cure)
    if load:
        least, most = float(load.values.min()), float(load.values.max())
        if most < -least:
            pulls = f"{load.where} pulls the knee apart by up to {-least:.0f} N, and presses with {most:.4g} N at most"
            sentences.append(f"{pulls}: is it the force on the tibia, {direction}?")
        sentences += outside(
            load.where, "the peak", most, "N", (0.0, LARGEST_LOAD), "is load.unit right?"
        )
    return sentences


def doubts(
    angle: Series,
    load: Series | None,
    unit: str | None,
    weight: float | None,
    max_gap: float,
    moment: Series | None = None,
    *,
    mapped: bool = True,
) -> list[str]:
    """List what is likely a mistake.

    `unit` is the load's in the map, `weight` the body's [N]; a longer time between rows than `max_gap` [s] is a gap.
    OpenSim's results are not `mapped`.
    """
    name, where, low = angle.name, angle.where, math.degrees(angle.values.min())
    ask, cure = IN_SECONDS, "is it the included angle?"
    if mapped:
        ask = "is time.unit right (s, milliseconds), or does it count frames (time.rate)?"
        cure = (
            f"is {name}.sign right, or has the sensor an offset ({name}.offset, or knee-contact align)? The "
            "included angle has sign: -1, offset: 180 (in deg)"
        )
    no_gap = np.diff(angle.stamps) <= max_gap * NANOSECONDS  # after a gap any angle is possible
    steps = np.degrees(np.abs(np.diff(angle.values)) * no_gap)
    worst = int(np.argmax(steps))
    jump = f"the step at {angle.stamps[worst + 1] / NANOSECONDS:.7g} s"
    found = [weight_doubt(weight)] if weight is not None and weight_doubt(weight) else []
    for series in filter(None, (angle, load)):
        found += rate_doubts(series.path, series.stamps, ask)
    found += joint_doubts(angle) if mapped else []
    found += outside(where, "the least flexion", low, "deg", (EXTENDED, BENT), cure)
    found += outside(
        where,
        "the largest flexion",
        math.degrees(angle.values.max()),
        "deg",
        (EXTENDED, FOLDED),
        cure,
    )
    found += outside(
        where,
        jump,
        float(steps[worst]),
        "deg",
        (0.0, JUMP),
        "a loose contact, or an encoder's turn?",
    )
    if load:
        least, pull = float(load.values.min()), -LARGEST_PULL * (weight or MIDDLE_WEIGHT)
        found += outside(
            load.where,
            "the least load",
            least,
            "N",
            (pull, math.inf),
            "does it stand for a missing one?",
        )
        found += _spike(load, weight or MIDDLE_WEIGHT) + peak_doubts(load, unit, weight)
    if moment:
        most, limits = (
            float(np.abs(moment.values).max()),
            (0.0, LARGEST_MOMENT * (weight or HEAVIEST)),
        )
        found += outside(
            moment.where,
            "the largest moment",
            most,
            "N m",
            limits,
            "is moment.unit right, or a spike?",
        )
    return list(dict.fromkeys(found))


def rate_doubts(where: object, stamps: Stamps, cure: str) -> list[str]:
    """Doubt about the number of rows a second, from increasing stamps [ns], shape (n,)."""
    if len(stamps) < 2:
        return []
    rate = NANOSECONDS / float(np.median(np.diff(stamps)))
    return outside(where, "the number of rows a second", rate, "", RATES, cure)


def joint_doubts(series: Series, *, is_torque: bool = False) -> list[str]:
    """List what is likely a mistake of a joint's angle, or of an actuator's torque."""
    cure = f"is {series.name}.unit right, and is it this joint's?"
    if is_torque:
        most = float(np.abs(series.values).max())
        return outside(series.where, "the largest torque", most, "N m", (0.0, MOST_TORQUE), cure)
    span, limits = math.degrees(np.ptp(series.values)), (math.degrees(STIFF), math.inf)
    return outside(series.where, "the range of motion", span, "deg", limits, cure)


def unusual(load: Series, weight: float | None) -> list[str]:
    """List what may be a mistake if no body weight [N] is given to judge the load by."""
    cure = "percent of body weight, kN, or a spike? Give a body weight to be sure"
    return (
        []
        if weight
        else outside(load.where, "the peak", float(load.values.max()), "N", USUAL_LOAD, cure)
    )


def _spike(load: Series, weight: float) -> list[str]:
    """Doubt about rows that are far above both neighbours."""
    inner, beside = load.values[1:-1], np.maximum(load.values[:-2], load.values[2:])
    above = np.where(inner > ALONE * beside, inner - beside, 0.0)
    if not above.size:
        return []
    row = int(np.argmax(above))
    what = f"the step up to {inner[row]:.5g} N at {load.stamps[row + 1] / NANOSECONDS:.7g} s"
    return outside(load.where, what, float(above[row]), "N", (0.0, SPIKE * weight), "a spike?")


def peak_doubts(
    load: Series,
    unit: str | None,
    weight: float | None,
    limits: Range = PEAK,
    right: Range = RIGHT_PEAK,
) -> list[str]:
    """Doubt about a peak that is not of the order of the body weight, with the unit in which it would be right.

    `unit` is the map's, None for OpenSim's files. `limits` [BW] are for the knee, `right` where a hint brings the peak.
    """
    peak = float(load.values.max())
    cure = f"is {load.name}.unit {unit} right, and is it a load's column?"
    if unit is None:
        cure = "is it of this person (model), in N, and without spikes?"
    if weight is None:
        return outside(
            load.where, "the peak", peak, "N", (limits[0] * LIGHTEST, limits[1] * HEAVIEST), cure
        )
    for other in (PERCENT, BODY_WEIGHT, "kN", "kgf", "N", "lbf") if unit else ():
        there = (
            peak
            / factor(str(unit), FORCE, "load", weight)
            * factor(other, FORCE, "load", weight)
            / weight
        )
        if right[0] <= there <= right[1]:
            cure = f"is {load.name}.unit {unit} right? In {other} it would be {there:.2g} body weights"
    return outside(
        load.where, f"the peak of {peak:.4g} N", peak / weight, "body weights", limits, cure
    )

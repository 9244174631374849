"""What a knee can do, and what its sensors can measure: values beyond it point to a wrong unit, sign, column or frame.

All limits on imported values are here. OpenSim's files say what they hold, so what contradicts that is refused by a
UsageError. Of a laboratory's files a map says what they hold: what is `impossible` is never imported, what raises
`doubts` only if the user insists, and both are sentences.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from knee_contact_ros.joint_reaction.estimator import LEAST_PEAK, LIGHTEST, MOST_PEAK, STIFF, weight_doubt
from knee_contact_ros.lab.tables import BODY_WEIGHT, FORCE, PERCENT, Floats, Series, Table, factor
from knee_contact_ros.model.inputs import CLEAR, TIMES_MORE, WIDEST
from knee_contact_ros.model.knee import LARGEST_ANGLE, LARGEST_LOAD
from knee_contact_ros.model.types import EXTENDS, FLEXES
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError

LARGEST_RADIANS = 3.5
"""Number that no knee reaches in rad, and below which a range in deg may also be one in rad"""
BENT, FOLDED = math.radians(90.0), math.radians(160.0)
"""Flexion [rad] that a knee falls below in every step, and one that no knee exceeds under load"""
SPIKE, ALONE = 1.5, 2.0
"""Load [BW] by which a row exceeds both its neighbours, and how many times as large it is, that point to a spike"""
JUMP = math.radians(30.0)
"""Step [rad] from one row to the next that points to a loose contact, or to a new turn of an encoder"""
SLOWEST, FASTEST = 5.0, 1e4
"""Range of plausible rates of rows [Hz]"""
MOVES, FITS = 0.1, (0.5, 2.0)
"""RMS of the rate [rad/s] below which a given rate cannot be checked; and range of the slope of given over derived
rate, outside of which the given one has another unit or is another joint's"""
SMALLEST_FORCE, LARGEST_FORCE = 20.0, 1e6
"""Range of the peak of an axial force [N], outside of which the force is not in N"""
USUAL_WEIGHT = (LIGHTEST, 2500.0)
"""Range of body weights [N] that is assumed where none is given"""
MIDDLE_WEIGHT = 700.0
"""Body weight [N] that limits of spikes are of where none is given"""
USUAL_LOAD = (400.0, 8000.0)
"""Range of peak loads [N] outside of which a body weight is asked for where none is given"""
USUAL_PEAK = (1.5, 4.0)
"""Range of peak loads [BW] into which the right unit would bring a peak"""
GROUND_PEAK = (0.4, 5.0)
"""Range of the peak of the ground's force on a foot [BW], outside of which its unit is asked for"""
MOST_TORQUE = 300.0
"""Largest torque [N m] of an actuator that is not asked about"""
STANDS = 100.0
"""Vertical force [N] that a walking foot reaches, and above which its centre of pressure must be near the ankle"""
NEAR = 0.30
"""Largest median distance [m] of ankle and centre of pressure in the ground plane: more than a foot's length ahead"""
AHEAD = 0.7
"""Smallest mean x component of the pelvis's forward direction: within 45 degrees of x"""


def unit_of(table: Table, column: str, requested: str) -> str:
    """Unit of an angle's column, `deg` or `rad`: the requested one, or with `auto` that of the header, if it can be.

    Raises:
        UsageError: header and values contradict each other, or the unit is not clear.
    """
    if requested != "auto":
        return requested
    values = table.column(column)
    reach, span = float(np.abs(values).max()), f"{column} goes from {values.min():.3g} to {values.max():.3g}"
    likely = "deg" if reach > LARGEST_RADIANS else "rad"
    if table.degrees is None and likely == "rad":
        raise UsageError(f"{table.path} does not say inDegrees, and {span}; give --angle-unit deg or rad")
    if table.degrees not in (None, likely == "deg"):
        says, like = ("yes", "rad") if table.degrees else ("no", "degrees")
        raise UsageError(f"{table.path} says inDegrees={says}, but {span}, like {like}; give --angle-unit deg or rad")
    return likely


def sign_of(angle: Floats, where: str, requested: int | None, bounds: tuple[float, float] | None) -> int:
    """Sign that makes an angle [rad] positive in flexion, 1 or -1.

    It is the requested one, or else follows from the data, as a walking knee flexes far more than it extends, or else
    from `bounds`, the coordinate's range [rad] in the model. `where` names file and column in messages.

    Raises:
        UsageError: the sign is impossible for a knee, or is not clear.
    """
    low, high = float(angle.min()), float(angle.max())
    span = f"{where} goes from {math.degrees(low):.1f} to {math.degrees(high):.1f} deg"
    sign = requested or _clear_sign(low, high) or (_clear_sign(*bounds) if bounds else 0)
    if not sign:
        raise UsageError(f"{span}: which sign is flexion? Give --angle-sign 1 or -1, or --model")
    lowest, highest = (low, high) if sign > 0 else (-high, -low)
    if lowest < EXTENDS or highest > FLEXES:
        raise UsageError(
            f"{span}; with sign {sign:+d} that is {math.degrees(lowest):.1f} to {math.degrees(highest):.1f} deg of "
            f"flexion, and a knee has {math.degrees(EXTENDS):.0f} to {math.degrees(FLEXES):.0f}: "
            "see --angle-sign and --angle-unit"
        )
    return sign


def _clear_sign(low: float, high: float) -> int:
    """Sign of flexion if a range of angles [rad] reaches clearly further to one side; 0 if it does not."""
    if high >= CLEAR and high >= -TIMES_MORE * low:
        return 1
    return -1 if -low >= CLEAR and -low >= TIMES_MORE * high else 0


def check_rate(given: Floats, derived: Floats, where: str) -> None:
    """Refuse a rate [rad/s] that is not that of the angle, from which the other one is derived; shapes (n,)."""
    power = float(derived @ derived)
    slope = float(given @ derived) / power if power > MOVES**2 * len(derived) else 1.0
    if not FITS[0] <= slope <= FITS[1]:
        raise UsageError(
            f"{where} is {slope:.3g} times the rate of the angle; another unit than its inDegrees says, or another "
            "coordinate's?"
        )


def check_axial(load: Floats, where: str) -> None:
    """Refuse an axial load [N], > 0 in compression, shape (n,), that is mostly tension, or not in N."""
    least, most = float(load.min()), float(load.max())
    if most < -least:
        raise UsageError(f"{where} {_pulls(least, most)}: it is not the force on the tibia, or its y does not point up")
    if not SMALLEST_FORCE <= most <= LARGEST_FORCE:
        raise UsageError(f"{where} presses with {most:.3g} at most; it must be in N")


def check_upright(up: Floats, where: str) -> None:
    """Refuse a vertical ground force, shape (n,), that does not act upwards as on a walking foot."""
    if up.max() < max(STANDS, -up.min()):
        raise UsageError(
            f"{where} goes from {up.min():.4g} to {up.max():.4g}; it must be in N, upwards, "
            "and the force of the ground on the foot"
        )


def check_near(arm: Floats, up: Floats, where: str) -> None:
    """Refuse centres of pressure that are not near the foot.

    `arm` [m] is from the ankle to each, shape (n, 3), and `up` the vertical force [N], shape (n,).
    """
    standing = arm[up >= STANDS]
    away = float(np.median(np.hypot(standing[:, 0], standing[:, 2]))) if len(standing) else 0.0
    if away > NEAR:
        raise UsageError(
            f"{where} is {away:.2f} m away from the ankle while the foot stands, by the median: the other foot's, not "
            "in m, or in other axes than the model's?"
        )


def check_heading(forward: Floats, path: Path) -> None:
    """Refuse a person who does not face towards x; `forward` is the direction of the pelvis, shape (n, 3)."""
    x, _, z = forward.mean(axis=0)
    if x < AHEAD:
        raise UsageError(
            f"{path}: the pelvis points to x {x:.2f}, z {z:.2f} on average, and a leg's sensors have x forward: turn "
            "markers and ground reactions about y, so that the person walks towards x"
        )


def impossible(angle: Series, load: Series | None = None) -> str:
    """Say why these cannot be an angle and a load at all; empty if they can."""
    low, high = float(angle.values.min()), float(angle.values.max())
    if high - low > WIDEST or max(-low, high) > LARGEST_ANGLE:
        return (
            f"{angle.where} goes from {math.degrees(low):.4g} to {math.degrees(high):.4g} deg, more than any knee: is "
            f"{angle.name}.unit right, and is it an angle's column?"
        )
    least, most = (float(load.values.min()), float(load.values.max())) if load else (0.0, 0.0)
    if load and most < -least:
        return f"{load.where} {_pulls(least, most)}: see load.direction"
    if load and most > LARGEST_LOAD:
        return f"{load.where} presses with {most:.3g} N, beyond {LARGEST_LOAD:g}: is load.unit right?"
    return ""


def _pulls(least: float, most: float) -> str:
    return f"pulls the knee apart, by up to {-least:.0f} N, and presses with {most:.4g} N at most"


def doubts(
    angle: Series, load: Series | None, unit: str | None, weight: float | None, max_gap: float, *, mapped: bool = True
) -> list[str]:
    """List what is likely a mistake.

    `unit` is the load's in the map; `weight` is the body's [N]; `max_gap` is the longest time [s] between rows that is
    no gap; OpenSim's results are not `mapped`.
    """
    ask = "is time.unit right, or does it count frames (time.rate)?" if mapped else "are its times in s?"
    sentences = ["" if weight is None else weight_doubt(weight), _slow(angle, ask), *[_still(angle)][:mapped]]
    sentences += [_outside(angle, mapped), _jumps(angle, max_gap)]
    if load:
        sentences += [_slow(load, ask), _spike(load, weight), _peak(load, unit, weight)]
    return [sentence for sentence in sentences if sentence]


def joint_doubts(series: Series, *, is_torque: bool) -> list[str]:
    """List what is likely a mistake of the hip's or ankle's angle, or of an actuator's torque."""
    most = float(np.abs(series.values).max())
    torque = f"{series.where} reaches {most:.4g} N m: is {series.name}.unit right?" * (most > MOST_TORQUE)
    return [*filter(None, [torque if is_torque else _still(series)])]


def ground_doubts(ground: Series, unit: str, weight: float | None) -> list[str]:
    """List what is likely a mistake of the ground's vertical force, whose `unit` is the map's."""
    sentence = _peak(ground, unit, weight, GROUND_PEAK, (0.9, 1.6), "a foot that bears its body")
    return [sentence] * bool(sentence)


def unusual(load: Series, weight: float | None) -> list[str]:
    """List what may be a mistake, and cannot be told without a body weight [N]."""
    peak, (least, most) = float(load.values.max()), USUAL_LOAD
    if weight or least <= peak <= most:
        return []
    hint = "little: percent of body weight, or kN?" if peak < least else "much: a spike, or another unit?"
    return [f"{load.where} presses with {peak:.4g} N at most, which is {hint}"]


def _slow(series: Series, ask: str) -> str:
    rate = NANOSECONDS / float(np.median(np.diff(series.stamps)))
    if SLOWEST <= rate <= FASTEST:
        return ""
    hint = f" In ms there would be {1000.0 * rate:.3g}" if rate < SLOWEST else ""
    return f"{series.path} has {rate:.3g} rows a second: {ask}{hint}"


def _outside(angle: Series, mapped: bool) -> str:
    """Doubt about a knee that extends or bends more than one under load can, or is never less bent than 90 degrees."""
    low, high = np.degrees([angle.values.min(), angle.values.max()])
    least, most, bent = np.degrees([EXTENDS, FOLDED, BENT])
    if low >= least and high <= most and low < bent:
        return ""
    name = angle.name
    offset = f"is {name}.sign right, or has the sensor an offset ({name}.offset, or knee-contact align)?"
    cure = f"{offset} The included angle has sign: -1, offset: 180 (in deg)" if mapped else "is it the included angle?"
    return (
        f"{angle.where} is {low:.1f} to {high:.1f} deg of flexion, and a knee that walks is within {least:.0f} to "
        f"{most:.0f}, and below {bent:.0f} in every step: {cure}"
    )


def _spike(load: Series, weight: float | None) -> str:
    """Doubt about rows that stand out of both their neighbours."""
    inner = load.values[1:-1]
    beside = np.maximum(load.values[:-2], load.values[2:])
    spikes = (inner - beside > SPIKE * (weight or MIDDLE_WEIGHT)) & (inner > ALONE * beside)
    if not spikes.any():
        return ""
    row = int(np.argmax(np.where(spikes, inner, -math.inf)))
    return (
        f"{load.where} is {inner[row]:.5g} N at {load.stamps[row + 1] / NANOSECONDS:.7g} s and {beside[row]:.5g} N at "
        f"most in the rows beside ({np.count_nonzero(spikes)} such rows in all): a spike?"
    )


def _still(angle: Series) -> str:
    span = float(np.ptp(angle.values))
    if span >= STIFF:
        return ""
    moves = f"{angle.where} moves by {math.degrees(span):.3g} deg in all"
    return f"{moves}: is {angle.name}.unit right, and is it the knee's?"


def _jumps(angle: Series, max_gap: float) -> str:
    """Doubt about steps that no knee makes; behind a gap, which is noted elsewhere, any angle is possible."""
    steps = np.where(np.diff(angle.stamps) <= max_gap * NANOSECONDS, np.abs(np.diff(angle.values)), 0.0)
    worst = int(np.argmax(steps))
    if steps[worst] <= JUMP:
        return ""
    return (
        f"{angle.where} jumps by {math.degrees(steps[worst]):.0f} deg at {angle.stamps[worst + 1] / NANOSECONDS:.7g} s "
        f"({np.count_nonzero(steps > JUMP)} such steps in all): a loose contact, or an encoder's turn?"
    )


def _peak(
    load: Series, unit: str | None, weight: float | None, limits: tuple[float, float] = (LEAST_PEAK, MOST_PEAK),
    usual: tuple[float, float] = USUAL_PEAK, who: str = "a knee that bears its body",
) -> str:  # fmt: skip
    """Doubt about a peak that is not of the order of the body weight, with the unit in which it would be `usual`."""
    peak = float(load.values.max())
    least, most = np.multiply(limits, (weight, weight) if weight else USUAL_WEIGHT)
    if least <= peak <= most:
        return ""
    measured = f"{peak:.4g} N" + (f", {peak / weight:.3g} body weights" if weight else "")
    expected = f"{limits[0]:g} to {limits[1]:g}" if weight else f"{least:.0f} to {most:.0f} N"
    hint = f"is {load.name}.unit {unit} right, and is it a load's column?"
    if unit is None:
        hint = "is it of this person (model), in N, and without spikes?"
    elif weight:
        for other in (PERCENT, BODY_WEIGHT, "kN", "kgf", "N", "lbf"):
            there = peak / factor(unit, FORCE, "load", weight) * factor(other, FORCE, "load", weight) / weight
            if usual[0] <= there <= usual[1]:
                hint = f"is {load.name}.unit {unit} right? In {other} it would be {there:.2g} body weights"
    return f"{load.where} presses with {measured} at most, and {who} with {expected}: {hint}"

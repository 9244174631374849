"""Doubts about what was read, each a sentence: values that no knee has point to a wrong unit, sign or column.

What is `impossible` is never imported; what has `doubts` only if the user insists.
"""

from __future__ import annotations

import math

import numpy as np

from knee_contact_ros.messages.stamps import NANOSECONDS
from knee_contact_ros.model.knee import LARGEST_ANGLE, LARGEST_LOAD
from knee_contact_ros.parameters.plausibility import LEAST_PEAK, LIGHTEST, MOST_PEAK, STIFF, weight_doubt
from knee_contact_ros.tools.sensors.channels import Series
from knee_contact_ros.tools.sensors.sensor_map import SensorMap
from knee_contact_ros.tools.sensors.units import BODY_WEIGHT, FORCE, UNITS

WIDEST = math.radians(180.0)
"""Range of motion [rad] beyond that of any knee"""
EXTENDS, FLEXES = math.radians(-30.0), math.radians(170.0)
"""Range of flexion angles of any knee [rad]"""
JUMP = math.radians(30.0)
"""Step [rad] from one row to the next that points to a loose contact, or to a new turn of an encoder"""
USUAL_WEIGHT = (LIGHTEST, 2500.0)
"""Range of body weights [N] that is assumed where the map has none"""
USUAL_PEAK = (1.5, 4.0)
"""Range of peak loads [BW] into which the right unit would bring a peak"""
SLOWEST = 5.0
"""Lowest plausible rate of rows [Hz]"""


def impossible(angle: Series, load: Series | None) -> str:
    """Say why these cannot be an angle and a load at all; empty if they can."""
    low, high = float(angle.values.min()), float(angle.values.max())
    if high - low > WIDEST or max(-low, high) > LARGEST_ANGLE:
        return (
            f"{angle.where} goes from {math.degrees(low):.4g} to {math.degrees(high):.4g} deg, which no knee does: is "
            f"{angle.name}.unit right, and is it an angle's column?"
        )
    if load is None:
        return ""
    least, most = float(load.values.min()), float(load.values.max())
    if most < -least:
        return (
            f"{load.where} pulls the knee apart, by up to {-least:.0f} N, and presses with {most:.0f} N at most: see "
            "load.direction"
        )
    if most > LARGEST_LOAD:
        return f"{load.where} presses with {most:.3g} N, beyond {LARGEST_LOAD:g}: is load.unit right?"
    return ""


def doubts(angle: Series, load: Series | None, sensors: SensorMap) -> list[str]:
    """List what is likely a mistake in the map."""
    weight = "" if sensors.body_weight is None else weight_doubt(sensors.body_weight)
    sentences = [weight, _slow(angle), _still(angle), _outside(angle), _jumps(angle, sensors.max_gap)]
    if load is not None:
        sentences += [_slow(load), _peak(load, sensors)]
    return [sentence for sentence in sentences if sentence]


def _slow(series: Series) -> str:
    rate = NANOSECONDS / float(np.median(np.diff(series.stamps)))
    if rate >= SLOWEST:
        return ""
    return f"{series.path} has {rate:.3g} rows a second: is time.unit right?"


def _still(angle: Series) -> str:
    span = float(np.ptp(angle.values))
    if span >= STIFF:
        return ""
    return (
        f"{angle.where} moves by {math.degrees(span):.3g} deg in all: is {angle.name}.unit right, and is it the knee's?"
    )


def _outside(angle: Series) -> str:
    low, high = float(angle.values.min()), float(angle.values.max())
    if low >= EXTENDS and high <= FLEXES:
        return ""
    return (
        f"{angle.where} is {math.degrees(low):.1f} to {math.degrees(high):.1f} deg of flexion, and a knee has "
        f"{math.degrees(EXTENDS):.0f} to {math.degrees(FLEXES):.0f}: is {angle.name}.sign right, or has the sensor an "
        "offset (knee-contact align)?"
    )


def _jumps(angle: Series, max_gap: float) -> str:
    """Doubt about steps that no knee makes; behind a gap, which is noted elsewhere, any angle is possible."""
    steps = np.where(np.diff(angle.seconds) <= max_gap, np.abs(np.diff(angle.values)), 0.0)
    worst = int(np.argmax(steps))
    if steps[worst] <= JUMP:
        return ""
    at, times = angle.stamps[worst + 1] / NANOSECONDS, np.count_nonzero(steps > JUMP)
    return (
        f"{angle.where} jumps by {math.degrees(steps[worst]):.0f} deg at {at:.7g} s"
        f"{f', and {times} times in all' if times > 1 else ''}: a loose contact, or an encoder's turn?"
    )


def _peak(load: Series, sensors: SensorMap) -> str:
    """Doubt about a peak load that is not of the order of the body weight."""
    peak, weight = float(load.values.max()), sensors.body_weight
    lightest, heaviest = (weight, weight) if weight else USUAL_WEIGHT
    least, most = LEAST_PEAK * lightest, MOST_PEAK * heaviest
    if least <= peak <= most:
        return ""
    measured = f"{peak:.4g} N" + (f", {peak / weight:.3g} body weights" if weight else "")
    usual = f"{least:.0f} to {most:.0f} N" if not weight else f"{LEAST_PEAK:g} to {MOST_PEAK:g}"
    hint = _meant(peak, sensors)
    return f"{load.where} presses with {measured} at most, and a knee that bears its body with {usual}{hint}"


def _meant(peak: float, sensors: SensorMap) -> str:
    """Hint at the unit in which a peak load [N] would be a usual one."""
    assert sensors.load is not None  # noqa: S101  (there is a peak)
    weight, given = sensors.body_weight, sensors.load.unit
    question = f": is load.unit {given} right, and is it a load's column?"
    if weight is None or given == BODY_WEIGHT or given not in UNITS[FORCE]:
        return question
    for unit in ("lbf", "N", "kgf", "kN"):
        there = peak / UNITS[FORCE][given] * UNITS[FORCE][unit] / weight
        if unit != given and USUAL_PEAK[0] <= there <= USUAL_PEAK[1]:
            return f": is load.unit {given} right? In {unit} it would be {there:.2g} body weights"
    return question

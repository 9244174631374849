"""What no knee does: signs of a wrong unit, sign or column in what was read, each in one sentence.

`impossible` is never imported; the rest only if the user insists.
"""

from __future__ import annotations

import math

import numpy as np

from knee_contact_ros.core.model import LARGEST_ANGLE, LARGEST_LOAD
from knee_contact_ros.messages.ros_types import NANOSECONDS
from knee_contact_ros.parameters.plausibility import GRAVITY, LEAST_PEAK, LIGHTEST, MOST_PEAK, STIFF
from knee_contact_ros.tools.sensors.channels import Series
from knee_contact_ros.tools.sensors.sensor_map import SensorMap
from knee_contact_ros.tools.sensors.units import BODY_WEIGHT, FORCE, UNITS

WIDEST = math.radians(180.0)
"""[rad] from the straightest to the most bent: no knee moves so far"""
EXTENDS, FLEXES = math.radians(-30.0), math.radians(170.0)
"""[rad] flexion of any knee"""
JUMP = math.radians(30.0)
"""[rad] from one row to the next: a lost contact, or an encoder that begins a new turn"""
USUAL_WEIGHT = (LIGHTEST, 2500.0)
"""[N] where the map does not tell"""
USUAL_PEAK = (1.5, 4.0)
"""[BW] in which the right unit would put it"""
SLOWEST = 5.0
"""[Hz] of rows"""


def impossible(angle: Series, load: Series | None) -> str:
    """Why these can be no angle and no load at all; empty if they may be."""
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
    """What is likely a mistake in the map."""
    found = [_weight(sensors), _slow(angle), _still(angle), _outside(angle), _jumps(angle, sensors.max_gap)]
    if load is not None:
        found += [_slow(load), _peak(load, sensors)]
    return [sentence for sentence in found if sentence]


def _weight(sensors: SensorMap) -> str:
    weight = sensors.body_weight
    if weight is None or weight >= LIGHTEST:
        return ""
    return f"body_weight {weight:.7g} N: is it kg? {weight:.7g} kg weigh {weight * GRAVITY:.1f} N"


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
    """Steps that no knee makes; behind a gap, which is told, a knee may be anywhere."""
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
    """A largest load that is not of the body's order."""
    peak, weight = float(load.values.max()), sensors.body_weight
    least, most = (LEAST_PEAK * w for w in (weight, weight)) if weight else (LEAST_PEAK * w for w in USUAL_WEIGHT)
    most *= MOST_PEAK / LEAST_PEAK
    if least <= peak <= most:
        return ""
    told = f"{peak:.4g} N" + (f", {peak / weight:.3g} body weights" if weight else "")
    usual = f"{least:.0f} to {most:.0f} N" if not weight else f"{LEAST_PEAK:g} to {MOST_PEAK:g}"
    return (
        f"{load.where} presses with {told} at most, and a knee that bears its body with {usual}{_meant(peak, sensors)}"
    )


def _meant(peak: float, sensors: SensorMap) -> str:
    """The unit that would put a peak where peaks are."""
    assert sensors.load is not None  # noqa: S101  (there is a peak)
    weight, given = sensors.body_weight, sensors.load.unit
    told = f": is load.unit {given} right, and is it a load's column?"
    if weight is None or given == BODY_WEIGHT or given not in UNITS[FORCE]:
        return told
    for unit in ("lbf", "N", "kgf", "kN"):
        there = peak / UNITS[FORCE][given] * UNITS[FORCE][unit] / weight
        if unit != given and USUAL_PEAK[0] <= there <= USUAL_PEAK[1]:
            return f": is load.unit {given} right? In {unit} it would be {there:.2g} body weights"
    return told

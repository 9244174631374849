"""What is prescribed between two ticks: load and flexion angle, linear in time, and the translation with flexion."""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.contact_pairs.base import ContactPair, Touch
from knee_contact_ros.core.kernel_source import in_kernel
from knee_contact_ros.core.mechanisms.base import Mechanism

KINK_WIDTH = 2e-12
"""Margin of the flexion angle [rad] on both sides of a kink: more than the rounding of its place"""


class Interval(NamedTuple):
    """Load and pose from one tick to the next, as functions of the time s [s] since the first of the two."""

    pair: ContactPair
    mechanism: Mechanism
    duration: float
    """Length of the interval [s]"""
    angle: float
    """Flexion angle at s = 0 [rad]"""
    angle_rate: float
    """Rate of the flexion angle [rad/s]"""
    start_load: float
    """Compressive load at s = 0 [N]"""
    load_rate: float
    """Rate of the load [N/s]"""
    end_height: float
    """Height of the femoral reference point at the end [m] where it is prescribed, else NaN"""


@in_kernel
def touch_at(interval: Interval, s: float) -> Touch:
    """Return the contact at s [s] as a function of the femoral height."""
    angle = interval.angle + interval.angle_rate * s
    x, slope = interval.mechanism.translation(angle)
    return interval.pair.at(angle, interval.angle_rate, x, slope * interval.angle_rate)


@in_kernel
def load_at(interval: Interval, s: float) -> float:
    """Return the compressive load [N] at s [s]."""
    return interval.start_load + interval.load_rate * s


@in_kernel
def stretch_from(interval: Interval, begin: float) -> tuple[float, float]:
    """Return the end [s] of the smooth stretch that begins at `begin` [s], and the beginning [s] of the next one.

    Between the two, the rate of the femoral surface jumps.

    At a kink of the femoral profile one stretch ends shortly before it and the next begins shortly behind, so that
    rounding cannot put either on the wrong side. The last stretch ends with the interval, and so does its next.
    """
    angle = interval.angle + interval.angle_rate * begin
    end_angle = interval.angle + interval.angle_rate * interval.duration
    kink = interval.pair.next_kink(angle, end_angle)
    while not math.isnan(kink):
        margin = KINK_WIDTH / abs(interval.angle_rate)
        s = (kink - interval.angle) / interval.angle_rate
        if begin < s - margin and s + margin < interval.duration:
            return s - margin, s + margin
        kink = interval.pair.next_kink(kink, end_angle)
    return interval.duration, interval.duration

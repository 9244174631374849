"""What is prescribed between two ticks: load and flexion angle, linear in time, and the translation with flexion."""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.contact_pairs.base import ContactPair, Touch
from knee_contact_ros.core.kernel_source import in_kernel
from knee_contact_ros.core.mechanisms.base import Mechanism

KINK_WIDTH = 2e-12
"""Of the flexion angle [rad], to both sides: more than a kink's place is rounded by"""


class Interval(NamedTuple):
    """Load and pose from one tick to the next, as functions of the time s [s] since the first of the two."""

    pair: ContactPair
    mechanism: Mechanism
    duration: float
    """[s]"""
    angle: float
    """Flexion angle at s = 0 [rad]"""
    angle_rate: float
    """[rad/s]"""
    start_load: float
    """[N] compressive"""
    load_rate: float
    """[N/s]"""
    end_height: float
    """Of the femoral reference point [m], where it is prescribed; else not a number"""


@in_kernel
def touch_at(interval: Interval, s: float) -> Touch:
    """The contact at s [s], still open to the femoral height."""
    angle = interval.angle + interval.angle_rate * s
    x, slope = interval.mechanism.translation(angle)
    return interval.pair.at(angle, interval.angle_rate, x, slope * interval.angle_rate)


@in_kernel
def load_at(interval: Interval, s: float) -> float:
    """Compressive load [N] at s [s]."""
    return interval.start_load + interval.load_rate * s


@in_kernel
def stretch_from(interval: Interval, begin: float) -> tuple[float, float]:
    """End [s] of the stretch that begins at `begin` [s], and beginning of the next; the surface's rate jumps between.

    At a kink of the femoral profile one stretch ends shortly before it and the next begins shortly behind, so that
    rounding cannot put either on the wrong side. The last stretch ends with the interval, and so does its next.
    """
    angle = interval.angle + interval.angle_rate * begin
    end_angle = interval.angle + interval.angle_rate * interval.duration
    kink = interval.pair.next_kink(angle, end_angle)
    while not math.isnan(kink):
        aside = KINK_WIDTH / abs(interval.angle_rate)
        s = (kink - interval.angle) / interval.angle_rate
        if begin < s - aside and s + aside < interval.duration:
            return s - aside, s + aside
        kink = interval.pair.next_kink(kink, end_angle)
    return interval.duration, interval.duration

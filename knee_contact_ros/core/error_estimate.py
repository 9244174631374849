"""The error that the steps leave behind: each step's estimated error, carried along by the linearised contact."""

from __future__ import annotations

import math

from knee_contact_ros.core.integrators.base import StateError

HORIZON = 0.1
"""How long [s] a velocity error counts where neither spring nor dashpot holds it back."""
SAFETY = 5.0
"""Published estimate over the carried one: room for what the linearisation and Richardson's estimate leave out."""


def carry(error: StateError, stiffness: float, damping: float, mass: float, h: float) -> StateError:
    """Carry an error over `h` [s] by m ë = -stiffness e - damping ė, exactly (closed form of the 2 x 2 exponential)."""
    half_rate = 0.5 * damping / mass
    discriminant = half_rate * half_rate - stiffness / mass
    root = math.sqrt(abs(discriminant))
    if discriminant > 0.0:
        slow, fast = math.exp((root - half_rate) * h), math.exp(-(root + half_rate) * h)
        even, odd = 0.5 * (slow + fast), 0.5 * (slow - fast) / root
    elif discriminant < 0.0:
        decay = math.exp(-half_rate * h)
        even, odd = decay * math.cos(root * h), decay * math.sin(root * h) / root
    else:
        decay = math.exp(-half_rate * h)
        even, odd = decay, decay * h
    return StateError(
        (even + half_rate * odd) * error.height + odd * error.velocity,
        (even - half_rate * odd) * error.velocity - stiffness / mass * odd * error.height,
    )


def decay_rate(stiffness: float, damping: float, mass: float) -> float:
    """Rate [1/s] at which the linearised contact forgets an error: real part of its slower eigenvalue."""
    half_rate = 0.5 * damping / mass
    discriminant = half_rate * half_rate - stiffness / mass
    return half_rate if discriminant <= 0.0 else stiffness / mass / (half_rate + math.sqrt(discriminant))


def depth_error(error: StateError, stiffness: float, damping: float, mass: float) -> float:
    """Error of the depth [m] that an error of the state amounts to: the height's, and what the velocity's becomes."""
    holding = max(math.sqrt(stiffness / mass), damping / mass, 1.0 / HORIZON)
    return math.hypot(error.height, error.velocity / holding)

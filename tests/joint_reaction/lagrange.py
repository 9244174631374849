"""Thigh, shank and foot by Lagrange's equations: what judges the inverse dynamics, and shares no code with it.

Derivatives are complex steps: exact but for rounding. The kinetic energy is a quadratic form of the rates, so a
momentum is a difference of energies, and its derivative along the motion is one complex step.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Coordinates = NDArray[np.float64]
"""Hip, flexion, dorsiflexion [rad], and their derivatives"""
Values = NDArray[Any]
"""The same, or a point, beside a complex step"""
STEP = 1e-200
GRAVITY = 9.80665
TURNS = {"thigh": (1.0, 0.0, 0.0), "shank": (1.0, -1.0, 0.0), "foot": (1.0, -1.0, 1.0)}
"""How a segment's angle to the vertical grows with the coordinates"""
THIGH_MASS, THIGH_INERTIA = 7.5, 0.13
"""[kg], [kg m^2]: neither knee nor ankle may notice it"""
Path = list[tuple[str, float, float]]
"""From the hip to a point: segments, and how far it goes on in each, forwards and upwards as it hangs down"""


class Holds(NamedTuple):
    """What knee and ankle exert."""

    extension: float
    plantarflexion: float
    compression: float


def turned(name, q):
    return np.asarray(np.dot(TURNS[name], q))


def place(path, q):
    """Of a point, from the hip."""
    along = [(turned(name, q), x, y) for name, x, y in path]
    return np.array(
        [
            sum(x * np.cos(angle) - y * np.sin(angle) for angle, x, y in along),
            sum(x * np.sin(angle) + y * np.cos(angle) for angle, x, y in along),
        ]
    )


def velocity(path, q, rate):
    along = [(turned(name, q), turned(name, rate), x, y) for name, x, y in path]
    return np.array(
        [
            sum(-turn * (x * np.sin(angle) + y * np.cos(angle)) for angle, turn, x, y in along),
            sum(turn * (x * np.cos(angle) - y * np.sin(angle)) for angle, turn, x, y in along),
        ]
    )


def derivative(function, at, along):
    """Of a function of vectors, as they change at given rates."""
    values = function(*[one + 1j * STEP * change for one, change in zip(at, along, strict=True)])
    return np.asarray(np.imag(values) / STEP)


class Chain:
    """A leg that hangs from a hip at rest."""

    def __init__(self, leg):
        knee: Path = [("thigh", 0.0, -leg.thigh_length)]
        self.ankle: Path = [*knee, ("shank", 0.0, -leg.shank_length)]
        self.bodies: list[tuple[float, float, str, Path]] = [
            (THIGH_MASS, THIGH_INERTIA, "thigh", [("thigh", 0.0, -0.4 * leg.thigh_length)]),
            (
                leg.shank_mass,
                leg.shank_inertia,
                "shank",
                [*knee, ("shank", 0.0, -leg.shank_centre)],
            ),
            (
                leg.foot_mass,
                leg.foot_inertia,
                "foot",
                [*self.ankle, ("foot", leg.foot_forward, -leg.foot_below)],
            ),
        ]

    def kinetic(self, q, rate):
        parts = [
            mass * (velocity(path, q, rate) ** 2).sum() + inertia * turned(name, rate) ** 2
            for mass, inertia, name, path in self.bodies
        ]
        return np.asarray(0.5 * np.sum(parts))

    def potential(self, q):
        return np.asarray(
            GRAVITY * np.sum([mass * place(path, q)[1] for mass, _, _, path in self.bodies])
        )

    def momenta(self, q, rate):
        def one(unit):
            return np.asarray(
                self.kinetic(q, rate + unit) - self.kinetic(q, rate) - self.kinetic(q, unit)
            )

        return np.array([one(unit) for unit in np.eye(3)])

    def torques(
        self,
        q,
        rate,
        acceleration,
        force,
        torque,
    ):
        """What acts along the coordinates beside gravity, and a force and a torque [N m] on the foot at the ankle."""
        found, nothing = derivative(self.momenta, [q, rate], [rate, acceleration]), np.zeros(3)
        for number, unit in enumerate(np.eye(3)):
            found[number] -= derivative(self.kinetic, [q, rate], [unit, nothing])
            found[number] += derivative(self.potential, [q], [unit])
            found[number] -= force @ derivative(lambda at: place(self.ankle, at), [q], [unit])
            found[number] -= torque * turned("foot", unit)
        return found

    def holds(
        self,
        q,
        rate,
        acceleration,
        force,
        torque,
    ):
        """Moments by virtual work; compression by Newton's law for shank and foot."""
        _, flexing, dorsiflexing = self.torques(q, rate, acceleration, force, torque)

        def momentum(at, turning):
            parts = [mass * velocity(path, at, turning) for mass, _, _, path in self.bodies[1:]]
            return np.asarray(np.sum(parts, axis=0))

        weight = np.array([0.0, -GRAVITY * sum(mass for mass, *_ in self.bodies[1:])])
        from_thigh = derivative(momentum, [q, rate], [rate, acceleration]) - weight - force
        shank = turned("shank", q)
        return Holds(
            -flexing, -dorsiflexing, float(from_thigh @ np.array([np.sin(shank), -np.cos(shank)]))
        )

"""Femora and tibiae that tests of several modules build contacts of."""

from __future__ import annotations

from functools import cache

import numpy as np

from knee_contact_ros.core.contact_pairs.tibial_circle import TibialCircle
from knee_contact_ros.core.contact_pairs.tibial_profile import TibialProfile
from knee_contact_ros.core.geometries import Profile


@cache
def ellipse(points: int, a: float = 0.034, b: float = 0.028) -> Profile:
    """The lower part of an ellipse, from posterior over inferior to anterior."""
    t = np.linspace(-np.pi - 0.9, 0.9, points)
    return Profile(a * np.cos(t), b * np.sin(t))


@cache
def noisy_femur(noise: float, points: int = 120, seed: int = 2) -> Profile:
    """An ellipse with radial noise [m]."""
    t = np.linspace(-np.pi - 0.9, 0.9, points)
    radial = np.random.default_rng(seed).normal(0.0, 1.0, points) * noise
    return Profile((0.034 + radial) * np.cos(t), (0.028 + radial) * np.sin(t))


def plateau(points: int = 45, noise: float = 0.0, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A cup of radius 45 mm in the middle that rolls off at both edges, like a measured one."""
    x = np.linspace(-0.022, 0.022, points)
    y = 0.5 * x * x / 0.045 - 0.004 * (x / 0.022) ** 6 + 0.1 * x
    return x, y + np.random.default_rng(seed).normal(0.0, 1.0, points) * noise


def wavy(points: int, height: float, waves: int, phase: float) -> tuple[Profile, TibialProfile]:
    """A femur and a plateau with waves [m], which are dents where they are high."""
    t = np.linspace(-np.pi - 0.9, 0.9, points)
    wave = height * np.cos(waves * t + phase)
    x, y = plateau(points)
    return (
        Profile((0.034 + wave) * np.cos(t), (0.028 + wave) * np.sin(t)),
        TibialProfile(x, y + 0.3 * height * np.cos(40.0 * waves * x - phase)),
    )


TIBIAL_RADIUS = 0.095
CUP = TibialCircle(TIBIAL_RADIUS)
PLATEAU = TibialProfile(*plateau())
DEGENERATE = {
    "straight": (np.linspace(-0.02, 0.02, 9), np.full(9, -0.03)),
    "four": ([-0.02, -0.01, 0.01, 0.02], [-0.02, -0.03, -0.03, -0.02]),
    "repeated": (np.repeat([-0.02, -0.01, 0.01, 0.02], 3), np.repeat([-0.02, -0.03, -0.03, -0.02], 3)),
    "zigzag": (np.linspace(-0.02, 0.02, 41), -0.03 + 0.001 * (-1.0) ** np.arange(41)),
}
"""Points of odd profiles, by what is odd about them"""

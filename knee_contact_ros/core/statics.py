"""The static solution: the depth at which a contact law at rest carries a load (the start of every run)."""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.contact_pairs.base import Touch

MAX_ITERATIONS = 200
ROUNDING = 1e-16
"""Depth and height are solved to this [m], or to this part of them."""
START_HEIGHT = 0.1
"""Where the search for the femoral height begins [m]: above any contact."""


class StaticSolution(NamedTuple):
    """Depth of equilibrium [m] and what it cost in contact law evaluations."""

    depth: float
    evaluations: int


class StaticContact(NamedTuple):
    """The contact at rest under a load."""

    height: float
    """Of the femoral reference point [m]"""
    depth: float
    """[m]"""
    force: float
    """Normal contact force [N]"""
    evaluations: int


def static_contact(law: ContactLaw, touch: Touch, load: float) -> StaticContact:
    """Solve n_y F(depth, 0) = load [N] for the femoral height [m]; a load <= 0 leaves the surfaces just touching.

    The normal hardly turns with the height, so depth and height are solved in turns; on a plane one turn is exact.
    """
    height, depth, evaluations, cosine = height_at(touch, 0.0, START_HEIGHT), 0.0, 0, 0.0
    for _ in range(MAX_ITERATIONS):
        last, cosine = cosine, touch(height)[2]
        if abs(cosine - last) <= ROUNDING:
            break
        depth, spent = static_depth(law, load / cosine)
        evaluations += spent
        height = height_at(touch, depth, height)
    return StaticContact(height, depth, law.static_force(depth), evaluations + (depth > 0.0))


def height_at(touch: Touch, depth: float, near: float) -> float:
    """Solve depth(height) = depth [m] for the height [m] by Newton's method, from a height `near` it."""
    height = near
    for _ in range(MAX_ITERATIONS):
        reached, _, cosine = touch(height)
        correction = (reached - depth) / cosine
        height += correction
        if abs(correction) <= ROUNDING * max(1.0, abs(height)) or height + 0.5 * correction == height:
            break
    return height


def static_depth(law: ContactLaw, force: float) -> StaticSolution:
    """Solve F(depth, 0) = force [N] for the depth [m], to rounding; 0 for a force <= 0 (just touching).

    Newton's method inside a bracket that halves when Newton leaves it; the static force grows with depth in every law.

    Raises:
        ValueError: the law does not reach the force below 1e9 m (a stiffness that is no contact's).
    """
    if force <= 0.0:
        return StaticSolution(0.0, 0)
    evaluations = 0
    layer = 0
    for index in range(1, len(law.layers)):
        evaluations += 1
        if law.layers[index - 1].force(law.layers[index].begin, 0.0)[0] < force:
            layer = index
    formula, low = law.layers[layer].force, law.layers[layer].begin

    high = max(2.0 * low, 1e-9)
    evaluations += 1
    while formula(high, 0.0)[0] < force:
        evaluations += 1
        low, high = high, 10.0 * high
        if high > 1e9:
            raise ValueError(f"no static depth below 1e9 m carries {force} N")

    depth = high
    for _ in range(MAX_ITERATIONS):
        value, slope, _ = formula(depth, 0.0)
        evaluations += 1
        if value >= force:
            high = depth
        else:
            low = depth
        newton = depth - (value - force) / slope if slope > 0.0 else low
        following = newton if low < newton < high else 0.5 * (low + high)
        if following == depth or not low < following < high or abs(following - depth) <= ROUNDING * depth:
            break
        depth = following
    return StaticSolution(depth, evaluations)

"""The static solution: the depth at which a contact law at rest carries a load (the start of every run)."""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import ContactLaw

MAX_ITERATIONS = 200


class StaticSolution(NamedTuple):
    """Depth of equilibrium [m] and what it cost in contact law evaluations."""

    depth: float
    evaluations: int


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
        if following == depth or not low < following < high or abs(following - depth) <= 1e-16 * depth:
            break
        depth = following
    return StaticSolution(depth, evaluations)

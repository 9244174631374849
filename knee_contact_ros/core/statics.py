"""The static solution: the depth at which a contact law at rest carries a load (the start of every run)."""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import ContactLaw, static_force
from knee_contact_ros.core.contact_pairs.base import Touch
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined

MAX_ITERATIONS = 200
NO_LIMIT = 1_000_000
"""Number of evaluations that stands for no limit"""
ANSWER = 24
"""Largest number of evaluations for the answer to an unresolved tick: enough for any load without a guess"""
ROUNDING = 1e-16
"""Error [m] to which depth and height are solved, or part of them."""
START_HEIGHT = 0.1
"""Height [m] at which the search for the femoral height begins: above any contact."""
RESOLVED = 1e-3
"""Largest part of the depth that Newton's last correction may be"""
DEEPEST = 1e9
"""Depth [m] at which the search for the depth ends"""


class StaticSolution(NamedTuple):
    """Depth of equilibrium [m] and what it cost in contact law evaluations."""

    depth: float
    evaluations: int


class StaticContact(NamedTuple):
    """The contact at rest under a load."""

    height: float
    """Height of the femoral reference point [m]"""
    depth: float
    """Penetration depth [m]"""
    force: float
    """Normal contact force [N]"""
    stiffness: float
    """Slope of the force over the depth [N/m]"""
    damping: float
    """Slope of the force over the rate [N s/m]"""
    evaluations: int


@never_inlined
def static_contact(
    law: ContactLaw, touch: Touch, load: float, near_height: float, near_depth: float, resolution: float,
    most: int,
) -> StaticContact:  # fmt: skip
    """Solve n_y F(depth, 0) = load [N] for the femoral height [m]; a load <= 0 leaves the surfaces just touching.

    `near_height` and `near_depth` [m] are guesses; without one, `START_HEIGHT` and 0. The depth is solved until
    Newton's method corrects it by less than `resolution` [m], which leaves about the square of that. The normal hardly
    turns with the height, so depth and height are solved alternately; on a plane one round is exact. About `most`
    evaluations are taken; what is not solved by then is returned as it is.
    """
    near, depth, evaluations, cosine = near_depth, 0.0, 0, 0.0
    height = height_at(touch, near_depth, near_height)
    for _ in range(MAX_ITERATIONS):
        last = cosine
        _, _, cosine = touch.touch(height)
        if abs(cosine - last) <= ROUNDING or evaluations >= most:
            break
        solution = static_depth(law, load / cosine, near, resolution, most - evaluations)
        depth, near = solution.depth, solution.depth
        evaluations += solution.evaluations
        height = height_at(touch, depth, height)
    force, stiffness, damping = static_force(law, depth)
    return StaticContact(
        height=height, depth=depth, force=force, stiffness=stiffness, damping=damping,
        evaluations=evaluations + (1 if depth > 0.0 else 0),
    )  # fmt: skip


@in_kernel
def height_at(touch: Touch, depth: float, near: float) -> float:
    """Solve depth(height) = depth [m] for the height [m] by Newton's method, from a height `near` it."""
    height = near
    for _ in range(MAX_ITERATIONS):
        reached, _, cosine = touch.touch(height)
        correction = (reached - depth) / cosine
        height += correction
        if abs(correction) <= ROUNDING * max(1.0, abs(height)) or height + 0.5 * correction == height:
            break
    return height


@in_kernel
def static_depth(law: ContactLaw, force: float, near: float, resolution: float, most: int) -> StaticSolution:
    """Solve F(depth, 0) = force [N] for the depth [m]; 0 for a force <= 0 (just touching).

    Newton's method from `near` [m], of the logarithms where that is far, inside a bracket that halves when Newton
    leaves it, until a correction is below `resolution` [m] (0: to rounding); the static force grows with the depth in
    every law. For a force that is not reached at 1e9 m the solution is that depth. `most` limits the evaluations.
    """
    if force <= 0.0:
        return StaticSolution(0.0, 0)
    evaluations, layer, base = 0, 0, 0.0
    for index in range(1, len(law.layers)):
        evaluations += 1
        carried, _, _ = law.layers[index - 1].formula.force_at(law.layers[index].begin, 0.0, 0.0)
        if carried < force:
            layer, base = index, carried
    begin = law.layers[layer].begin
    low, high, depth, extra = bracket(law, layer, force, near)
    evaluations += extra
    for _ in range(MAX_ITERATIONS):
        value, slope, _ = law.layers[layer].formula.force_at(depth, 0.0, 0.0)
        evaluations += 1
        if value >= force:
            high = depth
        else:
            low = depth
        newton = depth - (value - force) / slope if slope > 0.0 else low
        if slope > 0.0 and value > base and not 0.5 * (force - base) < value - base < 2.0 * (force - base):
            # Far away the force is nearly a power of the depth in the layer, which this solves at once.
            exponent = (value - base) / (slope * (depth - begin))
            newton = begin + (depth - begin) * ((force - base) / (value - base)) ** exponent
        following = newton if low < newton < high else 0.5 * (low + high)
        correction = abs(following - depth)
        if newton == depth or not low < following < high or correction <= ROUNDING * depth:
            break
        depth = following
        if correction <= min(resolution, RESOLVED * depth) or evaluations >= most:
            break
    return StaticSolution(depth, evaluations)


@in_kernel
def bracket(law: ContactLaw, layer: int, force: float, near: float) -> tuple[float, float, float, int]:
    """Return two depths [m] between which a layer reaches a force [N], a guess between them, and evaluations taken."""
    low, high, evaluations = law.layers[layer].begin, DEEPEST, 0
    if low < near < high:
        return low, high, near, evaluations
    depth = max(2.0 * low, 1e-9)
    evaluations += 1
    while depth < high and law.layers[layer].formula.force_at(depth, 0.0, 0.0)[0] < force:
        evaluations += 1
        low, depth = depth, 10.0 * depth
    return low, depth, depth, evaluations

"""The static contact n_y F(δ, 0) = L: the start of a run, the quasi-static level, and the answer to a given-up tick."""

import math

from .closest import Surfaces, touch
from .compiler import in_kernel
from .laws import BEGIN, force_at, law_force
from .types import Floats

MAX_ITERATIONS = 200
MAX_ANSWER_EVALUATIONS = 24
"""Largest number of evaluations for the answer to a tick that was given up: enough for any load without a guess"""
NO_LIMIT = 1_000_000
"""Number of evaluations that means no limit"""
STATIC_ROUNDING = 1e-16
"""Error to which depth and height are solved: in m, or relative to them"""
START_HEIGHT = 0.1
"""Height [m] at which the search for the femoral height begins: above any contact"""
MAX_LAST_CORRECTION = 1e-3
"""Largest last correction of Newton's method, relative to the depth, whatever the resolution"""
MAX_SEARCH_DEPTH = 1e9
"""Depth [m] at which the search for the depth ends"""


@in_kernel
def height_at(surfaces: Surfaces, angle: float, depth: float, near: float) -> float:
    """Solve depth(height) = depth [m] for the height [m] by Newton's method, from a height `near` it."""
    height = near
    for _ in range(MAX_ITERATIONS):
        reached, _, cosine = touch(surfaces, angle, 0.0, height)
        correction = (reached - depth) / cosine
        height += correction
        if (
            abs(correction) <= STATIC_ROUNDING * max(1.0, abs(height))
            or height + 0.5 * correction == height
        ):
            break
    return height


@in_kernel
def static_depth(
    law: Floats, force: float, near: float, resolution: float, most: int
) -> tuple[float, int]:
    """Solve F(depth, 0) = force [N] for the depth [m]; 0 for a force <= 0 (just touching). Also return evaluations.

    Newton's method starts at `near` [m], uses logarithms if that is far, and stays in a bracket that is halved when an
    iterate leaves it. It stops when a correction is below `resolution` [m] (0: to rounding). The static force grows
    with the depth in every law. A force that is not reached at 1e9 m gives that depth. `most` limits the evaluations.
    """
    if force <= 0.0:
        return 0.0, 0
    # The deepest layer whose beginning carries less than the force, and what the layers above it carry [N].
    evaluations, layer, base = 0, 1, 0.0
    for index in range(2, len(law) - 1):
        evaluations += 1
        carried, _, _ = force_at(law, index - 1, float(law[index, BEGIN]), 0.0, 0.0)
        if carried < force:
            layer, base = index, carried
    begin = float(law[layer, BEGIN])
    low, high, depth = begin, MAX_SEARCH_DEPTH, near
    if not low < near < high:
        # Without a guess the depth is enclosed in steps of a decade, as laws span many of them.
        depth = max(2.0 * low, 1e-9)
        evaluations += 1
        while depth < high and force_at(law, layer, depth, 0.0, 0.0)[0] < force:
            evaluations += 1
            low, depth = depth, 10.0 * depth
        high = depth
    for _ in range(MAX_ITERATIONS):
        value, slope, _ = force_at(law, layer, depth, 0.0, 0.0)
        evaluations += 1
        if value >= force:
            high = depth
        else:
            low = depth
        newton = depth - (value - force) / slope if slope > 0.0 else low
        in_layer, wanted = value - base, force - base
        if slope > 0.0 and value > base and not 0.5 * wanted < in_layer < 2.0 * wanted:
            # Far away the force is nearly a power of the depth in the layer, which this solves at once.
            exponent = in_layer / (slope * (depth - begin))
            newton = begin + (depth - begin) * (wanted / in_layer) ** exponent
        # Halving keeps the method safe at the beginning of a layer, where the slope is 0.
        following = newton if low < newton < high else 0.5 * (low + high)
        correction = abs(following - depth)
        if newton == depth or not low < following < high or correction <= STATIC_ROUNDING * depth:
            break
        depth = following
        if correction <= min(resolution, MAX_LAST_CORRECTION * depth) or evaluations >= most:
            break
    return depth, evaluations


@in_kernel
def static_contact(
    surfaces: Surfaces,
    law: Floats,
    angle: float,
    load: float,
    near_height: float,
    near_depth: float,
    resolution: float,
    most: int,
) -> tuple[float, float, float, float, float, float, int]:
    """Solve n_y F(depth, 0) = load [N] for the femoral height [m]; a load <= 0 leaves the surfaces just touching.

    `near_height` and `near_depth` [m] are guesses; without one, `START_HEIGHT` and 0. The depth is solved until
    Newton's method corrects it by less than `resolution` [m], which leaves about the square of that. The normal hardly
    turns with the height, so depth and height are solved alternately; on a plane one round is exact. About `most`
    evaluations are taken. Returns height [m], depth [m], force [N], its slopes over the depth [N/m] and over the rate
    [N s/m], n_y, and evaluations.
    """
    near, depth, evaluations, cosine = near_depth, 0.0, 0, 0.0
    height = height_at(surfaces, angle, near_depth, near_height)
    for _ in range(MAX_ITERATIONS):
        last = cosine
        _, _, cosine = touch(surfaces, angle, 0.0, height)
        if abs(cosine - last) <= STATIC_ROUNDING or evaluations >= most:
            break
        depth, extra = static_depth(law, load / cosine, near, resolution, most - evaluations)
        near, evaluations = depth, evaluations + extra
        height = height_at(surfaces, angle, depth, height)
    force, stiffness, damping = law_force(law, depth, 0.0, 0.0)
    evaluations += 1 if depth > 0.0 else 0
    return height, depth, force, stiffness, damping, cosine, evaluations


def plain_static_depth(law: Floats, force: float) -> float:
    """Return the depth [m] at which a law at rest carries a force [N], to rounding."""
    return static_depth(law, force, 0.0, 0.0, NO_LIMIT)[0] if math.isfinite(force) else math.inf

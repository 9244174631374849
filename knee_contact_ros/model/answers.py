"""The row of answers to a tick, written by the words, bytes and half words that `types.ROW` lays out."""

import math

from .closest import closest, contact_point
from .compiler import inlined
from .contact import KneeConstants, Result
from .error_estimate import capped, velocity_bound
from .laws import BEGIN, force_at, layer_at
from .mechanisms import translation
from .types import (
    BYTE_OF,
    MAX_CONTACT_X,
    MAX_FLEXION,
    MIN_FLEXION,
    WORD_OF,
    Bytes,
    Counts,
    Floats,
    Status,
)

LARGEST_FORCE_ERROR = 1e12
"""Largest published error estimate of the contact force [N]"""
LINEAR_FORCE_FRACTION = 0.05
"""Part of the depth up to which a depth error changes the force in proportion to the stiffness. Tuned;
`studies.honesty scenes` would notice: 1532 of the quasi-static forces are not covered without it."""
NOT_CONVERGED = int(Status.NOT_CONVERGED)
IMPLAUSIBLE = int(Status.IMPLAUSIBLE)


@inlined
def write_answer(
    knee: KneeConstants,
    angle: float,
    angle_rate: float,
    load: float,
    fidelity: int,
    result: Result,
    far: bool,
    words: Floats,
    codes: Bytes,
    counts: Counts,
    i: int,
) -> None:
    """Fill row i with the answer to a tick, except for stamp and latency, which the kernel does not know."""
    stage, force, height = result.stage, result.force, result.femur.height
    depth = max(0.0, stage.depth)
    bone = max(0.0, depth - float(knee.law[2, BEGIN]))
    x, x_slope = translation(knee.surfaces.pieces, angle)
    found = closest(knee.surfaces, angle, x, height)
    _, extent, _, normal_x, normal_y = found
    point_x, point_y = contact_point(found, x, height)
    estimate, force_estimate = result.estimate, result.force_estimate
    evaluations = result.evaluations
    if estimate > LINEAR_FORCE_FRACTION * abs(stage.depth) and stage.depth + estimate > 0.0:
        # The law bends over the error of the depth: evaluate it at the deeper end.
        deeper, rate = stage.depth + estimate, stage.rate + velocity_bound(result.femur.error)
        impact = 0.0 if math.isnan(result.femur.impact_speed) else result.femur.impact_speed
        most, _, _ = force_at(knee.law, layer_at(knee.law, deeper), deeper, rate, impact)
        force_estimate = max(force_estimate, most - force, force)
        evaluations += 1
    force_kept = knee.force_tolerance == 0.0 or force_estimate <= knee.force_tolerance
    missed = not (result.converged and estimate <= knee.tolerance and force_kept)
    velocity = 0.0 if math.isnan(result.femur.velocity) else result.femur.velocity
    force_x, force_y = -force * normal_x, -force * normal_y
    words[i, WORD_OF.flexion_angle] = angle
    words[i, WORD_OF.load] = load
    words[i, WORD_OF.contact_force] = force
    words[i, WORD_OF.penetration_depth] = depth
    words[i, WORD_OF.gap] = max(0.0, -stage.depth)
    words[i, WORD_OF.penetration_rate] = stage.rate
    # Second of Eqs. 6: velocity of the femur's deepest point along the anterior tangent t = (n_y, -n_x) of the tibia.
    words[i, WORD_OF.sliding_velocity] = (
        angle_rate * (x_slope * normal_y + extent) - velocity * normal_x
    )
    words[i, WORD_OF.contact_point_x] = point_x
    words[i, WORD_OF.contact_point_y] = point_y
    words[i, WORD_OF.femoral_height] = height
    words[i, WORD_OF.femoral_x] = x
    words[i, WORD_OF.normal_x] = normal_x
    words[i, WORD_OF.normal_y] = normal_y
    words[i, WORD_OF.cartilage_depth] = depth - bone
    words[i, WORD_OF.bone_depth] = bone
    words[i, WORD_OF.error_estimate] = capped(estimate)
    force_error = force_estimate if force_estimate < LARGEST_FORCE_ERROR else LARGEST_FORCE_ERROR
    words[i, WORD_OF.force_error_estimate] = force_error
    words[i, WORD_OF.contact_wrench_force_x] = force_x
    words[i, WORD_OF.contact_wrench_force_y] = force_y
    words[i, WORD_OF.contact_wrench_torque_z] = point_x * force_y - point_y * force_x
    codes[i, BYTE_OF.contact_state] = 2 if bone > 0.0 else 1 if depth > 0.0 else 0
    codes[i, BYTE_OF.fidelity] = fidelity
    implausible = depth > knee.plausible_depth or far or not MIN_FLEXION <= angle <= MAX_FLEXION
    implausible = implausible or (depth > 0.0 and abs(point_x) > MAX_CONTACT_X)
    codes[i, BYTE_OF.status] = (NOT_CONVERGED if missed else 0) | (
        IMPLAUSIBLE if implausible else 0
    )
    counts[i, BYTE_OF.evaluations // 4] = evaluations

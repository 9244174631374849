"""The row of answers to a tick, written by the words, bytes and half words that `types.ROW` lays out."""

import math

from .closest import closest
from .compiler import inlined
from .contact import KneeConstants, Result
from .error_estimate import capped, velocity_bound
from .laws import BEGIN, force_at, layer_at
from .mechanisms import translation
from .types import (
    MAX_CONTACT_X,
    MAX_FLEXION,
    MIN_FLEXION,
    Bytes,
    Counts,
    Floats,
    Status,
    byte_offset,
    word_index,
)

LARGEST_FORCE_ERROR = 1e12
"""Largest published error estimate of the contact force [N]"""
LINEAR_FORCE_FRACTION = 0.05
"""Part of the depth up to which a depth error changes the force in proportion to the stiffness. Tuned;
`studies.honesty scenes` would notice: 1532 of the quasi-static forces are not covered without it."""
NOT_CONVERGED = int(Status.NOT_CONVERGED)
IMPLAUSIBLE = int(Status.IMPLAUSIBLE)
# Numba reads places from global numbers only. Each name of a place stands beside the name of its field.
W_ANGLE = word_index("flexion_angle")
W_LOAD = word_index("load")
W_FORCE = word_index("contact_force")
W_DEPTH = word_index("penetration_depth")
W_GAP = word_index("gap")
W_RATE = word_index("penetration_rate")
W_SLIDING = word_index("sliding_velocity")
W_POINT = word_index("contact_point_x")
W_HEIGHT = word_index("femoral_height")
W_CARTILAGE = word_index("cartilage_depth")
W_BONE = word_index("bone_depth")
W_ERROR = word_index("error_estimate")
W_FORCE_ERROR = word_index("force_error_estimate")
W_WRENCH = word_index("contact_wrench_force_x")
W_TORQUE_Z = word_index("contact_wrench_torque_z")
W_X = word_index("femoral_x")
W_NORMAL_X = word_index("normal_x")
W_NORMAL_Y = word_index("normal_y")
B_STATE = byte_offset("contact_state")
B_FIDELITY = byte_offset("fidelity")
B_STATUS = byte_offset("status")
C_EVALUATIONS = byte_offset("evaluations") // 4


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
    overlap, extent, turning, normal_x, normal_y = closest(knee.surfaces, angle, x, height)
    along, across = -turning, overlap - extent
    point_x = x + along * normal_y + across * normal_x
    point_y = height - along * normal_x + across * normal_y
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
    words[i, W_ANGLE] = angle
    words[i, W_LOAD] = load
    words[i, W_FORCE] = force
    words[i, W_DEPTH] = depth
    words[i, W_GAP] = max(0.0, -stage.depth)
    words[i, W_RATE] = stage.rate
    # Second of Eqs. 6: velocity of the femur's deepest point along the anterior tangent t = (n_y, -n_x) of the tibia.
    words[i, W_SLIDING] = angle_rate * (x_slope * normal_y + extent) - velocity * normal_x
    words[i, W_POINT] = point_x
    words[i, W_POINT + 1] = point_y
    words[i, W_HEIGHT] = height
    words[i, W_X] = x
    words[i, W_NORMAL_X] = normal_x
    words[i, W_NORMAL_Y] = normal_y
    words[i, W_CARTILAGE] = depth - bone
    words[i, W_BONE] = bone
    words[i, W_ERROR] = capped(estimate)
    force_error = force_estimate if force_estimate < LARGEST_FORCE_ERROR else LARGEST_FORCE_ERROR
    words[i, W_FORCE_ERROR] = force_error
    words[i, W_WRENCH] = force_x
    words[i, W_WRENCH + 1] = force_y
    words[i, W_TORQUE_Z] = point_x * force_y - point_y * force_x
    codes[i, B_STATE] = 2 if bone > 0.0 else 1 if depth > 0.0 else 0
    codes[i, B_FIDELITY] = fidelity
    implausible = depth > knee.plausible_depth or far or not MIN_FLEXION <= angle <= MAX_FLEXION
    implausible = implausible or (depth > 0.0 and abs(point_x) > MAX_CONTACT_X)
    codes[i, B_STATUS] = (NOT_CONVERGED if missed else 0) | (IMPLAUSIBLE if implausible else 0)
    counts[i, C_EVALUATIONS] = evaluations

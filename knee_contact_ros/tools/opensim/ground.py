"""Ground reactions of force plates → force and torque about a moving ankle."""

from __future__ import annotations

import numpy as np

from knee_contact_ros.messages.stamps import NANOSECONDS
from knee_contact_ros.offline.gait_files.leg_gait import GroundForces
from knee_contact_ros.offline.gait_files.storage import Floats, Stamps, Storage
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.opensim.external_loads import FootForce, GroundFile

IN_THE_AIR = 10.0
"""Vertical force [N] below which a foot is in the air: plates are noisy, and have no centre of pressure then"""
STANDS = 100.0
"""Vertical force [N] that a walking foot reaches, and above which its centre of pressure must be near the ankle"""
NEAR = 0.30
"""Largest median distance [m] of ankle and centre of pressure in the ground plane: more than a foot's length ahead"""


def during(ground: GroundFile, stamps: Stamps) -> GroundFile:
    """Select the rows between the first and the last stamp [ns], with a neighbour at each end.

    Raises:
        UsageError: there are fewer than two.
    """
    data = ground.data
    first = max(int(np.searchsorted(data.stamps, stamps[0], "right")) - 1, 0)
    last = int(np.searchsorted(data.stamps, stamps[-1], "left")) + 1
    within = data._replace(stamps=data.stamps[first:last], values=data.values[first:last])
    if len(within.stamps) < 2:
        span = " to ".join(f"{stamp / NANOSECONDS:g}" for stamp in (stamps[0], stamps[-1]))
        raise UsageError(f"{data.path} spans {data.span()}, and the kinematics {span} s")
    return ground._replace(data=within)


def about_ankle(ground: GroundFile, ankle: Floats) -> GroundForces:
    """Sum the forces on a foot, with their torque about the ankle, at the rows of the file; 0 with the foot in the air.

    Args:
        ground: the file, in OpenSim's axes of the ground (x forward, y up, z to the right).
        ankle: [m] the ankle joint's centre in these axes, at the file's stamps; shape (n, 3).

    Raises:
        UsageError: a number is not finite, or this cannot be what acts on this foot.
    """
    force, torque = np.zeros_like(ankle), np.zeros_like(ankle)
    for each in ground.forces:
        one, about = wrench_of(ground.data, each, ankle)
        force, torque = force + one, torque + about
    return GroundForces(ground.data.stamps, force, torque)


def wrench_of(data: Storage, names: FootForce, ankle: Floats) -> tuple[Floats, Floats]:
    """Force [N] and torque [N m] about the ankle of one external force, shapes (n, 3).

    Raises:
        UsageError: a number that counts is not finite, or this cannot be what acts on this foot.
    """
    force = vector(data, names.force)
    stands = force[:, 1] >= IN_THE_AIR
    point, moment = (vector(data, name, stands) if name else np.zeros_like(force) for name in names[1:])
    arm = np.where(stands[:, None], point - ankle, 0.0)
    check_near(data, names, arm[force[:, 1] >= STANDS])
    kept = np.where(stands[:, None], force, 0.0)
    return kept, np.where(stands[:, None], np.cross(arm, kept) + moment, 0.0)


def vector(data: Storage, name: str, where: np.ndarray | None = None) -> Floats:
    """Vector in three columns, shape (n, 3), 0 where `where`, shape (n,), is false: a point may be NaN in the air.

    Raises:
        UsageError: a number that counts is not finite.
    """
    table = np.column_stack([data.values[:, data.names.index(name + axis)] for axis in "xyz"])
    if where is not None:
        table = np.where(where[:, None], table, 0.0)
    wrong = ~np.isfinite(table).all(axis=1)
    if wrong.any():
        time = data.stamps[int(np.argmax(wrong))] / NANOSECONDS
        raise UsageError(f"{data.path}: {name}(x y z) is not finite at {time:g} s, and the foot stands")
    return table


def check_upright(ground: GroundFile) -> None:
    """Check that each force acts upwards, and is as large as that on a walking foot.

    Raises:
        UsageError: one does not or is not, or a number is not finite.
    """
    for names in ground.forces:
        up = vector(ground.data, names.force)[:, 1]
        low, high = float(up.min()), float(up.max())
        if high >= max(STANDS, -low):
            continue
        raise UsageError(
            f"{ground.data.path}: {names.force}y goes from {low:.4g} to {high:.4g}; it must be in N, upwards, "
            "and what the ground does to the foot"
        )


def check_near(data: Storage, names: FootForce, arm: Floats) -> None:
    """Check that centres of pressure are near the foot; `arm` [m] is from the ankle to each, shape (n, 3).

    Raises:
        UsageError: they are not near it.
    """
    if not len(arm):
        return
    away = float(np.median(np.hypot(arm[:, 0], arm[:, 2])))
    if away > NEAR:
        raise UsageError(
            f"{data.path}: {names.point}(x y z) is {away:.2f} m away from the ankle while the foot stands, by the "
            "median: the other foot's, not in m, or in other axes than the model's?"
        )

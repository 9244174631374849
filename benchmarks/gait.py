"""The gait bags that are part of the package, as arrays."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.reader import BagReader
from knee_contact_ros.parameters.schema import Knee
from knee_contact_ros.streams.contact_stream import angle_sample, load_sample
from knee_contact_ros.streams.messages import JOINT_STATE, WRENCH
from knee_contact_ros.streams.topics import JOINT_REACTION_FORCE, JOINT_STATES
from knee_contact_ros.system.files import share_folder


@cache
def gait(side: str) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return time [s], flexion angle [rad] and half the axial load [N] of a bundled bag.

    Both topics of the bag have the same stamps.

    Args:
        side: `right` or `left`.

    Returns:
        Three arrays of shape (n,), which cannot be written: all callers share them.
    """
    angles, loads = {}, {}
    with BagReader(share_folder() / "bags" / f"gait2354_{side}") as reader:
        for topic, _, data in reader.raw_messages():
            if topic == f"/{JOINT_STATES}":
                angle = angle_sample(JOINT_STATE.read(data, JOINT_STATES)[0], Knee())
                angles[angle.stamp] = angle.angle
            else:
                load = load_sample(WRENCH.read(data, JOINT_REACTION_FORCE)[0])
                loads[load.stamp] = 0.5 * load.axial
    stamps = sorted(loads)
    time = np.array(stamps, dtype=np.float64) * 1e-9
    columns = time, np.array([angles[stamp] for stamp in stamps]), np.array([loads[stamp] for stamp in stamps])
    for column in columns:
        column.flags.writeable = False
    return columns

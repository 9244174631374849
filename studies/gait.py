"""The gait bags that come with the package, as arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.parameters import Knee, Load
from knee_contact_ros.stream_in.bag import BagReader
from knee_contact_ros.stream_in.samples import angle_sample, load_sample
from knee_contact_ros.topics import JOINT_STATES

BAGS = Path(__file__).parent.parent / "bags"
BODY_WEIGHT = 75.16 * 9.80665
"""[N] that the paper divides by"""
HEEL_STRIKE = {"right": (0.618, 1.853), "left": (1.247, 2.460)}
"""[s] in the bags, from the vertical ground reaction"""


def gait(side: str) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Time [s], flexion angle [rad] and half the axial load [N] of a bundled bag; both topics have the same stamps."""
    angles, loads = {}, {}
    with BagReader(BAGS / f"gait2354_{side}") as reader:
        for topic, _, message in reader.messages():
            if topic == f"/{JOINT_STATES}":
                angle = angle_sample(message, Knee())
                angles[angle.stamp] = angle.angle
            else:
                load = load_sample(message, Load())
                loads[load.stamp] = load.load
    stamps = sorted(loads)
    time = np.array(stamps, dtype=np.float64) * 1e-9
    return time, np.array([angles[stamp] for stamp in stamps]), np.array([loads[stamp] for stamp in stamps])

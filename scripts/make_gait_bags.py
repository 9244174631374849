#!/usr/bin/env python3
"""Make the gait bags from tables of OpenSim results: `make_gait_bags.py CSV_FOLDER BAG_FOLDER`.

Each `gait2354_<side>.csv` (columns t [s], knee_angle [rad, flexion positive], knee_vel [rad/s], Fx Fy Fz [N] and
Mx My Mz [N m] on the tibia in the tibia frame) becomes the rosbag2 folder `gait2354_<side>`. The same table gives the
same bytes.
"""

from __future__ import annotations

import csv
import shutil
import sys
from decimal import Decimal
from pathlib import Path

from mcap.writer import CompressionType

from knee_contact_ros.bags.writer import BagWriter
from knee_contact_ros.messages.cdr import JointState, WrenchStamped, encode_joint_state, encode_wrench_stamped
from knee_contact_ros.messages.topics import INPUTS, JOINT_REACTION_FORCE, JOINT_STATES, MESSAGE_TYPES

ORIGIN = {
    "source": "OpenSim 4.6, scale, IK, RRA, CMC and JointReaction on gait2354, subject01 walking",
    "credit": "gait2354: Delp et al. 1990; Yamaguchi & Zajac 1989; Thelen; Seth; Anderson; John et al.",
    "licence": "model: CC BY 3.0; these results: Apache-2.0",
    "angle": "knee flexion, rad, positive in flexion",
    "force": "joint reaction on the tibia at its joint frame's origin, in the tibia frame (x anterior, y superior, "
    "z to the right; the left side is mirrored)",
}


def make_bag(table: Path, folder: Path) -> None:
    """Write one table as a rosbag2 folder, replacing the one that is there."""
    side = table.stem.rsplit("_", 1)[-1]
    with table.open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    shutil.rmtree(folder, ignore_errors=True)
    # Not compressed: the bytes then do not depend on the version of a compressor.
    with BagWriter(folder / f"{folder.name}_0.mcap", CompressionType.NONE) as bag:
        for topic in INPUTS:
            bag.add_topic(f"/{topic}", MESSAGE_TYPES[topic])
        bag.add_metadata("origin", ORIGIN)
        for row in rows:
            stamp = int(Decimal(row["t"]) * 1_000_000_000)
            angle = JointState(stamp, "", ("knee",), (float(row["knee_angle"]),), (float(row["knee_vel"]),), ())
            force, torque = (tuple([float(row[f"{letter}{axis}"]) for axis in "xyz"]) for letter in "FM")
            wrench = WrenchStamped(stamp, f"tibia_{side[0]}", force, torque)
            bag.write(f"/{JOINT_STATES}", stamp, encode_joint_state(angle))
            bag.write(f"/{JOINT_REACTION_FORCE}", stamp, encode_wrench_stamped(wrench))


def main() -> int:
    """Make all bags."""
    tables, bags = map(Path, sys.argv[1:3])
    for table in sorted(tables.glob("gait2354_*.csv")):
        make_bag(table, bags / table.stem)
        print(f"{bags / table.stem} from {table}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

#!/usr/bin/env python3
"""Make the gait bags from tables of OpenSim results: `make_gait_bags.py CSV_FOLDER BAG_FOLDER`.

Each `gait2354_<side>.csv` (columns t [s], knee_angle [rad, flexion positive], knee_vel [rad/s], Fx Fy Fz [N] and
Mx My Mz [N m] on the tibia in the tibia frame) becomes the rosbag2 folder `gait2354_<side>`. The same table gives the
same bytes.

The right one becomes `gait2354_right_sensors`, too: what a knee encoder and an insole would tell. The trial's measured
ground force is not ours to give away, so the insole's is modelled: `vertical_force`.
"""

from __future__ import annotations

import csv
import math
import shutil
import sys
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path

from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import INPUTS, LOAD_INPUTS, MESSAGE_TYPES

ORIGIN = {
    "source": "OpenSim 4.6, scale, IK, RRA, CMC and JointReaction on gait2354, subject01 walking",
    "credit": "gait2354: Delp et al. 1990; Yamaguchi & Zajac 1989; Thelen; Seth; Anderson; John et al.",
    "licence": "model: CC BY 3.0; these results: Apache-2.0",
    "angle": "knee flexion, rad, positive in flexion",
    "force": "joint reaction on the tibia at its joint frame's origin, in the tibia frame (x anterior, y superior, "
    "z to the right; the left side is mirrored)",
}
SENSORS = ORIGIN | {
    "force": "vertical ground force on the foot in force.y, all else 0; modelled and not measured: Alexander & Jayes "
    "1980 (doi:10.1016/0021-9290(80)90019-6), from body mass, heel strikes and toe-offs",
}
BODY_WEIGHT = 72.6 * 9.80665
"""Body weight [N] of the trial's subject"""
HEEL_STRIKES, STANCE = (0.618, 1.853), 0.792
"""Times [s] of the right foot's heel strikes, and from one to its toe-off"""
SHAPE = 0.3
"""Shape of the vertical force: above 1/9 it has two humps; here 1.02 body weights each, and a valley of 0.78"""


def vertical_force(time: float) -> float:
    """Vertical ground force [N] on the right foot at a time [s], by two terms of a Fourier series.

    Alexander & Jayes (1980), Fourier analysis of forces exerted in walking and running,
    doi:10.1016/0021-9290(80)90019-6: A (cos(pi x) - q cos(3 pi x)) from x = -1/2 at heel strike to 1/2 at toe-off.
    A follows from the weight: over a stride each of two equal legs bears half of it.
    """
    stride = HEEL_STRIKES[1] - HEEL_STRIKES[0]
    size = 0.5 * BODY_WEIGHT * stride / (2.0 * STANCE / math.pi * (1.0 + SHAPE / 3.0))
    since = time - max(strike for strike in (-math.inf, *HEEL_STRIKES) if strike <= time)
    if since >= STANCE:
        return 0.0
    turn = math.pi * (since / STANCE - 0.5)
    return size * (math.cos(turn) - SHAPE * math.cos(3.0 * turn))


def rows_of(table: Path) -> list[dict[str, str]]:
    """Rows of a table of OpenSim results."""
    with table.open(encoding="utf-8") as lines:
        return list(csv.DictReader(line for line in lines if not line.startswith("#")))


def joint_reaction(row: dict[str, str], stamp: int, side: str) -> WrenchStamped:
    """WrenchStamped that the femur exerts on the tibia."""
    force, torque = (tuple([float(row[f"{letter}{axis}"]) for axis in "xyz"]) for letter in "FM")
    return WrenchStamped(stamp, f"tibia_{side[0]}", force, torque)


def ground_force(row: dict[str, str], stamp: int, _side: str) -> WrenchStamped:
    """WrenchStamped that an insole would measure."""
    vertical = round(vertical_force(float(row["t"])), 3)
    return WrenchStamped(stamp, "insole", (0.0, vertical, 0.0), (0.0, 0.0, 0.0))


Wrench = Callable[[dict[str, str], int, str], WrenchStamped]


def make_bag(
    table: Path, folder: Path, topics: tuple[str, str], wrench_at: Wrench, origin: dict[str, str]
) -> None:
    """Write a table's angles and a wrench as a rosbag2 folder, which replaces the one that is there."""
    side = table.stem.rsplit("_", 1)[-1]
    shutil.rmtree(folder, ignore_errors=True)
    # Not compressed: the bytes then do not depend on the version of a compressor.
    with BagWriter(folder / f"{folder.name}_0.mcap", compressed=False) as bag:
        for topic in topics:
            bag.add_topic(f"/{topic}", MESSAGE_TYPES[topic])
        bag.add_metadata("origin", origin)
        for row in rows_of(table):
            stamp = int(Decimal(row["t"]) * 1_000_000_000)
            angle = JointState(
                stamp, "", ("knee",), (float(row["knee_angle"]),), (float(row["knee_vel"]),), ()
            )
            bag.write_message(f"/{topics[0]}", stamp, encode_joint_state(angle))
            bag.write_message(
                f"/{topics[1]}", stamp, encode_wrench_stamped(wrench_at(row, stamp, side))
            )
    print(f"{folder} from {table}")


def main() -> int:
    """Make all gait bags."""
    tables, bags = map(Path, sys.argv[1:3])
    for table in sorted(tables.glob("gait2354_*.csv")):
        make_bag(table, bags / table.stem, INPUTS, joint_reaction, ORIGIN)
    right = "gait2354_right"
    make_bag(
        tables / f"{right}.csv", bags / f"{right}_sensors", LOAD_INPUTS, ground_force, SENSORS
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

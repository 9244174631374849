"""What OpenSim computes of gait2354's walk, in a process of its own: it prints much, and can take its process with it.

python opensim_step.py, in a folder with the model's set-up files, scales the model, runs its inverse dynamics into
`load_inverse_dynamics.sto`, and writes `load_centres.csv`: time, and of either leg the centres of hip, knee and ankle
and the x axis of the tibia, all in the ground's frame. It imports nothing of ours.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import opensim

KINEMATICS = "reference_CMC_Kinematics_q.sto"
SIDES = "rl"
JOINTS = ("hip", "knee", "ankle")
TRANSLATIONAL = 2
"""OpenSim's number for a coordinate that is a length"""


def scaled() -> opensim.Model:
    """Scaled model of the person who walks."""
    opensim.ScaleTool("subject01_Setup_Scale.xml").run()
    return opensim.Model("subject01_simbody.osim")


def inverse_dynamics(model: opensim.Model, first: float, last: float) -> None:
    """Moments of all joints by OpenSim's inverse dynamics, from the same motion and the same plates."""
    muscles = opensim.ArrayStr()
    muscles.append("Muscles")
    tool = opensim.InverseDynamicsTool()
    tool.setModel(model)
    tool.setCoordinatesFileName(KINEMATICS)
    tool.setLowpassCutoffFrequency(6.0)
    tool.setExternalLoadsFileName("subject01_walk1_grf.xml")
    tool.setExcludedForces(muscles)
    tool.setStartTime(first)
    tool.setEndTime(last)
    tool.setOutputGenForceFileName("load_inverse_dynamics.sto")
    tool.run()


def centres(model: opensim.Model, table: opensim.TimeSeriesTable) -> list[list[float]]:
    """Rows of joint centres for every time of the motion."""
    state = model.initSystem()
    names, values = list(table.getColumnLabels()), table.getMatrix().to_numpy()
    coordinates, joints, bodies = model.getCoordinateSet(), model.getJointSet(), model.getBodySet()
    rows = []
    for time, row in zip(table.getIndependentColumn(), values, strict=True):
        for name, value in zip(names, row.tolist(), strict=True):
            if coordinates.contains(name):
                coordinate = coordinates.get(name)
                length = int(coordinate.getMotionType()) == TRANSLATIONAL
                coordinate.setValue(state, value if length else math.radians(value), False)
        model.assemble(state)
        model.realizePosition(state)
        told = [float(time)]
        for side in SIDES:
            for joint in JOINTS:
                place = joints.get(f"{joint}_{side}").getChildFrame().getPositionInGround(state)
                told += [place.get(axis) for axis in range(3)]
            forward = bodies.get(f"tibia_{side}").expressVectorInGround(state, opensim.Vec3(1.0, 0.0, 0.0))
            told += [forward.get(axis) for axis in range(3)]
        rows.append(told)
    return rows


def main() -> None:
    """Compute all results and write them to files."""
    opensim.Logger.setLevelString("Off")
    model = scaled()
    table = opensim.TimeSeriesTable(KINEMATICS)
    times = list(table.getIndependentColumn())
    inverse_dynamics(model, times[0], times[-1])
    columns = [f"{what}_{side}_{axis}" for side in SIDES for what in (*JOINTS, "tibia") for axis in "xyz"]
    header = ",".join(["time", *columns])
    np.savetxt(Path("load_centres.csv"), np.array(centres(model, table)), delimiter=",", header=header, comments="")


if __name__ == "__main__":
    main()

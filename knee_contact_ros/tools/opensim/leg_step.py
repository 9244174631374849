"""Compute positions of a leg's joints with OpenSim, in a process of its own with the arguments REQUEST ANSWER (JSON).

It imports nothing of ours: OpenSim prints much, and can end its process. It runs in a folder that it may write to.

REQUEST has `model` (its path), `joints` (names of hip, knee and ankle), `degrees` (whether angles are in degrees) and
`coordinates` (by name, a value for each row). ANSWER is a list with a list for each row: the centres of hip, knee and
ankle [m] and the pelvis's x axis, each three numbers in ground, and the angle of the foot's x axis above the shank's
[rad].
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any


def main() -> int:
    """Read the request, and write the answer; return the exit code."""
    import opensim

    request = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    model = opensim.Model(request["model"])
    state = model.initSystem()
    joints = [model.getJointSet().get(name) for name in request["joints"]]
    coordinates = [model.getCoordinateSet().get(name) for name in request["coordinates"]]
    turning = [request["degrees"] and each.getMotionType() == opensim.Coordinate.Rotational for each in coordinates]
    for coordinate in coordinates:
        coordinate.setLocked(state, False)
    answer = []
    for values in zip(*request["coordinates"].values(), strict=True):
        for coordinate, value, degrees in zip(coordinates, values, turning, strict=True):
            coordinate.setValue(state, math.radians(value) if degrees else value, False)
        if model.getConstraintSet().getSize():
            model.assemble(state)
        model.realizePosition(state)
        answer.append(row(opensim.Vec3(1.0, 0.0, 0.0), joints, state))
    Path(sys.argv[2]).write_text(json.dumps(answer), encoding="utf-8")
    return 0


def row(forward: Any, joints: list[Any], state: Any) -> list[float]:
    """Row of the answer for a state of the model; `forward` is the x axis as a vector of OpenSim."""
    hip, knee, ankle = joints
    vectors = [joint.getChildFrame().getPositionInGround(state) for joint in joints]
    vectors.append(hip.getParentFrame().findBaseFrame().expressVectorInGround(state, forward))
    shank, foot = knee.getChildFrame().findBaseFrame(), ankle.getChildFrame().findBaseFrame()
    toes = foot.expressVectorInAnotherFrame(state, forward, shank)
    return [vector.get(axis) for vector in vectors for axis in range(3)] + [math.atan2(toes.get(1), toes.get(0))]


if __name__ == "__main__":
    raise SystemExit(main())

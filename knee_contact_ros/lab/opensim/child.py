"""What OpenSim does in a process of its own: `TOOL SETUP` runs a tool, `places REQUEST ANSWER` finds a leg's joints.

It imports nothing of ours: OpenSim prints much, and can end its process. It runs in a folder that it may write to.

REQUEST (JSON) has `model` (its path), `joints` (names of hip, knee and ankle), `degrees` (whether angles are in
degrees) and `coordinates` (by name, a value for each row). ANSWER is a list with a list for each row: the centres of
hip, knee and ankle [m] and the pelvis's x axis, each three numbers in ground, and the angle of the foot's x axis above
the shank's [rad].
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

PLACES = "places"


def main(what: str, *files: str) -> int:
    """Run a tool with its set-up file, or find places; return the exit code, 1 if the tool reports that it failed."""
    import opensim

    if what != PLACES:
        return 0 if getattr(opensim, what)(*files).run() else 1
    request, answer = map(Path, files)
    answer.write_text(json.dumps(places(opensim, json.loads(request.read_text(encoding="utf-8")))), encoding="utf-8")
    return 0


def places(opensim: Any, request: dict[str, Any]) -> list[list[float]]:
    """Answer a request; `opensim` is the module."""
    model = opensim.Model(request["model"])
    state = model.initSystem()
    hip, knee, ankle = joints = [model.getJointSet().get(name) for name in request["joints"]]
    coordinates = [model.getCoordinateSet().get(name) for name in request["coordinates"]]
    turning = [request["degrees"] and each.getMotionType() == opensim.Coordinate.Rotational for each in coordinates]
    for coordinate in coordinates:
        coordinate.setLocked(state, False)
    pelvis = hip.getParentFrame().findBaseFrame()
    shank, foot = knee.getChildFrame().findBaseFrame(), ankle.getChildFrame().findBaseFrame()
    forward, answer = opensim.Vec3(1.0, 0.0, 0.0), []
    for values in zip(*request["coordinates"].values(), strict=True):
        for coordinate, value, degrees in zip(coordinates, values, turning, strict=True):
            coordinate.setValue(state, math.radians(value) if degrees else value, False)
        if model.getConstraintSet().getSize():
            model.assemble(state)
        model.realizePosition(state)
        vectors = [joint.getChildFrame().getPositionInGround(state) for joint in joints]
        vectors.append(pelvis.expressVectorInGround(state, forward))
        toes = foot.expressVectorInAnotherFrame(state, forward, shank)
        numbers = [vector.get(axis) for vector in vectors for axis in range(3)]
        answer.append([*numbers, math.atan2(toes.get(1), toes.get(0))])
    return answer


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))

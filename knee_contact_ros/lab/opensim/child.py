"""OpenSim in its own process: `TOOL SETUP` runs a tool, `places REQUEST ANSWER` computes where frames are.

OpenSim prints a lot and may end its process, so this module imports nothing of ours. It runs in a writable folder.

REQUEST (JSON) has `model` (its path), `degrees` (whether angles are in degrees), `coordinates` (by name, a value for
each row) and `frames`, pairs of a kind and a name: of a joint `child` (its frame on the child), `child_base` and
`parent_base` (the bodies); or `frame` (a body, the ground or another frame of the model). ANSWER has `names` (those of
the frames), `places` (by row and frame: the nine numbers of its rotation in ground, and its origin there [m]), and
`unknown`: coordinates between the first two frames that the request does not have.
"""

import json
import math
import sys
from pathlib import Path
from typing import Any

PLACES = "places"


def main(what: str, *files: str) -> int:
    """Run a tool with its set-up file, or find places; return the exit code, 1 if the tool reports a failure."""
    import opensim

    if what != PLACES:
        return 0 if getattr(opensim, what)(*files).run() else 1
    request, answer = map(Path, files)
    answer.write_text(
        json.dumps(places(opensim, json.loads(request.read_text(encoding="utf-8")))),
        encoding="utf-8",
    )
    return 0


def places(opensim: Any, request: dict[str, Any]) -> dict[str, Any]:
    """Answer a request; `opensim` is the module."""
    model = opensim.Model(request["model"])
    state = model.initSystem()
    frames = [_frame(model, kind, name) for kind, name in request["frames"]]
    coordinates = [model.getCoordinateSet().get(name) for name in request["coordinates"]]
    turning = [
        request["degrees"] and each.getMotionType() == opensim.Coordinate.Rotational
        for each in coordinates
    ]
    unknown = [
        each.getName()
        for each in (
            model.getCoordinateSet().get(place)
            for place in range(model.getCoordinateSet().getSize())
        )
        if each.getName() not in request["coordinates"] and _moves(model, state, each, *frames[:2])
    ]
    for coordinate in coordinates:
        coordinate.setLocked(state, False)
    rows = []
    for values in zip(*request["coordinates"].values(), strict=True):
        for coordinate, value, degrees in zip(coordinates, values, turning, strict=True):
            coordinate.setValue(state, math.radians(value) if degrees else value, False)
        if model.getConstraintSet().getSize():
            model.assemble(state)
        model.realizePosition(state)
        rows.append([_numbers(frame.getTransformInGround(state)) for frame in frames])
    return {"names": [frame.getName() for frame in frames], "places": rows, "unknown": unknown}


def _frame(model: Any, kind: str, name: str) -> Any:
    """Find a frame of a request."""
    if kind == "frame":
        found = [each for each in model.getFrameList() if each.getName() == name]
        if len(found) != 1:
            raise ValueError(f"error: the model has {len(found)} frames {name}")
        return found[0]
    joint = model.getJointSet().get(name)
    frame = joint.getParentFrame() if kind == "parent_base" else joint.getChildFrame()
    return frame if kind == "child" else frame.findBaseFrame()


def _moves(model: Any, state: Any, coordinate: Any, frame: Any, other: Any) -> bool:
    """Whether a free coordinate moves two frames relative to each other."""
    if coordinate.getLocked(state) or coordinate.isDependent(state):
        return False
    places = []
    for step in (0.1, -0.1):
        model.realizePosition(state)
        places.append(_numbers(frame.findTransformBetween(state, other)))
        coordinate.setValue(state, coordinate.getValue(state) + step, False)
    return any(abs(a - b) > 1e-9 for a, b in zip(*places, strict=True))


def _numbers(transform: Any) -> list[float]:
    """Rotation by rows, and origin, of a transform."""
    rotation, origin = transform.R(), transform.p()
    return [
        *(rotation.get(row, column) for row in range(3) for column in range(3)),
        *(origin.get(k) for k in range(3)),
    ]


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))

"""Ground reactions and external loads as OpenSim has them, made by the tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from tests.lab.opensim.storages import DURATION, write_storage

LOADS = """<?xml version="1.0"?><OpenSimDocument Version="40000"><ExternalLoads name="loads"><objects>{}</objects>
<datafile>{}</datafile></ExternalLoads></OpenSimDocument>"""
FORCE = """<ExternalForce name="{body}"><applied_to_body>{body}</applied_to_body>
<force_identifier>{stem}v</force_identifier><point_identifier>{stem}p</point_identifier>
<torque_identifier>{torque}</torque_identifier>{more}</ExternalForce>"""
MODEL = """<?xml version="1.0"?><OpenSimDocument Version="40000"><Model name="m"><BodySet><objects>
<Body name="a"><mass>72.6</mass></Body></objects></BodySet><JointSet><objects>{}</objects></JointSet></Model>
</OpenSimDocument>"""
JOINT = '<CustomJoint name="{0}"><coordinates><Coordinate name="{1}"/></coordinates></CustomJoint>'
JOINTS = (("hip", "hip_flexion"), ("walker_knee", "knee_angle"), ("ankle", "ankle_angle"), ("subtalar", "turn"))
FREE = (1.0, 7.0, -2.0)
"""[N m] free moment of a plate"""
TIME = np.linspace(0.0, DURATION, 241)
STANDS = TIME < 0.7
"""Then the foot is in the air"""


def plate(stem: str, torque: str, ankle: tuple[float, float, float] = (0.4, 0.09, 0.1)) -> dict[str, np.ndarray]:
    """Columns of a plate that a foot stands on, 0.1 m ahead of the ankle; nothing of it is a number in the air."""
    points = (ankle[0] + 0.1, 0.0, ankle[2] + 0.02)
    forces = (50.0 + TIME, 700.0 - 100.0 * TIME, -40.0 + TIME)
    columns = {f"{stem}v{axis}": np.where(STANDS, force, 0.0) for axis, force in zip("xyz", forces, strict=True)}
    columns |= {f"{stem}p{axis}": np.where(STANDS, at, np.nan) for axis, at in zip("xyz", points, strict=True)}
    if torque:
        columns |= {torque + axis: np.where(STANDS, value, 3.0) for axis, value in zip("xyz", FREE, strict=True)}
    return columns


def write_plates(path: Path, *columns: Mapping[str, np.ndarray]) -> Path:
    """A .mot file with these plates."""
    return write_storage(path, TIME, {name: values for each in columns for name, values in each.items()}, "yes")


def external(body: str, stem: str = "ground_force_", torque: str = "ground_torque_", more: str = "") -> str:
    """An external force on a body."""
    return FORCE.format(body=body, stem=stem, torque=torque, more=more)


def write_loads(path: Path, data: str, forces: Sequence[str]) -> Path:
    """An external loads file."""
    path.write_text(LOADS.format("".join(forces), data))
    return path


def write_model(path: Path, sides: str = "rl") -> Path:
    """A model's file, as far as names of joints and coordinates go."""
    joints = [JOINT.format(f"{joint}_{side}", f"{angle}_{side}") for side in sides for joint, angle in JOINTS]
    path.write_text(MODEL.format("".join(joints)))
    return path

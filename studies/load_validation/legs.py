"""The shipped walk of OpenSim's gait2354 as walks of both legs: what our sensors would say, and what OpenSim says.

The reference is a model's: muscles are those of computed muscle control, and nothing of it was measured in a knee.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.joint_reaction.estimator import LEVELS
from knee_contact_ros.joint_reaction.leg import Ground, Joints, MotionFilter, NetMoments, leg_of
from knee_contact_ros.lab.tables import Table, read_storage
from studies.load_validation.walks import Floats, Walk

NEEDED = (
    "gait2354_simbody.osim", "subject01_Setup_Scale.xml", "subject01_static.trc", "subject01_walk1_grf.mot",
    "subject01_walk1_grf.xml", "reference_CMC_Kinematics_q.sto", "reference_JointReaction_ReactionLoads.sto",
)  # fmt: skip
STEP = Path(__file__).resolve().with_name("opensim_step.py")
SIDES = {"right": "r", "left": "l"}
PLATES = {"right": "", "left": "1_"}
MASS, HEIGHT = 72.6, 1.80
"""Mass [kg] and height [m] of the person, as in the set-up for scaling"""
WINDOW = 0.05
"""Time [s] over which the motion is estimated: the parameters' default"""
SEEN = 0.05
"""Time [s] from the beginning until the motion is known"""
SECOND = 1e9
FOLDER, CENTRES = "gait2354", "load_centres.csv"


class Leg(NamedTuple):
    """A leg's walk, and OpenSim's own moments [N m] beside ours, shape (n,) each."""

    walk: Walk
    knee: Floats
    """OpenSim's moment of the knee, extension positive"""
    ankle: Floats
    """OpenSim's moment of the ankle, plantarflexion positive"""
    frontal: Floats
    """Moment of the plate's wrench about the knee's centre, about x of the tibia, in three dimensions"""


def is_there(folder: Path) -> bool:
    """Whether a folder has the model, its walk and OpenSim's results."""
    return all((folder / name).is_file() for name in NEEDED)


def is_installed() -> bool:
    """Whether OpenSim is installed."""
    return find_spec("opensim") is not None


def is_computed(work: Path) -> bool:
    """Whether `computed` has all results already."""
    return (work / FOLDER / CENTRES).is_file()


def computed(folder: Path, work: Path) -> Path:
    """Folder with OpenSim's results for a model's folder, which are computed in `work` if they are not there yet."""
    place = work / FOLDER
    if not is_computed(work):
        shutil.copytree(folder, place, dirs_exist_ok=True, copy_function=shutil.copyfile)
        step = [sys.executable, str(STEP)]
        with (place / "load_opensim.log").open("wb") as log:
            subprocess.run(step, cwd=place, check=True, stdout=log, stderr=subprocess.STDOUT)
    return place


def legs(place: Path) -> list[Leg]:
    """Right and left leg, from a folder of `computed`."""
    files = {
        "motion": "reference_CMC_Kinematics_q.sto", "plates": "subject01_walk1_grf.mot",
        "reaction": "reference_JointReaction_ReactionLoads.sto", "dynamics": "load_inverse_dynamics.sto",
    }  # fmt: skip
    tables = {what: read_storage(place / name) for what, name in files.items()}
    centres = np.genfromtxt(place / CENTRES, delimiter=",", names=True)
    return [_leg(side, tables, centres) for side in SIDES]


def _at(time: Floats, storage: Table, name: str) -> Floats:
    """Column of a storage at other times [s]."""
    found: Floats = np.interp(time, storage.stamps / SECOND, storage.column(name))
    return found


def _three(time: Floats, storage: Table, prefix: str) -> Floats:
    """Three columns of a storage, shape (n, 3)."""
    return np.stack([_at(time, storage, f"{prefix}{axis}") for axis in "xyz"], axis=1)


def _leg(side: str, tables: dict[str, Table], centres: NDArray[np.void]) -> Leg:
    letter, plate = SIDES[side], PLATES[side]
    time, mirror = np.asarray(centres["time"]), 1.0 if side == "right" else -1.0
    hip, knee, ankle, forward = (
        np.stack([centres[f"{what}_{letter}_{axis}"] for axis in "xyz"], axis=1)
        for what in ("hip", "knee", "ankle", "tibia")
    )
    force, place, free = (
        _three(time, tables["plates"], f"{plate}ground_{what}") for what in ("force_v", "force_p", "torque_")
    )
    about_ankle, about_knee = (np.cross(place - centre, force) + free for centre in (ankle, knee))
    joints = [
        Joints(*angles)
        for angles in zip(
            (-np.radians(_at(time, tables["motion"], f"knee_angle_{letter}"))).tolist(),
            np.arctan2(knee[:, 0] - hip[:, 0], hip[:, 1] - knee[:, 1]).tolist(),
            np.radians(_at(time, tables["motion"], f"ankle_angle_{letter}")).tolist(),
            strict=True,
        )
    ]
    wrenches = zip((force * [1.0, 1.0, mirror]).tolist(), (about_ankle * [mirror, mirror, 1.0]).tolist(), strict=True)
    reaction = f"knee_{letter}_on_tibia_{letter}_in_tibia_{letter}_fy"
    walk = Walk(
        f"OpenSim, {side}", MASS, HEIGHT, time, force[:, 1], joints,
        nets_of(time, joints, [Ground((x, y, z), (a, b, c)) for (x, y, z), (a, b, c) in wrenches]),
        -_at(time, tables["reaction"], reaction), time > time[0] + SEEN,
    )  # fmt: skip
    return Leg(
        walk, _at(time, tables["dynamics"], f"knee_angle_{letter}_moment"),
        -_at(time, tables["dynamics"], f"ankle_angle_{letter}_moment"), -mirror * (about_knee * forward).sum(axis=1),
    )  # fmt: skip


def nets_of(time: Floats, joints: list[Joints], grounds: list[Ground]) -> dict[str, list[NetMoments]]:
    """Net moments of our levels from the sensors' samples, stamp by stamp, by level."""
    found: dict[str, list[NetMoments]] = {level: [] for level in LEVELS}
    leg, seen = leg_of(MASS, HEIGHT), MotionFilter(WINDOW)
    for stamp, one, ground in zip(np.rint(time * SECOND).astype(np.int64).tolist(), joints, grounds, strict=True):
        motion = seen.see(stamp, one)
        for level, way in LEVELS.items():
            found[level].append(way.dynamics(leg, one, motion, ground))
    return found


def nets_in(walk: Walk) -> tuple[Floats, Floats, Floats]:
    """Our moments [N m], shape (n,): extension of the knee, plantarflexion of the ankle, frontal moment of the knee."""
    nets = walk.nets["ankle_moment"]
    extension, plantarflexion, frontal = (
        np.array([net[place] for net in nets])
        for place in (NetMoments._fields.index(name) for name in ("extension", "plantarflexion", "frontal"))
    )
    return extension, plantarflexion, frontal

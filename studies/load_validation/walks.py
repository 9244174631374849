"""Measured and simulated walks, the leg and the implanted knee behind them."""

from __future__ import annotations

import math
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.joint_reaction.estimator import LEVELS
from knee_contact_ros.joint_reaction.leg import (
    GRAVITY,
    STILL,
    UNKNOWN,
    Ground,
    Joints,
    MotionFilter,
    NetMoments,
    leg_of,
)
from knee_contact_ros.joint_reaction.muscles import Person, reaction_of
from knee_contact_ros.lab.tables import Table, read_storage
from knee_contact_ros.parameters.schema import PersonParameters
from studies.validation.data import BODY_WEIGHT, ON_PLATE, TRIALS, Measured, read

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Constants(NamedTuple):
    """Personal constants of the muscles, as in `Person`."""

    moment_arm_scale: float
    co_contraction: float
    tone: float


def _defaults() -> Constants:
    person = PersonParameters()
    return Constants(person.moment_arm_scale, person.co_contraction, person.tone)


DEFAULTS = _defaults()
"""Constants by the default parameters"""
PUBLISHED = DEFAULTS._replace(moment_arm_scale=1.0)
"""Default constants with the published moment arms"""


class Walk(NamedTuple):
    """One leg in one trial, at n samples."""

    name: str
    mass: float
    """Mass [kg]"""
    height: float
    """Height [m]"""
    time: Floats
    """Times [s], shape (n,)"""
    vertical: Floats
    """Vertical ground force [N], shape (n,)"""
    joints: Sequence[Joints]
    """Joint angles and velocities, length n"""
    nets: Mapping[str, Sequence[NetMoments]]
    """Net moments by level, length n each"""
    reference: Floats
    """Axial force of the knee [N], compression positive, shape (n,)"""
    used: Flags
    """Samples that are judged and fitted to, shape (n,)"""

    @property
    def weight(self) -> float:
        """Body weight [N]."""
        return self.person(DEFAULTS).weight

    def person(self, constants: Constants) -> Person:
        """Person of this walk with constants."""
        return Person(self.mass, self.height, *constants)

    @property
    def stance(self) -> Flags:
        """Whether the foot is on the ground, shape (n,)."""
        on: Flags = self.vertical > ON_PLATE
        return on

    def steps(self) -> list[tuple[int, int]]:
        """First sample of every stance and the first one behind it, for whole stances whose samples are all used."""
        on = self.stance
        strikes = np.flatnonzero(on[1:] & ~on[:-1]) + 1
        leaves = np.flatnonzero(~on[1:] & on[:-1]) + 1
        pairs = [(int(first), int(leaves[leaves > first][0])) for first in strikes if (leaves > first).any()]
        return [(first, last) for first, last in pairs if self.used[first:last].all()]


def axial(walk: Walk, level: str, constants: Constants) -> Floats:
    """Joint reaction [N] of a walk by a level, shape (n,): `reaction_of`, sample by sample."""
    person = walk.person(constants)
    rows = zip(walk.joints, walk.nets[level], walk.vertical.tolist(), strict=True)
    return np.array([reaction_of(person, joints, net, vertical).axial for joints, net, vertical in rows])


HEIGHT = 1.7
"""Assumed height [m], which is not in the data; only the level `ground_force` needs it, for the length of the shank"""
ON_THE_PLATE_UNTIL = 3.2
"""Time [s] up to which the overground trial is used: the next step hits a plate that is not in the data"""
LARGEST_KNEE, LARGEST_ANKLE = 80.0, 150.0
"""Largest moments [N m] that are plausible in this man's walking: without the spikes they are 46 and 86 at most"""
MARGIN = 0.1
"""Time [s] before and behind a spike that is left out with it"""
MS = 1e3


class Moments(NamedTuple):
    """Net moments [N m] at the cells' samples, shape (n,)."""

    extension: Floats
    plantarflexion: Floats


def walks(folder: Path) -> list[Walk]:
    """The overground and the treadmill trial."""
    return [_walk(measured, _moments(folder, measured)) for measured in read(folder)]


def _moments(folder: Path, measured: Measured) -> Moments:
    """Net moments of inverse dynamics; the ankle's is positive in dorsiflexion in the data."""
    motion = np.genfromtxt(folder / f"{TRIALS[measured.name]}_motion.csv", delimiter=",", names=True)
    knee, ankle = (
        np.interp(measured.time, motion["time_s"], motion[column])
        for column in ("knee_flexion_moment_nm", "ankle_moment_nm")
    )
    return Moments(knee, -ankle)


def plausible(time: Floats, moments: Moments) -> Flags:
    """Samples that are farther than `MARGIN` from any implausible moment."""
    spikes = time[(np.abs(moments.extension) > LARGEST_KNEE) | (np.abs(moments.plantarflexion) > LARGEST_ANKLE)]
    near = np.zeros(len(time), dtype=bool)
    for spike in spikes.tolist():
        near |= np.abs(time - spike) <= MARGIN
    kept: Flags = ~near
    return kept


def _walk(measured: Measured, moments: Moments) -> Walk:
    mass = BODY_WEIGHT / GRAVITY
    leg = leg_of(mass, HEIGHT)
    vertical = np.interp(measured.time, measured.plate_time, measured.plate)
    joints = [Joints(flexion, UNKNOWN, UNKNOWN) for flexion in measured.flexion.tolist()]
    without_muscles = np.maximum(vertical, 0.0) - (leg.shank_mass + leg.foot_mass) * GRAVITY
    rows = list(zip(*(each.tolist() for each in (*moments, without_muscles)), strict=True))
    dynamics = LEVELS["ground_force"].dynamics
    nets = {
        "ground_force": [
            dynamics(leg, one, STILL, Ground((0.0, force, 0.0), (UNKNOWN,) * 3))
            for one, force in zip(joints, vertical.tolist(), strict=True)
        ],
        "knee_moment": [NetMoments(knee, UNKNOWN, force, UNKNOWN) for knee, _, force in rows],
        "ankle_moment": [NetMoments(knee, ankle, force, UNKNOWN) for knee, ankle, force in rows],
    }
    used = plausible(measured.time, moments)
    if measured.name == "overground":
        used = measured.time < ON_THE_PLATE_UNTIL
    return Walk(measured.name, mass, HEIGHT, measured.time, vertical, joints, nets, measured.total, used)


def largest_moments(walk: Walk) -> tuple[float, float]:
    """Largest used moments of knee and ankle [N m]."""
    kept = [net for net, used in zip(walk.nets["ankle_moment"], walk.used.tolist(), strict=True) if used]
    return max(abs(net.extension) for net in kept), max(abs(net.plantarflexion) for net in kept)


def moments_of(walk: Walk) -> Moments:
    """Moments of a walk; 0 where the ankle's is not known."""
    nets = walk.nets["ankle_moment"]
    ankles = [0.0 if math.isnan(net.plantarflexion) else net.plantarflexion for net in nets]
    return Moments(np.array([net.extension for net in nets]), np.array(ankles))


NEEDED = (
    "gait2354_simbody.osim", "subject01_Setup_Scale.xml", "subject01_static.trc", "subject01_walk1_grf.mot",
    "subject01_walk1_grf.xml", "reference_CMC_Kinematics_q.sto", "reference_JointReaction_ReactionLoads.sto",
)  # fmt: skip
STEP = Path(__file__).resolve().with_name("opensim_step.py")
SIDES = {"right": "r", "left": "l"}
PLATES = {"right": "", "left": "1_"}
MASS, TALL = 72.6, 1.80
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
        f"OpenSim, {side}", MASS, TALL, time, force[:, 1], joints,
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
    leg, seen = leg_of(MASS, TALL), MotionFilter(WINDOW)
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

"""Walking trials of persons with instrumented knees, read from files that are not part of the project.

Two kinds of files are found by their names and first lines: the tables of the fourth and fifth Grand Challenge
(`PERSONS`), and single strides whose first line tells the person (`STRIDE_HEADER`). A new person needs a file alone.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.joint_reaction.compartments import STANDING_LOAD
from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS
from knee_contact_ros.joint_reaction.leg import (
    GRAVITY,
    NOT_MEASURED,
    Ground,
    Joints,
    MotionFilter,
    NetMoments,
    leg_of,
)
from knee_contact_ros.lab.tables import read_storage
from studies.validation.shares import Trial

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
MEDIAL = {"am_n": 0.9871, "pm_n": 0.9683, "al_n": 0.0387, "pl_n": 0.0211}
"""Weights of JW's cells in the medial force: the tray's published regression"""
ON_PLATE = 30.0
"""Vertical ground force [N] of a foot on the plate, above the noise of the plates in swing (19 and 23 N)"""
KNEE_SPIKE, ANKLE_SPIKE, MARGIN = 0.12, 0.23, 0.1
"""Moments [m times the body weight] beyond which a sample is a spike where feet change plates (the others reach 0.075
and 0.22), and the time [s] on both sides that is left out with it"""
MISSED_LOAD, MISSED_TIME = 0.75, 0.25
"""A plate is missing where the implant bears so many body weights for so long [s] and the plate nothing: all from
`MARGIN` before that to the next contact is left out"""
SHORT, STRIKE = 0.3, 0.3
"""Time [s] that a whole stance takes at least, and the ground force [body weights] below which it begins"""
WINDOW = 0.05
"""Time [s] over which the motion is estimated: the parameters' default"""
SECOND = 1e9


class Person(NamedTuple):
    """A person with an instrumented knee."""

    name: str
    body_weight: float
    """Body weight [N]"""
    height: float
    """Height [m]"""

    @property
    def mass(self) -> float:
        """Body mass [kg]."""
        return self.body_weight / GRAVITY


PERSONS = {
    "ngait_*_tibia_cells.csv": (Person("JW", 654.3, 1.70), "GC4"),
    "PS_ngait_*_tibia_force.csv": (Person("PS", 735.75, 1.80), "GC5"),
}
"""Persons and sessions by the pattern of the names of the files with forces; `_motion.csv` and `_ground_force.csv` lie
beside them. JW: right knee (fourth Grand Challenge); PS: left knee, mirrored (fifth). JW's height is assumed"""
STRIDE_HEADER = re.compile(r"# person (\w+), mass ([\d.]+) kg, height ([\d.]+) m")
"""First line of the file of one stride, `PERSON_SESSION_movement*.csv`"""
STRIDE_COLUMNS = (
    "ground_x_N",
    "ground_y_N",
    "ground_z_N",
    "torque_x_Nm",
    "torque_y_Nm",
    "torque_z_Nm",
)
"""Columns of the ground force and of its moment about the ankle in such a file"""
NET_LOAD = "net_load"
SENSOR_LEVELS = [level for level in LOAD_LEVELS if level != NET_LOAD]
"""Levels at which constants are fitted: the net load would count the moment of `knee_moment` twice"""
WALKING = "ngait"
"""Movement of plain level walking in the names of the files"""


class Walk(NamedTuple):
    """One leg in one trial, at n samples."""

    person: Person
    session: str
    """Name of the person's session: the implant's clock and zero are those of one session"""
    name: str
    time: Floats
    """Times [s], shape (n,)"""
    vertical: Floats
    """Vertical ground force [N], shape (n,)"""
    total: Floats
    """Measured total force [N], shape (n,)"""
    medial: Floats
    """Measured medial force [N], shape (n,); NaN where it is not known"""
    frontal: Floats
    """Frontal moment [N m] as torque.x, shape (n,): JW's of inverse dynamics, PS's with the muscles of OpenSim"""
    external: Floats
    """The same [N m] without muscles, shape (n,)"""
    joints: list[Joints]
    """Joint angles, length n"""
    nets: dict[str, list[NetMoments]]
    """Net moments as each level knows them, length n each"""
    grounds: list[Ground]
    """What the ground does to the foot, length n; in tables only upwards"""
    used: Flags
    """Samples that are judged and fitted to, shape (n,)"""
    sensors: Path | None = None
    """Bag with what the leg's sensors tell, and the measured force; None: there is none"""

    @property
    def flexion(self) -> Floats:
        """Flexion angles [rad], shape (n,)."""
        return np.array([joints.flexion for joints in self.joints])

    @property
    def stance(self) -> Flags:
        """Whether the foot is on the ground, shape (n,)."""
        return np.asarray(self.vertical > ON_PLATE)

    @property
    def trial(self) -> Trial:
        """The trial relative to the body weight, as the fits of shares take it."""
        weight = self.person.body_weight
        moment = np.where(self.used, self.frontal, NOT_MEASURED) / weight
        return Trial(self.flexion, self.total / weight, self.medial / weight, moment)

    @property
    def movement(self) -> str:
        """Movement by the name of the file, without the number of the trial."""
        return WALKING if WALKING in self.name else self.name.split("_")[2].rstrip("0123456789")

    @property
    def key(self) -> str:
        """Person and session."""
        return f"{self.person.name} {self.session}"

    def steps(self) -> list[tuple[int, int]]:
        """First sample of every stance and the first one behind it, for whole stances whose samples are all used."""
        return [
            (first, last)
            for first, last in runs(self.stance)
            if last < len(self.time)
            and self.used[first:last].all()
            and self.time[last] - self.time[first] > SHORT
            and self.vertical[first] < STRIKE * self.person.body_weight
        ]


def walks(folder: Path) -> list[Walk]:
    """All trials in a folder and those below it, ordered by person and session; empty if there are none."""
    tables = [
        _walk(person, session, path)
        for pattern, (person, session) in PERSONS.items()
        for path in sorted(folder.rglob(pattern))
    ]
    strides = [found for path in sorted(folder.rglob("*_*_*.csv")) if (found := _stride(path))]
    return sorted(tables + strides, key=lambda walk: walk.key)


def level_walks(all_walks: list[Walk]) -> list[Walk]:
    """Walks in plain level walking."""
    return [walk for walk in all_walks if walk.movement == WALKING]


def with_medial(all_walks: list[Walk]) -> list[Walk]:
    """Walks whose medial force is known."""
    return [walk for walk in all_walks if np.isfinite(walk.medial).all()]


def of(all_walks: list[Walk], name: str) -> list[Walk]:
    """Walks of a person."""
    return [walk for walk in all_walks if walk.person.name == name]


def _stride(path: Path) -> Walk | None:
    """Read a file of one stride; None if it is another file."""
    with path.open(encoding="utf-8") as file:
        header = STRIDE_HEADER.match(file.readline())
    if header is None:
        return None
    person = Person(header[1], float(header[2]) * GRAVITY, float(header[3]))
    table = np.genfromtxt(path, delimiter=",", names=True, skip_header=1)
    time = table["time_s"]
    joints = [
        Joints(*row)
        for row in zip(
            table["knee_flexion_rad"].tolist(),
            table["hip_to_vertical_rad"].tolist(),
            table["ankle_rad"].tolist(),
            strict=True,
        )
    ]
    rows = zip(*(table[name].tolist() for name in STRIDE_COLUMNS), strict=True)
    grounds = [Ground((x, y, z), tuple(torque)) for x, y, z, *torque in rows]
    nets = nets_of(person, time, joints, grounds, SENSOR_LEVELS)
    nets[NET_LOAD] = nets["knee_moment"]
    unknown = np.full(len(time), np.nan)
    return Walk(
        person,
        path.stem.split("_")[1],
        path.stem,
        time,
        table["ground_y_N"],
        table["implant_N"],
        unknown,
        unknown,
        unknown,
        joints,
        nets,
        grounds,
        np.isfinite(table["implant_N"]),
    )


def nets_of(
    person: Person,
    time: Floats,
    joints: Sequence[Joints],
    grounds: Sequence[Ground],
    levels: Sequence[str],
) -> dict[str, list[NetMoments]]:
    """Net moments by level as the load node computes them from angles and ground force at times [s]."""
    leg, seen = leg_of(person.mass, person.height), MotionFilter(WINDOW)
    motions = [
        seen.add_angles(round(stamp * SECOND), each)
        for stamp, each in zip(time.tolist(), joints, strict=True)
    ]
    return {
        name: [
            LOAD_LEVELS[name].dynamics(leg, *each)
            for each in zip(joints, motions, grounds, strict=True)
        ]
        for name in levels
    }


def _walk(person: Person, session: str, path: Path) -> Walk:
    stem = path.name.rsplit("_tibia_", 1)[0]
    forces, motion, ground = (
        np.genfromtxt(each, delimiter=",", names=True)
        for each in (
            path,
            path.with_name(f"{stem}_motion.csv"),
            path.with_name(f"{stem}_ground_force.csv"),
        )
    )
    steady = forces if person.name == "JW" else motion  # the denser one
    first, last = (
        pick(forces["time_s"][end], motion["time_s"][end]) for pick, end in ((max, 0), (min, -1))
    )
    time = steady["time_s"][(steady["time_s"] >= first) & (steady["time_s"] <= last)]

    def at(table: NDArray[np.void], column: str) -> Floats:
        return np.asarray(np.interp(time, table["time_s"], table[column]))

    if person.name == "JW":
        total = np.sum([at(forces, cell) for cell in MEDIAL], axis=0)
        medial = np.sum([factor * at(forces, cell) for cell, factor in MEDIAL.items()], axis=0)
    else:
        total, medial = at(forces, "total_n"), at(forces, "medial_n")
    vertical, flexion = at(ground, "f2_y_n"), np.radians(-at(motion, "knee_flexion_deg"))
    extension, plantarflexion = (
        at(motion, "knee_flexion_moment_nm"),
        -at(motion, "ankle_moment_nm"),
    )
    external = frontal = at(motion, "knee_adduction_moment_nm")
    reaction = path.parent / "opensim" / f"{stem}_JointReaction_ReactionLoads.sto"
    if reaction.is_file():
        table = read_storage(reaction)
        column = next(
            name for name in table.names if name.endswith("knee_l_on_tibia_l_in_tibia_l_mx")
        )
        frontal = np.interp(time, table.stamps / SECOND, -table.column(column))
    joints = [Joints(angle, NOT_MEASURED, NOT_MEASURED) for angle in flexion.tolist()]
    leg = leg_of(person.mass, person.height)
    without_muscles = np.maximum(vertical, 0.0) - leg.weight_below
    columns = zip(
        extension.tolist(), plantarflexion.tolist(), without_muscles.tolist(), strict=True
    )
    moments = [NetMoments(knee, ankle, force, NOT_MEASURED) for knee, ankle, force in columns]
    grounds = [Ground((0.0, force, 0.0), (NOT_MEASURED,) * 3) for force in vertical.tolist()]
    nets = {
        **nets_of(person, time, joints, grounds, ["ground_force"]),
        "knee_moment": [net._replace(plantarflexion=NOT_MEASURED) for net in moments],
        "ankle_moment": moments,
    }
    nets[NET_LOAD] = nets["knee_moment"]
    spikes = (np.abs(extension) > KNEE_SPIKE * person.body_weight) | (
        np.abs(plantarflexion) > ANKLE_SPIKE * person.body_weight
    )
    used = ~near(time, spikes) & ~missed(
        time, vertical > ON_PLATE, total > MISSED_LOAD * person.body_weight
    )
    bag = path.with_name(f"{stem}_sensors_and_implant.mcap")
    return Walk(
        person,
        session,
        stem,
        time,
        vertical,
        total,
        medial,
        frontal,
        external,
        joints,
        nets,
        grounds,
        used,
        bag if bag.is_file() else None,
    )


def near(time: Floats, spikes: Flags) -> Flags:
    """Samples that are within `MARGIN` of a spike, shape (n,)."""
    found = np.zeros(len(time), dtype=bool)
    for spike in time[spikes].tolist():
        found |= np.abs(time - spike) <= MARGIN
    return found


def missed(time: Floats, on_plate: Flags, bears: Flags) -> Flags:
    """Samples of steps on a plate that is not in the data, shape (n,); see `MISSED_LOAD`."""
    found, off = np.zeros(len(time), dtype=bool), ~on_plate
    for begin, end in runs(off):
        for rise, fall in runs(bears & off):
            if begin <= rise < end and time[fall - 1] - time[rise] > MISSED_TIME:
                found[begin:end] |= time[begin:end] >= time[rise] - MARGIN
    return found


def runs(flags: Flags) -> list[tuple[int, int]]:
    """First samples of all runs, and the first ones behind them."""
    padded = np.concatenate(([False], flags, [False]))
    begins, ends = (
        np.flatnonzero(padded[1:] & ~padded[:-1]),
        np.flatnonzero(~padded[1:] & padded[:-1]),
    )
    return list(zip(begins.tolist(), ends.tolist(), strict=True))


def stands(walk: Walk) -> Flags:
    """Samples while the leg stands, shape (n,)."""
    return np.asarray(walk.total > STANDING_LOAD * walk.person.body_weight)

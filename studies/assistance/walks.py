"""A gait of sensors through estimator and contact model, again and again, with more and more assistance."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

import knee_contact_ros
from examples.assist_as_needed import AssistLaw, Settings
from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.commands.demo import FORCE_LIMIT, LOAD_FILE, SENSOR_BAG
from knee_contact_ros.joint_reaction.estimator import Estimator
from knee_contact_ros.joint_reaction.leg import NOT_MEASURED, Ground, Joints, MotionFilter
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.streams.topics import (
    GROUND_REACTION_FORCE,
    JOINT_STATES,
    LOAD_INPUTS,
    stamp_to_ns,
    types_of,
)
from knee_contact_ros.system.files import share_folder

Floats = NDArray[np.float64]
SHARE = 0.5
"""Share of the joint reaction that the medial compartment bears, as in `healthy.yaml`"""
SECOND = 1e-9
"""Length of a nanosecond [s]"""
NO_TORQUE = (NOT_MEASURED, NOT_MEASURED, NOT_MEASURED)


class Sample(NamedTuple):
    """Measured values of encoder and insole at a stamp."""

    stamp: int
    """Stamp [ns]"""
    flexion: float
    """Flexion angle [rad]"""
    vertical: float
    """Vertical ground force [N]"""


class Peaks(NamedTuple):
    """Largest values of a gait, with the load a standard deviation below the estimate, at it, and above it."""

    force: tuple[float, float, float]
    """Contact forces [N]: below, as estimated, above"""
    depth: tuple[float, float, float]
    """Penetration depths [m]: below, as estimated, above"""


class Walk(NamedTuple):
    """Series of a gait with assistance; arrays have shape (n,)."""

    time: Floats
    """Times [s]"""
    torque: Floats
    """Torque [N m] that extends the knee"""
    axial: Floats
    """Estimated axial joint reaction [N]"""
    force: Floats
    """Contact force [N]"""
    peaks: Peaks


class Law(Protocol):
    """A law that decides on the assisting torque."""

    def __call__(self, sample: Sample, contact_force: float, /) -> float:
        """The torque [N m] at a sample, after the contact force [N] of the one before."""


def constant_in_stance(torque: float) -> Law:
    """Build the law of a constant torque [N m] while the foot is on the ground, and none in swing."""
    return lambda sample, _contact: torque if sample.vertical > 0.0 else 0.0


def companion(torque: float) -> Law:
    """Build the example's law with a nominal torque [N m], which yields above the demo's limit and knows no stance."""
    if torque == 0.0:
        return lambda _sample, _contact: 0.0
    law = AssistLaw(Settings(nominal_torque=torque, force_limit=FORCE_LIMIT))

    def decide(sample: Sample, contact_force: float) -> float:
        now = sample.stamp * SECOND
        law.hear(now, contact_force, 0, 0.0)
        return law.command(now)

    return decide


LAWS: dict[str, Callable[[float], Law]] = {
    "constant in stance": constant_in_stance,
    "companion's law": companion,
}


def sensors(bag: Path | None = None) -> list[Sample]:
    """The samples of a bag, the shipped one by default: a vertical force of every stamp with an angle."""
    types = types_of(LOAD_INPUTS)
    angles: dict[int, float] = {}
    forces: dict[int, float] = {}
    for topic, _, message in read_bag(bag or share_folder() / "bags" / SENSOR_BAG, types):
        stamp = stamp_to_ns(message.header.stamp)
        if topic == f"/{JOINT_STATES}":
            angles[stamp] = float(message.position[0])
        elif topic == f"/{GROUND_REACTION_FORCE}":
            forces[stamp] = float(message.wrench.force.y)
    return [
        Sample(stamp, angles[stamp], forces[stamp]) for stamp in sorted(angles.keys() & forces)
    ]


def person() -> LoadParameters:
    """Parameters of the person in the shipped bag."""
    return load_parameters(LOAD_FILE, LoadParameters)


def walk(
    samples: Sequence[Sample], law: Law, model: KneeModel, parameters: LoadParameters
) -> Walk:
    """Estimate, assist and compute, sample by sample: the torque of a sample follows from the contact before it.

    Then once more with the load a standard deviation of every sample off, under the same torques: who assists sees the
    estimate alone. What muscles do at rest presses on (`person.tone`): no load falls below that by a deviation.
    """
    estimator = Estimator(parameters.chosen_level, parameters.person.constants)
    stream, contact, motion = model.stream(), 0.0, MotionFilter(parameters.motion_window)
    torques, axial, force, off = [], [], [], []
    for sample in samples:
        torques.append(law(sample, contact))
        joints = Joints(sample.flexion, NOT_MEASURED, NOT_MEASURED, knee_assistance=torques[-1])
        estimate = estimator.estimate(
            sample.stamp,
            joints,
            motion.add_angles(sample.stamp, joints),
            Ground((0.0, sample.vertical, 0.0), NO_TORQUE),
        )
        stream.advance(sample.stamp, sample.flexion, SHARE * estimate.axial_force)
        contact = float(stream.answer["contact_force"][0])
        axial.append(estimate.axial_force)
        off.append(estimate.standard_deviation)
        force.append(contact)
    time = np.array([sample.stamp for sample in samples]) * SECOND
    flexion, loads, deviations = (
        np.array([sample.flexion for sample in samples]),
        np.array(axial),
        np.array(off),
    )
    least = np.minimum(loads, parameters.person.tone * parameters.person.constants.weight)
    runs = [
        model.run(time, flexion, SHARE * np.maximum(loads + by * deviations, least))
        for by in (-1.0, 0.0, 1.0)
    ]
    below, middle, above = (
        (float(run.contact_force.max()), float(run.penetration_depth.max())) for run in runs
    )
    peaks = Peaks(*zip(below, middle, above, strict=True))
    return Walk(time, np.array(torques), loads, np.array(force), peaks)


def walks(
    torques: Sequence[float], compiled: bool | None = None
) -> Iterator[tuple[str, list[Walk]]]:
    """Walks under each of `LAWS`, by its name, one for each torque [N m]."""
    samples, parameters = sensors(), person()
    model = knee_contact_ros.load_model("healthy", compiled=compiled)
    for name, law in LAWS.items():
        yield name, [walk(samples, law(torque), model, parameters) for torque in torques]

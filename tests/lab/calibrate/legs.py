"""Made trials of a leg: sensors of a walking or standing person, and what a knee with known constants bears."""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros import estimate_load
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.streams.messages import JOINT_STATE, JointState, WrenchStamped, encode_wrench_stamped
from knee_contact_ros.streams.topics import GROUND_REACTION_FORCE, JOINT_REACTION_FORCE, JOINT_STATES, MESSAGE_TYPES

Floats = NDArray[np.float64]
TRUE = {"person.moment_arm_scale": 0.9, "person.co_contraction": 0.35, "person.tone": 0.25}
FREE = list(TRUE)
BODY = {"person.mass": 70.0, "person.height": 1.75}
EPOCH = 1_700_000_000_000_000_000
STEP = 10_000_000
"""[ns] from a sample to the next: 100 Hz"""
NOISE = 60.0
"""[N]"""
REFERENCE = f"/{JOINT_REACTION_FORCE}"
WEIGHT = 70.0 * 9.80665


def walk(count: int, standing: bool = False) -> tuple[Floats, Floats]:
    """Flexion [rad] and vertical ground force [N] at 100 Hz; strides of 1.1 s, or a person who sways a little."""
    time = 0.01 * np.arange(count)
    if standing:
        return 0.2 + 0.0 * time, 0.5 * WEIGHT + 0.0 * time
    phase = (time / 1.1) % 1.0
    flexion = 0.15 + 0.25 * np.exp(-(((phase - 0.14) / 0.07) ** 2)) + 0.95 * np.exp(-(((phase - 0.72) / 0.11) ** 2))
    humps = np.exp(-(((phase - 0.15) / 0.08) ** 2)) + np.exp(-(((phase - 0.47) / 0.08) ** 2))
    stance = np.clip(np.sin(np.pi * phase / 0.62), 0.0, None) * (phase < 0.62)
    return flexion, WEIGHT * np.minimum(0.8 * stance**0.3 + 0.35 * humps * stance, 1.3)


def noise(count: int, seed: int, correlation: float = 0.0, size: float = NOISE) -> Floats:
    """Of a normal distribution, each like the one before as far as `correlation` says."""
    drawn = np.random.default_rng(seed).standard_normal(count)
    for place in range(1, count):
        drawn[place] = correlation * drawn[place - 1] + math.sqrt(1.0 - correlation**2) * drawn[place]
    return size * drawn


def joints_at(place: int, flexion: float) -> JointState:
    """Hip, knee and ankle."""
    time = 0.01 * place
    angles = (0.4 * math.cos(math.tau * time / 1.1), flexion, 0.2 * math.sin(math.tau * time / 1.1))
    return JointState(EPOCH + STEP * place, "", ("hip", "knee", "ankle"), angles, (), ())


def ground_at(place: int, vertical: float) -> WrenchStamped:
    """A wrench that goes forward under the foot."""
    forward = 0.1 * math.sin(math.tau * 0.01 * place / 1.1)
    return WrenchStamped(
        EPOCH + STEP * place, "plate", (forward * vertical, vertical, 0.02 * vertical), (2.0, 1.0, forward * vertical)
    )


def write_sensors(
    path: Path, flexion: Floats, ground: Floats, reference: dict[int, float] | None = None, *, topic: str = REFERENCE,
    namespace: str = "", without_angle: Collection[int] = (),
) -> Path:  # fmt: skip
    """A bag; `reference` are axial forces [N] by stamps, on `topic`."""
    with BagWriter(path, alone=True) as writer:
        for name in (JOINT_STATES, GROUND_REACTION_FORCE):
            writer.add_topic(f"{namespace}/{name}", MESSAGE_TYPES[name])
        if reference is not None:
            writer.add_topic(f"{namespace}{topic}", MESSAGE_TYPES[JOINT_REACTION_FORCE])
        for place, (angle, force) in enumerate(zip(flexion.tolist(), ground.tolist(), strict=True)):
            joints, wrench = joints_at(place, angle), ground_at(place, force)
            if place not in without_angle:
                writer.write(f"{namespace}/{JOINT_STATES}", joints.stamp, JOINT_STATE.encode(joints))
            writer.write(f"{namespace}/{GROUND_REACTION_FORCE}", wrench.stamp, encode_wrench_stamped(wrench))
        for stamp, axial in (reference or {}).items():
            wrench = WrenchStamped(stamp, "tibia", (0.0, -axial, 0.0), (0.0, 0.0, 0.0))
            writer.write(f"{namespace}{topic}", stamp, encode_wrench_stamped(wrench))
    return path


def true_load(folder: Path, flexion: Floats, ground: Floats, *params: Any) -> dict[int, float]:
    """What the knee bears [N] by stamp: the load pipeline's own answer with the true constants."""
    bag = write_sensors(folder / "true.mcap", flexion, ground)
    found = estimate_load(bag, [*params, {**BODY, **TRUE}])
    bag.unlink()
    return dict(zip(found["stamp"].tolist(), found["axial_force"].tolist(), strict=True))


def trial(
    folder: Path, seed: int = 0, *params: Any, count: int = 400, correlation: float = 0.0, size: float = NOISE,
    standing: bool = False, **more: Any,
) -> Path:  # fmt: skip
    """A bag with a reference that has noise [N]."""
    flexion, ground = walk(count, standing)
    true = true_load(folder, flexion, ground, *params)
    off = noise(len(true), seed, correlation, size)
    reference = {stamp: axial + error for (stamp, axial), error in zip(true.items(), off.tolist(), strict=True)}
    return write_sensors(folder / "trial.mcap", flexion, ground, reference, **more)

"""Made trials of a leg: sensors of a walking or standing person, and what a knee with known constants bears."""

import math

import numpy as np

from knee_contact_ros import estimate_load
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import JOINT_REACTION_FORCE, LOAD_INPUTS, MESSAGE_TYPES
from tests.helpers.walking import ANGLES, FORCE, STRIDE

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


def noise(count, seed, correlation=0.0, size=NOISE):
    """Of a normal distribution, each like the one before as far as `correlation` says."""
    drawn = np.random.default_rng(seed).standard_normal(count)
    for place in range(1, count):
        drawn[place] = (
            correlation * drawn[place - 1] + math.sqrt(1.0 - correlation**2) * drawn[place]
        )
    return size * drawn


def sensors(stamp, standing):
    """Hip, knee and ankle, and a wrench that goes forward under the foot, of a person who walks or stands still."""
    phase = ((stamp - EPOCH) * 1e-9 / STRIDE) % 1.0
    turn = math.tau * phase
    bumps = {
        at: math.exp(-(((phase - at) / wide) ** 2))
        for at, wide in ((0.14, 0.07), (0.72, 0.11), (0.15, 0.08), (0.47, 0.08))
    }
    stance = max(math.sin(math.pi * phase / 0.62), 0.0) if phase < 0.62 else 0.0
    flexion = 0.2 if standing else 0.15 + 0.25 * bumps[0.14] + 0.95 * bumps[0.72]
    force = min(0.8 * stance**0.3 + 0.35 * (bumps[0.15] + bumps[0.47]) * stance, 1.3)
    vertical, forward = WEIGHT * (0.5 if standing else force), 0.1 * math.sin(turn)
    angles = (0.4 * math.cos(turn), flexion, 0.2 * math.sin(turn))
    joints = JointState(stamp, "", ("hip", "knee", "ankle"), angles, (), ())
    shear, moment = forward * vertical, (2.0, 1.0, forward * vertical)
    return joints, WrenchStamped(stamp, "plate", (shear, vertical, 0.02 * vertical), moment)


def write_sensors(
    path,
    count,
    reference=None,
    *,
    standing=False,
    topic=REFERENCE,
    namespace="",
    without_angle=(),
):
    """A bag; `reference` are axial forces [N] by stamps, on `topic`."""
    with BagWriter(path, alone=True) as writer:
        for name in LOAD_INPUTS:
            writer.add_topic(f"{namespace}/{name}", MESSAGE_TYPES[name])
        if reference is not None:
            writer.add_topic(f"{namespace}{topic}", MESSAGE_TYPES[JOINT_REACTION_FORCE])
        for place in range(count):
            joints, wrench = sensors(stamp := EPOCH + STEP * place, standing)
            if place not in without_angle:
                writer.write_message(f"{namespace}{ANGLES}", stamp, encode_joint_state(joints))
            writer.write_message(f"{namespace}{FORCE}", stamp, encode_wrench_stamped(wrench))
        for stamp, axial in (reference or {}).items():
            wrench = WrenchStamped(stamp, "tibia", (0.0, -axial, 0.0), (0.0, 0.0, 0.0))
            writer.write_message(f"{namespace}{topic}", stamp, encode_wrench_stamped(wrench))
    return path


def trial(
    folder,
    seed=0,
    *params,
    count=400,
    correlation=0.0,
    size=NOISE,
    standing=False,
    **more,
):
    """A bag with what the knee bears, by the load pipeline's own answer with the true constants, and noise [N]."""
    bag = write_sensors(folder / "true.mcap", count, standing=standing)
    true = estimate_load(bag, [*params, {**BODY, **TRUE}])
    bag.unlink()
    measured = true["axial_force"] + noise(len(true["stamp"]), seed, correlation, size)
    reference = dict(zip(true["stamp"].tolist(), measured.tolist(), strict=True))
    return write_sensors(folder / "trial.mcap", count, reference, standing=standing, **more)

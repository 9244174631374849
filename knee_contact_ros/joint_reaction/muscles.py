"""Forces of the muscles that balance net moments at knee and ankle, and the joint reaction with them.

One moment does not determine several forces, so rules do. The gastrocnemius bears a fixed share of the plantarflexion
moment. Extensors and flexors each pull with at least half of a floor, which models antagonists (tone, and
co-contraction that grows with the ground force). Beyond that, only the side that is needed pulls. A muscle's force
follows with a first-order lag (electromechanical delay, activation dynamics: Thelen 2003, doi:10.1115/1.1531112; its
time constant was fitted to two instrumented knees, docs/explanation/validation.md).

Moment arms are polynomials [m] of angles [rad], fitted to the musculoskeletal model gait2354 (Delp et al. 1990,
doi:10.1109/10.102791; knee: Yamaguchi & Zajac 1989, doi:10.1016/0021-9290(89)90179-6) from -10 to 110 degrees of
flexion and -30 to 25 degrees of dorsiflexion; the muscles of a group are weighted by their maximum isometric forces.
RMS errors of the fit: 1.1, 0.2, 0.7 and 0.1 mm; `python -m studies.moment_arms MODEL` repeats it. People differ by a
tenth or more.
"""

import math
from typing import NamedTuple

from .leg import (
    GRAVITY,
    NOT_MEASURED,
    SECONDS_PER_NANOSECOND,
    Joints,
    NetMoments,
)

# Angles beyond which moment arms stay constant: the ends of their fit, -10 and 110, -30 and 25 degrees
_MIN_FLEXION = -0.1745
"""Smallest flexion [rad] of the fit"""
_MAX_FLEXION = 1.9199
"""Largest flexion [rad] of the fit"""
_MIN_DORSIFLEXION = -0.5236
"""Smallest dorsiflexion [rad] of the fit"""
_MAX_DORSIFLEXION = 0.4363
"""Largest dorsiflexion [rad] of the fit"""
# Coefficients of the moment arms [m], in rising powers of the angle [rad]
QUADRICEPS_ARM = (0.04463, 0.01629, -0.03135, 0.00889)
"""Rectus femoris and vasti, through the patellar tendon; they extend the knee"""
HAMSTRINGS_ARM = (0.02616, 0.02728, -0.02370, 0.00214)
"""Long and short heads of the hamstrings; they flex the knee"""
GASTROCNEMIUS_ARM = (0.02220, 0.00004, -0.00539, 0.00123)
"""Gastrocnemius at the knee, which it flexes"""
ACHILLES_ARM = (0.04573, -0.01311, -0.02042)
"""Gastrocnemius and soleus at the ankle, as a function of dorsiflexion; they plantarflex it"""
GASTROCNEMIUS_SHARE = 0.342
"""Share of the gastrocnemius in the plantarflexion moment: maximum isometric force times moment arm, relative to the
sum over gastrocnemius, soleus and tibialis posterior (2500, 4000 and 3600 N at 46, 45 and 11 mm in gait2354)"""


def moment_arm(coefficients: tuple[float, ...], angle: float) -> float:
    """Return a muscle's moment arm [m] at the knee at a flexion [rad]; for `ACHILLES_ARM` at a dorsiflexion [rad]."""
    least, most = (
        (_MIN_DORSIFLEXION, _MAX_DORSIFLEXION)
        if coefficients is ACHILLES_ARM
        else (_MIN_FLEXION, _MAX_FLEXION)
    )
    within = min(max(angle, least), most)
    value = 0.0
    for coefficient in reversed(coefficients):
        value = value * within + coefficient
    return value


class Muscles(NamedTuple):
    """Muscle forces [N], 0 or more, taken along the tibia: tendons are within 20 degrees of it (cosine above 0.94)."""

    quadriceps: float
    """Force of the quadriceps through the patellar tendon"""
    hamstrings: float
    gastrocnemius: float

    @property
    def total(self) -> float:
        """Sum of the forces [N], which press femur and tibia together."""
        return self.quadriceps + self.hamstrings + self.gastrocnemius


def muscles_of(
    extension_moment: float, flexion: float, gastrocnemius: float, floor: float, scale: float
) -> Muscles:
    """Compute the forces of the muscles that balance a moment at the knee.

    Args:
        extension_moment: Net moment of the muscles at the knee [N m].
        flexion: Flexion angle [rad].
        gastrocnemius: Force of the gastrocnemius [N].
        floor: Smallest force [N] of extensors and flexors together.
        scale: Ratio of the person's moment arms to the published ones.
    """
    extensor, flexor, calf = (
        scale * moment_arm(muscle, flexion)
        for muscle in (QUADRICEPS_ARM, HAMSTRINGS_ARM, GASTROCNEMIUS_ARM)
    )
    moment = extension_moment + calf * gastrocnemius
    half = 0.5 * floor
    hamstrings = max(half - gastrocnemius, 0.0)
    quadriceps = (moment + flexor * hamstrings) / extensor
    if quadriceps < half:
        quadriceps = half
        hamstrings = max((extensor * half - moment) / flexor, hamstrings)
    return Muscles(quadriceps, hamstrings, gastrocnemius)


class Person(NamedTuple):
    """Constants of a person."""

    mass: float
    """Body mass [kg]"""
    height: float
    """Height [m]"""
    moment_arm_scale: float
    """Ratio of the person's moment arms to the published ones"""
    co_contraction: float
    """Part of the smallest muscle force that grows with the vertical ground force, relative to that"""
    tone: float
    """Constant part of the smallest muscle force, relative to the body weight"""
    electromechanical_delay: float
    """Time constant [s] with which a muscle's force follows the required one; 0: without delay"""
    expected_load: float
    """Weight of the load that is expected in level walking, from 0 (the sensors alone) to 1 (the expectation alone)"""

    @property
    def weight(self) -> float:
        """Body weight [N]."""
        return self.mass * GRAVITY

    def floor(self, vertical: float) -> float:
        """Return the smallest force [N] of extensors and flexors together, at a vertical ground force [N]."""
        return self.co_contraction * max(vertical, 0.0) + self.tone * self.weight


class ActivationLag:
    """First-order lag of the muscle forces behind the required ones.

    It is exact if the required force is linear in time between two samples. So it is stable at any rate and after any
    gap, and the forces stay within the range of the required ones.
    """

    def __init__(self) -> None:
        """Begin without a past: the first forces are the required ones."""
        self._last: tuple[int, Muscles, Muscles] | None = None

    def forget_forces(self) -> None:
        """Forget the past."""
        self._last = None

    def forces_at(
        self, stamp: int, needed: Muscles, time_constant: float, sure: bool = True
    ) -> Muscles:
        """Return the forces at a stamp [ns] for the forces required then, and a time constant [s].

        A stamp that is not later than the last one restarts the lag. A sample that is not `sure` does not change it.
        """
        forces = needed
        if self._last and stamp > self._last[0] and time_constant > 0.0:
            since = (stamp - self._last[0]) * SECONDS_PER_NANOSECOND / time_constant
            left, ramp = math.exp(-since), -math.expm1(-since) / since
            forces = Muscles(
                *(
                    new - (new - old) * ramp + (force - old) * left
                    for new, old, force in zip(needed, *self._last[1:], strict=True)
                )
            )
        if sure:
            self._last = stamp, needed, forces
        return forces


class MuscledReaction(NamedTuple):
    """Joint reaction of a knee, and the muscle forces in it."""

    axial: float
    """Force along the tibia [N], positive in compression"""
    muscles: Muscles
    extension: float
    """Net moment of the muscles at the knee [N m], positive when they extend it"""
    plantarflexion: float
    """Net moment of the muscles at the ankle [N m], positive when they plantarflex it; NaN if unknown"""
    sensed: float
    """Force along the tibia [N] by the sensors alone"""
    expected: float = NOT_MEASURED
    """Force along the tibia [N] that is expected at this moment of a stride; NaN where the leg does not walk"""


def reaction_of(
    person: Person, joints: Joints, net: NetMoments, vertical: float
) -> MuscledReaction:
    """Compute the joint reaction of a knee whose muscles pull with the required forces without delay.

    Args:
        person: Constants of the person.
        joints: Angles, and torques of actuators, which are part of the net moments.
        net: Net moments at knee and ankle.
        vertical: Vertical ground force [N].
    """
    extension = net.extension - joints.knee_assistance
    plantarflexion = net.plantarflexion - joints.ankle_assistance
    scale = person.moment_arm_scale
    calf = 0.0
    if math.isfinite(plantarflexion):
        achilles = scale * moment_arm(
            ACHILLES_ARM, joints.ankle if math.isfinite(joints.ankle) else 0.0
        )
        calf = max(plantarflexion, 0.0) * GASTROCNEMIUS_SHARE / achilles
    muscles = muscles_of(extension, joints.flexion, calf, person.floor(vertical), scale)
    axial = net.compression + muscles.total
    return MuscledReaction(axial, muscles, extension, plantarflexion, axial)

"""What all of the solver shares: a knee, one interval, the state of the femur, and the contact in one mode.

The contact is in one mode at a time: apart; pressing in one layer of the law; or released, where the surfaces overlap
but the layer's formula would pull, which cartilage cannot. In a pressing contact the layer's force acts on the femur;
in the other modes only the load does, and the femur flies. A mode ends where a boundary is crossed.
"""

from typing import NamedTuple

from .closest import Surfaces, touch
from .compiler import in_kernel, inlined
from .error_estimate import Error
from .laws import BEGIN, force_at
from .types import Floats

NO_BOUNDARY = -1
LAYER_BEGIN = 0
"""Boundary where the layer begins; for the first layer the surfaces part there"""
FORCE_ZERO = 1
"""Boundary between pressing and released: the force of the layer's formula changes its sign"""
LAYER_END = 2
"""Boundary where the next layer begins; for surfaces that are apart they touch there"""
DEPTH_ROUNDING = 1e-13
"""How far [m] a depth must be beyond a boundary to be more than rounding of femoral heights of 0.1 m"""
FORCE_ROUNDING = 1e-10
"""The same for a force, relative to the load or to 1 N"""


class KneeConstants(NamedTuple):
    """A knee and the accuracy of its solution: the constants of a run in the kernel's form."""

    surfaces: Surfaces
    law: Floats
    """Rows of the contact law's layers; see `laws.Layer`"""
    mass: float
    """Mass of the femur [kg]"""
    per_mass: float
    """1 / mass [1/kg]"""
    tolerance: float
    """Tolerated error of the depth [m]"""
    force_tolerance: float
    """Tolerated error of the contact force [N]; 0: no limit"""
    budget: int
    """Largest number of evaluations of the contact in a tick, probes of its flights included"""
    level: int
    """The equations that a tick solves; see `ticks.py`"""
    allow_tension: bool
    """Whether the law may pull; else its force is clamped at 0"""
    remembers_impact: bool
    """Whether the law depends on the impact speed"""
    plausible_depth: float
    """Depth [m] beyond which an answer is `IMPLAUSIBLE`"""


class Interval(NamedTuple):
    """Load and flexion angle from one tick to the next, linear in the time s [s] since the first of the two."""

    duration: float
    """Length of the interval [s]"""
    angle: float
    """Flexion angle at s = 0 [rad]"""
    angle_rate: float
    """[rad/s]"""
    load: float
    """Compressive load at s = 0 [N]"""
    load_rate: float
    """[N/s]"""
    rounding: float
    """Contact force [N] that is taken as zero"""


class FemurState(NamedTuple):
    """State of a run: what one tick hands to the next."""

    height: float
    """Height of the femoral reference point [m]"""
    velocity: float
    """Its velocity [m/s]"""
    error: Error
    """Estimated error of both"""
    try_step: float
    """Duration [s] that the next step should try"""
    impact_speed: float
    """Penetration rate [m/s] at which the present contact began, 0 at rest; NaN while the surfaces are apart"""
    impact_error: float
    """Estimated error of the impact speed [m/s]"""


class Stage(NamedTuple):
    """The contact at one time: at a stage of a Runge-Kutta method, or at the beginning or end of a step."""

    depth: float
    """Signed depth [m]: < 0 apart"""
    rate: float
    """Rate of the depth [m/s]"""
    force: float
    """Force [N] of the layer's formula, not clamped; 0 apart"""
    stiffness: float
    """Slope of the force along the height over the height [N/m]"""
    damping: float
    """Slope of the force along the height over the velocity [N s/m]"""
    surface_rate: float
    """Rate of the depth [m/s] if the height were held"""
    cosine: float
    """n_y of the contact normal"""
    acceleration: float
    """Acceleration of the femur [m/s²] if the force is exerted"""


class Result(NamedTuple):
    """The contact at the end of a tick."""

    femur: FemurState
    stage: Stage
    force: float
    """Exerted normal force [N]"""
    estimate: float
    """Estimated error of the depth [m]"""
    force_estimate: float
    """Estimated error of the force [N]"""
    evaluations: int
    converged: bool
    """False if the tick was given up: it needs more evaluations or events than it may take"""


class Mode(NamedTuple):
    """What acts on the femur until the next boundary."""

    knee: KneeConstants
    tick: Interval
    layer: int
    """Row of the law, `APART` for surfaces that do not touch"""
    pressing: bool
    """Whether the layer's force acts; else the femur flies"""
    impact_speed: float
    """Penetration rate [m/s] at which the contact began, 0 for a contact that began at rest"""


class Motion(NamedTuple):
    """The femur at one time of an interval."""

    time: float
    """Time since the beginning of the interval [s]"""
    height: float
    """Height of the femoral reference point [m]"""
    velocity: float
    """[m/s]"""
    stage: Stage
    """The contact there, in the present mode"""


@in_kernel
def load_at(tick: Interval, s: float) -> float:
    """Return the load [N] at s [s]."""
    return tick.load + tick.load_rate * s


@inlined
def stage_at(mode: Mode, s: float, height: float, velocity: float) -> Stage:
    """Return the contact in a mode at s [s] for a height [m] and a velocity [m/s]."""
    knee, tick, _, _, _ = mode
    angle_rate = tick.angle_rate
    depth, surface_rate, cosine = touch(
        knee.surfaces, tick.angle + angle_rate * s, angle_rate, height
    )
    rate = surface_rate - cosine * velocity
    return stage_in(mode, s, depth, rate, surface_rate, cosine)


@inlined
def stage_in(
    mode: Mode, s: float, depth: float, rate: float, surface_rate: float, cosine: float
) -> Stage:
    """Return the contact in a mode at s [s] where depth, rates and normal are known: see the fields of `Stage`."""
    # In plain Python, unpacking a named tuple is faster than reading its fields by name: most of a tick is spent here.
    knee, tick, layer, _, impact_speed = mode
    force, stiffness, damping = force_at(knee.law, layer, depth, rate, impact_speed)
    square = cosine * cosine
    return Stage(
        depth,
        rate,
        force,
        square * stiffness,
        square * damping,
        surface_rate,
        cosine,
        (cosine * force - tick.load - tick.load_rate * s) * knee.per_mass,
    )


@in_kernel
def distance_inside(mode: Mode, boundary: int, stage: Stage) -> float:
    """Return the distance of a contact from a boundary of its mode, >= 0 inside: [m], or [N] for `FORCE_ZERO`."""
    law = mode.knee.law
    if boundary == LAYER_BEGIN:
        return stage.depth - float(law[mode.layer, BEGIN])
    if boundary == LAYER_END:
        return float(law[mode.layer + 1, BEGIN]) - stage.depth
    return stage.force if mode.pressing else -stage.force


@in_kernel
def crossed(mode: Mode, stage: Stage, known: int) -> int:
    """Return the first boundary that a contact is beyond, except the `known` one; `NO_BOUNDARY` if it is inside."""
    knee, layer = mode.knee, mode.layer
    # Before its beginning a layer's formula says nothing of the force, so this boundary comes first.
    if known != LAYER_BEGIN and stage.depth < knee.law[layer, BEGIN] - DEPTH_ROUNDING:
        return LAYER_BEGIN
    pull = -stage.force if mode.pressing else stage.force
    if known != FORCE_ZERO and pull > mode.tick.rounding and not knee.allow_tension:
        return FORCE_ZERO
    if known != LAYER_END and stage.depth > knee.law[layer + 1, BEGIN] + DEPTH_ROUNDING:
        return LAYER_END
    return NO_BOUNDARY

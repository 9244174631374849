"""The state of a run between two ticks: an array of the caller, so that a tick allocates nothing.

All of it is 0 before the first tick.
"""

from .compiler import in_kernel
from .contact import FemurState, Result
from .error_estimate import Error
from .types import Floats

AT_BEGUN = 0
"""Place in the state of a run: 1 after its first tick"""
AT_ANGLE = 1
"""Flexion angle of the last tick [rad]"""
AT_LOAD = 2
"""Load of the last tick [N]"""
AT_HEIGHT = 3
"""From here to `AT_IMPACT_ERROR`: the fields of `FemurState`"""
AT_VELOCITY = 4
AT_HEIGHT_ERROR = 5
AT_VELOCITY_ERROR = 6
AT_HH = 7
AT_HV = 8
AT_VV = 9
AT_TRY_STEP = 10
AT_IMPACT_SPEED = 11
AT_IMPACT_ERROR = 12
AT_STIFFNESS = 13
"""Slope of the last contact's force along the height over the height [N/m]"""
AT_DAMPING = 14
"""The same over the velocity [N s/m]"""
AT_LOST_SPEED = 15
"""Bound of the speed of the exact femur beside the answers [m/s], while it is lost; 0: it is known"""
AT_STATIC_VELOCITY = 16
"""Velocity of the last answer while the exact femur is lost [m/s]"""
AT_LOST_DISTANCE = 17
"""Bound of the distance of the exact femur from the answers [m], while it is lost"""
AT_LOAD_IMPULSE = 18
"""Impulse of the load over the mass [m/s], since it has pressed without a break"""
AT_STRONGEST_LOAD = 19
"""Largest load since then [N]"""
AT_RELAXATION_TIMES = 20
"""Relaxation times of the contact that have passed since the last landing of a lost femur"""
AT_SETTLING = 21
"""Time of contact [s] that is left until the femur has settled after a flight too far for a knee"""
STATE_SIZE = 22


@in_kernel
def femur_in(state: Floats) -> FemurState:
    """Return the state of the femur after the last tick."""
    error = Error(
        float(state[AT_HEIGHT_ERROR]),
        float(state[AT_VELOCITY_ERROR]),
        float(state[AT_HH]),
        float(state[AT_HV]),
        float(state[AT_VV]),
    )
    return FemurState(
        float(state[AT_HEIGHT]),
        float(state[AT_VELOCITY]),
        error,
        float(state[AT_TRY_STEP]),
        float(state[AT_IMPACT_SPEED]),
        float(state[AT_IMPACT_ERROR]),
    )


@in_kernel
def keep_state(state: Floats, angle: float, load: float, result: Result) -> None:
    """Keep what the next tick needs of a tick at an angle [rad] under a load [N]."""
    femur, error = result.femur, result.femur.error
    state[AT_BEGUN] = 1.0
    state[AT_ANGLE] = angle
    state[AT_LOAD] = load
    state[AT_HEIGHT] = femur.height
    state[AT_VELOCITY] = femur.velocity
    state[AT_HEIGHT_ERROR] = error.height
    state[AT_VELOCITY_ERROR] = error.velocity
    state[AT_HH] = error.hh
    state[AT_HV] = error.hv
    state[AT_VV] = error.vv
    state[AT_TRY_STEP] = femur.try_step
    state[AT_IMPACT_SPEED] = femur.impact_speed
    state[AT_IMPACT_ERROR] = femur.impact_error
    state[AT_STIFFNESS] = result.stage.stiffness
    state[AT_DAMPING] = result.stage.damping

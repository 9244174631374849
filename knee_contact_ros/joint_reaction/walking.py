"""Level walking: whether a leg walks, and the load that its knee bears then on average.

The sensors of a leg tell a knee's load to a third of a body weight, and the mean curve of other people's knees over a
stride tells it as well. Their errors are different ones, so the mean of both is closer than either
(docs/explanation/validation.md).
"""

from typing import NamedTuple

from .leg import SECONDS_PER_NANOSECOND

_LOADED = 0.3
"""Ground force [body weights] above which a knee is loaded"""
_MAX_LOADED_FLEXION = 0.85
"""Largest flexion [rad] of a loaded knee in level walking, 49 degrees.

The two measured walkers had 36 to 38 degrees. On stairs, in sit to stand and in squats knees are loaded at 60 to 100
degrees.
"""
_MAX_WALKING_FORCE = 1.6
"""Largest ground force [body weights] of walking; running has 2 and more"""
UNLOADED = 0.05
"""Ground force [body weights] below which a foot bears nothing"""
_MAX_UNLOADED_TIME = 3.0
"""Longest time [s] in walking for which a foot bears nothing"""
_SLOW_STRIDE = 1.5
"""Duration [s] of a slow stride, for which a sample of another movement counts"""


class Movement:
    """Finds movements for which no constants were measured: everything but level walking and standing."""

    def __init__(self, weight: float) -> None:
        """Begin without samples of a person of a body weight [N]."""
        self._weight = weight
        self._other_until: int | None = None
        """Stamp [ns] until which a sample of another movement counts"""
        self._bore = 0
        """Stamp [ns] at which the foot last bore something"""
        self._last: int | None = None
        """Stamp [ns] of the last sample"""

    def is_other(self, stamp: int, flexion: float, vertical: float) -> bool:
        """Whether a sample at a stamp [ns], with flexion [rad] and ground force [N], is of another movement.

        A foot that bears nothing for longer than in walking counts too: sitting, cycling, or a sensor that is off.
        """
        force = vertical / self._weight
        longest = _MAX_UNLOADED_TIME / SECONDS_PER_NANOSECOND
        if self._last is None or not 0 <= stamp - self._last <= longest:
            # The first sample, or one after a pause
            self._other_until = None
            self._bore = stamp
        self._last = stamp
        if force > UNLOADED:
            self._bore = stamp
        if (force > _LOADED and flexion > _MAX_LOADED_FLEXION) or force > _MAX_WALKING_FORCE:
            self._other_until = stamp + round(_SLOW_STRIDE / SECONDS_PER_NANOSECOND)
        if (stamp - self._bore) * SECONDS_PER_NANOSECOND > _MAX_UNLOADED_TIME:
            return True
        return self._other_until is not None and stamp <= self._other_until


_STANCE = 0.71
"""Duration [s] of a stance before one was seen: the mean of the strides in `MEASURED_LOADS`"""
STANCES = (0.4, 1.3)
"""Shortest and longest stance [s] of walking, from fast to very slow"""
_SWING = 0.42
"""Duration [s] of a swing: the mean of the same strides"""
LONGEST_SWING = 1.0
"""Longest swing [s] of walking"""


class StrideLoads(NamedTuple):
    """Load of a knee [body weights] over a stride, at equal distances in time."""

    stance: tuple[float, ...]
    """From heel strike to toe-off"""
    swing: tuple[float, ...]
    """From toe-off to heel strike"""


MEASURED_LOADS = StrideLoads(
    stance=(
        1.12, 1.14, 1.45, 1.74, 1.99, 2.15, 2.16, 2.07, 1.97, 1.85,
        1.80, 1.83, 1.89, 2.01, 2.13, 2.14, 2.03, 1.80, 1.40, 0.97, 0.61,
    ),
    swing=(0.61, 0.32, 0.24, 0.16, 0.20, 0.34, 0.45, 0.88, 1.14),
)  # fmt: skip
"""Mean of the strides of three persons with instrumented knees (JW in two sessions, PS, DM), each person and session
with the same weight; their implants' clocks were set to the sensors' first. `python -m studies.validation` makes it"""
_BEGIN = 0.3
"""Ground force [body weights] of a first sample up to which it may be the beginning of a stance, as in recordings that
begin with a heel strike"""
_LATE_FORCE = 0.75
"""Ground force [body weights] at which the end of a stance begins"""
_LATE_STANCE = 0.2
"""Part of a stance that is left where the foot bears the body, for each body weight up to `_LATE_FORCE`.

A foot that still bears the body has not come to the end of its stance, however slow the person walks.
"""
_FADE = 0.1
"""Time [s] over which the expected load gains its weight after the first heel strike, and steps of it are spread"""


class ExpectedLoad(NamedTuple):
    """The load that a walking knee is expected to bear, and how far that counts."""

    load: float
    """Expected load [body weights]; 0 where the leg does not walk"""
    certainty: float
    """0 where the leg does not walk, 1 where it does; between them the expectation gains or loses its weight"""


NOT_WALKING = ExpectedLoad(0.0, 0.0)


class StridePhase:
    """Follows the strides of a leg by its ground force, and gives the load that is expected at each moment."""

    def __init__(self, loads: StrideLoads = MEASURED_LOADS) -> None:
        """Begin without a stride; `loads` are expected."""
        self._loads = loads
        self.forget_strides()

    def forget_strides(self) -> None:
        """Forget the present stride and the pace."""
        self._last: int | None = None
        """Stamp [ns] of the last sample"""
        self._bears = True
        """Whether the foot bears something; until a first heel strike was seen, the leg does not walk"""
        self._began: int | None = None
        """Stamp [ns] at which the present stance or swing began; None: not walking"""
        self._walks_since = 0
        """Stamp [ns] of the first heel strike since the leg walks"""
        self._stance = _STANCE
        """Duration [s] of the last stance"""
        self._load = 0.0
        """Load [body weights] that was expected last"""
        self._step = 0.0
        """Step [body weights] of the curves where the present stance or swing began, which fades"""

    def expect_load(self, stamp: int, force: float) -> ExpectedLoad:
        """Return the load that is expected at a stamp [ns] with a vertical ground force [body weights].

        To be called for every sample in order; a stamp that goes back, or a pause, begins anew.
        """
        if self._last is None or not 0 <= (stamp - self._last) * SECONDS_PER_NANOSECOND <= _SWING:
            self.forget_strides()
            self._bears = force > _BEGIN
        self._last = stamp
        bears = force > UNLOADED
        if bears != self._bears:
            self._begin_phase(stamp, bears)
        if self._began is None:
            return NOT_WALKING
        since = (stamp - self._began) * SECONDS_PER_NANOSECOND
        fade = min((stamp - self._walks_since) * SECONDS_PER_NANOSECOND / _FADE, 1.0)
        if bears:
            part = min(since / self._stance, 1.0 - _LATE_STANCE * min(force, _LATE_FORCE))
            left = (STANCES[1] - since) / _FADE
            load = at_part(self._loads.stance, part)
        else:
            left = (LONGEST_SWING - since) / _FADE
            load = at_part(self._loads.swing, since / _SWING)
        if left <= 0.0:
            self._began = None
            return NOT_WALKING
        if since == 0.0:
            self._step = self._load - load
        self._load = load + self._step * max(1.0 - since / _FADE, 0.0)
        return ExpectedLoad(self._load, min(fade, left, 1.0))

    def _begin_phase(self, stamp: int, bears: bool) -> None:
        """Begin a stance or a swing at a stamp [ns]; a stance that is no walker's ends the walk."""
        self._bears = bears
        if bears:
            if self._began is None:
                self._walks_since = stamp
                self._load = self._loads.stance[0]
            self._began = stamp
            return
        if self._began is None:
            return
        stance = (stamp - self._began) * SECONDS_PER_NANOSECOND
        if STANCES[0] <= stance <= STANCES[1]:
            self._stance = stance
            self._began = stamp
        else:
            self._began = None


def at_part(loads: tuple[float, ...], part: float) -> float:
    """Return a load [body weights] at a part (0 to 1) of a phase, from values at equal distances."""
    place = min(max(part, 0.0), 1.0) * (len(loads) - 1)
    before = min(int(place), len(loads) - 2)
    return loads[before] + (place - before) * (loads[before + 1] - loads[before])

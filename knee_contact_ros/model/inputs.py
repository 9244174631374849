"""Plausible angles and loads of a knee: values beyond them point to a wrong unit, sign, offset or axis.

Nothing is refused here: the user may model a rat. Each finding is one sentence with the values and the likely cause.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from .types import FIRST_DATE, MAX_FLEXION, MIN_FLEXION, NANOSECOND, Floats, Stamps

CLEAR_RATIO = 2.0
"""Ratio of two ranges or forces above which one clearly is the larger"""
_SWING_RATE = math.radians(180.0)
"""Rate [rad/s] faster than which only a swinging knee extends out of deep flexion: squats and chairs take longer"""
_DEEP = 0.6
"""Part of the range of motion beyond which flexion is deep: on stairs a loaded knee extends quickly, but below it"""
_SWING_LOAD = 0.75
"""Mean load of a swinging knee, as a part of that of the straight knee, from which their times do not fit.

In 21 shipped and measured gaits it is 0.19 at most, in 2000 made-up ones 0.39, and in running, on stairs and in
mixtures of movements 0.48. A load that is 0.4 s late or early makes it 0.98 or more in the 21, one of 0.2 s often less.
"""
_CLASSES = np.arange(MIN_FLEXION, MAX_FLEXION, math.radians(5.0))
"""Least angles [rad] of the classes by which the loads of swinging knees are kept until the range of motion is known"""
_SWING_SHARE = 0.01
"""Least part of the time in which the knee swings, for its load to be judged"""
STEP_FLEXION = math.radians(20.0)
"""Angle [rad] that a knee reaches in flexion in every step, and never in extension"""
MAX_RANGE_OF_MOTION = math.radians(180.0)
"""Range of motion [rad] beyond that of any knee"""
_JUDGED_TICKS = 100
"""Number of ticks from which a wrong sign, or a missing load, cannot be a swing phase"""
_JUDGED_TIME = 1.0
"""Time [s] from which a wrong sign, or a missing load, cannot be a swing phase"""
_PULLING_LOAD = -50.0
"""Mean load [N] below which even an unloaded knee is not plausible"""
_INCLUDED_ANGLE = math.radians(110.0)
"""Mean flexion [rad] under load that no gait has: it is 180 degrees minus the flexion"""
_JUDGED_SHARE = 0.1
"""Smallest fraction of ticks in a posture for their mean angle or load to be judged"""
_MOVING_LOAD = 10.0
"""Load [N] that a moving knee exceeds, if only by the weight of the shank"""
_PERCENT_LOAD = 0.3
"""Peak load [BW] that is too small for gait, as if a load in percent were read as newtons"""
_SWING_FLEXION = math.radians(40.0)
"""Flexion [rad] above which a walking leg swings"""
_STANCE_FLEXION = math.radians(25.0)
"""Flexion [rad] below which a walking leg may stand"""
_MAX_LOAD = 10.0
"""Load [BW] beyond that of any knee in gait"""
_HEAVIEST = 2000.0
"""Body weight [N] for `_MAX_LOAD` if it is not known: beyond that of nearly all people"""
MOST_PLAUSIBLE_LOAD = _MAX_LOAD * _HEAVIEST
"""Load [N] beyond that of any knee"""
_STANDING_LOAD = 0.5
"""Load [BW] above which a leg counts as standing"""
_TYPICAL_WEIGHT = 735.0
"""Body weight [N] for `_STANDING_LOAD` and `_PERCENT_LOAD` if it is not known: that of 75 kg"""
_IDLE_LOAD = 0.4
"""Load [BW] of a whole knee below which a straight leg is not stood on: in quiet standing it bears twice that"""
_STOOD_ON = 1.5
"""Mean load of a straight leg over `_IDLE_LOAD` from which it walks, and does not swing in the air.

In the 21 gaits with a load that is 0.4 s late or early it is 2.2 or more.
"""
_IDLE_SHARE = 0.03
"""Fraction of ticks with an idle straight leg from which angle and load may be of different times"""
_HOLE = 1.0
"""Time step [s] that is a hole, if the others are shorter by `_HOLE_RATIO`"""
_HOLE_RATIO = 10.0
_COARSE_STEP = 0.1
"""Mean time step [s] from which a load that changes much between samples is sampled too coarsely"""
_COARSE_CHANGE = 0.2
"""Mean change of the load between samples, as a fraction of its range: a period then has ten samples or fewer"""
_FEW_TICKS = 10
"""Number of ticks from which steps are judged"""
_LONG_STEP = 0.5
"""Time step [s] that is too long to show a gait"""
_NET_FORCE = 1.5
"""Largest load [BW] of a walking knee without the pull of its muscles: net joint forces peak at 0.98 to 1.25, and the
contact forces of instrumented knees in walking at 1.8 and more"""
_TURNING_TIME = 20_000_000
"""Time [ns] over which an angular velocity is taken at least, so that an encoder's steps do not count"""
_FASTEST = 25.0
"""Angular velocity [rad/s] beyond that of any knee: sprinters reach 20"""
_OTHER_AXIS_LOAD = 100.0
"""Mean force [N] along another axis than the tibia's above which there is a warning"""

_TURNS = {"x": ("0 0 90", "0 0 -90"), "z": ("-90 0 0", "90 0 0")}
"""Values of `load.rotation` that make an axis y, and y with the other sign"""


@dataclass
class InputCheck:
    """Angles and loads of a run of any length, kept as extremes and sums."""

    body_weight: float | None = None
    """Body weight [N]; None: not known"""
    load_driven: bool = True
    """Whether the load drives the femur; otherwise it is only passed on, and not judged"""
    share: float | None = None
    """Part of the whole knee's load that the loads are; None: not known"""
    names: str = "knee.flexion_"
    """Beginning of the names of the parameters `sign` and `offset`"""
    unit: str = ""
    """What to write if the angles are degrees"""
    compression: str = "force.y < 0 in joint_reaction_force"
    """Sign of a compression, and where it is"""
    ticks: int = 0
    """Number of ticks"""
    min_load: float = math.inf
    """Smallest load [N]"""
    max_load: float = -math.inf
    """Largest load [N]"""
    min_angle: float = math.inf
    """Smallest flexion angle [rad]"""
    max_angle: float = -math.inf
    """Largest flexion angle [rad]"""
    angles_outside: int = 0
    """Number of angles beyond those of any knee"""
    loads_outside: int = 0
    """Number of loads beyond those of any knee"""
    long_steps: int = 0
    """Number of time steps of `_LONG_STEP` or more"""
    longest_step: int = 0
    """Longest time step [ns]"""
    _idle: int = 0
    """Number of ticks with a flexion below `_STANCE_FLEXION` and a load below `_idle_load`"""
    _load_way: float = field(default=0.0, compare=False)
    """Sum of the changes [N] of the load between ticks"""
    _last_load: float = field(default=0.0, compare=False)
    # Sums are not compared: their rounding depends on the blocks in which samples came.
    _standing: int = 0
    """Number of ticks in which the leg stood"""
    _standing_angles: float = field(default=0.0, compare=False)
    """Sum of the angles [rad] of these ticks"""
    _bent: int = 0
    """Number of ticks with a flexion above `_SWING_FLEXION`"""
    _straight: int = 0
    """Number of ticks with a flexion below `_STANCE_FLEXION`"""
    _bent_load: float = field(default=0.0, compare=False)
    """Sum of the loads [N] at such angles"""
    _straight_load: float = field(default=0.0, compare=False)
    _load_sum: float = field(default=0.0, compare=False)
    """Sum of all loads [N]"""
    _first: int = 0
    """First stamp [ns]"""
    _latest: int = 0
    """Latest stamp [ns]"""
    _previous: int = 0
    """Stamp [ns] of the last sample that came, which is an earlier one after a reset of the time"""
    fastest: float = 0.0
    """Largest angular velocity [rad/s]"""
    fastest_at: int = 0
    """Stamp [ns] at which it was reached"""
    _turned: tuple[Stamps, Floats, Floats] | None = field(default=None, compare=False)
    """Stamps [ns], angles [rad] and loads [N] of the last samples, of which the angular velocity of the next follows"""
    _pieces: int = 0
    """Number of angular velocities"""
    _swings_at: Floats = field(default_factory=lambda: np.zeros(len(_CLASSES) + 1), compare=False)
    """How often a knee extended faster than `_SWING_RATE`, by `_CLASSES` of its angle"""
    _swing_loads: Floats = field(
        default_factory=lambda: np.zeros(len(_CLASSES) + 1), compare=False
    )
    """Sums of the loads [N] at these"""

    def add_samples(self, stamps: Stamps, angles: Floats, loads: Floats) -> None:
        """Add samples, at least one: stamps [ns], flexion angles [rad] and loads [N], shape (n,)."""
        if not self.ticks:
            self._first = self._previous = int(stamps[0])
            self._last_load = float(loads[0])
        self._load_way += float(np.abs(np.diff(loads, prepend=self._last_load)).sum())
        self._last_load = float(loads[-1])
        steps = np.diff(stamps, prepend=self._previous)
        self.long_steps += int(np.count_nonzero(steps >= _LONG_STEP / NANOSECOND))
        self.longest_step = max(self.longest_step, int(steps.max()))
        self._previous = int(stamps[-1])
        self._latest = max(self._latest, int(stamps.max()))
        self.ticks += len(stamps)
        self._load_sum += float(loads.sum())
        self.min_load = min(self.min_load, float(loads.min()))
        self.max_load = max(self.max_load, float(loads.max()))
        self.min_angle = min(self.min_angle, float(angles.min()))
        self.max_angle = max(self.max_angle, float(angles.max()))
        outside = (angles < MIN_FLEXION) | (angles > MAX_FLEXION)
        self.angles_outside += int(np.count_nonzero(outside))
        self.loads_outside += int(np.count_nonzero(loads > self.plausible_load))
        bent = angles > _SWING_FLEXION
        straight = angles < _STANCE_FLEXION
        self._bent += int(np.count_nonzero(bent))
        self._straight += int(np.count_nonzero(straight))
        self._idle += int(np.count_nonzero(straight & (loads < self._idle_load)))
        self._bent_load += float(loads[bent].sum())
        self._straight_load += float(loads[straight].sum())
        self._add_turning(stamps, angles, loads)
        stands = loads >= _STANDING_LOAD * (self.body_weight or _TYPICAL_WEIGHT)
        self._standing += int(np.count_nonzero(stands))
        self._standing_angles += float(angles[stands].sum())

    def _add_turning(self, stamps: Stamps, angles: Floats, loads: Floats) -> None:
        """Find angular velocities, between the last samples in pieces of time of `_TURNING_TIME`."""
        if self._turned:
            stamps, angles, loads = (
                np.concatenate(each)
                for each in zip(self._turned, (stamps, angles, loads), strict=True)
            )
        pieces = stamps // _TURNING_TIME
        last = np.flatnonzero(pieces[1:] != pieces[:-1])  # the present piece may go on
        kept = [*last[-1:], -1]
        self._turned = stamps[kept], angles[kept], loads[kept]
        if len(last) < 2:
            return
        times = np.diff(stamps[last])
        rates = np.diff(angles[last]) / np.maximum(times, _TURNING_TIME) / NANOSECOND
        rates[times <= 0] = 0.0  # the time was reset
        at = int(np.abs(rates).argmax())
        if abs(rates[at]) > self.fastest:
            self.fastest, self.fastest_at = float(abs(rates[at])), int(stamps[last[at + 1]])
        self._pieces += len(rates)
        swing = last[1:][rates < -_SWING_RATE]
        classes = np.searchsorted(_CLASSES, angles[swing], "right")
        np.add.at(self._swings_at, classes, 1.0)
        np.add.at(self._swing_loads, classes, loads[swing])

    @property
    def plausible_load(self) -> float:
        """Load [N] beyond that of any knee."""
        return _MAX_LOAD * (self.share or 1.0) * (self.body_weight or _HEAVIEST)

    @property
    def _idle_load(self) -> float:
        """Load [N] below which a straight leg is not stood on; of an unknown share that of a half."""
        return _IDLE_LOAD * (self.share or 0.5) * (self.body_weight or _TYPICAL_WEIGHT)

    @property
    def _can_be_judged(self) -> bool:
        """Whether the run is too long to be a swing phase."""
        long_enough = self._latest - self._first >= _JUDGED_TIME / NANOSECOND
        return self.ticks >= _JUDGED_TICKS and long_enough

    @property
    def _is_percent(self) -> bool:
        """Whether the load follows the angle as in gait, but is much too small."""
        too_small = self.max_load <= _PERCENT_LOAD * (self.body_weight or _TYPICAL_WEIGHT)
        return self._can_be_judged and too_small and self._swings

    @property
    def _swings(self) -> bool:
        """Whether the leg stands and swings: the straight knee bears clearly more than the bent one on average."""
        enough = min(self._bent, self._straight) >= _JUDGED_SHARE * self.ticks
        # Without dividing by a number of ticks that may be 0
        bent = CLEAR_RATIO * self._bent_load * self._straight
        return enough and bent <= self._straight_load * self._bent

    @property
    def about_net_force(self) -> str:
        """Sentence about a load that has no muscle forces in it; empty if it may have them, or is not known enough."""
        weight = (self.share or math.nan) * (self.body_weight or math.nan)
        if not (_PERCENT_LOAD * weight < self.max_load < _NET_FORCE * weight and self._swings):
            return ""
        return (
            f"the load of a swinging and standing leg reaches {self.max_load / weight:.2f} body weights in the whole "
            "knee, and the contact force of a walking knee 2 to 3: is body_weight another person's, or is it the net "
            "joint force of inverse dynamics, which has no muscle forces? estimate-load computes "
            "a load with them: from it and the net moment (load/net_load), or from joint angles and the ground force"
        )

    @property
    def about_angle(self) -> str:
        """Sentence about angles that no knee has; empty if they are plausible."""
        least, most = self.min_angle, self.max_angle
        low, high = math.degrees(least), math.degrees(most)
        span = f"the flexion angle goes from {low:.1f} to {high:.1f} deg"
        extends = -least >= STEP_FLEXION and -least >= CLEAR_RATIO * most and most < STEP_FLEXION
        if self._can_be_judged and extends:
            hint = ", and is it in degrees instead of radians" if least < -MAX_FLEXION else ""
            return f"{span}, which is extension: is its sign the other one ({self.names}sign -1){hint}?"
        could_be_included = math.pi - most >= MIN_FLEXION and math.pi - least <= MAX_FLEXION
        stood = self._standing >= _JUDGED_SHARE * self.ticks
        bent_under_load = self._standing_angles >= _INCLUDED_ANGLE * self._standing
        if self._can_be_judged and could_be_included and stood and bent_under_load:
            mean = math.degrees(self._standing_angles / self._standing)
            return (
                f"{span}, and is {mean:.0f} deg on average under load: is it the included angle, 180 deg - flexion "
                f"({self.names}sign -1, {self.names}offset {math.pi:.5f})?"
            )
        if self.angles_outside:
            knee = f"and a knee has {math.degrees(MIN_FLEXION):.0f} to {math.degrees(MAX_FLEXION):.0f}"
            raw = f"{least:.4g} to {most:.4g}"
            often = f"{self.angles_outside} of {self.ticks} ticks are beyond"
            if most - least > MAX_RANGE_OF_MOTION:
                return (
                    f"{span}, {knee} ({often}): are {raw} degrees instead of radians{self.unit}?"
                )
            cause = f"does it have an offset ({self.names}offset, in rad), or is it in degrees instead of radians"
            cause += self.unit
            if least < MIN_FLEXION and -most >= MIN_FLEXION and -least <= MAX_FLEXION:
                cause = f"is its sign the other one ({self.names}sign -1), {cause}"
            return f"{span} ({raw} rad), {knee} ({often}): {cause}?"
        return self.about_turning

    @property
    def about_turning(self) -> str:
        """Sentence about an angular velocity that no knee has; empty if there is none."""
        if self.fastest <= _FASTEST:
            return ""
        begin = self._first if self._first >= FIRST_DATE else 0
        at = f"{(self.fastest_at - begin) * NANOSECOND:.7g} s{' from the first sample on' if begin else ''}"
        return (
            f"the knee turns at up to {self.fastest:.3g} rad/s (at {at}), and no knee "
            f"at more than {_FASTEST:g}: are these the times of the angle, or does its sensor jump?"
        )

    @property
    def load_pulls(self) -> bool:
        """Whether the load pulls throughout or for the most part."""
        tensile = self._load_sum <= _PULLING_LOAD * self.ticks
        mostly = -self.min_load >= CLEAR_RATIO * self.max_load
        return self.load_driven and self._can_be_judged and tensile and mostly

    @property
    def about_load(self) -> str:
        """Sentence about a load with the wrong sign or unit, or too large for a knee; empty if it is plausible."""
        least, most = self.min_load, self.max_load
        if not self.load_driven:
            return ""
        if self.load_pulls:
            how = "throughout" if most <= 0.0 else "for the most part"
            return (
                f"the load was negative {how} ({least:.0f} to {most:.0f} N): compression is {self.compression}; "
                "does your sensor use the opposite sign?"
            )
        if self._can_be_judged and max(-least, most) < _MOVING_LOAD:
            if least != most or least:
                return f"the load was {least:.3g} to {most:.3g} N throughout: is it in kN or body weights instead of N?"
            return f"the load was 0 throughout: does another axis carry it than {self.compression}, or nothing?"
        if most > self.plausible_load:
            weights = f"{most / self.body_weight:.3g} body weights, " if self.body_weight else ""
            return (
                f"the load reaches {most:.0f} N ({weights}beyond {self.plausible_load:.0f} N in {self.loads_outside} "
                f"of {self.ticks} ticks), more than any knee bears: is it in N, does it have a spike, or is "
                "body_weight wrong?"
            )
        share = f", or load.share {self.share:g} too small" if (self.share or 1.0) < 0.3 else ""
        percent = f"the load of a gait was {most:.3g} N at most: is it in percent of body weight instead of N{share}?"
        net_force = self.about_net_force if self._can_be_judged else ""
        return percent if self._is_percent else net_force

    @property
    def about_time(self) -> str:
        """Sentence about ticks that are too far apart for any gait; empty otherwise."""
        if self.ticks < _JUDGED_TICKS or self.long_steps < 0.5 * self.ticks:
            return ""
        step = (self._latest - self._first) * NANOSECOND / (self.ticks - 1)
        return f"the samples are {step:.3g} s apart: are their times in milliseconds instead of seconds?"

    @property
    def about_pairing(self) -> str:
        """Sentence about a leg that is loaded in swing and idle when straight, as no step is; empty otherwise."""
        deep = max(_SWING_FLEXION, self.min_angle + _DEEP * (self.max_angle - self.min_angle))
        swings = slice(int(np.searchsorted(_CLASSES, deep)), None)
        times = float(self._swings_at[swings].sum())
        enough = times > _SWING_SHARE * self._pieces
        enough &= self._straight >= _JUDGED_SHARE * self.ticks
        idle = self._idle >= _IDLE_SHARE * self.ticks
        pulls = self.min_load < -self._idle_load
        judged = self._can_be_judged and self.load_driven
        judged = judged and not self.about_load and not self.about_angle
        if pulls or not (judged and enough and idle):
            return ""
        swing = float(self._swing_loads[swings].sum()) / times
        straight = self._straight_load / self._straight
        if swing <= _SWING_LOAD * straight or straight < _STOOD_ON * self._idle_load:
            return ""
        return (
            f"the load is {swing:.0f} N on average when the bent knee extends quickly, as in swing, and {straight:.0f} "
            "N when it is straight and idle at times: a step is the other way round; are angle and load of the same "
            "times (stamps, pairing.angle_delay)?"
        )

    @property
    def about_steps(self) -> str:
        """Sentence about a hole between samples, or about samples too far apart for their load; empty otherwise."""
        if self.ticks < _FEW_TICKS or self.about_time:
            return ""
        whole = self._latest - self._first
        others = (whole - self.longest_step) / (self.ticks - 2)
        hole = self.longest_step * NANOSECOND
        if hole >= _HOLE and self.longest_step >= _HOLE_RATIO * others:
            return f"there is a hole of {hole:.3g} s between two samples: angle and load are straight lines there"
        step = whole * NANOSECOND / (self.ticks - 1)
        change = self._load_way / (self.ticks - 1)
        if step >= _COARSE_STEP and change > _COARSE_CHANGE * (self.max_load - self.min_load):
            return (
                f"the samples are {step:.3g} s apart, and the load changes by {change:.0f} N from one to the next: "
                "lines between them are no gait; it needs some 50 samples a second"
            )
        return ""

    @property
    def sentences(self) -> list[str]:
        """All sentences on a whole run."""
        texts = (
            self.about_angle,
            self.about_load,
            self.about_time,
            self.about_pairing,
            self.about_steps,
        )
        return [text for text in texts if text]


@dataclass
class AxisCheck:
    """Which axis of the joint reaction carries the load."""

    topic: str = "joint_reaction_force"
    """Topic of the forces"""
    turned_by: str = ""
    """Name and value of the parameter by which forces are turned; empty: they are not"""
    forces: int = 0
    """Number of forces"""
    x: float = 0.0
    """Sum of the absolute forces along x [N]"""
    y: float = 0.0
    """The same along y"""
    z: float = 0.0
    """The same along z"""

    def add_force(self, x: float, y: float, z: float) -> None:
        """Add a force [N]; NaN along x or z counts as 0."""
        self.forces += 1
        # A number that differs from itself is NaN; `math.isnan` takes longer, and this is done in every tick.
        self.x += abs(x) if x == x else 0.0  # noqa: PLR0124
        self.y += abs(y)
        self.z += abs(z) if z == z else 0.0  # noqa: PLR0124

    def add_forces(self, forces: Floats) -> None:
        """Add forces [N], shape (n, 3)."""
        self.forces += len(forces)
        x, y, z = np.nansum(np.abs(forces), axis=0).tolist()
        self.x += x
        self.y += y
        self.z += z

    @property
    def sentence(self) -> str:
        """Sentence about another axis than y that carries the load; empty if y carries it."""
        if self.forces < _JUDGED_TICKS:
            return ""
        name, other = max((("x", self.x), ("z", self.z)), key=lambda axis: axis[1])
        if other <= _OTHER_AXIS_LOAD * self.forces or other <= CLEAR_RATIO * self.y:
            return ""
        sizes = f"{other / self.forces:.0f} N on average, and force.y {self.y / self.forces:.0f} N"
        carried = f"force.{name} carries {sizes} in {self.topic}"
        if self.turned_by:
            return f"{carried}: is {name} up? Is {self.turned_by} right?"
        return (
            f"{carried}: is {name} up? Where it is < 0 in compression, set load.rotation to {_TURNS[name][0]} deg (for "
            "z up as in REP 103 also frame.tibia to the name of the forces' frame followed by _isb) or name it in "
            f"load.source (-wrench.force.{name}). Where it is > 0, its sign is the other one or it points down: set "
            f"{_TURNS[name][1]} deg, or name wrench.force.{name}"
        )

"""Plausible angles and loads of a knee: values beyond them point to a wrong unit, sign, offset or axis.

Nothing is refused here: the user may model a rat. Each finding is one sentence with the values and the likely cause.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from knee_contact_ros.model.types import MAX_FLEXION, MIN_FLEXION, NANOSECOND, Floats, Integers

ONE_SIDED_TICKS, ONE_SIDED_TIME = 100, 1.0
"""Number of ticks and time [s] after which a wrong sign, or a missing load, cannot be a swing phase"""
PULLING = -50.0
"""Mean load [N] below which even an unloaded knee is not plausible"""
TIMES_MORE = 2.0
"""Ratio of two ranges or forces above which one clearly is the larger"""
CLEAR = math.radians(20.0)
"""Angle [rad] that a knee reaches in flexion in every step, and never in extension"""
WIDEST = math.radians(180.0)
"""Range of motion [rad] beyond that of any knee"""
BENT = math.radians(110.0)
"""Mean flexion [rad] under load that no gait has"""
OFTEN = 0.1
"""Smallest fraction of ticks under load for their mean angle to be judged"""
LEAST_LOAD = 10.0
"""Load [N] that a moving knee exceeds, if only by the weight of the shank"""
PERCENT, SWINGS, STRAIGHT = 0.3, math.radians(40.0), math.radians(25.0)
"""Peak load [BW] that is too small for gait, as if a load in percent were read as newtons; flexion [rad] above which a
walking leg swings, and below which it may stand"""
MOST_WEIGHTS = 10.0
"""Load [BW] beyond that of any knee in gait"""
HEAVIEST = 2000.0
"""Body weight [N] that is taken for the largest plausible load where none is known"""
STANDS = 0.5
"""Load [BW] above which a leg counts as standing; an unknown body weight is replaced by `USUAL`"""
USUAL = 735.0
"""Body weight [N] of a typical person"""
SLOWEST = 0.5
"""Time step [s] that is too long to show a gait"""
CARRIES = 100.0
"""Mean force [N] along another axis than the tibia's above which there is a warning"""


@dataclass
class Inputs:
    """Angles and loads of a run of any length, kept as extremes and sums."""

    body_weight: float | None = None
    """Body weight [N]; None: not known"""
    driven: bool = True
    """Whether the load drives the femur; otherwise it is only passed on, and not judged"""
    names: str = "knee.flexion_"
    """Beginning of the names of the parameters `sign` and `offset`"""
    ticks: int = 0
    """Number of ticks"""
    lowest: float = math.inf
    """Lowest load [N]"""
    highest: float = -math.inf
    """Highest load [N]"""
    least: float = math.inf
    """Least flexion angle [rad]"""
    most: float = -math.inf
    """Largest flexion angle [rad]"""
    outside: int = 0
    """Number of angles beyond those of any knee"""
    overloaded: int = 0
    """Number of loads beyond those of any knee"""
    slow: int = 0
    """Number of time steps of `SLOWEST` or more"""
    _stood: int = 0
    _angles: float = field(
        default=0.0, compare=False
    )  # sum of the angles [rad] while the leg stood
    _bent: int = 0
    _straight: int = 0
    _bent_load: float = field(default=0.0, compare=False)  # sums of the loads [N] at such angles
    _straight_load: float = field(default=0.0, compare=False)
    _sum: float = field(
        default=0.0, compare=False
    )  # of all loads [N]; rounding depends on the blocks that came
    _first: int = 0  # stamps [ns]
    _last: int = 0
    _newest: int = 0

    def add_all(self, stamps: Integers, angles: Floats, loads: Floats) -> None:
        """Add samples, at least one: stamps [ns], flexion angles [rad] and loads [N], shape (n,)."""
        if not self.ticks:
            self._first = self._newest = int(stamps[0])
        steps = np.diff(stamps, prepend=self._newest)
        self.slow += int(np.count_nonzero(steps >= SLOWEST / NANOSECOND))
        self._newest, self._last = int(stamps[-1]), max(self._last, int(stamps.max()))
        self.ticks += len(stamps)
        self._sum += float(loads.sum())
        self.lowest, self.highest = (
            min(self.lowest, float(loads.min())),
            max(self.highest, float(loads.max())),
        )
        self.least, self.most = (
            min(self.least, float(angles.min())),
            max(self.most, float(angles.max())),
        )
        self.outside += int(np.count_nonzero((angles < MIN_FLEXION) | (angles > MAX_FLEXION)))
        self.overloaded += int(np.count_nonzero(loads > self.limit))
        bent, straight = angles > SWINGS, angles < STRAIGHT
        self._bent += int(np.count_nonzero(bent))
        self._straight += int(np.count_nonzero(straight))
        self._bent_load += float(loads[bent].sum())
        self._straight_load += float(loads[straight].sum())
        stands = loads >= STANDS * (self.body_weight or USUAL)
        self._stood += int(np.count_nonzero(stands))
        self._angles += float(angles[stands].sum())

    @property
    def limit(self) -> float:
        """Load [N] beyond that of any knee."""
        return MOST_WEIGHTS * (self.body_weight or HEAVIEST)

    @property
    def _long(self) -> bool:
        return (
            self.ticks >= ONE_SIDED_TICKS
            and self._last - self._first >= ONE_SIDED_TIME / NANOSECOND
        )

    @property
    def _percent(self) -> bool:
        """Whether the load follows the angle as in gait, but is much too small."""
        if not self._long or self.highest > PERCENT * (self.body_weight or USUAL):
            return False
        often = min(self._bent, self._straight) >= OFTEN * self.ticks
        return (
            often
            and TIMES_MORE * self._bent_load * self._straight <= self._straight_load * self._bent
        )

    @property
    def about_angle(self) -> str:
        """Sentence about angles that no knee has; empty if they are plausible."""
        low, high = math.degrees(self.least), math.degrees(self.most)
        span = f"the flexion angle goes from {low:.1f} to {high:.1f} deg"
        if (
            self._long
            and -self.least >= CLEAR
            and -self.least >= TIMES_MORE * self.most
            and self.most < CLEAR
        ):
            hint = ", and is it in degrees instead of radians" if self.least < -MAX_FLEXION else ""
            return f"{span}, which is extension: is its sign the other one ({self.names}sign -1){hint}?"
        mirrored = math.pi - self.most >= MIN_FLEXION and math.pi - self.least <= MAX_FLEXION
        if (
            self._long
            and mirrored
            and self._stood >= OFTEN * self.ticks
            and self._angles >= BENT * self._stood
        ):
            mean = math.degrees(self._angles / self._stood)
            return (
                f"{span}, and is {mean:.0f} deg on average under load: is it the included angle, 180 deg - flexion "
                f"({self.names}sign -1, {self.names}offset {math.pi:.5f})?"
            )
        if self.outside:
            knee = f"and a knee has {math.degrees(MIN_FLEXION):.0f} to {math.degrees(MAX_FLEXION):.0f}"
            raw = f"{self.least:.4g} to {self.most:.4g}"
            often = f"{self.outside} of {self.ticks} ticks are beyond"
            if self.most - self.least > WIDEST:
                return f"{span}, {knee} ({often}): are {raw} degrees instead of radians?"
            turned = (
                self.least < MIN_FLEXION
                and -self.most >= MIN_FLEXION
                and -self.least <= MAX_FLEXION
            )
            cause = f"is its sign the other one ({self.names}sign -1), " * turned
            cause += f"does it have an offset ({self.names}offset, in rad), or is it in degrees instead of radians"
            return f"{span} ({raw} rad), {knee} ({often}): {cause}?"
        return ""

    @property
    def pulls(self) -> bool:
        """Whether the load pulls throughout or for the most part."""
        low = self._sum <= PULLING * self.ticks and -self.lowest >= TIMES_MORE * self.highest
        return self.driven and self._long and low

    @property
    def about_load(self) -> str:
        """Sentence about a load with the wrong sign or unit, or too large for a knee; empty if it is plausible."""
        least, most = self.lowest, self.highest
        if not self.driven:
            return ""
        if self.pulls:
            how = "throughout" if most <= 0.0 else "for the most part"
            return (
                f"the load was negative {how} ({least:.0f} to {most:.0f} N): compression is force.y < 0 "
                "in joint_reaction_force; does your sensor use the opposite sign?"
            )
        if self._long and max(-least, most) < LEAST_LOAD:
            if least != most or least:
                return f"the load was {least:.3g} to {most:.3g} N throughout: is it in kN or body weights instead of N?"
            return "the load was 0 throughout: does another axis of joint_reaction_force carry it, or nothing?"
        percent = f"the load of a gait was {most:.3g} N at most: is it in percent of body weight instead of N?"
        if most > self.limit:
            weights = f"{most / self.body_weight:.3g} body weights, " if self.body_weight else ""
            return (
                f"the load reaches {most:.0f} N ({weights}beyond {self.limit:.0f} N in {self.overloaded} of "
                f"{self.ticks} ticks), more than any knee bears: is it in N, does it have a spike, or is body_weight "
                "wrong?"
            )
        return percent if self._percent else ""

    @property
    def about_time(self) -> str:
        """Sentence about ticks that are too far apart for any gait; empty otherwise."""
        if self.ticks < ONE_SIDED_TICKS or self.slow < 0.5 * self.ticks:
            return ""
        step = (self._last - self._first) * NANOSECOND / (self.ticks - 1)
        return f"the samples are {step:.3g} s apart: are their times in milliseconds instead of seconds?"

    @property
    def sentences(self) -> list[str]:
        """All sentences."""
        return [
            sentence
            for sentence in (self.about_angle, self.about_load, self.about_time)
            if sentence
        ]


@dataclass
class Axes:
    """Which axis of the joint reaction carries the load."""

    frame: str = ""
    """The parameter `frame.tibia`"""
    forces: int = 0
    """Number of forces"""
    x: float = 0.0
    """Sum of the absolute forces along x [N]"""
    y: float = 0.0
    """The same along y"""
    z: float = 0.0
    """The same along z"""

    def add(self, x: float, y: float, z: float) -> None:
        """Add a force [N]; NaN counts as 0."""
        self.forces += 1
        self.x += abs(x) if x == x else 0.0  # noqa: PLR0124  (sooner than math.isnan)
        self.y += abs(y)
        self.z += abs(z) if z == z else 0.0  # noqa: PLR0124

    def add_all(self, forces: Floats) -> None:
        """Add forces [N], shape (n, 3)."""
        self.forces += len(forces)
        x, y, z = np.nansum(np.abs(forces), axis=0).tolist()
        self.x, self.y, self.z = self.x + x, self.y + y, self.z + z

    @property
    def sentence(self) -> str:
        """Sentence about another axis than y that carries the load; empty if y carries it."""
        if self.forces < ONE_SIDED_TICKS:
            return ""
        name, other = max((("x", self.x), ("z", self.z)), key=lambda axis: axis[1])
        if other <= CARRIES * self.forces or other <= TIMES_MORE * self.y:
            return ""
        carried = f"force.{name} carries {other / self.forces:.0f} N on average, and force.y {self.y / self.forces:.0f}"
        if self.frame:
            return f"{carried} N in joint_reaction_force: is {name} up? Is frame.tibia {self.frame!r} right?"
        return (
            f"{carried} N in joint_reaction_force: is {name} up? Set frame.tibia (for z up as in REP 103: the name of "
            f"the forces' frame followed by _isb), name the axis in load.source (as -wrench.force.{name}), or send "
            "force.y along the tibia, < 0 in compression"
        )

"""Whether a leg's angles and ground force follow our conventions: what holds in every step of level walking.

A standing foot is level, so hip, knee and ankle give its pitch; the ground pushes back before it pushes forwards; and
it pushes under the foot, which is ahead of the ankle. Another convention breaks one of these, and the estimate with
it: an angle of the hip against the pelvis makes 3.6 body weights of 2.6. Of a net load: muscles extend the standing
knee more, the more it is bent.
"""

import math
from dataclasses import dataclass, field

from .leg import SECONDS_PER_NANOSECOND, Ground, Joints
from .walking import LONGEST_SWING, STANCES, UNLOADED

_STANDS = 0.5
"""Ground force [body weights] above which the foot is level, and its centre of pressure known"""
_JUDGED = 30
"""Number of samples of standing from which conventions can be judged"""
_LEAST_PITCH = math.radians(-25.0)
"""Smallest mean pitch [rad] of a standing foot. Where angles are ours it was -5 to 0 degrees in thirteen trials; in
running the heel is up"""
_ABSURD_PITCH = math.radians(90.0)
"""Pitch [rad] beyond that of another convention: an angle is no joint's, which other checks say"""
_MOST_PITCH = math.radians(4.5)
"""Largest one; with the hip's angle against the pelvis it was 7 to 10 degrees"""
_TURNS = math.radians(15.0)
"""Range [rad] that the thigh goes through in stance; in less of it, nothing is pushed back and forwards"""
_BENDS = math.radians(10.0)
"""The same of a standing knee; below it the net moment is not judged"""
_FOLLOWS = 0.7
"""Correlation of forward force and thigh above which the force is turned; where it is ours it was -0.98 to -0.94"""
_REVERSED = -0.4
"""Correlation of flexion and net moment below which the moment is turned; in fifteen trials it was 0.47 to 0.91"""
_BEHIND = -0.02
"""Most backward mean place [m] of the centre of pressure, from the ankle; in ten strides it was 43 to 88 mm ahead"""
_STRAIGHT = math.radians(25.0)
"""Flexion [rad] below which a knee that bears `_BEARS` body weights stands in walking, and does not pedal"""
_BEARS = 0.3
_SHORTEST_SWING = 0.2
"""Shortest swing [s] of walking"""
_LEAST_PEAK = 0.7
"""Largest ground force [body weights] that is too small for walking, where it is 1.0 to 1.3"""


@dataclass
class LegCheck:
    """Sums over the samples of a standing leg, of a run of any length."""

    weight: float
    """Body weight [N]"""
    net: bool = False
    """Whether the wrench is the knee's net one, and not the ground's"""
    samples: int = 0
    """Number of samples in which the foot stood"""
    _sums: dict[str, float] = field(default_factory=dict)
    """Sums by name; NaN where something is not measured"""
    _turned: tuple[float, float] = (math.inf, -math.inf)
    """Range of the angle [rad] that moves with the force: the thigh's, or the knee's with the net moment"""
    _steps: int = 0  # in walking: a stance on a straight knee, a swing, a landing
    _peak: float = 0.0  # largest force upwards [N]
    _bears: bool = True  # whether the foot bears something
    _since: int = 0  # stamp [ns] since when
    _stood: bool = False  # whether it stood on a straight knee

    def add_sample(self, stamp: int, joints: Joints, ground: Ground) -> None:
        """Add a sample with its stamp [ns]; what is not measured is NaN."""
        forward, up, _ = ground.force
        if up > self._peak:  # noqa: PLR1730  (max is called in every tick)
            self._peak = up
        if up > _BEARS * self.weight and joints.flexion < _STRAIGHT:
            self._stood = True
        if (up > UNLOADED * self.weight) != self._bears:
            self._begin_phase(stamp)
        if not up > _STANDS * self.weight:
            return
        self.samples += 1
        angle = joints.hip
        if self.net:
            angle, forward = joints.flexion, ground.torque[2]
        terms = {
            "pitch": joints.hip - joints.flexion + joints.ankle,
            "angle": angle,
            "forward": forward,
            "angle * angle": angle * angle,
            "forward * forward": forward * forward,
            "angle * forward": angle * forward,
            "up": up,
            "moment": ground.torque[2],
        }
        for name, value in terms.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
        self._turned = min(self._turned[0], angle), max(self._turned[1], angle)

    def _begin_phase(self, stamp: int) -> None:
        """Begin a stance or a swing at a stamp [ns]; count a step if the stance and swing before were those of one."""
        lasted = (stamp - self._since) * SECONDS_PER_NANOSECOND
        if self._bears:
            self._stood &= STANCES[0] <= lasted <= STANCES[1]
        else:
            self._steps += self._stood and _SHORTEST_SWING <= lasted <= LONGEST_SWING
            self._stood = False
        self._bears, self._since = not self._bears, stamp

    @property
    def about_weight(self) -> str:
        """Sentence about a walking foot that bears too little for the body weight; empty if it bears enough."""
        part = self._peak / self.weight
        if self.net or not self._steps or part >= _LEAST_PEAK:
            return ""
        return (
            f"the foot of a walking leg bears {part:.2f} body weights at most, and in walking it is 1.0 to 1.3: is the "
            "body's mass another person's, does the sensor miss a part, or does something else bear it (a harness)?"
        )

    @property
    def sentences(self) -> list[str]:
        """Sentences about a body weight and conventions that are likely others; none where too little is known."""
        if self.about_weight:
            return [self.about_weight]  # what follows is judged by the weight
        if self.samples < _JUDGED:
            return []
        mean = {name: value / self.samples for name, value in self._sums.items()}
        walks = self._turned[1] - self._turned[0] > (_BENDS if self.net else _TURNS)
        both, angles, forces = (
            mean[f"{one} * {other}"] - mean[one] * mean[other]
            for one, other in (("angle", "forward"), ("angle", "angle"), ("forward", "forward"))
        )
        together = math.sqrt(max(angles * forces, 0.0))
        if self.net:
            if not walks or both >= _REVERSED * together:
                return []
            return [
                "the net moment of the standing knee falls as the knee bends, and muscles extend it more then: is it "
                "positive if they extend it? An external moment that is positive in flexion is the same number"
            ]
        found = []
        pitch = mean["pitch"]
        if -_ABSURD_PITCH < pitch < _LEAST_PITCH or _MOST_PITCH < pitch < _ABSURD_PITCH:
            found.append(
                f"by hip, knee and ankle the standing foot is pitched by {math.degrees(pitch):.1f} deg on average, and "
                "it is level: is the hip's angle that of the thigh to the vertical, not to the pelvis (a map takes the "
                "pelvis' angle as pelvis), positive with the knee ahead? And is the ankle 0 at a right angle?"
            )
        if walks and both > _FOLLOWS * together:
            found.append(
                "the ground pushes the standing foot forwards while the thigh is ahead, and back later, but it brakes "
                "first: is the force's x forwards, and the hip's angle positive with the knee ahead?"
            )
        place = mean["moment"] / mean["up"]
        if place < _BEHIND:
            found.append(
                f"by its torque about z the ground pushes {-1e3 * place:.0f} mm behind the ankle on average, and a "
                "foot is ahead of it: is the torque about the ankle's centre, with z to the right?"
            )
        return found

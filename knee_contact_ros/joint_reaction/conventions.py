"""Whether a leg's angles and ground force follow our conventions: what holds in every step of level walking.

A standing foot is level, so hip, knee and ankle give its pitch; the ground pushes back before it pushes forwards; and
it pushes under the foot, which is ahead of the ankle. Another convention breaks one of these, and the estimate with
it: an angle of the hip against the pelvis makes 3.6 body weights of 2.6.
"""

import math
from dataclasses import dataclass, field

from .leg import Ground, Joints

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
_FOLLOWS = 0.7
"""Correlation of forward force and thigh above which the force is turned; where it is ours it was -0.98 to -0.94"""
_BEHIND = -0.02
"""Most backward mean place [m] of the centre of pressure, from the ankle; in ten strides it was 43 to 88 mm ahead"""


@dataclass
class LegCheck:
    """Sums over the samples of a standing leg, of a run of any length."""

    weight: float
    """Body weight [N]"""
    samples: int = 0
    """Number of samples in which the foot stood"""
    _sums: dict[str, float] = field(default_factory=dict)
    """Sums by name; NaN where something is not measured"""
    _thigh: tuple[float, float] = (math.inf, -math.inf)
    """Range of the thigh's angle [rad]"""

    def add_sample(self, joints: Joints, ground: Ground) -> None:
        """Add a sample; what is not measured is NaN."""
        forward, up, _ = ground.force
        if not up > _STANDS * self.weight:
            return
        self.samples += 1
        hip = joints.hip
        terms = {
            "pitch": hip - joints.flexion + joints.ankle,
            "hip": hip,
            "forward": forward,
            "hip * hip": hip * hip,
            "forward * forward": forward * forward,
            "hip * forward": hip * forward,
            "up": up,
            "moment": ground.torque[2],
        }
        for name, value in terms.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
        self._thigh = min(self._thigh[0], hip), max(self._thigh[1], hip)

    @property
    def sentences(self) -> list[str]:
        """Sentences about conventions that are likely others; none where too little is known."""
        if self.samples < _JUDGED:
            return []
        mean = {name: value / self.samples for name, value in self._sums.items()}
        found = []
        pitch = mean["pitch"]
        if -_ABSURD_PITCH < pitch < _LEAST_PITCH or _MOST_PITCH < pitch < _ABSURD_PITCH:
            found.append(
                f"by hip, knee and ankle the standing foot is pitched by {math.degrees(pitch):.1f} deg on average, and "
                "it is level: is the hip's angle that of the thigh to the vertical, not to the pelvis (a map takes the "
                "pelvis' angle as pelvis), positive with the knee ahead? And is the ankle 0 at a right angle?"
            )
        walks = self._thigh[1] - self._thigh[0] > _TURNS
        both, hips, forces = (
            mean[f"{one} * {other}"] - mean[one] * mean[other]
            for one, other in (("hip", "forward"), ("hip", "hip"), ("forward", "forward"))
        )
        if walks and both > _FOLLOWS * math.sqrt(max(hips * forces, 0.0)):
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

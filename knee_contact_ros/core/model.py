"""The knee model: one tick after another, or a whole series at once, with the same bits."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from knee_contact_ros.core.contact_pairs.base import Closest, ContactPair
from knee_contact_ros.core.displacement import contact_at, follow
from knee_contact_ros.core.dynamics import Advance, FemurDynamics, Progress, Tick
from knee_contact_ros.core.integrators.base import NO_ERROR, FemurState
from knee_contact_ros.core.mechanisms.base import Mechanism
from knee_contact_ros.core.prescribed import Interval
from knee_contact_ros.core.regions import Regions
from knee_contact_ros.core.statics import static_contact
from knee_contact_ros.core.types import Contact, ContactState, Fidelity, Point, Status

NANOSECOND = 1e-9
INPUTS = "flexion_angle, load and femoral_height"
LARGEST_LOAD = 1e6
"""Load [N] beyond which a sample is a fault of its source and no knee's."""
LARGEST_ANGLE = 10.0
"""The same for the flexion angle [rad]."""
LARGEST_HEIGHT = 10.0
"""The same for a prescribed femoral height [m]."""


@dataclass(frozen=True)
class KneeModel:
    """One tibiofemoral compartment: a femoral surface over a tibial one under a contact law.

    The tibia frame is fixed: x anterior, y superior, z to the right, origin on the plateau. The femur turns by the
    flexion angle, is carried along x by the mechanism, and either moves freely along y under the load (the force drive)
    or is held at a prescribed height (the displacement drive). All methods are functions of their arguments: no clock,
    no file.
    """

    pair: ContactPair
    """The surfaces"""
    mechanism: Mechanism
    """Where the femoral reference point lies along x"""
    regions: Regions
    """The contact law, clamped or not"""
    mass: float
    """Of the femur [kg]"""
    cartilage_thickness: float
    """Depth [m] at which the second layer begins; infinite for a law with one layer"""
    tolerance: float
    """Wanted error of the penetration depth [m]"""
    budget: int
    """Contact law evaluations a tick may cost; 0: no limit"""
    height_prescribed: bool = False
    """Whether the femoral height is prescribed; else it follows from the load (Eq. 13)"""

    def stream(self) -> Stream:
        """Start a run that takes one tick at a time."""
        return Stream(self)

    def run(
        self, time: ArrayLike, flexion_angle: ArrayLike, load: ArrayLike, femoral_height: ArrayLike | None = None
    ) -> np.recarray[Any, Any]:
        """Run over a whole series.

        Args:
            time: Stamps [s], shape (n,), increasing; resolved to the nanosecond as ROS stamps are.
            flexion_angle: [rad], shape (n,), positive in flexion.
            load: Compressive load of the compartment [N], shape (n,), > 0 when it presses the femur onto the tibia.
                With the displacement drive it is only passed on to the answer.
            femoral_height: For the displacement drive, and only for it: height of the femoral reference point [m],
                shape (n,).

        Returns:
            Record array of shape (n,) with the fields of `KneeContact.msg`: `series.contact_force`,
            `series.contact_point.x` and so on. Bit for bit the records that `stream().tick` gives.

        Raises:
            ValueError: shapes differ, a value is not finite or is beyond `LARGEST_LOAD`, `LARGEST_ANGLE` or
                `LARGEST_HEIGHT`, time does not increase, or the drive and `femoral_height` do not go together.
        """
        given = (time, flexion_angle, load) if femoral_height is None else (time, flexion_angle, load, femoral_height)
        columns = [np.asarray(column, dtype=float) for column in given]
        if any(column.ndim != 1 or column.shape != columns[0].shape for column in columns):
            shapes = ", ".join(str(column.shape) for column in columns)
            raise ValueError(f"time, {INPUTS} must be one-dimensional and of equal length, got {shapes}")
        stream = self.stream()
        rows = [stream.tick(*row) for row in zip(*(column.tolist() for column in columns), strict=True)]
        return np.array(rows, dtype=SERIES_DTYPE).view(np.recarray)

    def contact(self, angle: float, load: float, advance: Advance) -> Contact:
        """Put the answer to a tick into the terms of the message."""
        depth = max(0.0, advance.depth)
        bone = max(0.0, depth - self.cartilage_thickness)
        state = ContactState.BONE if bone > 0.0 else ContactState.CARTILAGE if depth > 0.0 else ContactState.SEPARATED
        height = advance.progress.state.height
        missed = not advance.dynamic or advance.error_estimate > self.tolerance
        return Contact(
            flexion_angle=angle,
            load=load,
            contact_force=advance.force,
            penetration_depth=depth,
            gap=max(0.0, -advance.depth),
            penetration_rate=advance.rate,
            contact_point=self.contact_point(angle, height),
            femoral_height=height,
            cartilage_depth=depth - bone,
            bone_depth=bone,
            contact_state=int(state),
            fidelity=int(Fidelity.DYNAMIC if advance.dynamic else Fidelity.QUASI_STATIC),
            status=int(Status.NOT_CONVERGED if missed else Status.OK),
            error_estimate=advance.error_estimate,
            evaluations=advance.evaluations,
        )

    def closest(self, angle: float, height: float) -> Closest:
        """The common normal of femur and tibia at a flexion angle [rad] and femoral height [m]."""
        return self.pair.closest(angle, self.mechanism.translation(angle)[0], height)

    def contact_point(self, angle: float, height: float) -> Point:
        """Point of the tibia [m] in which the femur is deepest (when apart: the closest to it), tibia frame."""
        x, _ = self.mechanism.translation(angle)
        return Point(*self.pair.closest(angle, x, height).point(x, height), 0.0)


@dataclass
class Stream:
    """A run of a model, one tick at a time. The first tick is answered with the static solution."""

    model: KneeModel
    _progress: Progress | None = field(default=None, init=False)
    _last: tuple[int, float, float] = field(default=(0, 0.0, 0.0), init=False)

    def tick(self, time: float, flexion_angle: float, load: float, femoral_height: float | None = None) -> Contact:
        """Advance to `time` [s] and answer; angle [rad], load [N] and height [m] are linear since the previous tick.

        Raises:
            ValueError: a value is not finite or too large, time is not later than at the previous tick, or the drive
                and `femoral_height` do not go together.
        """
        height = 0.0 if femoral_height is None else femoral_height
        if not all(map(math.isfinite, (time, flexion_angle, load, height))):
            raise ValueError(f"time, {INPUTS} must be finite, got {time}, {flexion_angle}, {load}, {femoral_height}")
        if abs(flexion_angle) > LARGEST_ANGLE or abs(load) > LARGEST_LOAD or abs(height) > LARGEST_HEIGHT:
            limits = f"{LARGEST_ANGLE:g} rad, {LARGEST_LOAD:g} N and {LARGEST_HEIGHT:g} m"
            raise ValueError(f"{INPUTS} must not exceed {limits}, got {flexion_angle}, {load}, {femoral_height}")
        return self.tick_ns(round(time / NANOSECOND), flexion_angle, load, femoral_height)

    def tick_ns(self, stamp: int, flexion_angle: float, load: float, femoral_height: float | None = None) -> Contact:
        """The same with the time as an integer stamp [ns]."""
        if self.model.height_prescribed != (femoral_height is not None):
            needs = "needs a femoral_height" if self.model.height_prescribed else "takes no femoral_height"
            raise ValueError(f"drive {'displacement' if self.model.height_prescribed else 'force'} {needs}")
        if self._progress is None:
            advance = self._start(flexion_angle, load, femoral_height)
        else:
            interval = self._interval(stamp, flexion_angle, load)
            advance = self._advance(self._progress, interval, femoral_height)
        self._progress = advance.progress
        self._last = (stamp, flexion_angle, load)
        return self.model.contact(flexion_angle, load, advance)

    def _start(self, angle: float, load: float, femoral_height: float | None) -> Advance:
        """Contact at rest: under the load, or at the prescribed height; the penetration rate is 0."""
        model = self.model
        touch = model.pair.touch(angle, 0.0, model.mechanism.translation(angle)[0], 0.0)
        if femoral_height is not None:
            depth = touch(femoral_height)[0]
            state, impact_speed = FemurState(femoral_height, 0.0), 0.0 if depth > 0.0 else None
            return contact_at(model.regions.after_impact(0.0), state, depth, 0.0, impact_speed)
        static = static_contact(model.regions.law, touch, load)
        return Advance(
            progress=Progress(FemurState(static.height, math.nan), NO_ERROR, math.inf, 0.0),
            depth=static.depth,
            rate=0.0,
            force=static.force,
            error_estimate=0.0,
            evaluations=static.evaluations,
            dynamic=True,
        )

    def _interval(self, stamp: int, angle: float, load: float) -> Interval:
        """From the previous tick to this one."""
        last_stamp, last_angle, last_load = self._last
        if stamp <= last_stamp:
            raise ValueError(f"time must increase: {stamp} ns after {last_stamp} ns")
        duration = (stamp - last_stamp) * NANOSECOND
        return Interval(
            pair=self.model.pair,
            mechanism=self.model.mechanism,
            duration=duration,
            angle=last_angle,
            angle_rate=(angle - last_angle) / duration,
            start_load=last_load,
            load_rate=(load - last_load) / duration,
        )

    def _advance(self, progress: Progress, interval: Interval, femoral_height: float | None) -> Advance:
        model = self.model
        if femoral_height is not None:
            return follow(model.regions, interval, progress, femoral_height)
        height, velocity = progress.state
        if math.isnan(velocity):  # the static start: the femur follows its turning surface
            _, rate, cosine = interval.touch(0.0)(height)
            progress = progress._replace(state=FemurState(height, rate / cosine))
        scene = FemurDynamics(model.regions, model.mass, model.tolerance, model.budget)
        return Tick(scene, interval, progress).advance()


POINT_DTYPE = np.dtype([(axis, np.float64) for axis in Point._fields])
INTEGER_FIELDS = {
    "contact_state": np.uint8,
    "fidelity": np.uint8,
    "status": np.uint8,
    "evaluations": np.uint32,
}
SERIES_DTYPE = np.dtype(
    [
        (name, POINT_DTYPE if name == "contact_point" else INTEGER_FIELDS.get(name, np.float64))
        for name in Contact._fields
    ]
)
"""One row of `KneeModel.run`."""

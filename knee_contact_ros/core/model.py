"""The knee model: one tick after another, or a whole series at once, with the same bits."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from knee_contact_ros.core.dynamics import Advance, FemurDynamics, Progress, Tick
from knee_contact_ros.core.geometries.base import FemoralGeometry
from knee_contact_ros.core.integrators.base import NO_ERROR, FemurState
from knee_contact_ros.core.prescribed import Interval
from knee_contact_ros.core.regions import Regions
from knee_contact_ros.core.statics import static_depth
from knee_contact_ros.core.types import Contact, ContactState, Fidelity, Point, Status

NANOSECOND = 1e-9
LARGEST_LOAD = 1e6
"""Load [N] beyond which a sample is a fault of its source and no knee's."""
LARGEST_ANGLE = 10.0
"""The same for the flexion angle [rad]."""


@dataclass(frozen=True)
class KneeModel:
    """One tibiofemoral compartment: a femoral geometry on a plateau under a contact law.

    The tibia frame is fixed: x anterior, y superior, z to the right, origin on the plateau. The femur turns by the
    flexion angle and moves freely along y only. All methods are functions of their arguments: no clock, no file.
    """

    geometry: FemoralGeometry
    regions: Regions
    """The contact law, clamped or not"""
    mass: float
    """Of the femur [kg]"""
    plateau_slope: float
    """Slope of the plateau [rad], > 0 when its anterior edge is the higher one"""
    cartilage_thickness: float
    """Depth [m] at which the second layer begins; infinite for a law with one layer"""
    tolerance: float
    """Wanted error of the penetration depth [m]"""
    budget: int
    """Contact law evaluations a tick may cost; 0: no limit"""

    def stream(self) -> Stream:
        """Start a run that takes one tick at a time."""
        return Stream(self)

    def run(self, time: ArrayLike, flexion_angle: ArrayLike, load: ArrayLike) -> np.recarray[Any, Any]:
        """Run over a whole series.

        Args:
            time: Stamps [s], shape (n,), increasing; resolved to the nanosecond as ROS stamps are.
            flexion_angle: [rad], shape (n,), positive in flexion.
            load: Compressive load of the compartment [N], shape (n,), > 0 when it presses the femur onto the tibia.

        Returns:
            Record array of shape (n,) with the fields of `KneeContact.msg`: `series.contact_force`,
            `series.contact_point.x` and so on. Bit for bit the records that `stream().tick` gives.

        Raises:
            ValueError: shapes differ, a value is not finite or is beyond `LARGEST_LOAD` or `LARGEST_ANGLE`, or time
                does not increase.
        """
        columns = [np.asarray(column, dtype=float) for column in (time, flexion_angle, load)]
        if any(column.ndim != 1 or column.shape != columns[0].shape for column in columns):
            shapes = ", ".join(str(column.shape) for column in columns)
            raise ValueError(f"time, flexion_angle and load must be one-dimensional and of equal length, got {shapes}")
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

    def contact_point(self, angle: float, height: float) -> Point:
        """Foot of the femur's lowest point on the plateau [m], tibia frame."""
        _, slope = self.geometry.support(angle - self.plateau_slope)
        along = height * math.sin(self.plateau_slope) - slope
        return Point(along * math.cos(self.plateau_slope), along * math.sin(self.plateau_slope), 0.0)


@dataclass
class Stream:
    """A run of a model, one tick at a time. The first tick is answered with the static solution."""

    model: KneeModel
    _progress: Progress | None = field(default=None, init=False)
    _last: tuple[int, float, float] = field(default=(0, 0.0, 0.0), init=False)

    def tick(self, time: float, flexion_angle: float, load: float) -> Contact:
        """Advance to `time` [s] and answer; angle [rad] and load [N] are linear since the previous tick.

        Raises:
            ValueError: a value is not finite or too large, or time is not later than at the previous tick.
        """
        if not (math.isfinite(time) and math.isfinite(flexion_angle) and math.isfinite(load)):
            raise ValueError(f"time, flexion_angle and load must be finite, got {time}, {flexion_angle}, {load}")
        if abs(flexion_angle) > LARGEST_ANGLE or abs(load) > LARGEST_LOAD:
            limits = f"{LARGEST_ANGLE:g} rad and {LARGEST_LOAD:g} N"
            raise ValueError(f"flexion_angle and load must not exceed {limits}, got {flexion_angle}, {load}")
        return self.tick_ns(round(time / NANOSECOND), flexion_angle, load)

    def tick_ns(self, stamp: int, flexion_angle: float, load: float) -> Contact:
        """The same with the time as an integer stamp [ns]."""
        if self._progress is None:
            advance = self._start(flexion_angle, load)
        else:
            advance = self._advance(self._progress, stamp, flexion_angle, load)
        self._progress = advance.progress
        self._last = (stamp, flexion_angle, load)
        return self.model.contact(flexion_angle, load, advance)

    def _start(self, angle: float, load: float) -> Advance:
        """Static solution: F(δ₀, 0) = L; the penetration rate is 0."""
        model = self.model
        cosine = math.cos(model.plateau_slope)
        static = static_depth(model.regions.law, load / cosine)
        surface, _ = model.geometry.support(angle - model.plateau_slope)
        height = (surface - static.depth) / cosine
        return Advance(
            progress=Progress(FemurState(height, math.nan), NO_ERROR, math.inf),
            depth=static.depth,
            rate=0.0,
            force=model.regions.law.static_force(static.depth),
            error_estimate=0.0,
            evaluations=static.evaluations + (static.depth > 0.0),
            dynamic=True,
        )

    def _advance(self, progress: Progress, stamp: int, angle: float, load: float) -> Advance:
        model = self.model
        last_stamp, last_angle, last_load = self._last
        if stamp <= last_stamp:
            raise ValueError(f"time must increase: {stamp} ns after {last_stamp} ns")
        duration = (stamp - last_stamp) * NANOSECOND
        interval = Interval(
            geometry=model.geometry,
            duration=duration,
            angle=last_angle - model.plateau_slope,
            angle_rate=(angle - last_angle) / duration,
            start_load=last_load,
            load_rate=(load - last_load) / duration,
        )
        cosine = math.cos(model.plateau_slope)
        if math.isnan(progress.state.velocity):  # the static start: the femur follows its turning surface
            velocity = interval.surface(0.0)[1] / cosine
            progress = progress._replace(state=FemurState(progress.state.height, velocity))
        scene = FemurDynamics(model.regions, model.mass, cosine, model.tolerance, model.budget)
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

"""The knee model: tick by tick or a whole series at once, with the same bits."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from operator import index
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import run_state, ticks
from .arrays import InputError, check_answers, plain_array
from .contact import KneeConstants
from .inputs import MOST_PLAUSIBLE_LOAD, InputCheck
from .kernel import Kernel
from .laws import ContactLaw, check
from .lost_state import LEAST_LOST_SPEED, throw_lost
from .readouts import ContactPatch, Readings, load_uncertainty
from .ringing import Ringing
from .statics import plain_static_depth
from .surfaces import ContactPair
from .types import (
    MAX_SURFACE_GAP,
    NANOSECOND,
    ROW,
    Contact,
    Floats,
    Rows,
    Stamps,
    Status,
    blank_answers,
)

_SAMPLE = ("flexion_angle", "load", "femoral_height")
"""Names of the numbers of a sample, in messages"""
LARGEST_TIME = 9e9
"""Time [s] beyond which integer nanoseconds do not reach: 285 years."""
LARGEST_LOAD = 1e6
"""Load [N] above which a sample must be a fault of its source."""
LARGEST_ANGLE = 10.0
"""Flexion angle [rad] above which a sample must be a fault of its source."""
LARGEST_HEIGHT = 10.0
"""Prescribed femoral height [m] above which a sample must be a fault of its source."""
BUDGET = 20_000
"""Default of the largest number of evaluations in a tick"""
MOST_BUDGET = 100_000
"""Largest number of evaluations in a tick if the budget is 0"""
_SAMPLE_LAYOUT = Struct("4d")
"""Writes a row of `samples`, in a quarter of the time that NumPy takes"""
_STAMP_LAYOUT = Struct("q")
"""Writes the stamp of an answer, likewise"""
_PLAUSIBLE_SHARE = 0.2
"""Fraction of the femoral radius above which a depth is implausible: 6.8 mm of 34 mm, that is 4 mm of cartilage pressed
flat and nearly as much bone. Contact laws are valid for depths that are small compared with the radius."""


@dataclass(frozen=True, repr=False)
class KneeModel:
    """One tibiofemoral compartment: a femoral surface over a tibial one under a contact law.

    The tibia frame is fixed: x anterior, y superior, z to the right, origin on the plateau. The femur rotates by the
    flexion angle, and the mechanism moves it along x. Along y it either moves freely under the load (the force drive)
    or is held at a prescribed height (the displacement drive). All methods depend only on their arguments: no clock,
    no file.

    Example:
        >>> from knee_contact_ros import load_model
        >>> knee = load_model()
        >>> print(f"{1e3 * knee.static_depth(800.0):.3f} mm")
        0.468 mm
    """

    pair: ContactPair
    """The femoral and the tibial surface, and the mechanism that prescribes where the femur lies along the tibia's x"""
    law: ContactLaw
    mass: float
    """Mass of the femur [kg]"""
    tolerance: float = 1e-6
    """Tolerated error of the penetration depth [m]"""
    budget: int = BUDGET
    """Largest number of evaluations of the contact in a tick, probes of its flights included; 0: 100 000"""
    force_tolerance: float = 0.0
    """Tolerated error of the contact force [N]; 0: no limit"""
    allow_tension: bool = False
    """Whether the law may pull; else its force is clamped at 0"""
    height_prescribed: bool = False
    """Whether the femoral height is prescribed; else it follows from the load (Eq. 13)"""
    level: int = ticks.DYNAMIC
    """The equations that a tick solves, a value of `LEVELS`; has no effect where the height is prescribed"""
    compiled: bool | None = False
    """Whether the library computes, or, if this is False, the plain model. Both give the same bits."""
    patch: ContactPatch | None = None
    """The patch that the contact spreads over, for `readouts`; None if the radii in `contact.*` do not fit together"""
    results: type[np.recarray[Any, Any]] = np.recarray
    """Class of the record array that a run returns; it may add methods (`knee_contact_ros.results`)"""

    def __post_init__(self) -> None:
        """Check the formulas of the contact law that are not shipped ones.

        Raises:
            ValueError: the law does not fulfil what `ContactLaw` requires.
        """
        check(self.law)

    def __repr__(self) -> str:
        return f"<KneeModel: {self.description}>"

    @property
    def description(self) -> str:
        """Surfaces, mechanism, law and drive of the model, in one line for a person."""
        drive = "displacement drive" if self.height_prescribed else "force drive"
        layers = (f"{each.stiffness:.4g} N/m^{each.exponent:g}" for each in self.law.layers)
        return f"{self.pair}, contact law {' + '.join(layers)}, {drive}"

    @property
    def plausible_depth(self) -> float:
        """Depth [m] above which an answer is `IMPLAUSIBLE`: a fraction of the radius, at most the law's thickness."""
        return min(_PLAUSIBLE_SHARE * self.pair.femoral_radius, self.law.thickness)

    @property
    def cartilage_thickness(self) -> float:
        """Depth [m] at which the second layer begins; infinite for a law with one layer."""
        layers = self.law.layers
        return layers[1].begin if len(layers) > 1 else math.inf

    @cached_property
    def constants(self) -> KneeConstants:
        """The model in the form that the kernel takes: numbers, arrays and named tuples."""
        return KneeConstants(
            surfaces=self.pair.surfaces,
            law=self.law.rows,
            mass=float(self.mass),
            per_mass=1.0 / self.mass,
            tolerance=float(self.tolerance),
            force_tolerance=float(self.force_tolerance),
            budget=int(self.budget) or MOST_BUDGET,
            level=ticks.PRESCRIBED_HEIGHT if self.height_prescribed else int(self.level),
            allow_tension=bool(self.allow_tension),
            remembers_impact=self.law.remembers_impact,
            plausible_depth=float(self.plausible_depth),
        )

    @cached_property
    def kernel(self) -> Kernel:
        """What computes the ticks: the library, or the plain model; both give the same bits."""
        return Kernel(self.constants, compiled=self.compiled is not False)

    def compute(self, samples: Floats, answers: Rows, state: Floats | None = None) -> None:
        """Compute a run, or continue one, into rows of answers, without checks; see `ticks.run`.

        `samples` has shape (n, 4): time since the last tick [s], flexion angle [rad], load [N] and prescribed height
        [m] or NaN. Stamps and latencies of `answers` are left as they are.
        """
        state = np.zeros(run_state.STATE_SIZE) if state is None else state
        self.kernel.bind(state, np.ascontiguousarray(samples), answers)()

    def stream(self) -> Stream:
        """Start a run that is given one tick at a time.

        Example:
            >>> from knee_contact_ros import load_model
            >>> load_model().stream()
            <Stream no tick yet: circle on plane, hinge, contact law 7.906e+07 N/m^1.5, force drive>
        """
        return Stream(self)

    def run(
        self,
        time: ArrayLike,
        flexion_angle: ArrayLike,
        load: ArrayLike,
        femoral_height: ArrayLike | None = None,
    ) -> np.recarray[Any, Any]:
        """Compute the answers to a whole series of samples.

        Args:
            time: Stamps [s], shape (n,), increasing; resolved to the nanosecond as ROS stamps are.
            flexion_angle: [rad], shape (n,), positive in flexion.
            load: Compressive load of the compartment [N], shape (n,), > 0 when it presses the femur onto the tibia.
                With the displacement drive it is only passed on to the answer.
            femoral_height: For the displacement drive, and only for it: height of the femoral reference point [m],
                shape (n,).

        Returns:
            Record array of shape (n,) with the fields of `Contact`: `series.contact_force`, `series.contact_point.x`
            and so on; with `load_model`'s models, `Results`. Bit for bit the records that `stream().tick` gives.

        Implausible angles, loads or times (degrees instead of radians, a load of the wrong sign) cause a warning.

        Raises:
            ValueError: shapes differ, a value is masked, is not finite or is beyond `LARGEST_LOAD`, `LARGEST_ANGLE` or
                `LARGEST_HEIGHT`, time does not increase, or `femoral_height` does not fit the drive.

        Example:
            >>> from knee_contact_ros import load_model
            >>> knee = load_model()
            >>> answers = knee.run([0.0, 0.01, 0.02], [0.30, 0.32, 0.34], [700.0, 800.0, 900.0])
            >>> answers.contact_force.round(1)
            array([700. , 801.7, 900.1])
        """
        given = [time, flexion_angle, load]
        if femoral_height is not None:
            given.append(femoral_height)
        names = f"time, {_listed(_SAMPLE[: len(given) - 1])}"
        columns = [plain_array(names, column, None) for column in given]
        times, angles, loads, *heights = columns
        if any(column.ndim != 1 or column.shape != times.shape for column in columns):
            shapes = ", ".join(str(column.shape) for column in columns)
            raise InputError(f"{names} must be one-dimensional and of equal length, got {shapes}")
        stamps = np.rint(times / NANOSECOND)
        if not (np.abs(times) < LARGEST_TIME).all() or (np.diff(stamps) <= 0.0).any():
            raise InputError(f"time must be finite, below {LARGEST_TIME:g} s, and increase")
        height = heights[0] if heights else None
        answers = self.stream().advance_all(stamps.astype(np.int64), angles, loads, height)
        inputs = InputCheck(load_driven=not heights, compression="load > 0")
        if len(answers):
            inputs.add_samples(answers["stamp"], angles, loads)
        for sentence in inputs.sentences:
            warnings.warn(sentence, stacklevel=2)
        series: np.recarray[Any, Any] = answers.view(self.results)
        if hasattr(series, "model"):
            series.model = self  # type: ignore[assignment]  # an attribute of Results
        return series

    def readouts(self, answers: Rows) -> Readings:
        """Compute contact patch, pressure, strain and loading rate from answers of this model.

        Args:
            answers: Shape (n,), in their order in time: what `run` returns, or joined answers of a stream.

        Returns:
            Record array of shape (n,) with the fields of `READOUTS`: `half_width` [m], `mean_pressure` and
            `peak_pressure` [Pa], `strain` and `loading_rate` [N/s]; see `ContactPatch.readouts`.

        Raises:
            ValueError: `contact.femoral_radius` is not below `contact.tibial_radius`, so that there is no patch.

        Example:
            >>> from knee_contact_ros import load_model
            >>> knee = load_model()
            >>> answers = knee.run([0.0, 0.01, 0.02], [0.30, 0.32, 0.34], [700.0, 800.0, 900.0])
            >>> (1e-6 * knee.readouts(answers).peak_pressure).round(1)
            array([14.7, 15.3, 15.9])
        """
        if self.patch is None:
            raise ValueError(
                "no readouts: contact.femoral_radius must be below contact.tibial_radius"
            )
        fields = ("stamp", "status", "contact_state", "contact_force", "cartilage_depth")
        return self.patch.readouts(self.law, check_answers(answers, "penetration_depth", *fields))

    def uncertainty(self, answers: Rows, load_deviation: Any) -> Readings:
        """Compute the uncertainty of force and depth that follows from the load's, from answers of this model.

        It is of first order and cheap: 40 us for a tick of a stream, 1.5 us for one of many. `error_estimate` says how
        accurately the model is solved; this says how well the knee is known. Parameters and shares are uncertain too
        (`knee_contact_ros.uncertainty`).

        Args:
            answers: Shape (n,): what `run` returns, or ticks of a stream in an array.
            load_deviation: Standard deviation of the compartment's `load` [N], a number or shape (n,). For an estimated
                load it is `standard_deviation` of `LoadEstimate` times the compartment's share. NaN where it is not
                known; the result is NaN there.

        Returns:
            Record array of shape (n,) with the standard deviations `contact_force` [N] and `penetration_depth` [m].

        Raises:
            ValueError: a standard deviation is negative.

        Example:
            >>> from knee_contact_ros import load_model
            >>> knee = load_model()
            >>> answers = knee.run([0.0, 0.01, 0.02], [0.30, 0.32, 0.34], [700.0, 800.0, 900.0])
            >>> (1e6 * knee.uncertainty(answers, load_deviation=50.0).penetration_depth).round(1)
            array([20.4, 19.7, 18.9])
        """
        known = check_answers(answers, "load", "contact_force", "penetration_depth")
        given = plain_array("load_deviation", load_deviation, None)
        if given.ndim and given.shape != known.shape:
            raise InputError(f"load_deviation must have shape {known.shape}, got {given.shape}")
        return load_uncertainty(self.law, known, given)

    def ringing(self, answers: Rows) -> Floats:
        """Compute how far the contact force of answers of this model rings [N], shape (n,), in their order in time.

        It is the contact force minus that of the same knee with a dashpot. 0 where all layers are damped.

        Example:
            >>> from knee_contact_ros import load_model, solve
            >>> gait = solve("bags/gait2354_right")
            >>> printed = load_model("osteoarthritis_as_printed")
            >>> answers = printed.run(gait.time, gait.flexion_angle, gait.load)
            >>> print(f"{abs(printed.ringing(answers)).max():.0f} N")
            39 N
        """
        fields = ("contact_force", "stamp", "flexion_angle", "load", "status")
        return Ringing(self).add_answers(check_answers(answers, *fields))

    def check_drive(self, height_given: bool) -> None:
        """Reject a series that does not fit the drive.

        Raises:
            ValueError: a femoral height is needed but not given, or given but not needed.
        """
        if self.height_prescribed != height_given:
            if self.height_prescribed:
                raise ValueError("drive displacement needs a femoral_height")
            raise ValueError("drive force takes no femoral_height")

    def static_depth(self, load: float) -> float:
        """Return the depth [m] at which the law at rest carries a normal force [N]."""
        return plain_static_depth(self.law.rows, load)


@dataclass(repr=False)
class Stream:
    """A run of a model, tick by tick. The answer to the first tick is the static solution.

    Example:
        >>> from knee_contact_ros import load_model
        >>> stream = load_model().stream()
        >>> for time, angle, load in ((0.0, 0.30, 700.0), (0.01, 0.32, 800.0)):
        ...     print(f"{1e3 * stream.tick(time, angle, load).penetration_depth:.3f} mm")
        0.428 mm
        0.460 mm
    """

    model: KneeModel
    answer: Rows = field(init=False)
    """Answer to the last tick, shape (1,); the next tick overwrites it"""

    def __post_init__(self) -> None:
        self.answer = blank_answers(1)
        self._stamp_bytes = self.answer["stamp"].data.cast("B")
        self.latency = self.answer["latency"]
        """The `latency` field of `answer` [s], shape (1,), for callers that measure it"""
        self._stamp: int | None = None
        self._height_prescribed = self.model.height_prescribed
        self._state = np.zeros(run_state.STATE_SIZE)
        self._sample = np.zeros((1, 4))
        self._sample_bytes = self._sample.data.cast("B")
        self._compute = self.model.kernel.bind(self._state, self._sample, self.answer)

    def __repr__(self) -> str:
        at = "no tick yet" if self._stamp is None else f"at {self._stamp * NANOSECOND:.9g} s"
        return f"<Stream {at}: {self.model.description}>"

    def continue_with(self, model: KneeModel) -> None:
        """Continue the run with another model of the same drive, from the present state instead of from rest.

        A quasi-static model is always at the static contact of its own law. Its distance from the present state is an
        error of the next answers until it has decayed.
        """
        before, self.model = self.model, replace(model, compiled=self.model.compiled)
        state = self._state
        self._compute = self.model.kernel.bind(state, self._sample, self.answer)
        if state[run_state.AT_BEGUN] == 0.0 or self._height_prescribed:
            return
        state[run_state.AT_TRY_STEP] = math.inf
        angle, height = float(state[run_state.AT_ANGLE]), float(state[run_state.AT_HEIGHT])
        if state[run_state.AT_LOST_SPEED] > 0.0:
            depth = model.pair.closest(angle, height).depth
            same = model.law == before.law and model.mass == before.mass
            if not same or depth != before.pair.closest(angle, height).depth:
                throw_lost(state, model.law.rows, depth, model.mass, before.mass)
        if self.model.constants.level == ticks.QUASI_STATIC:
            rest = np.zeros(run_state.STATE_SIZE)
            sample = np.array([[0.0, angle, state[run_state.AT_LOAD], math.nan]])
            replace(self.model, budget=MOST_BUDGET).compute(sample, blank_answers(1), rest)
            moved = rest[run_state.AT_HEIGHT] - height
            state[run_state.AT_HEIGHT_ERROR] += moved
            if state[run_state.AT_LOST_SPEED] > 0.0:
                state[run_state.AT_LOST_DISTANCE] += abs(moved)
            for place in (run_state.AT_HEIGHT, run_state.AT_STIFFNESS, run_state.AT_DAMPING):
                state[place] = rest[place]

    def state(self) -> Floats:
        """Return the state after the last tick, as `resume` takes it."""
        return self._state.copy()

    def resume(self, stamp: int, state: Sequence[float]) -> None:
        """Continue from the `state` of another stream of this model, after its tick at a stamp [ns].

        Raises:
            ValueError: it is not the state of a run of this version.
        """
        if len(state) != run_state.STATE_SIZE or state[run_state.AT_BEGUN] != 1.0:
            raise ValueError(f"a run has {run_state.STATE_SIZE} numbers, and has begun")
        self._state[:] = state
        self._stamp = stamp

    def mark_state_lost(self) -> None:
        """Declare the state after the first tick unknown: answers are `NOT_CONVERGED` until the contact forgets it.

        This is for a run that begins in the middle of a motion, and so not at rest.
        """
        # The femur may just have been thrown by what a contact under any load of a knee had stored.
        load = max(float(self.answer["load"][0]), MOST_PLAUSIBLE_LOAD)
        depth = min(self.model.static_depth(load), self.model.plausible_depth)
        stored = depth * self.model.law.static_force(depth)
        self._state[run_state.AT_LOST_SPEED] = (
            math.sqrt(2.0 * stored / self.model.mass) + LEAST_LOST_SPEED
        )
        self._state[run_state.AT_LOST_DISTANCE] = self.answer["error_estimate"][0] = (
            self.model.plausible_depth + MAX_SURFACE_GAP
        )
        self.answer["status"] |= int(Status.NOT_CONVERGED)

    def tick(
        self, time: float, flexion_angle: float, load: float, femoral_height: float | None = None
    ) -> Contact:
        """Advance to `time` [s] and answer; angle [rad], load [N] and height [m] are linear since the previous tick.

        Raises:
            ValueError: a value is not finite or too large, time is not later than at the previous tick, or
                `femoral_height` does not fit the drive.

        Example:
            >>> from knee_contact_ros import load_model
            >>> load_model().stream().tick(time=0.0, flexion_angle=0.3, load=800.0).contact_force
            800.0
        """
        if not isinstance(time, Real):
            raise InputError("time must be a number")
        if not abs(time) < LARGEST_TIME:
            raise InputError(f"time must be finite and below {LARGEST_TIME:g} s, got {time}")
        self.advance(round(time / NANOSECOND), flexion_angle, load, femoral_height)
        # A copy of the row would leave out its padding; these are all its bytes.
        contact: Contact = np.frombuffer(self.answer.tobytes(), ROW)[0]
        return contact

    def advance(
        self, stamp: int, flexion_angle: float, load: float, femoral_height: float | None = None
    ) -> None:
        """Advance to an integer stamp [ns] and leave the answer in `answer`, which is faster than returning a copy.

        Example:
            >>> from knee_contact_ros import load_model
            >>> stream = load_model().stream()
            >>> stream.advance(5_000_000, 0.3, 800.0)
            >>> stream.answer["contact_force"]
            array([800.])
        """
        if self._height_prescribed or femoral_height is not None:
            self.model.check_drive(femoral_height is not None)
        height = math.nan if femoral_height is None else femoral_height
        try:
            stamp = index(stamp)
            allowed = -LARGEST_ANGLE <= flexion_angle <= LARGEST_ANGLE
            allowed = allowed and -LARGEST_LOAD <= load <= LARGEST_LOAD
            allowed = allowed and (femoral_height is None or abs(height) <= LARGEST_HEIGHT)
        except (TypeError, ValueError):
            raise InputError("time, flexion_angle, load and height must be numbers") from None
        if not allowed:
            _refuse(flexion_angle, load, femoral_height)
        last = self._stamp
        if last is None:
            duration = 0.0
        elif stamp > last:
            duration = (stamp - last) * NANOSECOND
        else:
            raise InputError(f"time must increase: {stamp} ns after {last} ns")
        _STAMP_LAYOUT.pack_into(self._stamp_bytes, 0, stamp)
        _SAMPLE_LAYOUT.pack_into(self._sample_bytes, 0, duration, flexion_angle, load, height)
        self._compute()
        self._stamp = stamp

    def advance_all(
        self, stamps: Stamps, angles: Floats, loads: Floats, heights: Floats | None
    ) -> Rows:
        """Advance through many ticks and return their answers, shape (n,).

        Stamps [ns], angles [rad], loads [N] and heights [m] have shape (n,); heights are None for the force drive.

        Raises:
            ValueError: as `advance`.
        """
        _check_limits([angles, loads] if heights is None else [angles, loads, heights])
        self.model.check_drive(heights is not None)
        steps = np.diff(stamps, prepend=stamps[:1] if self._stamp is None else self._stamp)
        first = 1 if self._stamp is None else 0
        if (steps[first:] <= 0).any():
            raise ValueError("time must increase")
        height = np.full(len(stamps), math.nan) if heights is None else heights
        samples = np.column_stack([steps * NANOSECOND, angles, loads, height])
        answers = blank_answers(len(stamps))
        answers["stamp"] = stamps
        self.model.compute(samples, answers, self._state)
        if len(stamps):
            self._stamp = int(stamps[-1])
        return answers


def _check_limits(columns: list[Floats]) -> None:
    """Reject columns with a value beyond its limit.

    Raises:
        ValueError: see `_refuse`.
    """
    limits = (LARGEST_ANGLE, LARGEST_LOAD, LARGEST_HEIGHT)
    bad = np.zeros(len(columns[0]), dtype=bool)
    for column, limit in zip(columns, limits, strict=False):
        bad |= ~(np.abs(column) <= limit)
    if bad.any():
        row = [float(column[bad][0]) for column in columns]
        _refuse(row[0], row[1], row[2] if len(row) > 2 else None)


def _refuse(angle: float, load: float, height: float | None) -> None:
    """Reject the values of a sample, with a message that says why.

    Raises:
        ValueError: always.
    """
    given = [value for value in (angle, load, height) if value is not None]
    names = _listed(_SAMPLE[: len(given)])
    got = ", ".join(map(str, given))
    if not all(map(math.isfinite, given)):
        raise InputError(f"{names} must be finite, got {got}")
    limits = f"{LARGEST_ANGLE:g} rad", f"{LARGEST_LOAD:g} N", f"{LARGEST_HEIGHT:g} m"
    listed = _listed(limits[: len(given)])
    raise InputError(f"{names} must not exceed {listed}, got {got}{degrees_hint(angle)}")


def _listed(words: Sequence[str]) -> str:
    """List at least two words, the last one after an "and"."""
    return f"{', '.join(words[:-1])} and {words[-1]}"


def degrees_hint(angle: float) -> str:
    """Hint for the message that refuses an angle; empty if the angle is not refused for its size."""
    return "; is it in degrees?" if LARGEST_ANGLE < abs(angle) < math.inf else ""

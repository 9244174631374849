"""Smooth ticks of several knees at once, by the processor's vector instructions, with the bits of `ticks.run`.

Beginning, step and end of a smooth tick (`core/levels/smooth.py`) have hardly a branch. Here each is a loop over lanes
with a knee in each, which LLVM turns into vector instructions; the operations of a lane are those of one knee, in their
order. A lane whose tick is not smooth, or not plainly so, stays at the tick's beginning, and `ticks.run` computes it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from numba import config, types
from numba.extending import register_jitable

from knee_contact_ros.compiled.functions import APART, INLINE, compiled_function
from knee_contact_ros.compiled.scene_memory import run_at, scene_at, size_of
from knee_contact_ros.compiled.source_meaning import digest
from knee_contact_ros.compiled.transposed import LANES, Transposed, numba_type_of, transposed
from knee_contact_ros.core.contact_modes import ContactMode
from knee_contact_ros.core.contact_pairs.on_plane import OnPlane
from knee_contact_ros.core.geometries.circle import Circle
from knee_contact_ros.core.integrators.fehlberg import EVALUATIONS
from knee_contact_ros.core.levels.advance import goes_straight_to_dynamic
from knee_contact_ros.core.levels.smooth import SmoothTick, begin_smooth, end_smooth, step_smooth
from knee_contact_ros.core.mechanisms.hinge import Hinge
from knee_contact_ros.core.prescribed import Interval
from knee_contact_ros.core.scene import AUTO, DYNAMIC, RunState, Scene, TickResult
from knee_contact_ros.core.ticks import MEMORY, interval_between, is_calm, read_run_state, write_answer, write_run_state
from knee_contact_ros.core.types import ROW

_Function = TypeVar("_Function", bound=Callable[..., Any])

EXPONENT = 1.5
"""Exponent of contact laws that use a square root; there are no vector instructions for powers"""
KEPT, ANSWER = MEMORY.itemsize, ROW.itemsize
"""Sizes [B] of a run's memory and of an answer"""


class LanesKernel(NamedTuple):
    """A kernel that computes knees of a kind in lanes."""

    rows: int
    """Number of rows of the memory that it works in"""
    through: Callable[..., None]
    """Computes the knees of some numbers, given also that memory, `OneTick` and an array for seven addresses"""


class OneTick(NamedTuple):
    """Addresses that a tick needs which is not smooth: of the kernel, and of the arrays of its arguments."""

    run: int
    scenes: int
    memory: int
    durations: int
    angles: int
    loads: int
    heights: int
    answers: int


class Tick(NamedTuple):
    """Inputs of a tick that all lanes have in common."""

    duration: float
    """Time since the tick before [s]"""
    last_angle: float
    """Flexion angle at the tick before [rad]"""
    angle: float
    """Flexion angle [rad]"""


class Lane(NamedTuple):
    """Inputs and state of a tick in one lane, beside scene and run state."""

    last_load: float
    """Load at the tick before [N]"""
    load: float
    """Load [N]"""
    behind: int
    """Number of ticks in the knee's backlog"""
    smooth: bool
    """Whether the tick is smooth so far"""


class Places(NamedTuple):
    """Where the parts of all lanes lie in memory."""

    kind: str
    """Digest of the kind of scene"""
    scene: Transposed
    lane: Transposed
    so_far: Transposed
    result: Transposed
    run_state: Transposed
    """The first field of the result: a tick begins where the one before has ended"""


def fits(scene: Scene) -> bool:
    """Whether a knee can be computed in a lane: its contact needs no search, no table and no power.

    None can where Numba has found Intel's SVML: then vectors have another exponential function, with other last bits.
    """
    pair, layers = scene.pair, scene.modes.law.layers
    in_closed_form = isinstance(pair, OnPlane) and isinstance(pair.femur, Circle) and isinstance(scene.mechanism, Hinge)
    formula = layers[0].formula
    by_root = getattr(formula, "exponent", EXPONENT) == EXPONENT and not formula.remembers_impact()
    dynamic = scene.level in (AUTO, DYNAMIC) and scene.budget == 0
    return in_closed_form and len(layers) == 1 and by_root and dynamic and not config.USING_SVML


@functools.cache
def lanes_kernel(kind: types.Type) -> LanesKernel:
    """Compile the kernel for those knees of a kind that fit into lanes."""
    read_scene, places, size = scene_at(kind), _places(kind), size_of(kind)
    put_scene, put_lane, lane_in = places.scene.put, places.lane.put, places.lane.get
    smooth_ticks, answer = _smooth_ticks(places), _answer(places)

    def through(
        numbers: Any, durations: Any, angles: Any, loads: Any, memory: Any, answers: Any, rows: int, one_tick: OneTick,
        addresses: Any,
    ) -> None:  # fmt: skip
        for first in range(0, len(numbers), LANES):
            group = numbers[first : first + LANES]
            for i in range(LANES):  # those without a knee are never smooth, as they have a backlog
                put_scene(read_scene(one_tick.scenes + group[min(i, len(group) - 1)] * size), rows, i)
                put_lane(Lane(0.0, 0.0, 1, False), rows, i)
            for k in range(len(durations)):
                last = max(k - 1, 0)
                for i in range(len(group)):
                    load = loads[group[i]]
                    put_lane(Lane(load[last], load[k], lane_in(rows, i).behind, False), rows, i)
                tick = Tick(durations[k], angles[last], angles[k])
                if k > 0:
                    smooth_ticks(rows, tick)
                for i in range(len(group)):
                    knee, number = group[i], group[i] * len(durations) + k
                    addresses[0], addresses[1] = one_tick.scenes + knee * size, one_tick.memory + (first + i) * KEPT
                    addresses[2], addresses[3] = one_tick.durations + 8 * k, one_tick.angles + 8 * k
                    addresses[4], addresses[5] = one_tick.loads + 8 * number, one_tick.heights + 8 * k
                    addresses[6] = one_tick.answers + number * ANSWER
                    answer(rows, i, tick, memory[first + i], answers[knee, k], one_tick.run, addresses)

    return LanesKernel(places.result.end, compiled_function(through, kind, nogil=True))


def _inlined(function: _Function) -> _Function:
    """Mark a function for compiled code as a part of its callers."""
    register_jitable(**INLINE)(function)
    return function


def _apart(loop: _Function, kind: str) -> _Function:
    """Mark a loop for compiled code to be kept out of its callers: only then LLVM uses vector instructions for it.

    It is linked by its name and the types of its arguments, so the name gets the digest of the kind of scene.
    """
    loop.__qualname__ += f"_{kind}"
    register_jitable(**APART)(loop)
    return loop


@_inlined
def interval_in_lane(scene: Scene, lane: Lane, tick: Tick) -> Interval:
    """Give what is prescribed to a lane in a tick."""
    return interval_between(scene, tick.duration, tick.last_angle, lane.last_load, tick.angle, lane.load, math.nan)


def _places(kind: types.Type) -> Places:
    """Lay out the memory for lanes with a kind of scene."""
    scene = transposed(kind, 0, {"exponent": EXPONENT})
    lane = transposed(numba_type_of(Lane), scene.end)
    so_far = transposed(numba_type_of(SmoothTick), lane.end)
    return Places(
        kind=digest(str(kind)), scene=scene, lane=lane, so_far=so_far,
        result=transposed(numba_type_of(TickResult), so_far.end),
        run_state=transposed(numba_type_of(RunState), so_far.end),
    )  # fmt: skip


def _smooth_ticks(places: Places) -> Callable[..., None]:
    """Make the function that computes a tick in all lanes in which it is smooth."""
    begin_all, stride_all, arrive_all = _begin_all(places), _stride_all(places), _arrive_all(places)

    def smooth_ticks(rows: Any, tick: Tick) -> None:
        most = begin_all(rows, tick)
        for number in range(most):
            stride_all(rows, tick, float(number))
        if most > 0:
            arrive_all(rows, tick)

    return _inlined(smooth_ticks)


def _begin_all(places: Places) -> Callable[..., int]:
    """Make the function that begins the ticks that may be smooth, and returns their largest number of steps."""
    scene_in, lane_in, run_state_in = places.scene.get, places.lane.get, places.run_state.get
    put_lane, put_so_far = places.lane.put, places.so_far.put

    def begin_all(rows: Any, tick: Tick) -> int:
        most = 0
        for i in range(LANES):
            scene, lane, start = scene_in(rows, i), lane_in(rows, i), run_state_in(rows, i)
            interval = interval_in_lane(scene, lane, tick)
            so_far, _, _ = begin_smooth(scene, interval, start)
            moves = (lane.behind == 0) & (not math.isnan(start.state.velocity))
            smooth = so_far.smooth & moves & is_calm(scene, interval, start)
            smooth = smooth & goes_straight_to_dynamic(scene, interval, start)
            put_so_far(so_far, rows, i)
            put_lane(Lane(lane.last_load, lane.load, lane.behind, smooth), rows, i)
            most = max(most, int(so_far.parts) if smooth else 0)
        return most

    return _apart(begin_all, places.kind)


def _stride_all(places: Places) -> Callable[..., None]:
    """Make the function that takes a step, by its number, in all lanes that have so many."""
    scene_in, lane_in, run_state_in = places.scene.get, places.lane.get, places.run_state.get
    so_far_in, put_lane, put_so_far = places.so_far.get, places.lane.put, places.so_far.put

    def stride_all(rows: Any, tick: Tick, number: float) -> None:
        for i in range(LANES):
            scene, lane, start, so_far = scene_in(rows, i), lane_in(rows, i), run_state_in(rows, i), so_far_in(rows, i)
            farther = step_smooth(
                scene, interval_in_lane(scene, lane, tick), start, ContactMode(0, True), so_far, number, True
            )
            if lane.smooth & (number < so_far.parts):
                put_so_far(farther, rows, i)
                put_lane(Lane(lane.last_load, lane.load, lane.behind, farther.smooth), rows, i)

    return _apart(stride_all, places.kind)


def _arrive_all(places: Places) -> Callable[..., None]:
    """Make the function that computes the results of the smooth ticks."""
    scene_in, lane_in, run_state_in = places.scene.get, places.lane.get, places.run_state.get
    so_far_in, put_result = places.so_far.get, places.result.put

    def arrive_all(rows: Any, tick: Tick) -> None:
        for i in range(LANES):
            scene, lane, start, so_far = scene_in(rows, i), lane_in(rows, i), run_state_in(rows, i), so_far_in(rows, i)
            spent = 1 + int(so_far.parts) * EVALUATIONS
            result = end_smooth(scene, interval_in_lane(scene, lane, tick), start, so_far, spent)
            if lane.smooth:
                put_result(result, rows, i)

    return _apart(arrive_all, places.kind)


def _answer(places: Places) -> Callable[..., None]:
    """Make the function that fills a lane's answer; if its tick was not smooth, `ticks.run` computes it."""
    scene_in, lane_in, run_state_in = places.scene.get, places.lane.get, places.run_state.get
    result_in, put_lane, put_run_state = places.result.get, places.lane.put, places.run_state.put

    def answer(rows: Any, i: int, tick: Tick, kept: Any, row: Any, run: int, addresses: Any) -> None:
        scene, lane = scene_in(rows, i), lane_in(rows, i)
        if lane.smooth:
            angle_rate = (tick.angle - tick.last_angle) / tick.duration
            write_answer(row, scene, tick.angle, angle_rate, lane.load, result_in(rows, i))
            return
        if kept["begun"] != 0:
            write_run_state(kept["run_state"], run_state_in(rows, i))
            kept["angle"], kept["load"] = tick.last_angle, lane.last_load
        run_at(run, addresses)
        put_run_state(read_run_state(kept["run_state"]), rows, i)
        put_lane(Lane(lane.last_load, lane.load, kept["backlog"]["count"], False), rows, i)

    return _inlined(answer)

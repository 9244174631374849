"""MuJoCo: a mass on a slide joint, contact and load as its passive force."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.peers.measure import Outcome, Setting, Solver, steps_per_tick, stopwatch
from benchmarks.peers.motion import Load, Ramp, contact_force, load_at, ticks
from benchmarks.peers.problems import Problem, start_depth

LAW = (
    "exact: contact and load in the passive-force callback, in plain Python; constraints, its own contacts and "
    "actuators switched off; one `mj_step` per tick for all steps in it"
)
STAGES = {"RK4": 4, "Euler": 1}
SCENE = """
<mujoco>
  <option gravity="0 0 0" timestep="{step!r}" integrator="{integrator}">
    <flag constraint="disable" contact="disable" actuation="disable" sensor="disable" energy="disable"
      warmstart="disable"/>
  </option>
  <worldbody>
    <body>
      <joint type="slide" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/>
    </body>
  </worldbody>
</mujoco>
"""


def solvers() -> list[Solver]:
    """RK4 and semi-implicit Euler; with a passive force of one's own, implicitfast gives the same as the latter."""
    settings = steps_per_tick(1, 2, 5, 10, 20, 50, 100, 200)
    return [
        Solver(f"MuJoCo {name}", "MuJoCo", LAW, settings, partial(whole, name), partial(stream, name))
        for name in STAGES
    ]


def whole(integrator: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with the load in tables."""
    return advance(problem, setting, integrator, load_at(problem), None)


def stream(integrator: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with the load of the current tick only."""
    ramp = Ramp()
    return advance(problem, setting, integrator, ramp, ramp)


def advance(problem: Problem, setting: Setting, integrator: str, load: Load, ramp: Ramp | None) -> Outcome:
    """Step through all ticks; a ramp is given every sample when it arrives."""
    import mujoco

    count = int(setting.value)
    step = float(problem.time[1] - problem.time[0]) / count
    model = mujoco.MjModel.from_xml_string(SCENE.format(step=step, integrator=integrator, mass=problem.mass))
    data, samples, depths = mujoco.MjData(model), ticks(problem), [start_depth(problem)]
    data.qpos[0] = depths[0]
    mujoco.set_mjcb_passive(passive(problem, load))
    try:
        with stopwatch() as watch:
            for tick in samples:
                if ramp:
                    ramp.set(tick)
                mujoco.mj_step(model, data, count)
                depths.append(float(data.qpos[0]))
    finally:
        mujoco.set_mjcb_passive(None)
    return Outcome(np.array(depths), watch.seconds, len(samples) * count * STAGES[integrator])


def passive(problem: Problem, load: Load) -> Callable[[Any, Any], None]:
    """Build MuJoCo's passive-force callback: load minus contact force [N]."""
    force = contact_force(problem)

    def callback(_model: Any, data: Any) -> None:
        data.qfrc_passive[0] = load(data.time) - force(float(data.qpos[0]), float(data.qvel[0]))

    return callback

"""Drake: a symbolic vector system, evaluated in C++."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks.peers.measure import Outcome, Setting, Solver, stopwatch, tolerances
from benchmarks.peers.motion import ticks
from benchmarks.peers.problems import EXPONENT, Problem, start_depth

LAW = (
    "exact: `SymbolicVectorSystem`, evaluated in C++; one call with dense output and the load as a trajectory, or one "
    "`AdvanceTo` per tick with the load's ramp as parameters"
)
SCHEMES = {"runge_kutta5": "RK5", "runge_kutta3": "RK3", "radau3": "Radau3"}
LARGEST_STEP = 0.01


def solvers() -> list[Solver]:
    """Drake's schemes with error control that are the cheapest at some error."""
    return [
        Solver(f"Drake {name}", "Drake", LAW, tolerances(*range(3, 13)), partial(whole, scheme),
               partial(stream, scheme))
        for scheme, name in SCHEMES.items()
    ]  # fmt: skip


def whole(scheme: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem in one call with dense output."""
    simulator = simulator_of(with_trajectory(problem), problem, scheme, setting)
    integrator = simulator.get_mutable_integrator()
    with stopwatch() as watch:
        integrator.StartDenseIntegration()
        simulator.AdvanceTo(problem.time[-1])
        depth = integrator.StopDenseIntegration().vector_values(problem.time)[0]
    return Outcome(depth, watch.seconds, integrator.get_num_derivative_evaluations())


def stream(scheme: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with one call per tick."""
    simulator = simulator_of(with_ramp(problem), problem, scheme, setting)
    context = simulator.get_mutable_context()
    ramp, state = context.get_mutable_numeric_parameter(0), context.get_continuous_state_vector()
    samples, depths = ticks(problem), [start_depth(problem)]
    with stopwatch() as watch:
        for tick in samples:
            slope = (tick.end_load - tick.start_load) / (tick.end - tick.begin)
            ramp.SetFromVector((tick.start_load, slope, tick.begin))
            simulator.AdvanceTo(tick.end)
            depths.append(state[0])
    evaluations = simulator.get_integrator().get_num_derivative_evaluations()
    return Outcome(np.array(depths), watch.seconds, evaluations)


def simulator_of(system: Any, problem: Problem, scheme: str, setting: Setting) -> Any:
    """Build a simulator of a system that is ready to start, at rest under the first load."""
    from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

    simulator = Simulator(system)
    ResetIntegratorFromFlags(simulator, scheme, LARGEST_STEP)
    simulator.get_mutable_integrator().set_target_accuracy(setting.value)
    simulator.get_mutable_context().SetContinuousState([start_depth(problem), 0.0])
    simulator.Initialize()
    return simulator


def with_trajectory(problem: Problem) -> Any:
    """Build the system whose load is known over the whole series."""
    from pydrake.symbolic import Variable
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import SymbolicVectorSystem, TrajectorySource
    from pydrake.trajectories import PiecewisePolynomial

    depth, rate, load = (Variable(name) for name in ("depth", "rate", "load"))
    builder = DiagramBuilder()
    source = builder.AddSystem(TrajectorySource(PiecewisePolynomial.FirstOrderHold(problem.time, problem.load[None])))
    motion = [rate, (load - force(problem, depth, rate)) / problem.mass]
    femur = builder.AddSystem(SymbolicVectorSystem(state=[depth, rate], input=[load], dynamics=motion, output=[]))
    builder.Connect(source.get_output_port(), femur.get_input_port())
    return builder.Build()


def with_ramp(problem: Problem) -> Any:
    """Build the system whose load is a ramp with three parameters: value [N], slope [N/s] and begin [s] of a tick."""
    from pydrake.symbolic import Variable
    from pydrake.systems.primitives import SymbolicVectorSystem

    time, depth, rate, load, slope, begin = (
        Variable(name) for name in ("time", "depth", "rate", "load", "slope", "begin")
    )
    motion = [rate, (load + slope * (time - begin) - force(problem, depth, rate)) / problem.mass]
    return SymbolicVectorSystem(
        time=time, state=[depth, rate], parameter=[load, slope, begin], dynamics=motion, output=[]
    )


def force(problem: Problem, depth: Any, rate: Any) -> Any:
    """Force of the clamped law [N] in Drake's symbols."""
    from pydrake import symbolic

    def power(value: Any) -> Any:
        return symbolic.pow(symbolic.max(value, 0.0), EXPONENT)

    pushing = problem.stiffness * power(depth) + problem.first_damping * rate
    if problem.layered:
        below = problem.layer_force + problem.stiffness_2 * power(depth - problem.layer_depth) + problem.damping * rate
        pushing = symbolic.if_then_else(depth <= problem.layer_depth, pushing, below)
    return symbolic.if_then_else(depth > 0.0, symbolic.max(pushing, 0.0), 0.0)

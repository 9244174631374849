"""Exudyn: a mass with one coordinate under a spring-damper with a force of its own."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.peers.measure import Outcome, Setting, Solver, steps_per_tick, stopwatch
from benchmarks.peers.motion import Tick, ticks
from benchmarks.peers.problems import EXPONENT, Problem, start_depth

LAW = (
    "exact: spring-damper with a symbolic user function, evaluated in C++; a Python function before every step hands "
    "in the load of the tick, so that a whole run is the same as a streamed one; the depths come from a sensor"
)
STAGES = {"RK44": 4, "RK67": 9}
"""Force evaluations per step of the explicit methods; Newton's depend on the step"""
NAMES = {"RK44": "RK44", "RK67": "RK67", "TrapezoidalIndex2": "trapezoidal"}
NEWTON = (1e-10, 1e-12)
"""Relative and absolute tolerance of the residual"""


def solvers() -> list[Solver]:
    """One solver per method; generalised-alpha with a spectral radius of 1 is the trapezoidal rule."""
    settings = steps_per_tick(1, 2, 5, 10, 20, 50, 100, 200)
    return [
        Solver(f"Exudyn {name}", "Exudyn", LAW, settings, None, partial(stream, method))
        for method, name in NAMES.items()
    ]


def stream(method: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem in one call, whose Python function takes every sample when its turn has come."""
    import exudyn

    exudyn.config.printToConsole = False
    count = int(setting.value)
    samples = ticks(problem)
    scene = Scene(problem, ramped=method in STAGES)
    scene.system.SetPreStepUserFunction(scene.feeder(samples, count))
    scene.system.Assemble()
    settings = simulation(exudyn, problem, count * len(samples))
    kind = getattr(exudyn.DynamicSolverType, method)
    with stopwatch() as watch:
        scene.system.SolveDynamic(settings, solverType=kind)
    rows = np.array(scene.system.GetSensorStoredData(scene.sensor))
    return Outcome(rows[:, 1], watch.seconds, len(samples) * count * STAGES.get(method, math.nan))


class Scene:
    """The model of a problem; its load is a ramp for every tick, or for implicit steps the value at a step's end."""

    def __init__(self, problem: Problem, ramped: bool) -> None:
        import exudyn
        from exudyn import itemInterface
        from exudyn.advancedUtilities import CreateSymbolicUserFunction as Symbolic

        self._container = exudyn.SystemContainer()
        self.system = system = self._container.AddSystem()
        self._constant, self._slope = exudyn.symbolic.Real("constant", 0.0), exudyn.symbolic.Real("slope", 0.0)
        node = system.AddNode(
            itemInterface.Node1D(
                referenceCoordinates=[0.0], initialCoordinates=[start_depth(problem)], initialVelocities=[0.0]
            )
        )
        system.AddObject(itemInterface.ObjectMass1D(mass=problem.mass, nodeNumber=node))
        ground = system.AddNode(itemInterface.NodePointGround())
        markers = [
            system.AddMarker(itemInterface.MarkerNodeCoordinate(nodeNumber=number, coordinate=0))
            for number in (ground, node)
        ]
        self._force = Symbolic(system, spring(problem), "springForceUserFunction",
                               itemTypeName="ObjectConnectorCoordinateSpringDamper")  # fmt: skip
        system.AddObject(
            itemInterface.ObjectConnectorCoordinateSpringDamper(
                markerNumbers=markers, springForceUserFunction=self._force
            )
        )
        self._ramp: Any = 0
        if ramped:
            self._ramp = Symbolic(
                system, ramp(self._constant, self._slope), "loadUserFunction", itemTypeName="LoadCoordinate"
            )
        self._load = system.AddLoad(
            itemInterface.LoadCoordinate(
                markerNumber=markers[1], load=float(problem.load[0]), loadUserFunction=self._ramp
            )
        )
        self.sensor = system.AddSensor(
            itemInterface.SensorNode(nodeNumber=node, storeInternal=True, writeToFile=False,
                            outputVariableType=exudyn.OutputVariableType.Coordinates)
        )  # fmt: skip

    def feeder(self, samples: list[Tick], count: int) -> Callable[[Any, float], bool]:
        """Build the function that is called before every step and hands in a tick's sample at its first step."""
        lines, ramped = [line(tick) for tick in samples], self._ramp != 0
        constant, slope, step = 0.0, 0.0, 0

        def feed(system: Any, end: float) -> bool:
            nonlocal constant, slope, step
            if step % count == 0:
                constant, slope = lines[step // count]
                if ramped:
                    self._constant.SetValue(constant)
                    self._slope.SetValue(slope)
            if not ramped:
                system.SetLoadParameter(self._load, "load", constant + slope * end)
            step += 1
            return True

        return feed


def line(tick: Tick) -> tuple[float, float]:
    """Load [N] at time 0 of the line through a tick, and its slope [N/s]."""
    slope = (tick.end_load - tick.start_load) / (tick.end - tick.begin)
    return tick.start_load - slope * tick.begin, slope


def ramp(constant: Any, slope: Any) -> Callable[..., Any]:
    """Build a load that is linear in time, in Exudyn's symbols."""

    def load_at(mbs: Any, t: Any, load: Any) -> Any:  # noqa: ARG001 - Exudyn goes by these names
        return constant + slope * t

    return load_at


def spring(problem: Problem) -> Callable[..., Any]:
    """Build the clamped law in Exudyn's symbols."""
    from exudyn import symbolic

    begin = problem.layer_depth

    def power(depth: Any) -> Any:
        return symbolic.pow(symbolic.max(depth, 0.0), EXPONENT)

    # Exudyn goes by the names of the arguments.
    def force(mbs, t, itemNumber, displacement, velocity, stiffness, damping, offset):  # type: ignore[no-untyped-def]  # noqa: ARG001, N803
        pushing = problem.stiffness * power(displacement) + problem.first_damping * velocity
        if problem.layered:
            below = problem.layer_force + problem.stiffness_2 * power(displacement - begin) + problem.damping * velocity
            pushing = symbolic.IfThenElse(displacement <= begin, pushing, below)
        return symbolic.IfThenElse(displacement > 0.0, symbolic.max(pushing, 0.0), symbolic.Real(0.0))

    return force


def simulation(exudyn: Any, problem: Problem, steps: int) -> Any:
    """Settings of a run: steps of equal size, no files, output at every tick."""
    settings = exudyn.SimulationSettings()
    time = settings.timeIntegration
    time.numberOfSteps, time.endTime = steps, float(problem.time[-1])
    time.automaticStepSize = time.adaptiveStep = False
    time.newton.relativeTolerance, time.newton.absoluteTolerance = NEWTON
    time.newton.useModifiedNewton = False
    settings.show.computationTime = False
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = float(problem.time[1] - problem.time[0])
    settings.linearSolver.solverType = exudyn.LinearSolverType.EXUdense
    return settings

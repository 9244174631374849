"""OpenSim on Simbody: a body on a slider joint."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from benchmarks.peers.measure import Outcome, Setting, Solver, stopwatch, tolerances
from benchmarks.peers.problems import EXPONENT, Problem, start_depth

LAW = (
    "exact: `ExpressionBasedCoordinateForce`, evaluated in C++, and a coordinate actuator with the load as a piecewise "
    "linear function; one `Manager.integrate` per tick, not beyond it; no streaming: a running system takes no new ramp"
)
METHODS = {"CPodes": "CPodes", "RungeKuttaMerson": "RK-Merson", "RungeKutta3": "RK3"}


def solvers() -> list[Solver]:
    """One solver per method: an implicit multistep method and two explicit ones."""
    settings = tolerances(*range(2, 11))
    return [
        Solver(f"OpenSim {name}", "OpenSim", LAW, settings, partial(whole, method), None)
        for method, name in METHODS.items()
    ]


def whole(method: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with all of the load in one function; `Manager` answers where it stops: one call per tick."""
    import opensim

    function = opensim.PiecewiseLinearFunction()
    for time, load in zip(problem.time.tolist(), problem.load.tolist(), strict=True):
        function.addPoint(time, load)
    scene = Scene(problem, function)
    manager = scene.manager(method, setting.value)
    ends = problem.time[1:].tolist()
    with stopwatch() as watch:
        depths = [manager.integrate(end).getQ().get(0) for end in ends]
    return Outcome(np.array([start_depth(problem), *depths]), watch.seconds, math.nan)


class Scene:
    """The model of a problem at rest under the first load; it must be kept as long as its parts are used."""

    def __init__(self, problem: Problem, load: Any) -> None:
        import opensim

        opensim.Logger.setLevelString("Error")
        self._model = model = opensim.Model()
        model.setGravity(opensim.Vec3(0))
        body = opensim.Body("femur", problem.mass, opensim.Vec3(0), opensim.Inertia(1.0))
        joint = opensim.SliderJoint("joint", model.getGround(), body)
        joint.updCoordinate().setName("depth")
        actuator = opensim.CoordinateActuator("depth")
        controller = opensim.PrescribedController()
        model.addBody(body)
        model.addJoint(joint)
        model.addForce(opensim.ExpressionBasedCoordinateForce("depth", expression(problem)))
        model.addForce(actuator)
        controller.addActuator(actuator)
        controller.prescribeControlForActuator(actuator.getName(), load)
        model.addController(controller)
        self._state = model.initSystem()
        coordinate = model.getCoordinateSet().get(0)
        coordinate.setValue(self._state, start_depth(problem))
        coordinate.setSpeedValue(self._state, 0.0)

    def manager(self, method: str, accuracy: float) -> Any:
        """Build the integrator with a method and an accuracy, which writes nothing."""
        import opensim

        manager = opensim.Manager(self._model)
        manager.setPerformAnalyses(False)
        manager.setWriteToStorage(False)
        manager.setRecordStatesTrajectory(False)
        manager.setIntegratorMethod(getattr(opensim.Manager, f"IntegratorMethod_{method}"))
        manager.setIntegratorAccuracy(accuracy)
        manager.setIntegratorInternalStepLimit(-1)
        manager.initialize(self._state)
        return manager


def expression(problem: Problem) -> str:
    """Minus the force of the clamped law [N], as an expression of OpenSim."""
    pushing = f"{problem.stiffness!r}*max(q,0)^{EXPONENT}+{problem.first_damping!r}*qdot"
    if problem.layered:
        below = f"q-{problem.layer_depth!r}"
        second = f"{problem.layer_force!r}+{problem.stiffness_2!r}*max({below},0)^{EXPONENT}+{problem.damping!r}*qdot"
        pushing = f"(1-step({below}))*({pushing})+step({below})*({second})"
    return f"-step(q)*max(0,{pushing})"

"""Checks that hold in any scene: finite, no pull, misses flagged, errors within the tolerance, no energy made."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.laws import ContactLaw
from knee_contact_ros.model.types import Fidelity, Status
from studies.stability_scenes import Scene, law_of, run

FINER = 300.0
"""Ratio of the tolerance to that of the finer run that it is judged by"""
FINE_BUDGET = 25_000
"""Contact law evaluations that a tick of the finer run may cost"""
TRUSTED = 0.1
"""Share of the tolerance that the finer run's own estimate may reach where it is compared with"""
ROUNDING = 1e-11
"""Share of the energies involved that is rounding: some 1e4 steps, each of some 1e-16"""
FIELDS = ("contact_force", "penetration_depth", "gap", "penetration_rate", "femoral_height", "error_estimate")


class Outcome(NamedTuple):
    """Result of all checks on one scene."""

    ticks: int
    flagged: int
    settled: int
    compared: int
    """Number of unflagged ticks whose error is known"""
    error: float
    """Largest error of these ticks, in tolerances"""
    energy: float
    """Largest gain of energy in a tick, relative to what is allowed; < 0 if energy was lost in every tick"""
    failures: tuple[str, ...]


def judge(scene: Scene, level: str = "dynamic", quick: bool = False) -> Outcome:
    """Run a scene at a level, and check it against the dynamic level."""
    try:
        series = run(scene, level=level, quick=quick)
        finer = run(scene, scene.tolerance / FINER, FINE_BUDGET, quick=quick)
    except Exception as raised:  # any exception is the failure that is looked for
        return Outcome(len(scene.time), 0, 0, 0, 0.0, -math.inf, (f"{type(raised).__name__}: {raised}",))
    failures = promises(series, scene.tolerance, level)
    said = series.status & Status.NOT_CONVERGED != 0
    settled = said & (series.fidelity == Fidelity.QUASI_STATIC)
    known = trusted(finer, scene.tolerance) & ~said
    error = np.abs(signed_depth(series) - signed_depth(finer))[known] / scene.tolerance
    gains = energy_gains(scene, series)
    if error.size and error.max() > 1.0:
        failures.append(f"error of {error.max():.3g} tolerances, not flagged")
    if gains.size and gains.max() > 1.0:
        failures.append(f"energy made: {gains.max():.3g} times what is allowed")
    return Outcome(
        len(series), int(said.sum()), int(settled.sum()), int(known.sum()), float(error.max(initial=0.0)),
        float(gains.max(initial=-math.inf)), tuple(failures),
    )  # fmt: skip


def promises(series: np.recarray[Any, Any], tolerance: float, level: str = "dynamic") -> list[str]:
    """Broken promises of a series of answers that are visible without the exact solution."""
    said = series.status & Status.NOT_CONVERGED != 0
    missed = series.error_estimate > tolerance
    if level == "dynamic":  # it answers quasi-statically only where it has given up
        missed |= series.fidelity == Fidelity.QUASI_STATIC
    found = [f"{field} not finite" for field in FIELDS if not np.isfinite(series[field]).all()]
    found += (
        ["contact_point not finite"] if not all(np.isfinite(series.contact_point[axis]).all() for axis in "xyz") else []
    )
    found += ["pulls"] if (series.contact_force < 0.0).any() else []
    found += ["depth and gap at once"] if (series.penetration_depth * series.gap != 0.0).any() else []
    found += ["a miss is not said"] if (missed & ~said).any() else []
    return found


def signed_depth(series: np.recarray[Any, Any]) -> NDArray[np.float64]:
    """Penetration depth, or less the gap [m]."""
    return np.asarray(series.penetration_depth - series.gap)


def trusted(finer: np.recarray[Any, Any], tolerance: float) -> NDArray[np.bool_]:
    """Ticks at which the finer run may stand for the exact solution: those before it ran out of budget."""
    dynamic = np.logical_and.accumulate(finer.fidelity == Fidelity.DYNAMIC)
    return np.asarray(dynamic & (finer.error_estimate <= TRUSTED * tolerance))


_nodes, _weights = np.polynomial.legendre.leggauss(24)
NODES, WEIGHTS = (0.5 * (_nodes + 1.0)).tolist(), (0.5 * _weights).tolist()
"""Nodes and weights of Gauss's rule between 0 and 1"""


class Energy:
    """Energy of a circular femur under a constant load; turning it does no work."""

    def __init__(self, scene: Scene) -> None:
        self.law: ContactLaw = law_of(scene)
        self.mass = scene.mass

    def elastic(self, depth: float) -> float:
        """Integral [J] of the static force of every layer up to a depth [m], by Gauss's rule.

        Over u with δ = u², in which a force that begins with δⁿ is smooth at its beginning: 24 nodes leave 1e-11 of it.
        """
        total = 0.0
        ends = [*(layer.begin for layer in self.law.layers[1:]), math.inf]
        for layer, end in zip(self.law.layers, ends, strict=True):
            inside = min(depth, end) - layer.begin
            if inside > 0.0:
                force = [layer.force_at(layer.begin + inside * u * u, 0.0)[0] for u in NODES]
                total += 2.0 * inside * sum(w * u * f for w, u, f in zip(WEIGHTS, NODES, force, strict=True))
        return total

    def reach(self, start: float, load: float) -> float:
        """Depth [m] to which an energy [J] and a load [N] can press the femur, from above within a factor of 2."""
        depth = 1e-9
        while self.elastic(depth) < start + max(load, 0.0) * depth:
            depth *= 2.0
        return depth

    def allowed(self, energy: float, error: float, depth: float) -> float:
        """Change of energy [J] that an error of the depth [m] amounts to.

        A mass m that swings with an energy E on a stiffness k has a speed of at most v = √(2E/m). An error e of the
        depth is one of e√(k/m), or of e c/m where the dashpot c holds it back, in the speed (`model.error_estimate`).
        """
        slopes = [layer.force_at(depth, 0.0)[1:] for layer in self.law.layers]
        stiffness = max(slope[0] for slope, layer in zip(slopes, self.law.layers, strict=True) if layer.begin < depth)
        damping = max(slope[1] for slope in slopes)
        off = error * max(math.sqrt(stiffness / self.mass), damping / self.mass, 10.0)
        return self.mass * off * (math.sqrt(2.0 * energy / self.mass) + 0.5 * off)


def energy_gains(scene: Scene, series: np.recarray[Any, Any]) -> NDArray[np.float64]:
    """Gain of energy in every tick under constant load over what the tolerance and rounding allow; <= 1 if all is well.

    The balance is that of kinetic energy, elastic energy and the load's potential L y. The error that is allowed for is
    the tolerance, or the published estimate where that is the larger one. Ticks answered with the static solution
    have no balance.
    """
    if scene.femur != "circle" or scene.tibia != "plane":
        return np.array([])
    energy, gains = Energy(scene), []
    for i in range(1, len(series)):
        load = scene.load[i]
        if load != scene.load[i - 1] or series.fidelity[i] == Fidelity.QUASI_STATIC:
            continue
        parts = [
            (
                0.5 * scene.mass * row.penetration_rate**2,
                energy.elastic(row.penetration_depth),
                load * row.femoral_height,
            )
            for row in (series[i - 1], series[i])
        ]
        # What can turn into motion: all but the load's potential at the lowest point that can be reached.
        moving = max(kinetic + elastic for kinetic, elastic, _ in parts) + abs(parts[0][2] - parts[1][2])
        moving += abs(load) * max(series.gap[i - 1], series.gap[i])
        reach = energy.reach(moving, load)
        swing = moving + max(load, 0.0) * reach
        error = max(scene.tolerance, series.error_estimate[i - 1], series.error_estimate[i])
        rounding = ROUNDING * (swing + abs(parts[0][2]) + abs(parts[1][2]))
        limit = energy.allowed(swing, error, reach) + rounding
        gains.append((sum(parts[1]) - sum(parts[0])) / limit)
    return np.array(gains)

"""The cases of `studies.calibration`: knees, their gait, the measured quantities, and their noise."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from studies.gait import gait

Floats = NDArray[np.float64]
Series = tuple[Floats, Floats, Floats]
"""Time [s], flexion angle [rad], load of the compartment [N]"""
SPRING: dict[str, Any] = {"stiffness": 7.905694e7, "exponent": 1.5}
HEALTHY = SPRING | {"damping": 5000.0}
LAYERS = HEALTHY | {"layer_depth": 5e-4, "stiffness_2": 3.112e9}
IMPACT = SPRING | {"restitution": 0.5, "least_impact_speed": 0.01}
MASS = 9.3014
GRAVITY = 9.80665
DEPTH, FORCE, GAP = "penetration_depth", "contact_force", "gap"
SHORT = {DEPTH: "depth", FORCE: "force", GAP: "gap"}


class Case(NamedTuple):
    """A knee, its gait, the measured quantities with their noise, and the fit."""

    law: str
    arguments: dict[str, Any]
    series: Series
    noise: dict[str, float]
    """Standard deviation by column, in its unit"""
    names: tuple[str, ...]
    """Names of the free parameters"""
    fitted_law: str = ""
    """Contact law of the fit, if it is another one than the knee's"""
    mass: float = MASS
    share: float | None = None
    """Share of the axial load in the table, if the table holds the axial load"""
    displacement: bool = False
    """Whether the height is an input, so that the force must follow from the depth alone"""
    told: float = 0.0
    """Part of the noise that the fit knows; 0: none"""
    loss: str = "linear"
    outliers: float = 0.0
    """Part of the samples whose noise is twenty times as large"""
    correlation: float = 0.0
    """Correlation of the noise of neighbouring samples"""
    starts: int = 1
    """Number of starts of the search; several where there are several minima"""
    part: float = 1.0
    """Part of the repetitions that is done, below 1 where a fit takes long"""
    expects: str = ""
    """The kind of warning that is counted"""

    @property
    def free(self) -> dict[str, float]:
        """True values of the free parameters by name."""
        true = {f"contact.{name}": value for name, value in self.arguments.items()}
        true |= {"femur.mass": self.mass, "femur.radius": 0.034, "load.share": self.share}
        return {name: float(true[name]) for name in self.names}

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of the true model."""
        contact = {f"contact.{name}": value for name, value in self.arguments.items()}
        law = {"contact.law": self.fitted_law or self.law, "drive": "displacement" if self.displacement else "force"}
        share = {} if self.share is None else {"load.share": self.share}
        return contact | law | share | {"femur.mass": self.mass}

    @property
    def measured(self) -> str:
        """Measured quantities in words, for the table."""
        units = {DEPTH: (1e6, "µm"), GAP: (1e6, "µm"), FORCE: (1.0, "N")}
        told = [f"{SHORT[name]} ({size * units[name][0]:g} {units[name][1]})" for name, size in self.noise.items()]
        return f"{', '.join(told)}, {len(self.series[0])} samples{', noise told' if self.told else ''}"


def lift_off() -> Series:
    """A knee that is let go of twice in half a second, and lands; it bends and stretches meanwhile."""
    time = np.arange(501, dtype=np.float64) * 1e-3
    return time, 0.4 + 0.4 * np.sin(9.0 * time), 300.0 + 350.0 * np.cos(math.tau * time / 0.25)


def drop() -> Series:
    """A femur that is lifted for 40 ms by 100 N, and falls by its own weight, and bounces."""
    time = np.arange(401, dtype=np.float64) * 1e-3
    load = np.where(time < 0.04, -100.0, MASS * GRAVITY)
    return time, np.full(len(time), 0.3), load


def narrow() -> Series:
    """A load that varies between 690 and 710 N only."""
    time = np.arange(301, dtype=np.float64) * 5e-3
    return time, np.full(len(time), 0.3), 700.0 + 10.0 * np.sin(math.tau * time)


GAIT = gait("right")
K, N, C = "contact.stiffness", "contact.exponent", "contact.damping"
VOIGT = "kelvin_voigt"
CASES = {
    "gait, depth": Case(VOIGT, HEALTHY, GAIT, {DEPTH: 2e-6}, (K, C)),
    "gait, depth and force": Case(VOIGT, HEALTHY, GAIT, {DEPTH: 5e-6, FORCE: 10.0}, (K, N)),
    "gait, depth, noise told": Case(VOIGT, HEALTHY, GAIT, {DEPTH: 5e-6}, (K, N, C), told=1.0),
    "gait, axial load, depth and force": Case(VOIGT, HEALTHY, GAIT, {DEPTH: 5e-6, FORCE: 10.0}, ("load.share", K),
                                              share=0.5),
    "lift-off and landing, depth and gap": Case(VOIGT, HEALTHY, lift_off(), {DEPTH: 5e-6, GAP: 2e-5},
                                                (K, C, "femur.mass")),
    "drop test, gap and force": Case("hunt_crossley", IMPACT, drop(), {GAP: 1e-5, FORCE: 5.0},
                                     (K, "contact.restitution"), starts=4),
    "drop test, Kelvin-Voigt, depth and gap": Case(VOIGT, HEALTHY, drop(), {DEPTH: 5e-6, GAP: 1e-5}, (K, C)),
    "gait, two layers damped, depth": Case("two_layer_viscoelastic", LAYERS | {"damp_first_layer": True}, GAIT,
                                           {DEPTH: 2e-6}, ("contact.layer_depth", "contact.stiffness_2")),
    "gait, two layers as printed, depth": Case("two_layer_viscoelastic", LAYERS | {"damp_first_layer": False}, GAIT,
                                               {DEPTH: 2e-6}, ("contact.layer_depth", "contact.stiffness_2"), starts=4,
                                               part=0.5),
    "gait, height prescribed, force": Case("hertz", SPRING, GAIT, {FORCE: 10.0}, ("femur.radius", K),
                                           displacement=True),
    "gait, depth, one in twenty far off, soft_l1": Case(VOIGT, HEALTHY, GAIT, {DEPTH: 2e-6}, (K, C), loss="soft_l1",
                                                        outliers=0.05),
}  # fmt: skip
"""Cases that the intervals are meant for"""
DOUBTFUL = {
    "loads of 690 to 710 N, depth": Case(VOIGT, HEALTHY, narrow(), {DEPTH: 5e-6}, (K, N), expects="apart"),
    "drop test, Kelvin-Voigt, force, which jumps at touch": Case(VOIGT, HEALTHY, drop(), {FORCE: 5.0}, (K, C), starts=4,
                                                                 expects="rough"),
    "noise correlated by 0.9": Case(VOIGT, HEALTHY, GAIT, {DEPTH: 2e-6}, (K, C), correlation=0.9,
                                    expects="correlated"),
    "another law: two layers, fitted by one": Case("two_layer_viscoelastic", LAYERS | {"damp_first_layer": True}, GAIT,
                                                   {DEPTH: 2e-6}, (K, C), fitted_law=VOIGT, part=0.2,
                                                   expects="correlated"),
    "least squares, one in twenty far off": Case(VOIGT, HEALTHY, GAIT, {DEPTH: 2e-6}, (K, C), outliers=0.05),
    "the noise told is half of it": Case(VOIGT, HEALTHY, GAIT, {DEPTH: 4e-6}, (K, C), told=0.5, expects="given"),
}  # fmt: skip
"""Cases that the intervals are not meant for"""

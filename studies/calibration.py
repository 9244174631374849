"""How often a calibration's 95 % intervals hold the true values: made data, by a solver that is not the model.

python -m studies.calibration [--repetitions N] [--output FILE]
"""

from __future__ import annotations

import functools
import math
import time as clock
from collections import Counter
from concurrent.futures import Executor, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta
from scipy.stats import t as student

from benchmarks.gait import gait
from benchmarks.report import Section, machine, save
from knee_contact_ros import calibrate
from knee_contact_ros.lab.calibrate import Calibration
from knee_contact_ros.lab.calibrate.contact_problem import (
    fittable,
    make_contact_problem,
    measured_from,
)
from knee_contact_ros.lab.calibrate.fit import Fit, scale_misfits
from knee_contact_ros.lab.calibrate.unknowns import unknowns_of
from knee_contact_ros.parameters.files import load_parameters
from studies.reference import LAWS, Knee, Solution, solve

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
    given_noise: float = 0.0
    """Ratio of the noise that is given to the fit to the true one; 0: none is given"""
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
        law = {
            "contact.law": self.fitted_law or self.law,
            "drive": "displacement" if self.displacement else "force",
        }
        share = {} if self.share is None else {"load.share": self.share}
        return contact | law | share | {"femur.mass": self.mass}

    @property
    def measured(self) -> str:
        """Measured quantities in words, for the table."""
        units = {DEPTH: (1e6, "µm"), GAP: (1e6, "µm"), FORCE: (1.0, "N")}
        columns = [
            f"{SHORT[name]} ({size * units[name][0]:g} {units[name][1]})"
            for name, size in self.noise.items()
        ]
        given = ", noise given" if self.given_noise else ""
        return f"{', '.join(columns)}, {len(self.series[0])} samples{given}"


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
    "gait, depth, noise given": Case(
        VOIGT, HEALTHY, GAIT, {DEPTH: 5e-6}, (K, N, C), given_noise=1.0
    ),
    "gait, axial load, depth and force": Case(
        VOIGT, HEALTHY, GAIT, {DEPTH: 5e-6, FORCE: 10.0}, ("load.share", K), share=0.5
    ),
    "lift-off and landing, depth and gap": Case(
        VOIGT, HEALTHY, lift_off(), {DEPTH: 5e-6, GAP: 2e-5}, (K, C, "femur.mass")
    ),
    "drop test, gap and force": Case(
        "hunt_crossley",
        IMPACT,
        drop(),
        {GAP: 1e-5, FORCE: 5.0},
        (K, "contact.restitution"),
        starts=4,
    ),
    "drop test, Kelvin-Voigt, depth and gap": Case(
        VOIGT, HEALTHY, drop(), {DEPTH: 5e-6, GAP: 1e-5}, (K, C)
    ),
    "gait, two layers damped, depth": Case(
        "two_layer_viscoelastic",
        LAYERS | {"damp_first_layer": True},
        GAIT,
        {DEPTH: 2e-6},
        ("contact.layer_depth", "contact.stiffness_2"),
    ),
    "gait, two layers as printed, depth": Case(
        "two_layer_viscoelastic",
        LAYERS | {"damp_first_layer": False},
        GAIT,
        {DEPTH: 2e-6},
        ("contact.layer_depth", "contact.stiffness_2"),
        starts=4,
        part=0.5,
    ),
    "gait, height prescribed, force": Case(
        "hertz", SPRING, GAIT, {FORCE: 10.0}, ("femur.radius", K), displacement=True
    ),
    "gait, depth, one in twenty far off, soft_l1": Case(
        VOIGT, HEALTHY, GAIT, {DEPTH: 2e-6}, (K, C), loss="soft_l1", outliers=0.05
    ),
}
"""Cases that the intervals are meant for"""
DOUBTFUL = {
    "loads of 690 to 710 N, depth": Case(
        VOIGT, HEALTHY, narrow(), {DEPTH: 5e-6}, (K, N), expects="apart"
    ),
    "drop test, Kelvin-Voigt, force, which jumps at touch": Case(
        VOIGT, HEALTHY, drop(), {FORCE: 5.0}, (K, C), starts=4, expects="rough"
    ),
    "noise correlated by 0.9": Case(
        VOIGT, HEALTHY, GAIT, {DEPTH: 2e-6}, (K, C), correlation=0.9, expects="correlated"
    ),
    "another law: two layers, fitted by one": Case(
        "two_layer_viscoelastic",
        LAYERS | {"damp_first_layer": True},
        GAIT,
        {DEPTH: 2e-6},
        (K, C),
        fitted_law=VOIGT,
        part=0.2,
        expects="correlated",
    ),
    "least squares, one in twenty far off": Case(
        VOIGT, HEALTHY, GAIT, {DEPTH: 2e-6}, (K, C), outliers=0.05
    ),
    "the given noise is half of it": Case(
        VOIGT, HEALTHY, GAIT, {DEPTH: 4e-6}, (K, C), given_noise=0.5, expects="given"
    ),
}
"""Cases that the intervals are not meant for"""


LEVEL = 0.95
DOUBTFUL_PART = 0.25
"""Part of the repetitions for cases whose intervals are not meant to hold"""
HEADER = (
    "case",
    "measured (standard deviation of the noise)",
    "parameter",
    "true",
    "half width of the interval, median",
    "bias, in standard deviations of the estimates",
    "intervals that hold the true value",
    "95 % range of that",
    "for the same noise along straight lines",
    "trade-off reported",
    "time of a fit [s]",
)
TEXT = """\
Depth, force and gap are made by the project's reference solver, which shares no code with the model, with known
parameters, and normal noise is added, in each repetition another one, seeded by case and repetition. Each fit starts
from values that are drawn up to a third off (an exponent up to 0.2), and does not know the noise unless the case says
so. The range is where the true share lies with 95 % (Clopper-Pearson), for so many repetitions. Beside it stands how
many intervals would hold the true value for the very same noise if the answers were straight lines in the parameters,
where the theory is exact: a shortfall in both is chance."""
DOUBTFUL_TEXT = """\
The same, where what the intervals assume does not hold, or the data tell little. They are not meant to hold here: what
counts is whether a warning says so. Warned: how many fits came with the warning that is due (for outliers none is)."""


class Outcome(NamedTuple):
    """Results of all repetitions of a case, shape (repetitions, p) each."""

    inside: NDArray[np.bool_]
    estimates: Floats
    widths: Floats
    """Widths of the intervals, in parts of the true value"""
    warnings: Counter[str]
    seconds: float
    """Time of a fit [s]"""


def case_of(name: str) -> Case:
    """Look up a case by its name."""
    return CASES[name] if name in CASES else DOUBTFUL[name]


@functools.cache
def truth(name: str) -> Solution:
    """Solve a case by the reference.

    Raises:
        ValueError: it is not exact enough to be a truth.
    """
    case = case_of(name)
    exact = solve(Knee(LAWS[case.law](**case.arguments), case.mass), *case.series)
    if not np.nanmax(exact.depth_bound) < 1e-12 or np.isnan(exact.depth).any():
        raise ValueError(f"{name}: the reference errs by {np.nanmax(exact.depth_bound):.1g} m")
    return exact


def made(name: str, case: Case, random: np.random.Generator) -> dict[str, Floats]:
    """Make a table of measurements of a case with new noise."""
    exact, (time, angle, load) = truth(name), case.series
    table = {"time": time, "flexion_angle": angle}
    if case.share is None:
        table["load"] = load
    else:
        table["axial_load"] = load / case.share
    if case.displacement:
        table["femoral_height"] = exact.height
    apart = exact.depth < 0.0
    whole = {
        DEPTH: np.where(apart, math.nan, exact.depth),
        GAP: np.where(apart, -exact.depth, math.nan),
        FORCE: exact.force,
    }
    for column, size in case.noise.items():
        noise = random.standard_normal(len(time))
        for place in range(1, len(time) if case.correlation else 0):  # of unit variance still
            noise[place] = (
                case.correlation * noise[place - 1]
                + math.sqrt(1 - case.correlation**2) * noise[place]
            )
        far = random.random(len(time)) < case.outliers
        table[column] = whole[column] + size * np.where(
            far, 20.0 * random.standard_normal(len(time)), noise
        )
    return table


def fit(name: str, case: Case, repetition: int) -> Calibration:
    """Fit a case to data of its own in one repetition."""
    random = np.random.default_rng((2026, sum(name.encode()), repetition))
    table = made(name, case, random)
    start = {each: _start(each, value, random) for each, value in case.free.items()}
    sigma = {column: case.given_noise * size for column, size in case.noise.items()}
    return calibrate(
        table,
        [case.parameters, start],
        list(case.free),
        sigma=sigma if case.given_noise else None,
        loss=case.loss,
        level=LEVEL,
        starts=case.starts,
        compiled=True,
    )


def _start(name: str, true: float, random: np.random.Generator) -> float:
    off = random.uniform(-1.0, 1.0)
    if name == "femur.radius":  # of a height that is prescribed: else nothing touches
        return true + 2e-4 * off
    return true + 0.2 * off if name.endswith("exponent") else true * math.exp(0.3 * off)


def repetition(
    name: str, number: int
) -> tuple[list[bool], list[float], list[float], set[str], float]:
    """Do one fit; return which intervals hold the truth, estimates, half widths, kinds of warnings, and time [s]."""
    case = case_of(name)
    began = clock.perf_counter()
    found = fit(name, case, number)
    took = clock.perf_counter() - began
    both = [(found.intervals[each], true) for each, true in case.free.items()]
    kinds = {
        kind
        for kind, words in KINDS.items()
        if any(words in warning for warning in found.warnings)
    }
    return (
        [one.low <= true <= one.high for one, true in both],
        [found.values[each] for each in case.free],
        [0.5 * (one.high - one.low) / true for one, true in both],
        kinds,
        took,
    )


def outcome(name: str, repetitions: int, pool: Executor) -> Outcome:
    """Collect all repetitions of a case."""
    every = list(pool.map(repetition, [name] * repetitions, range(repetitions)))
    inside, estimates, widths, kinds, took = zip(*every, strict=True)
    warnings = Counter(kind for each in kinds for kind in each)
    return Outcome(
        np.array(inside), np.array(estimates), np.array(widths), warnings, float(np.median(took))
    )


def along_straight_lines(name: str, repetitions: int) -> NDArray[np.int64]:
    """How many intervals would hold the truth for the same noise if answers were straight lines in the parameters.

    It judges the draws and not the fits: beside it one sees which part of a shortfall is theirs.
    """
    case = case_of(name)
    parameters, table = (
        load_parameters([case.parameters]),
        made(name, case, np.random.default_rng(0)),
    )
    measured = measured_from(table, parameters.drive)
    problem = make_contact_problem(
        parameters, measured, unknowns_of(list(case.free), fittable(), parameters, name), True
    )
    slopes = Fit.at_start(problem, "linear", case.noise).slopes
    spread = np.linalg.inv(slopes.T @ slopes)
    held = np.zeros(len(case.free), dtype=np.int64)
    exact, freedom = truth(name), len(slopes) - len(spread)
    for number in range(repetitions):
        drawn = made(name, case, np.random.default_rng((2026, sum(name.encode()), number)))
        whole = {DEPTH: exact.depth, GAP: -exact.depth, FORCE: exact.force}
        noise = {
            each: (drawn[each] - whole[each])[np.isfinite(drawn[each])]
            for each in measured.answers
        }
        off = scale_misfits(noise, case.noise)
        error = spread @ (slopes.T @ off)
        size = (
            1.0
            if case.given_noise
            else math.sqrt(float(((off - slopes @ error) ** 2).sum()) / freedom)
        )
        limit = student.ppf(0.5 + 0.5 * LEVEL, math.inf if case.given_noise else freedom)
        held += np.abs(error) <= limit * size * np.sqrt(np.diag(spread))
    return held


KINDS = {
    "trade": "trade off",
    "apart": "cannot tell them apart",
    "correlated": "correlated from sample to sample",
    "given": "times the given noise",
    "rough": "intervals are rough",
    "open": "not bounded",
}
"""Kinds of warnings, by a phrase of their text"""


def rows(
    name: str, case: Case, found: Outcome, control: NDArray[np.int64] | None
) -> list[list[str]]:
    """Rows of the table for a case: one for each parameter."""
    table = []
    number = len(found.inside)
    for place, (parameter, true) in enumerate(case.free.items()):
        held = int(found.inside[:, place].sum())
        low, high = (
            beta.ppf(0.025, held, number - held + 1),
            beta.ppf(0.975, held + 1, number - held),
        )
        spread = found.estimates[:, place].std(ddof=1)
        bias = (found.estimates[:, place].mean() - true) / spread
        low, high = 0.0 if math.isnan(low) else low, 1.0 if math.isnan(high) else high
        first = place == 0
        table.append(
            [
                name if first else "",
                case.measured if first else "",
                parameter,
                f"{true:.6g}",
                f"{100.0 * np.median(found.widths[:, place]):.2g} %",
                f"{bias:+.2f}",
                f"{100.0 * held / number:.1f} % ({held} of {number})",
                f"{100.0 * low:.1f} to {100.0 * high:.1f} %",
                "-" if control is None else str(control[place]),
                f"{found.warnings[case.expects or 'trade']} of {number}" if first else "",
                f"{found.seconds:.2f}" if first else "",
            ]
        )
    return table


@click.command()
@click.option("--repetitions", default=400, show_default=True)
@click.option("--workers", default=2, show_default=True, help="Processes.")
@click.option("--only", default="", help="Cases whose name has this.")
@click.option(
    "--output",
    default="docs/studies/calibration.md",
    show_default=True,
    type=click.Path(path_type=Path),
)
def main(repetitions: int, workers: int, only: str, output: Path) -> None:
    """Measure and write the tables."""
    tables: list[list[list[str]]] = [[], []]
    held: list[float] = []
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        for number, cases in enumerate((CASES, DOUBTFUL)):
            for name, case in cases.items():
                if only not in name:
                    continue
                count = round(case.part * repetitions * (DOUBTFUL_PART if number else 1.0))
                found = outcome(name, count, pool)
                control = None if number or case.outliers else along_straight_lines(name, count)
                held += [] if number else found.inside.ravel().tolist()
                tables[number] += rows(name, case, found, control)
                for row in tables[number][-len(case.free) :]:
                    click.echo(" | ".join(row), err=True)
                write(output, repetitions, tables, held)


def write(
    output: Path, repetitions: int, tables: list[list[list[str]]], held: list[float]
) -> None:
    """Write the page with the tables that there are so far."""
    text = f"{TEXT} In all, {100.0 * np.mean(held):.1f} % of {len(held)} intervals hold it."
    doubtful = tuple("warned" if each == "trade-off reported" else each for each in HEADER)
    sections = [Section("", text, HEADER, tables[0])]
    sections += (
        [Section("Where they do not hold", DOUBTFUL_TEXT, doubtful, tables[1])]
        if tables[1]
        else []
    )
    save(
        output,
        "Calibration",
        f"python -m studies.calibration --repetitions {repetitions}",
        sections,
        machine(),
    )


if __name__ == "__main__":
    main()

"""How often intervals of a person's constants hold the true values where what is left is alike from sample to sample.

python -m studies.load_calibration [--repetitions N] [--output FILE]
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import t as student

from benchmarks.report import Section, machine, save
from knee_contact_ros.joint_reaction.leg import STILL, UNKNOWN, Ground, Joints
from knee_contact_ros.lab.calibrate.fit import LINEAR, correlations, fitted, intervals, samples_per_value
from knee_contact_ros.lab.calibrate.load import AXIAL_FORCE, LoadProblem, Referenced, fittable_in, load_problem_of
from knee_contact_ros.lab.calibrate.problem import unknowns_of
from knee_contact_ros.offline.estimate_load import Sensed
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import LoadParameters

Floats = NDArray[np.float64]
TRUE = {"person.moment_arm_scale": 0.9, "person.co_contraction": 0.35, "person.tone": 0.25}
BODY = {"person.mass": 70.0, "person.height": 1.75}
WEIGHT, STRIDE, STEP, LEVEL = 70.0 * 9.80665, 1.1, 0.01, 0.95
NOISE = 60.0
"""Standard deviation of the noise [N]"""
WAYS = ("as if independent", "fewer samples", "sandwich")
REPETITIONS = 600
"""Number of repetitions along straight lines, where they cost nothing"""
TEXT = """\
Made walking (strides of 1.1 s at 100 Hz, level `ground_force`), its joint reaction by the estimator itself with known
constants, and normal noise of 60 N that is alike from sample to sample: chains (each value a part of the one before and
a new one), and what swings with the strides (a resonance). Whole fits, as `knee-contact calibrate` does them: intervals
of 95 % that hold the true value, of the three constants."""
WAYS_TEXT = """\
The same along straight lines in the parameters, 600 repetitions each, by three ways. *As if independent*: all samples
count. *Fewer samples*, as is done: n / τ count, τ = 1 + 2 Σ ρ(k) up to where the correlation of what is left is first 0
or less. *Sandwich*: the deviation of each estimate from the correlation of its own scores, summed likewise, which is
what a block bootstrap aims at, too."""
CONSTANTS = tuple(name.removeprefix("person.") for name in TRUE)


class Noise(NamedTuple):
    """A noise whose values correlate from sample to sample."""

    words: str
    filter: tuple[float, ...]
    """Coefficients of a recursion on earlier values, the first of which is 1"""


def swinging(frequency: float, memory: float) -> tuple[float, ...]:
    """Coefficients of a recursion that resonates at a frequency [Hz]."""
    return (1.0, -2.0 * memory * math.cos(math.tau * frequency * STEP), memory * memory)


NOISES = (
    Noise("independent", (1.0,)), Noise("chain, 0.5", (1.0, -0.5)), Noise("chain, 0.9", (1.0, -0.9)),
    Noise("chain, 0.97", (1.0, -0.97)), Noise("swings once a stride", swinging(1.0 / STRIDE, 0.97)),
    Noise("swings twice a stride", swinging(2.0 / STRIDE, 0.98)),
)  # fmt: skip
COUNTS = (220, 400, 1700)


def drawn(noise: Noise, count: int, random: np.random.Generator) -> Floats:
    """Draw noise [N], shape (count,), with a standard deviation of `NOISE`."""
    response = lfilter([1.0], noise.filter, np.eye(1, 20_000)[0])
    chain: Floats = lfilter([1.0], noise.filter, random.standard_normal(count + 3000))[3000:]
    return NOISE * chain / math.sqrt(float((response**2).sum()))


def walking(count: int) -> tuple[Sensed, ...]:
    """Flexion [rad] and a vertical force [N] of two humps, shape (count,) each."""
    samples = []
    for place in range(count):
        phase = (place * STEP / STRIDE) % 1.0
        bent, swung = math.exp(-(((phase - 0.14) / 0.07) ** 2)), math.exp(-(((phase - 0.72) / 0.11) ** 2))
        humps = math.exp(-(((phase - 0.15) / 0.08) ** 2)) + math.exp(-(((phase - 0.47) / 0.08) ** 2))
        stance = max(math.sin(math.pi * phase / 0.62), 0.0) if phase < 0.62 else 0.0
        vertical = WEIGHT * (0.8 * stance**0.3 + 0.35 * humps * stance)
        joints = Joints(0.15 + 0.25 * bent + 0.95 * swung, UNKNOWN, UNKNOWN)
        samples.append(
            Sensed(round(place * STEP * 1e9), joints, STILL, Ground((0.0, vertical, 0.0), (UNKNOWN,) * 3), 0)
        )
    return tuple(samples)


@cache
def true_problem(count: int) -> LoadProblem:
    """Problem of the fit against the true joint reaction, at the true constants."""
    parameters = load_parameters({**BODY, **TRUE}, LoadParameters)
    empty = Referenced("made", "", {AXIAL_FORCE: np.zeros(count)}, walking(count), {}, ())
    problem = load_problem_of(parameters, empty, unknowns_of(list(TRUE), fittable_in(parameters)))
    return held_against(problem, problem.answers(problem.start)[AXIAL_FORCE])


def held_against(problem: LoadProblem, reference: Floats) -> LoadProblem:
    """Problem in which the axial force is held against another reference [N]."""
    measured = replace(problem.measured, answers={AXIAL_FORCE: reference})
    return load_problem_of(problem.parameters, measured, problem.unknowns)


def held_by_a_fit(count: int, place: int, number: int) -> list[bool]:
    """Whether the intervals of a fit hold the true constants."""
    random = np.random.default_rng((2026, count, place, number))
    problem = true_problem(count)
    reference = problem.measured.answers[AXIAL_FORCE] + drawn(NOISES[place], count, random)
    minimum = fitted(held_against(problem, reference), LINEAR, {}, 1, lambda *_: None)
    found = intervals(minimum, LEVEL, lambda *_: None, ignore_better=True)
    return [each.low <= true <= each.high for each, true in zip(found, TRUE.values(), strict=True)]


def held_along_lines(count: int, place: int) -> Floats:
    """Parts of the intervals that hold the truth, shape (methods, constants)."""
    problem, random = true_problem(count), np.random.default_rng((2026, count, place))
    slopes = problem.jacobian(problem.start, {AXIAL_FORCE: 1.0})
    weights = slopes @ np.linalg.inv(slopes.T @ slopes)
    held = np.zeros((len(WAYS), len(TRUE)))
    for _ in range(REPETITIONS):
        error = weights.T @ (noise := drawn(NOISES[place], count, random))
        held += [np.abs(error) <= way(noise - slopes @ error, weights) for way in (independent, fewer, sandwich)]
    return held / REPETITIONS


def independent(left: Floats, weights: Floats) -> Floats:
    """Half widths, shape (p,), if all samples count as independent."""
    return _half(left, weights, len(left))


def fewer(left: Floats, weights: Floats) -> Floats:
    """Half widths, shape (p,), if the samples count as fewer than they are."""
    return _half(left, weights, len(left) / samples_per_value(left))


def _half(left: Floats, weights: Floats, number: float) -> Floats:
    freedom = max(number - weights.shape[1], 1.0)
    deviations = np.sqrt((left**2).sum() / freedom * (weights**2).sum(axis=0))
    return np.asarray(deviations * student.ppf(0.5 + 0.5 * LEVEL, freedom), dtype=np.float64)


def sandwich(left: Floats, weights: Floats) -> Floats:
    """Half widths, shape (p,), by the correlation of each estimate's scores."""
    variances = []
    for score in (weights * left[:, None]).T:
        known = correlations(score)
        ends = np.flatnonzero(known <= 0.0)
        variances.append((score**2).sum() * (1.0 + 2.0 * known[1 : ends[0] if len(ends) else None].sum()))
    freedom = max(len(left) / samples_per_value(left) - weights.shape[1], 1.0)
    return np.asarray(np.sqrt(variances) * student.ppf(0.5 + 0.5 * LEVEL, freedom), dtype=np.float64)


def percent(held: Floats) -> list[str]:
    """Format parts as percentages for a table."""
    return [f"{100.0 * part:.0f} %" for part in held]


@click.command()
@click.option("--repetitions", default=100, show_default=True)
@click.option("--workers", default=2, show_default=True, help="Processes.")
@click.option(
    "--output", default="docs/studies/load-calibration.md", show_default=True, type=click.Path(path_type=Path)
)
def main(repetitions: int, workers: int, output: Path) -> None:
    """Measure and write the tables."""
    fits: list[list[str]] = []
    ways: list[list[str]] = []
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        for place, noise in enumerate(NOISES):
            for count in COUNTS:
                held = held_along_lines(count, place)
                ways += [[noise.words, str(count), way, *percent(part)] for way, part in zip(WAYS, held, strict=True)]
                if count == COUNTS[1]:
                    every = _fits(pool.map, count, place, repetitions)
                    fits.append([noise.words, str(count), *percent(every.mean(axis=0))])
                    click.echo(" | ".join(fits[-1]), err=True)
    header = ("noise", "samples")
    sections = [Section("", TEXT, (*header, *CONSTANTS), fits),
                Section("Ways to count", WAYS_TEXT, (*header, "way", *CONSTANTS), ways)]  # fmt: skip
    command = f"python -m studies.load_calibration --repetitions {repetitions}"
    save(output, "Calibration of the load estimate", command, sections, machine())


def _fits(each: Callable[..., object], count: int, place: int, repetitions: int) -> Floats:
    arguments = [count] * repetitions, [place] * repetitions, range(repetitions)
    return np.array(list(each(held_by_a_fit, *arguments)), dtype=np.float64)  # type: ignore[call-overload]


if __name__ == "__main__":
    main()

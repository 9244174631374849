"""From standard deviations of inputs and parameters to those of depth and force: along straight lines, or by chance.

The linear way is the law of propagation (JCGM 100:2008, Sec. 5.1.2) for independent inputs: u² = Σ (∂f/∂x u(x))². The
slopes are those between one deviation less and one more, each a whole run of the model, so that a bend within them
counts on average. `sampled` draws all inputs at once (JCGM 101:2008) and needs no straight lines.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.types import Rows
from knee_contact_ros.offline.uncertainty.deviations import Deviation
from knee_contact_ros.offline.uncertainty.replay import Given, Moved
from knee_contact_ros.system.errors import UsageError

Floats = NDArray[np.float64]
DEPTH, FORCE = "penetration_depth", "contact_force"
LEVEL = 0.95
"""Of an interval, unless another one is asked for"""
TRIES = 100
"""Draws of a sample until all parameters lie in their ranges"""


class Propagated(NamedTuple):
    """The standard deviations of a compartment's depth and force, arrays of shape (n,)."""

    rows: Rows
    """The answers themselves, with the numerical errors beside"""
    parts: dict[Deviation, tuple[Floats, Floats]]
    """What each of the inputs does to depth [m] and force [N] alone, with its sign: when the input grows by one
    deviation"""

    @property
    def depth(self) -> Floats:
        """Standard deviation of the penetration depth [m]."""
        return self._together(0)

    @property
    def force(self) -> Floats:
        """Standard deviation of the contact force [N]."""
        return self._together(1)

    def depth_interval(self, level: float = LEVEL) -> tuple[Floats, Floats]:
        """Between which the depth [m] lies with a probability, if its errors are normal; never below 0."""
        return self._interval(DEPTH, self.depth, level)

    def force_interval(self, level: float = LEVEL) -> tuple[Floats, Floats]:
        """The same of the contact force [N], which is not cut off where a law may pull."""
        return self._interval(FORCE, self.force, level)

    def _interval(self, name: str, deviation: Floats, level: float) -> tuple[Floats, Floats]:
        reach, values = factor(level) * deviation, np.asarray(self.rows[name])
        least = np.minimum(values, 0.0)
        return np.maximum(values - reach, least), values + reach

    def _together(self, which: int) -> Floats:
        squares = [both[which] ** 2 for both in self.parts.values()]
        return np.asarray(np.sqrt(np.sum(squares, axis=0)))


class Sampled(NamedTuple):
    """What samples of the inputs make of a compartment's depth and force, arrays of shape (n,)."""

    number: int
    depth_mean: Floats
    """[m]"""
    depth: Floats
    """Standard deviation [m]"""
    force_mean: Floats
    """[N]"""
    force: Floats
    """Standard deviation [N]"""
    depth_inside: Floats
    """Share of the samples within the linear interval of `LEVEL`"""
    force_inside: Floats


def factor(level: float) -> float:
    """How many standard deviations an interval of a probability reaches to either side.

    Raises:
        UsageError: it is none.
    """
    if not 0.0 < level < 1.0:
        raise UsageError(f"level: {level!r} is not allowed; a probability between 0 and 1")
    return NormalDist().inv_cdf(0.5 + 0.5 * level)


def propagated(given: Given, deviations: Sequence[Deviation], advance: Callable[[int, int], None]) -> list[Propagated]:
    """Of each compartment, along straight lines; `advance` is told the inputs that are done, and how many there are.

    Raises:
        UsageError: an input or a parameter may go neither up nor down by its deviation.
    """
    parts: list[dict[Deviation, tuple[Floats, Floats]]] = [{} for _ in given.rows]
    for done, deviation in enumerate(deviations, start=1):
        # All are named, for one that is does not follow another: a lateral parameter has its own deviation then.
        low, high = (
            _answers(given, {each: times * (each == deviation) for each in deviations}) for times in (-1.0, 1.0)
        )
        if low is None and high is None:
            raise UsageError(
                f"uncertainty: {deviation.name}: {deviation.text} leaves the range of what it is of both ways"
            )
        sides = [one or list(given.rows) for one in (low, high)]
        width = 2.0 if low and high else 1.0
        for place, (below, above) in enumerate(zip(*sides, strict=True)):
            depth, force = ((above[name] - below[name]) / width for name in (DEPTH, FORCE))
            parts[place][deviation] = depth, force
        advance(done, len(deviations))
    return [Propagated(rows, of_it) for rows, of_it in zip(given.rows, parts, strict=True)]


def sampled(
    given: Given, linear: Sequence[Propagated], samples: int, seed: int, advance: Callable[[int, int], None]
) -> list[Sampled]:
    """Of each compartment, by samples of all inputs at once, normal and independent, to hold `linear` against.

    A sample with a parameter out of its range is drawn again.
    """
    random = np.random.default_rng(seed)
    deviations = list(linear[0].parts)
    bounds = [(one.depth_interval(), one.force_interval()) for one in linear]
    sums = [np.zeros((3, 2, len(one.rows))) for one in linear]
    for done in range(1, samples + 1):
        for place, rows in enumerate(_drawn(given, deviations, random)):
            before, total = linear[place].rows, sums[place]
            for which, name in enumerate((DEPTH, FORCE)):
                low, high = bounds[place][which]
                off = rows[name] - before[name]
                total[0, which] += off
                total[1, which] += off * off
                total[2, which] += (low <= rows[name]) & (rows[name] <= high)
        advance(done, samples)
    found = []
    for one, (first, second, inside) in zip(linear, sums, strict=True):
        mean = first / samples
        spread = np.sqrt(np.maximum(second - samples * mean**2, 0.0) / max(samples - 1, 1))
        means = [mean[which] + one.rows[name] for which, name in enumerate((DEPTH, FORCE))]
        shares = inside / samples
        found.append(Sampled(samples, means[0], spread[0], means[1], spread[1], shares[0], shares[1]))
    return found


def _answers(given: Given, moved: Moved) -> list[Rows] | None:
    """Those to inputs that are off; None if one leaves its range."""
    try:
        return given.answers(moved)
    except UsageError:
        return None


def _drawn(given: Given, deviations: Sequence[Deviation], random: np.random.Generator) -> list[Rows]:
    for _ in range(TRIES):
        try:
            return given.answers(dict(zip(deviations, random.standard_normal(len(deviations)).tolist(), strict=True)))
        except UsageError as error:
            last = error
    raise UsageError(f"uncertainty: of {TRIES} samples none lies in the parameters' ranges: {last}")

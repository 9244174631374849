"""Propagation of standard deviations of inputs and parameters to depth and force: linear, or by random samples.

Linear propagation follows JCGM 100:2008, Sec. 5.1.2, for independent inputs: u² = Σ (∂f/∂x u(x))². The
slopes are differences between one deviation less and one more, each a whole run of the model, so that a curvature
between them counts on average. `sampled` draws all inputs at once (JCGM 101:2008) and assumes no linearity.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.types import Rows
from knee_contact_ros.offline.uncertainty.deviations import Deviation
from knee_contact_ros.offline.uncertainty.replay import Given, Moved
from knee_contact_ros.system.errors import UsageError

Floats = NDArray[np.float64]
DEPTH, FORCE = "penetration_depth", "contact_force"
LEVEL = 0.95
"""Default probability of an interval"""
TRIES = 100
"""Largest number of draws of a sample until all parameters lie in their ranges"""


class Propagated(NamedTuple):
    """Standard deviations of a compartment's depth and force, arrays of shape (n,)."""

    rows: Rows
    """The answers themselves, with their estimated numerical errors"""
    parts: dict[Deviation, tuple[Floats, Floats]]
    """Changes of depth [m] and force [N], with their signs, when one input alone grows by one deviation"""

    @property
    def depth(self) -> Floats:
        """Standard deviation of the penetration depth [m]."""
        return self._combined(0)

    @property
    def force(self) -> Floats:
        """Standard deviation of the contact force [N]."""
        return self._combined(1)

    def depth_interval(self, level: float = LEVEL) -> tuple[Floats, Floats]:
        """Return the bounds between which the depth [m] lies with a probability, if errors are normal; not below 0."""
        return self._interval(DEPTH, self.depth, level)

    def force_interval(self, level: float = LEVEL) -> tuple[Floats, Floats]:
        """Return the bounds between which the contact force [N] lies with a probability, if errors are normal.

        They are not below 0, unless the force itself is because the contact law allows tension.
        """
        return self._interval(FORCE, self.force, level)

    def _interval(self, name: str, deviation: Floats, level: float) -> tuple[Floats, Floats]:
        reach, values = factor(level) * deviation, np.asarray(self.rows[name])
        least = np.minimum(values, 0.0)
        return np.maximum(values - reach, least), values + reach

    def _combined(self, which: int) -> Floats:
        """Return the standard deviation that all inputs make together, of the depth (0) or the force (1)."""
        squares = [part[which] ** 2 for part in self.parts.values()]
        return np.asarray(np.sqrt(np.sum(squares, axis=0)))


class Sampled(NamedTuple):
    """Mean and standard deviation of a compartment's depth and force over samples of the inputs, shape (n,)."""

    number: int
    """Number of samples"""
    depth_mean: Floats
    """Mean depth [m]"""
    depth: Floats
    """Standard deviation of the depth [m]"""
    force_mean: Floats
    """Mean contact force [N]"""
    force: Floats
    """Standard deviation of the contact force [N]"""
    depth_inside: Floats
    """Share of the samples whose depth is within the linear interval of `LEVEL`"""
    force_inside: Floats
    """Share of the samples whose force is within the linear interval of `LEVEL`"""


def factor(level: float) -> float:
    """Return the half-width, in standard deviations, of the interval of a normal value with probability `level`.

    Raises:
        UsageError: `level` is not between 0 and 1.
    """
    if not 0.0 < level < 1.0:
        raise UsageError(f"level: {level!r} is not allowed; a probability between 0 and 1")
    return NormalDist().inv_cdf(0.5 + 0.5 * level)


def propagated(given: Given, deviations: Sequence[Deviation], advance: Callable[[int, int], None]) -> list[Propagated]:
    """Propagate deviations linearly, for each compartment; `advance` is called with the inputs done and in all.

    Raises:
        UsageError: an input or a parameter leaves its range by one deviation both upwards and downwards.
    """
    parts: list[dict[Deviation, tuple[Floats, Floats]]] = [{} for _ in given.rows]
    for done, deviation in enumerate(deviations, start=1):
        # All are named, as a named lateral parameter does not follow its medial one: it has its own deviation.
        low, high = (
            _answers(given, {other: times * (other == deviation) for other in deviations}) for times in (-1.0, 1.0)
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
    return [Propagated(rows, part) for rows, part in zip(given.rows, parts, strict=True)]


def sampled(
    given: Given, linear: Sequence[Propagated], samples: int, seed: int, advance: Callable[[int, int], None]
) -> list[Sampled]:
    """Draw samples of all inputs at once, normal and independent, and compare them with `linear`, for each compartment.

    A sample with a parameter out of its range is drawn again. `advance` is called with the samples done and in all.
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
    results = []
    for one, (first, second, inside) in zip(linear, sums, strict=True):
        mean = first / samples
        spread = np.sqrt(np.maximum(second - samples * mean**2, 0.0) / max(samples - 1, 1))
        means = [mean[which] + one.rows[name] for which, name in enumerate((DEPTH, FORCE))]
        shares = inside / samples
        results.append(Sampled(samples, means[0], spread[0], means[1], spread[1], shares[0], shares[1]))
    return results


def _answers(given: Given, moved: Moved) -> list[Rows] | None:
    """Return the answers to inputs with errors; None if one leaves its range."""
    try:
        return given.answers(moved)
    except UsageError:
        return None


def _drawn(given: Given, deviations: Sequence[Deviation], random: np.random.Generator) -> list[Rows]:
    """Return the answers to a random sample of the inputs, in which all parameters are in their ranges."""
    for _ in range(TRIES):
        try:
            return given.answers(dict(zip(deviations, random.standard_normal(len(deviations)).tolist(), strict=True)))
        except UsageError as error:
            last = error
    raise UsageError(f"uncertainty: of {TRIES} samples none lies in the parameters' ranges: {last}")

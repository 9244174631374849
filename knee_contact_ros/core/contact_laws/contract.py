"""Numerical tests of the contract of contact laws (`ContactLaw`), made once for every law that a model is made with.

The formula of each layer is evaluated at depths over decades beyond the beginning of the layer, up to twice its
thickness, and at rates of both signs. Between these depths, jumps and kinks are searched for by bisection.
"""

from __future__ import annotations

import functools
import itertools
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import ContactLaw, LayerFormula

DECADES = tuple(10.0 ** (half / 2.0) for half in range(-18, -3))
"""Depths [m] beyond the beginning of a layer, 1e-9 to 1e-2: from far below any tolerance to far beyond any knee"""
PARTS = (1e-3, 0.1, 0.5, 0.9, 1.0, 1.1, 1.5, 2.0)
"""Depths beyond the beginning of a layer as parts of its thickness"""
BEFORE = (1e-3, 1e-6, 1e-9)
"""Depths [m] before the beginning of a layer"""
RATES = (-10.0, -0.1, -1e-3, 1e-3, 0.1, 10.0)
"""Penetration rates [m/s]; knees touch at up to some 1 m/s."""
IMPACT = 2.0
"""Impact speed [m/s] that is tried beside 0, that of a contact that began at rest"""
FAR_DEPTHS = (-10.0, -0.01, 0.0, 1.0, 1e3, 1e9)
"""Depths [m] that integrators may try: a flight leads far from the tibia, and the static search ends at 1e9 m"""
FAR_RATES = (-1e4, 0.0, 1e4)
FAR_IMPACTS = (-1.0, 0.0, 1e4)
SLOPE_RATES = (-0.1, 0.0, 10.0)
PULLED = -100.0
"""Rate [m/s] beside `SLOPE_RATES` at which the slope over the depth is compared with the force"""
LETTING_GO = 0.9
"""Another such rate, as a part of that at which the force vanishes: there a damping that grows with the depth matters
most"""

EPSILON = sys.float_info.epsilon
EQUAL = 1e-9
"""Part of a force, or N, up to which two forces count as equal. Formulas of a few terms err by 1e-15 of their terms; a
force that is 1e-9 off shifts a depth by less than 1e-9 of it."""
TRUE = 1e-3
"""Tolerated relative error of a slope. The difference quotient it is compared with errs by 1e-10 for a power of the
depth, and by 2e-5 where the force grows e-fold every 1000th of the depth. Estimates carry a safety of 8."""
STEP = 1e-5
"""Step of the difference quotient to both sides, as a part of the depth"""
RESOLVED = 1e4
"""Least width of a difference quotient or an interval, in units in the last place of the depth"""
SMOOTH_FORCE = 1e-4
"""Tolerated deviation of the force in the middle of an interval from the cubic through its ends, relative to the
force"""
SMOOTH_SLOPE = 2e-3
"""Tolerated deviation of the slope in the middle of an interval from the mean of its ends, relative to the slope. That
of a smooth slope is less once the interval is narrow against its depth; that of a leap of twice as much remains."""
NARROW = 1e-6
"""Width of an interval, as a part of its depth, below which it is not halved further"""
MOST_HALVINGS = 20_000
"""Largest number of intervals between two depths; a power of the depth needs up to 40, a force that grows e-fold every
500th of the depth 8000"""
GAP = 1e-9
"""Distance [m] from the beginning of a layer, on both sides, at which a formula must still give its value there"""


State = tuple[float, float, float]
"""Depth beyond the beginning of the layer [m], rate and impact speed [m/s]"""
Answer = tuple[float, float, float]
"""Force [N], and its slopes over the depth [N/m] and over the rate [N s/m]"""


class Trial(NamedTuple):
    """The formula of one layer, and where it is tested."""

    formula: LayerFormula
    begin: float
    """Depth [m] at which the layer begins"""
    offsets: Sequence[float]
    """Depths beyond the beginning of the layer [m], increasing"""
    impacts: Sequence[float]
    """Impact speeds [m/s]"""
    answers: dict[State, Answer]
    """What the formula has answered so far"""

    def at(self, offset: float, rate: float = 0.0, impact_speed: float = 0.0) -> Answer:
        """Return force [N] and slopes [N/m], [N s/m] at a depth beyond the layer's beginning [m]; NaN if that fails."""
        state = (offset, rate, impact_speed)
        answer = self.answers.get(state)
        if answer is None:
            answer = self.answers[state] = self.ask(*state)
        return answer

    def ask(self, offset: float, rate: float, impact_speed: float) -> Answer:
        """Return force and slopes as `at` does, by evaluating the formula anew."""
        try:
            force, stiffness, damping = self.formula.force_at(self.begin + offset, rate, impact_speed)
            return float(force), float(stiffness), float(damping)
        except (ArithmeticError, ValueError, TypeError):  # a root of what is negative is complex
            return math.nan, math.nan, math.nan

    def states(self) -> Iterator[State]:
        """Yield all states with a rate other than 0 that are tested."""
        before = (-offset for offset in BEFORE)
        return itertools.product((*before, *self.offsets), RATES, self.impacts)

    def where(self, offset: float, rate: float = 0.0, impact_speed: float = 0.0) -> str:
        """Describe a state for a message."""
        text = f"at a depth of {self.begin + offset:g} m and a rate of {rate:g} m/s"
        return text if impact_speed == 0.0 else f"{text} (impact speed {impact_speed:g} m/s)"


def check(law: ContactLaw) -> None:
    """Reject a law that breaks its contract. Each law is tested once, in milliseconds.

    Raises:
        ValueError: one line that says which clause of `ContactLaw` is broken, where, by what, and what is allowed.
    """
    broken = broken_clauses(law)
    if broken:
        more = f" (and {len(broken) - 1} more)" if len(broken) > 1 else ""
        raise ValueError(f"contact law: {broken[0]}{more}")


def broken_clauses(law: ContactLaw) -> list[str]:
    """Return the broken clauses of a law's contract, one line for each clause and layer."""
    try:
        # Named tuples of different types are equal if their numbers are.
        return list(_known(law, tuple(type(layer.formula) for layer in law.layers)))
    except TypeError:  # its constants have no hash
        return _broken(law)


@functools.lru_cache(maxsize=64)
def _known(law: ContactLaw, _types: tuple[type, ...]) -> tuple[str, ...]:
    return tuple(_broken(law))


def _broken(law: ContactLaw) -> list[str]:
    wrong = _layers(law)
    if wrong:
        return [f"layers: {wrong}"]
    lines = []
    for number, trial in enumerate(_trials(law), start=1):
        name = f"layer {number} ({type(trial.formula).__name__})"
        for clause, broken in CLAUSES.items():
            wrong = broken(trial)
            if wrong:
                lines.append(f"{name}, {clause}: {wrong}")
            if wrong and clause == "finite":
                break
        else:
            wrong = _touch(trial) if number == 1 else _joint(law, number - 1)
            if wrong:
                lines.append(f"{name}, {'touch' if number == 1 else 'joint'}: {wrong}")
    return lines


def _trials(law: ContactLaw) -> Iterator[Trial]:
    ends = [*(layer.begin for layer in law.layers[1:]), math.inf]
    for layer, end in zip(law.layers, ends, strict=True):
        thickness = end - layer.begin
        offsets = {offset for offset in DECADES if offset <= 2.0 * thickness}
        if thickness < math.inf:
            offsets |= {part * thickness for part in PARTS}
        impacts = (0.0, IMPACT) if layer.formula.remembers_impact() else (0.0,)
        yield Trial(formula=layer.formula, begin=layer.begin, offsets=sorted(offsets), impacts=impacts, answers={})


def _layers(law: ContactLaw) -> str:
    begins = [layer.begin for layer in law.layers]
    if not begins or begins[0] != 0.0:
        return f"the first one begins at {begins[0]:g} m; allowed is 0" if begins else "there is none"
    for before, begin in itertools.pairwise(begins):
        if not before < begin < math.inf:
            return f"one begins at {begin:g} m, and the one before at {before:g} m; they must go deeper one by one"
    if not law.thickness > 0.0:
        return f"the thickness is {law.thickness:g} m; allowed is > 0"
    types = {type(layer.formula).__name__ for layer in law.layers}
    if len({type(layer.formula) for layer in law.layers}) > 1:
        return f"their formulas are of several types, {' and '.join(sorted(types))}; allowed is one"
    if len({layer.formula.remembers_impact() for layer in law.layers}) > 1:
        return "remembers_impact is true in some and false in others; allowed is one of both"
    return ""


def _finite(trial: Trial) -> str:
    far = itertools.product((depth - trial.begin for depth in FAR_DEPTHS), FAR_RATES, FAR_IMPACTS)
    for state in itertools.chain(far, trial.states()):
        numbers = trial.at(*state)
        if not all(map(math.isfinite, numbers)):
            force, stiffness, damping = numbers
            finding = f"the force is {force:g} N and its slopes are {stiffness:g} N/m and {damping:g} N s/m"
            return f"{trial.where(*state)} {finding}; all must be finite"
    return ""


def _pure(trial: Trial) -> str:
    state = (trial.offsets[0], RATES[0], 0.0)
    first = trial.ask(*state)
    for other in trial.offsets:
        trial.ask(other, RATES[-1], IMPACT)
        again = trial.ask(*state)
        if again != first:
            return f"{trial.where(*state)} the force is {first[0]!r} N, and asked again {again[0]!r} N"
    return ""


def _impact(trial: Trial) -> str:
    remembers = trial.formula.remembers_impact()
    for offset, rate in itertools.product(trial.offsets, (0.0,) if remembers else (0.0, *RATES[-2:])):
        (force, *_), (other, *_) = trial.at(offset, rate), trial.at(offset, rate, IMPACT)
        if not abs(other - force) <= EQUAL * max(abs(force), abs(other), 1.0):
            reason = "at rest it must be the same" if remembers else "remembers_impact is false"
            where = f"{trial.where(offset, rate)} the force is {force:g} N"
            return f"{where} after an impact at 0 m/s, and {other:g} N after one at {IMPACT:g} m/s; {reason}"
    return ""


def _smooth(trial: Trial) -> str:
    rates = [0.0]
    if any(trial.at(offset)[1] != trial.at(offset, RATES[-1])[1] for offset in trial.offsets):
        rates.append(RATES[-1])  # the damping changes with the depth
    for rate, (low, high) in itertools.product(rates, itertools.pairwise(trial.offsets)):
        wrong = _leap(trial, low, high, rate)
        if wrong:
            return f"{wrong}; inside a layer both must go on smoothly"
    return _around_beginning(trial)


def _leap(trial: Trial, low: float, high: float, rate: float) -> str:
    """Describe a leap of force or slope between two depths, by halving intervals that their ends do not predict."""
    intervals, halvings = [(low, high, trial.at(low, rate), trial.at(high, rate))], 0
    while intervals:
        halvings += 1
        low, high, begin, end = intervals.pop()
        middle, width = 0.5 * (low + high), high - low
        if width < RESOLVED * math.ulp(trial.begin + high):
            continue
        there = trial.ask(middle, rate, 0.0)
        force = 0.5 * (begin[0] + end[0]) + 0.125 * width * (begin[1] - end[1])
        slope = 0.5 * (begin[1] + end[1])
        most = max(abs(begin[0]), abs(end[0])), max(abs(begin[1]), abs(end[1]))
        if abs(there[0] - force) <= SMOOTH_FORCE * most[0] and abs(there[1] - slope) <= SMOOTH_SLOPE * most[1]:
            continue
        if width <= NARROW * high or halvings > MOST_HALVINGS:
            where = f"{trial.where(high, rate)} the force goes from {begin[0]:g} to {end[0]:g} N"
            return f"{where} at once, and its slope from {begin[1]:g} to {end[1]:g} N/m"
        intervals += [(low, middle, begin, there), (middle, high, there, end)]
    return ""


def _around_beginning(trial: Trial) -> str:
    """Describe a leap of the force just beyond the beginning of a layer, or just before it."""
    force, slope, _ = trial.at(0.0)
    for offset in (min(GAP, trial.offsets[0]), -GAP):
        other, other_slope, _ = trial.at(offset)
        most = abs(offset) * (1.0 + TRUE) * max(slope, other_slope) + EQUAL * max(abs(force), 1.0)
        if not abs(other - force) <= most:
            finding = f"the force is {force:g} N, and {offset:g} m off {other:g} N"
            return f"{trial.where(0.0)} {finding}; its slope allows for {most:g} N of difference"
    return ""


def _affine(trial: Trial) -> str:
    for offset, rate, impact_speed in trial.states():
        at_rest, _, _ = trial.at(offset, 0.0, impact_speed)
        slope = _over_rate(trial, offset, impact_speed)
        force, _, _ = trial.at(offset, rate, impact_speed)
        line = at_rest + slope * rate
        rounding = 8.0 * EPSILON * abs(slope) * RATES[-1]
        if not abs(force - line) <= EQUAL * (abs(at_rest) + abs(slope * rate)) + rounding:
            finding = f"the force is {force:g} N; by the line through {RATES[0]:g} and {RATES[-1]:g} m/s it must be"
            return f"{trial.where(offset, rate, impact_speed)} {finding} {line:g} N"
    return ""


def _over_rate(trial: Trial, offset: float, impact_speed: float) -> float:
    """Return the slope of the force over the rate [N s/m], by the first and the last of `RATES`."""
    slow, fast = RATES[0], RATES[-1]
    return (trial.at(offset, fast, impact_speed)[0] - trial.at(offset, slow, impact_speed)[0]) / (fast - slow)


def _rising(trial: Trial) -> str:
    before, last, last_slope = 0.0, *trial.at(0.0)[:2]
    for offset in trial.offsets:
        force, slope, _ = trial.at(offset)
        if not force >= last - EQUAL * abs(last):
            return f"{trial.where(offset)} the force is {force:g} N, less than {last:g} N at {trial.begin + before:g} m"
        if not slope >= (1.0 - EQUAL) * last_slope:
            finding = f"the slope is {slope:g} N/m, less than {last_slope:g} N/m at {trial.begin + before:g} m"
            return f"{trial.where(offset)} {finding}; within a layer it must not fall"
        before, last, last_slope = offset, force, slope
    return ""


def _slopes(trial: Trial) -> str:
    for offset, rate, impact_speed in trial.states():
        force, stiffness, damping = trial.at(offset, rate, impact_speed)
        if not ((stiffness >= 0.0 or force < 0.0) and damping >= 0.0):
            where = trial.where(offset, rate, impact_speed)
            return f"{where} they are {stiffness:g} N/m and {damping:g} N s/m; allowed is >= 0"
        at_rest, _, _ = trial.at(offset, 0.0, impact_speed)
        true = _over_rate(trial, offset, impact_speed)
        rounding = 8.0 * EPSILON * abs(at_rest) / RATES[-1]
        if not abs(damping - true) <= TRUE * abs(true) + rounding:
            where = trial.where(offset, rate, impact_speed)
            return f"{where} that over the rate is {damping:g} N s/m; the force says {true:g} N s/m"
    for offset, impact_speed in itertools.product(trial.offsets, trial.impacts):
        at_rest, _, damping = trial.at(offset, 0.0, impact_speed)
        last = -LETTING_GO * at_rest / damping if damping > 0.0 else 0.0
        for rate in (*SLOPE_RATES, PULLED, max(last, FAR_RATES[0])):
            wrong = _over_depth(trial, offset, rate, impact_speed)
            if wrong:
                return f"{trial.where(offset, rate, impact_speed)} that over the depth is {wrong}"
    return ""


def _over_depth(trial: Trial, offset: float, rate: float, impact_speed: float) -> str:
    """Describe a slope over the depth that is not that of the force."""
    ahead, behind = (1.0 + STEP) * offset, (1.0 - STEP) * offset
    width = (trial.begin + ahead) - (trial.begin + behind)
    if width < RESOLVED * math.ulp(trial.begin + offset):
        return ""
    there, slope, damping = trial.at(offset, rate, impact_speed)
    before, after = (trial.ask(at, rate, impact_speed)[0] for at in (behind, ahead))
    true = (after - before) / width
    rounding = 8.0 * EPSILON * (abs(there) + 2.0 * abs(damping * rate)) / width
    if abs(slope - true) <= TRUE * abs(true) + rounding:
        return ""
    return f"{slope:g} N/m; the force says {true:g} N/m"


def _touch(trial: Trial) -> str:
    force, _, _ = trial.at(0.0)
    return "" if abs(force) <= EQUAL else f"{trial.where(0.0)} the force is {force:g} N; allowed is 0"


def _joint(law: ContactLaw, index: int) -> str:
    layer = law.layers[index]
    above, _, _ = law.layers[index - 1].formula.force_at(layer.begin, 0.0, 0.0)
    force, _, _ = layer.formula.force_at(layer.begin, 0.0, 0.0)
    if abs(force - above) <= EQUAL * max(abs(force), abs(above), 1.0):
        return ""
    return f"at a depth of {layer.begin:g} m and at rest the force leaps from {above:g} to {force:g} N"


CLAUSES: dict[str, Callable[[Trial], str]] = {
    "finite": _finite,
    "pure": _pure,
    "impact": _impact,
    "affine": _affine,
    "rising": _rising,
    "smooth": _smooth,
    "slopes": _slopes,
}
"""Tests of a layer by clause; each returns a description of what is broken, or an empty string"""

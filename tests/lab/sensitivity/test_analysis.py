"""Indices that are known: of Ishigami's function, and of a depth that follows a power law of stiffness and load."""

from __future__ import annotations

import math

import numpy as np
import pytest
from SALib.test_functions import Ishigami

import knee_contact_ros
from knee_contact_ros.lab.sensitivity import Analysed, SalibDesign, analyse
from knee_contact_ros.lab.sensitivity_page import not_converged

RANGES = {name: [-math.pi, math.pi] for name in ("a", "b", "c")}
A, B = 7.0, 0.1
"""Constants of Ishigami's function, as SALib has them"""
ALONE, FOURTH = 0.5 * (1.0 + B * math.pi**4 / 5.0) ** 2, 8.0 * B**2 * math.pi**8 / 225.0
VARIANCE = ALONE + A**2 / 8.0 + FOURTH
"""Parts and the whole: Ishigami & Homma 1990, doi:10.1109/ISUMA.1990.151285"""
KNOWN = {"S1": (ALONE / VARIANCE, A**2 / 8.0 / VARIANCE, 0.0),
         "ST": ((ALONE + FOURTH) / VARIANCE, A**2 / 8.0 / VARIANCE, FOURTH / VARIANCE)}  # fmt: skip
EXPONENT = 1.5


def test_ishigami_is_found_within_the_intervals() -> None:
    design = SalibDesign(n=1024, second_order=True, ranges=RANGES)
    found = analyse(design, "peak_depth", Ishigami.evaluate(design.points(), A, B))
    for kind, known in KNOWN.items():
        for name, value in zip(RANGES, known, strict=True):
            (index,) = (one for one in found.final(kind) if one.parameter == name)
            assert index.low <= value <= index.high
            assert index.high - index.low < 0.2
    assert found.final("S2")[0].parameter == "a x c"
    assert found.final("S2")[0].low <= FOURTH / VARIANCE <= found.final("S2")[0].high
    assert [index.n for index in found.course("ST", "a")] == [128, 256, 512, 1024]
    widths = [index.high - index.low for index in found.course("ST", "a")]
    assert widths == sorted(widths, reverse=True)


def test_morris_finds_what_bends_and_what_is_straight() -> None:
    design = SalibDesign(method="morris", n=40, ranges={"a": [0.0, 2.0], "b": [0.0, 1.0], "c": [0.0, 1.0]})
    a, b, _ = design.points().T
    found = analyse(design, "peak_depth", 3.0 * a - 4.0 * b**2)
    by = {index.parameter: index for index in found.final("mu_star")}
    assert by["a"].value == pytest.approx(6.0)  # over its whole range
    assert by["c"].value == 0.0
    assert by["b"].low <= 4.0 <= by["b"].high  # the mean slope of a square over steps of 2/3, of 0 and 1/3
    sigma = {index.parameter: index.value for index in found.final("sigma")}
    assert sigma["a"] == pytest.approx(0.0, abs=1e-9)
    assert sigma["b"] > 0.5
    signs = {index.parameter: index.value for index in found.final("mu")}
    assert signs["a"] > 0.0 > signs["b"]


@pytest.mark.parametrize("method", ["sobol", "morris"])
def test_a_larger_design_begins_with_the_smaller_one(method: str) -> None:
    small, large = (SalibDesign(method=method, n=n, ranges=RANGES) for n in (8, 32))
    assert np.array_equal(small.points(), large.points()[: small.number])
    assert np.array_equal(large.points(), large.points())
    assert (large.points() >= -math.pi).all()
    assert (large.points() <= math.pi).all()


def depth_law(found: Analysed) -> tuple[float, float]:
    (stiffness,) = (one for one in found.final("S1") if one.parameter == "contact.stiffness")
    return stiffness.low, stiffness.high


def test_a_depth_at_rest_has_the_indices_of_its_power_law() -> None:
    """depth = (share L / K)^(1/n): in the logarithm, indices go as the squares of the ranges' logarithms.

    Of the depth itself they are those of a product of independent factors x^a, x evenly in the logarithm.
    """
    ranges = {"contact.stiffness": {"from": 4e7, "to": 1.2e8, "scale": "log"},
              "load.share": {"from": 0.4, "to": 0.8, "scale": "log"}}  # fmt: skip
    gait = {"time": [0.0, 0.01], "flexion_angle": [0.2, 0.2], "axial_load": [1500.0, 1500.0]}
    params = {"contact.law": "hertz", "contact.exponent": EXPONENT, "fidelity.level": "quasi_static"}
    found = knee_contact_ros.sensitivity(gait, ranges, params, n=512, outcomes=["peak_depth"])
    rows = found.cohort
    expected = (1500.0 * rows.values["load.share"] / rows.values["contact.stiffness"]) ** (1.0 / EXPONENT)
    assert rows.outcomes.peak_depth == pytest.approx(expected, abs=1e-6)  # the tolerance

    widths = {name: math.log(told["to"] / told["from"]) ** 2 for name, told in ranges.items()}
    design = SalibDesign(n=512, ranges=ranges)
    low, high = depth_law(analyse(design, "peak_depth", np.log(rows.outcomes.peak_depth)))
    assert low <= widths["contact.stiffness"] / sum(widths.values()) <= high

    first, square = (
        {name: mean_power(told["from"], told["to"], times * sign / EXPONENT)
         for (name, told), sign in zip(ranges.items(), (-1.0, 1.0), strict=True)}
        for times in (1.0, 2.0)
    )  # fmt: skip
    spread = {name: square[name] / first[name] ** 2 - 1.0 for name in ranges}
    whole = (1.0 + spread["contact.stiffness"]) * (1.0 + spread["load.share"]) - 1.0
    low, high = depth_law(found.outcomes["peak_depth"])
    assert low <= spread["contact.stiffness"] / whole <= high
    assert set(found.to_pandas().columns) >= {"outcome", "parameter", "index", "n", "value", "low", "high"}


def mean_power(begin: float, end: float, power: float) -> float:
    """The mean of x^power, x evenly in the logarithm."""
    return (end**power - begin**power) / (power * math.log(end / begin))


def test_groups_with_a_case_that_failed_are_left_out_and_counted() -> None:
    design = SalibDesign(n=256, ranges=RANGES)
    values = Ishigami.evaluate(design.points(), A, B)
    values[[0, 1, 7 * design.group]] = np.nan  # of two groups
    found = analyse(design, "peak_depth", values)
    assert (found.cases, found.spoilt, found.reason) == (3, 2, "")
    assert found.final("ST")[0].n == 254
    values[: 30 * design.group : design.group] = np.nan
    refused = analyse(design, "peak_depth", values)
    assert not refused.indices
    assert "31 of 1280 cases have no value and spoil 30 of 256 groups" in refused.reason
    assert "no case has a value" in analyse(design, "peak_depth", np.full(design.number, np.nan)).reason


def test_an_outcome_that_does_not_vary_or_only_by_its_error_has_no_indices() -> None:
    design = SalibDesign(n=16, ranges=RANGES)
    assert "the same in all cases" in analyse(design, "bone_time", np.zeros(design.number)).reason
    noise = 3.0 + 1e-9 * np.random.default_rng(0).standard_normal(design.number)
    assert "its numerical error bound is 1e-06 m" in analyse(design, "peak_depth", noise, 1e-6).reason


def test_what_has_not_converged_is_told() -> None:
    design = SalibDesign(n=16, ranges=RANGES)
    told = not_converged(design, analyse(design, "peak_depth", Ishigami.evaluate(design.points(), A, B)))
    assert "not converged: the interval of the largest index" in told[0]
    assert "may do" in told[0]
    design = SalibDesign(n=4096, ranges={"a": [0.0, 1.0], "b": [0.0, 0.3]})
    assert not not_converged(design, analyse(design, "peak_depth", design.points() @ [1.0, 1.0]))

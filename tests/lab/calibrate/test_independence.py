"""What residuals are worth that are alike from sample to sample."""

from __future__ import annotations

import numpy as np
import pytest

from knee_contact_ros.lab.calibrate.fit import alike, correlations, independent_part, samples_per_value
from tests.lab.calibrate.legs import noise


@pytest.mark.parametrize("correlation", [0.3, 0.6, 0.9])
def test_a_chain_of_values_is_worth_what_theory_says(correlation: float) -> None:
    """Of ρ(k) = r^k: τ = (1 + r) / (1 - r)."""
    found = [samples_per_value(noise(20_000, seed, correlation)) for seed in range(20)]
    assert np.median(found) == pytest.approx((1.0 + correlation) / (1.0 - correlation), rel=0.05)  # they spread by 7 %


def test_independent_values_are_worth_themselves() -> None:
    """A correlation of four of its deviations has a probability of 3e-5."""
    assert {samples_per_value(noise(300, seed)) for seed in range(100)} == {1.0}
    for few in (np.zeros(0), np.zeros(1), np.ones(1), np.zeros(50), np.array([1.0, -1.0])):
        assert alike(few) == 0.0
        assert samples_per_value(few) == 1.0


def test_values_that_alternate_are_not_worth_more() -> None:
    assert samples_per_value(np.tile([1.0, -1.0], 100)) == 1.0


def test_values_that_never_change_sign_end_somewhere() -> None:
    assert samples_per_value(np.ones(100)) == pytest.approx(100.0)


def test_correlations_are_those_of_their_definition() -> None:
    values = noise(50, 3, 0.5)
    plain = [float((values[lag:] * values[: 50 - lag]).sum() / (values**2).sum()) for lag in range(50)]
    np.testing.assert_allclose(correlations(values), plain, atol=1e-12)


def test_the_column_that_is_most_alike_decides() -> None:
    columns = {"gap": noise(2000, 1), "depth": noise(2000, 2, 0.9)}
    assert independent_part(columns) == pytest.approx(1.0 / samples_per_value(columns["depth"]))

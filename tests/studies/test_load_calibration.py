"""The study of the load estimate's calibration: its noise is what it says, and its fits find the truth."""

from __future__ import annotations

import numpy as np
import pytest

from knee_contact_ros.lab.calibrate.fit import samples_per_value
from studies.load_calibration import NOISE, NOISES, TRUE, drawn, held_along_lines, held_by_a_fit, true_problem


@pytest.mark.parametrize("noise", NOISES, ids=[noise.words for noise in NOISES])
def test_noise_has_the_deviation_that_it_says(noise: object) -> None:
    values = drawn(noise, 100_000, np.random.default_rng(1))
    worth = len(values) / samples_per_value(values)
    assert values.std() == pytest.approx(NOISE, rel=5.0 / np.sqrt(worth))


def test_a_fit_without_bad_luck_holds_the_truth_and_ways_are_told_apart() -> None:
    assert true_problem(220).values(true_problem(220).start) == pytest.approx(TRUE)
    assert sum(sum(held_by_a_fit(220, 0, number)) for number in range(3)) >= 7  # of 9; P(fewer) is 0.8 %
    independent, fewer, sandwich = held_along_lines(220, 2).mean(axis=1)
    assert independent < 0.6 < sandwich < fewer

"""Publishers of one quantity that disagree: samples go back and forth."""

import numpy as np
import pytest

from knee_contact_ros.streams.publisher_conflicts import PublisherConflict

CASES = [
    (20, (0.1, 0.9), "angle goes back and forth by about 0.80 rad between samples"),
    (20, (0.1, 0.3), ""),  # a noisy sensor; not said until two publishers are known
    (20, (0.1, 0.15), None),
    (20, (0.1, 0.9, 0.1, 0.1, 0.1, 0.1), "angle"),
    (20, (0.1, 0.9, 0.6, 0.4, 0.1), None),  # the knee turns
    (30, (0.1, 0.9), None),  # time enough to turn
]
"""Time [ms] between samples, angles [rad] in turns, and how the sentence begins without knowledge of several; None:
nothing is said even if there are several"""


@pytest.mark.parametrize(("period", "angles", "begin"), CASES)
def test_samples_that_go_back_and_forth_are_said(period, angles, begin):
    conflict = PublisherConflict("angle", 0.1, "rad")
    stamps = 1_000_000 * period * np.arange(200)
    conflict.add_samples(stamps, np.resize(angles, 200))
    said = conflict.sentence()
    assert said.startswith(begin or "")
    assert bool(said) == bool(begin)
    assert bool(conflict.sentence("two publishers")) == (begin is not None)

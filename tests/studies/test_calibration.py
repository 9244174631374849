"""The study of calibration: made by the reference, found by the model."""

import numpy as np
import pytest

from studies.calibration import case_of, fit, made, truth


@pytest.mark.parametrize("name", ["gait, depth", "lift-off and landing, depth and gap"])
def test_a_case_is_what_the_reference_says_and_is_found_again(name):
    case = case_of(name)
    exact, table = truth(name), made(name, case, np.random.default_rng(1))
    measured = np.isfinite(table["penetration_depth"])
    assert (measured == (exact.depth >= 0.0)).all()
    off = table["penetration_depth"][measured] - exact.depth[measured]
    assert off.std() == pytest.approx(
        case.noise["penetration_depth"], rel=0.2
    )  # of 387 or more: 4 %
    found = fit(name, case, 0)
    for parameter, true in case.free.items():
        low, high, *_ = found.intervals[parameter]
        width = high - low
        assert low - width < true < high + width  # six deviations

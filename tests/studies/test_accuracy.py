"""The scenes of the accuracy study, against SciPy with its own laws and surfaces: in tolerance, or said aloud."""

import numpy as np
import pytest

from knee_contact_ros.model.types import Status
from studies.accuracy import ours, studies, theirs

NAMES = (
    "gait, right, circle carried forwards in a concave circle",
    "gait, right, two layers as printed",
    "lift-off and landing",
    "lift-off and landing, ellipse",
    "lift-off and landing, two layers",
    "stiff and overdamped: C 1e7, 1 g",
)
"""One of each kind; all of them are in docs/studies/accuracy.md"""
STUDIES = {study.name: study for study in studies() if study.name in NAMES}


@pytest.mark.parametrize("study", STUDIES.values(), ids=STUDIES)
def test_the_reference_is_met_to_the_tolerance_or_the_miss_is_said(study):
    exact = theirs(study)
    for tolerance in (1e-6, 1e-8):
        series = ours(study, tolerance)
        error = np.abs(series.penetration_depth - series.gap - exact)
        said = series.status & Status.NOT_CONVERGED != 0
        assert np.all(error[~said] <= tolerance)
        # The reference is good to some 1e-14 m; the estimate is an estimate.
        assert np.mean(error <= series.error_estimate + 1e-14) >= 0.985

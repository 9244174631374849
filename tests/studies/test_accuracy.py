"""The scenes of the accuracy study, against SciPy with its own laws and surfaces: in tolerance, or said aloud."""

from __future__ import annotations

import numpy as np
import pytest

from knee_contact_ros.model.types import Status
from studies.accuracy import Study, ours, studies, theirs

TAKES_LONG = "stiff: K 1e10, C 1e6, 0.1 kg"
"""By SciPy: this scene is in docs/studies/accuracy.md alone, two others that are as stiff are here"""
STUDIES = {study.name: study for study in studies() if study.name != TAKES_LONG}


@pytest.mark.parametrize("study", STUDIES.values(), ids=STUDIES)
def test_the_reference_is_met_to_the_tolerance_or_the_miss_is_said(study: Study) -> None:
    exact = theirs(study)
    for tolerance in (1e-6, 1e-8):
        series = ours(study, tolerance)
        error = np.abs(series.penetration_depth - series.gap - exact)
        said = series.status & Status.NOT_CONVERGED != 0
        assert np.all(error[~said] <= tolerance)
        # The reference is good to some 1e-14 m; the estimate is an estimate.
        assert np.mean(error <= series.error_estimate + 1e-14) >= 0.985

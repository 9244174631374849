"""The contact path of the model beside what the cells tell of the medial force's place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.report import Section
from knee_contact_ros.parameters.build import load_model
from studies.validation.data import BODY_WEIGHT, Floats, Measured
from studies.validation.shares import shipped

MM = 1e3
KNEES = {
    "circle, hinge (`healthy.yaml`)": ["healthy"],
    "MRI femur on a measured plateau, table of translation (`mri_knee.yaml`)": ["mri_knee"],
}
LOADED = 0.5
"""Medial force [BW] above which its measured place is meaningful"""


def path(measured: Measured, names: Sequence[str]) -> Floats:
    """Contact point x [m], anterior positive, of a shipped model under the medial load of the shipped table."""
    model = load_model([*names, {"body_weight": BODY_WEIGHT, "fidelity.level": "quasi_static"}], compiled=False)
    series = model.run(measured.time - measured.time[0], measured.flexion, shipped(measured))
    return np.asarray(series.contact_point.x)


def section(trials: Sequence[Measured]) -> Section:
    """Section on the range of the path, and its correlation with the cells'."""
    rows = []
    for measured in trials:
        loaded = measured.medial > LOADED * BODY_WEIGHT
        front = measured.front[loaded]
        for name, files in KNEES.items():
            x = path(measured, files)[loaded]
            related = f"{np.corrcoef(x, front)[0, 1]:+.2f}" if np.ptp(x) > 1e-6 else "it stands still"
            rows.append([
                measured.name, name, f"{MM * x.min():+.1f} to {MM * x.max():+.1f} mm",
                f"{front.min():.2f} to {front.max():.2f}", related,
            ])  # fmt: skip
    text = (
        "The tray has an anterior and a posterior cell below each condyle: the anterior one's part of both says how "
        "far "
        "forward the medial force acts. It is not a place in mm (the cells' distance, and a tray that bends, are "
        "not in "
        "the data), and the surfaces are an implant's, not those of the models here; so only the direction can be "
        f"compared, while the medial side bears {LOADED:g} BW or more."
    )
    header = ("trial", "model", "contact point x", "part of the anterior cell", "r")
    return Section("5. Contact path", text, header, rows)

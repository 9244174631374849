"""Our figures beside published ones, on the page that says what the numbers mean."""

import numpy as np
import pytest

from knee_contact_ros import solve
from knee_contact_ros.model.statics import plain_static_depth
from knee_contact_ros.parameters.build import contact_law, contact_patch
from knee_contact_ros.parameters.files import load_parameters
from tests import ROOT

ROWS = {
    row.split("|")[1].strip(): row.split("|")[3].strip()
    for row in (ROOT / "docs/explanation/numbers.md").read_text(encoding="utf-8").splitlines()
    if row.count("|") == 4
}
"""What is here, by quantity"""
HALF = 1150.0 / 2.0
"""Load [N] of one side in the published finite elements"""


@pytest.mark.parametrize(
    ("law", "times", "before"),
    [("kelvin_voigt", 4.6, ""), ("elastic_foundation", 2.0, "`elastic_foundation`: ")],
)
def test_pressure_and_area(law, times, before):
    contact = load_parameters({"contact.law": law}).contact
    model = contact_law(contact)
    patch = contact_patch(contact, model)
    depth = plain_static_depth(model.rows, HALF)
    assert model.static_force(depth) == pytest.approx(HALF, rel=1e-9)
    area = np.pi * patch.spread.area * patch.radius * depth
    peak = patch.spread.peak * HALF / area
    assert (
        f"{before}{peak / 1e6:.1f} MPa, {times:.1f} times" in ROWS["peak pressure, half of 1150 N"]
    )
    assert peak / 2.98e6 == pytest.approx(times, abs=0.05)
    assert f"{before}{area * 1e6:.0f} mm²" in ROWS["contact area, likewise"]


def test_depth_and_translation(right_bag):
    healthy = solve(right_bag, "healthy")
    depth = 1e3 * float(healthy.penetration_depth.max())
    assert ROWS["peak depth in gait"] == (
        f"{depth:.3f} mm: {100 * depth / 4.4:.0f} % of 4.4 mm, {100 * depth / 3.0:.0f} % of 3 mm"
    )
    ranges = []
    for mechanism in ("hinge", "parallel_mechanism", "table"):
        values = {
            "translation.mechanism": mechanism,
            "translation.table": "translation_medial.csv",
        }
        gait = solve(right_bag, "mri_femur", values)
        spans = [
            np.ptp(np.asarray(gait.femoral_x)[np.asarray(gait.load) > part * 737.068])
            for part in (0.1, 0.3, 0.5)
        ]
        ranges.append(", ".join(f"{1e3 * span:.1f}" for span in spans))
    hinge, parallel, table = ranges
    assert hinge == "0.0, 0.0, 0.0"
    assert ROWS[
        "translation of the femur in stance (here: load above 0.1, 0.3, 0.5 body weights)"
    ] == (f"hinge 0; parallel mechanism {parallel}; table {table} mm")

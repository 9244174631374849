"""Where the paper contradicts itself, with the figures of this report."""

from __future__ import annotations

from benchmarks.report import Section
from studies.reproduction.healthy import height_range, needed, second_peak_depths
from studies.reproduction.loads import load_peak
from studies.reproduction.numerics import evaluations, linearised
from studies.reproduction.osteoarthritis import (
    arthritic_depth,
    bone_stiffness_needed,
    break_even,
    load_needed,
    loss_for_paper,
)
from studies.reproduction.page import thousands
from studies.reproduction.phases import second_stance
from studies.reproduction.scenes import HEALTHY, MM, MRI, N_MM
from studies.reproduction.table1 import cartilage_stiffness


def section() -> Section:
    """Section with the closing table of contradictions."""
    sphere, curve = second_peak_depths()
    first, second = (load_peak(time) for time in second_stance())
    stiffness = thousands(round(bone_stiffness_needed(), -3))
    rows = [
        ["healthy peak depth 0.795 mm (abstract) and 0.705 mm (text)",
         f"one depth per load: {curve:.4f} mm at 2.19 BW. 0.705 mm needs {needed(0.705)[1]:.2f} BW, 0.795 mm "
         f"{needed(0.795)[1]:.2f} BW"],
        ["osteoarthritis: 0.521 mm = 0.5 + 0.021",
         f"{MM * arthritic_depth():.4f} mm = 0.5 + {MM * arthritic_depth() - 0.5:.4f} at 2.19 BW. 0.021 mm needs "
         f"K₂ = {stiffness} N/mm^1.5, or {load_needed():.3f} BW"],
        ["osteoarthritis lowers the contact force under identical inputs",
         "not when the force is prescribed (Eq. 13). When the femoral height is prescribed: only if more than "
         f"{break_even():.3f} mm of cartilage are lost ({loss_for_paper():.3f} mm for the paper's depth)"],
        ["sphere and fitted curve differ by 0.6 % in depth, in a force-driven planar model",
         f"{100 * (curve / sphere - 1):+.3f} %, by inertia. The curve shows in the contact point and in the range of "
         f"femoral height ({MM * height_range(HEALTHY, MRI):.2f} against {MM * height_range(HEALTHY):.2f} mm)"],
        ["K = 2500 N/mm^1.5 derived from the material properties",
         f"{cartilage_stiffness() * N_MM:.0f} N/mm^1.5 by Hertz; 2500 is calibrated"],
        ['"medial" force with peaks of 1.81 and 2.19 BW',
         f"half of the right knee's axial load: {first:.3f} and {second:.3f} BW, in body weights of the unscaled model "
         "(75.16 kg) for the walk of a subject of 72.6 kg"],
        ["time step 1e-12 s in a model offered for its efficiency",
         f"the contact's natural frequency is {linearised()[1]:.0f} rad/s; {evaluations():.0f} evaluations of the "
         "law per "
         "5 ms keep the estimated error of the depth below 1e-6 m"],
        ["Eq. 12: viscoelastic in the second layer, elastic in the first",
         "the force jumps by C δ̇ at 0.5 mm, and below nothing damps"],
    ]  # fmt: skip
    text = "Nothing in the model follows from this table; it says which statements cannot hold together."
    return Section("9. Where the paper contradicts itself", text, ("the paper", "its own formulas and Table 1"), rows)

"""Published scores beside ours, with their inputs and outputs."""

from __future__ import annotations

from benchmarks.report import Section

ROWS = (
    ("Grand Challenge 2010 to 2012, winners (Kinney et al. 2013, doi:10.1115/1.4023255)",
     "motion, ground reaction, some with EMG; muscle and contact models; blinded",
     "medial and lateral force in two gait trials",
     "medial 229 to 312 N, lateral 238 to 326 N; r² at most 0.91 and 0.70"),
    ("static optimisation in OpenSim (Bennett et al. 2024, doi:10.1115/1.4064550)",
     "motion, ground reaction", "medial force in walking", "medial 0.33 BW, r² 0.77"),
    ("recurrent network (the same)", "motion only; trained on six persons, tested on two others",
     "medial force in walking", "medial 0.27 BW, r² 0.77"),
    ("recurrent network (Derungs et al. 2026, doi:10.3390/bioengineering13020173)",
     "motion, EMG and ground reaction; the tested person left out",
     "total, medial and lateral force", "total 0.16 BW in walking at best"),
)  # fmt: skip


def section(ours: tuple[float, float]) -> Section:
    """Section with the table; `ours` are RMS errors [BW] of the medial force with a table of the other trial."""
    low, high = sorted(ours)
    mine = (
        "ours, `measured_share` (above)", "**the measured total force** and flexion; fitted to another trial of the "
        "same person", "how the total is divided", f"medial {low:.2f} and {high:.2f} BW",
    )  # fmt: skip
    text = (
        "These scores are not of one kind. The others predict the force itself, from motion, muscles or EMG; ours "
        "is given "
        "the sum, from the implant's own cells, and splits it. It had to be smaller. With a total that a "
        "musculoskeletal model "
        "computes, that model's error comes on top. Figures are as in the abstracts of the papers."
    )
    return Section(
        "6. The field", text, ("source", "given", "predicts", "RMS error"), [list(row) for row in (*ROWS, mine)]
    )

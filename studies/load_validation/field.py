"""Published scores beside ours."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.report import Section
from studies.load_validation.answers import FITTED, Answer
from studies.load_validation.scores import score

ROWS = (
    ("Grand Challenge 2010 to 2012, four winners (Kinney et al. 2013, doi:10.1115/1.4023255)",
     "motion, ground reaction, some with EMG; blinded",
     "medial 229 to 312 N, lateral 238 to 326 N, r² at most 0.91 and 0.70"),
    ("parametric numerical model, third Grand Challenge (PMC3627216)", "motion, ground reaction; blinded",
     "total 281 N in normal walking (peaks 3 and 9 % off), 470 N in medial thrust gait (4 and 15 % off)"),
    ("recurrent network (Derungs et al. 2026, doi:10.3390/bioengineering13020173)",
     "motion, EMG and ground reaction; the tested person left out", "total 0.16 BW in walking at best"),
)  # fmt: skip


def section(found: Sequence[Answer]) -> Section:
    """Section with the table of published scores and of ours."""
    rows = [list(row) for row in ROWS]
    for level in ("knee_moment", "ankle_moment", "ground_force"):
        mine = [each for each in found if (each.level, each.how) == (level, FITTED)]
        scores = [score(each.walk, each.force).rms for each in mine]
        newtons = " and ".join(f"{each * mine[0].walk.weight:.0f}" for each in scores)
        bodies = " and ".join(f"{each:.2f}" for each in scores)
        given = "ground reaction and knee angle" if level == "ground_force" else "net moments of inverse dynamics"
        rows.append([f"ours, `{level}`", f"{given}; fitted to another trial", f"total {newtons} N, {bodies} BW"])
    text = (
        "Not of one kind. In the competition nobody had seen a force of the trial; ours with constants of another "
        "trial has three numbers from the measured knee of the same man. The others use whole musculoskeletal models "
        "or many persons' data; ours is a few lines. Medial and lateral errors do not add up to that of the total; "
        "the winners' are 0.35 to 0.50 of this man's weight, per compartment. Figures are as in the abstracts."
    )
    return Section("7. The field", text, ("source", "given", "RMS error"), rows)

"""What an implant measured, through the commands: imported, divided by the shares of another trial, held against it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.bags.reader import read_answers
from knee_contact_ros.commands.main import main

pytest.importorskip("tabulate", reason="the studies' tables")

from studies.validation.data import walks

TRIALS = {"overground": "ngait_og5", "treadmill": "ngait_tm_fast1"}
MAP = """
time: {column: time_s, offset: 1.0}
angle: {column: knee_flexion_deg, unit: deg, sign: -1}
load: {columns: {pm_n: 1, am_n: 1, al_n: 1, pl_n: 1}, unit: N, direction: compression}
side: right
body_weight: 654.3
"""
SUMS = (
    "--axial", "pm_n + am_n + al_n + pl_n",
    "--medial", "0.9871 am_n + 0.9683 pm_n + 0.0387 al_n + 0.0211 pl_n",
    "--flexion=-knee_flexion_deg", "--angle-unit", "deg", "--body-weight", "654.3",
)  # fmt: skip


@pytest.mark.parametrize(("tried", "known"), [("overground", "treadmill"), ("treadmill", "overground")])
def test_both_compartments_of_a_trial_by_the_shares_of_the_other(
    tried: str, known: str, reference_data: Path, tmp_path: Path
) -> None:
    folder = reference_data / "instrumented_knee"
    if not folder.is_dir():
        pytest.skip("the measurements of the instrumented knee are not on this machine")
    files = {
        name: [str(folder / f"{stem}_{part}.csv") for part in ("tibia_cells", "motion")]
        for name, stem in TRIALS.items()
    }
    names, bag, share, out = (tmp_path / name for name in ("map.yaml", "bag", "share.csv", "out.mcap"))
    names.write_text(MAP, encoding="utf-8")
    assert main(["fit-share", "--trial", ",".join(files[known]), *SUMS, "--output", str(share)]) == 0
    assert main(["import-csv", *files[tried], "--map", str(names), "--output", str(bag)]) == 0
    values = {
        "body_weight": "654.3", "load.compartment": "both", "load.split": "measured_share", "load.share_file": share,
        "fidelity.level": "quasi_static",
    }  # fmt: skip
    given = [part for name, value in values.items() for part in ("-p", f"{name}:={value}")]
    assert main(["solve", str(bag), *given, "--output", str(out)]) == 0

    measured = next(walk for walk in walks(folder) if walk.name == TRIALS[tried])
    medial, lateral = (read_answers(out, f"/knee_contact{end}") for end in ("", "/lateral"))
    assert len(medial) == len(lateral) == len(measured.time)
    np.testing.assert_allclose(medial["load"] + lateral["load"], measured.total, rtol=1e-15, atol=1e-12)
    for answers, force in ((medial, measured.medial), (lateral, measured.total - measured.medial)):
        error = float(np.sqrt(np.mean((answers["contact_force"] - force) ** 2)))
        assert error <= 90.0

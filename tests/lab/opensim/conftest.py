"""OpenSim's gait2354 example, for the tests that run OpenSim itself."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest


@pytest.fixture
def example(reference_data: Path, tmp_path: Path) -> Path:
    """The example without residual reduction, over a tenth of a second."""
    folder = tmp_path / "example"
    shutil.copytree(reference_data / "opensim_gait2354", folder, copy_function=shutil.copyfile)
    folder.chmod(0o755)
    cmc = folder / "subject01_Setup_CMC.xml"
    text = cmc.read_text()
    for old, new in (
        ("subject01_simbody_adjusted.osim", "subject01_simbody.osim"),
        ("ResultsRRA/subject01_walk1_RRA_Kinematics_q.sto", "subject01_walk1_ik.mot"),
        ("0.80000000", "0.95"),
        ("1.20000000", "1.05"),
        ("     -10.00000000 </lowpass", "6 </lowpass"),
    ):
        assert old in text
        text = text.replace(old, new)
    cmc.write_text(text)
    return folder

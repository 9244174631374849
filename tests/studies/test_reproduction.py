"""docs/studies/reproduction.md says what the code gives, and its key numbers are those that must come out."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import ROOT

pytest.importorskip("tabulate", reason="the studies' tables")

from studies.reproduction.__main__ import write
from studies.reproduction.healthy import bone_stiffness, cartilage_stiffness, load_peak, static_depths
from studies.reproduction.osteoarthritis import arthritic_depth, bone_stiffness_needed, load_needed
from studies.reproduction.scenes import MM, N_MM, phases, second_stance

PAGES = ROOT / "docs" / "studies"


def test_load_peaks():
    assert [round(load_peak(time), 3) for time in second_stance()] == [1.815, 2.189]


def test_phases_follow_each_other():
    times = [moment.time for moment in phases()]
    assert times == sorted(times)
    assert len(times) == 4


def test_static_depths():
    assert [round(MM * depth, 6) for depth in static_depths()] == [0.657906, 0.747035]
    assert round(MM * arthritic_depth(), 6) == 0.538046


def test_what_the_arthritic_depth_would_need():
    assert load_needed() == pytest.approx(1.6055, abs=5e-5)  # its own rounding
    assert bone_stiffness_needed() == pytest.approx(2.40e5, rel=5e-3)


def test_stiffness_from_material():
    assert round(bone_stiffness() * N_MM) == 98408
    assert round(cartilage_stiffness() * N_MM) == 136


def test_page_and_tables_are_up_to_date(tmp_path):
    write(tmp_path, "some machine")
    kept = {path.name: _but_machine(path) for path in [PAGES / "reproduction.md", *(PAGES / "reproduction").iterdir()]}
    made = {path.name: _but_machine(path) for path in tmp_path.rglob("*.*")}
    assert made == kept, "run python -m studies.reproduction"


def _but_machine(page: Path) -> list[list[str]]:
    """Words of the lines; how wide a column is set depends on a library that may measure letters."""
    lines = page.read_text(encoding="utf-8").splitlines()
    return [line.replace("-", " ").split() for line in lines if not line.startswith("Made by")]

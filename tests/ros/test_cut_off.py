"""The study of recordings that are cut off, in short: one kill of each kind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests import ROOT
from tests.ros.conftest import PATIENCE

pytest.importorskip("tabulate", reason="the studies' tables")
LARGEST = 1000.0
"""[ms] of answers that may be missing on a machine that is busy with other tests; the study's own aim is 100"""


def test_little_is_lost_whatever_is_killed(tmp_path: Path) -> None:
    page = tmp_path / "cut_off.md"
    command = [sys.executable, "-m", "studies.cut_off", "--kills", "1", "--output", str(page)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=3 * PATIENCE, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.read_text().splitlines() if "|" in line]
    found = {row[0]: row[1:] for row in rows[2:]}
    assert set(found) == {"node", "recorder", "both", "both, beside busy processes"}
    for kills, _, _, largest, holes, _ in found.values():
        assert (kills, holes) == ("1", "0")
        assert float(largest) <= LARGEST
    assert found["node"][-1] == "complete"
    others = {found[what][-1] for what in set(found) - {"node"}}
    assert others == {"the last one `.partial`, 0 complete"}

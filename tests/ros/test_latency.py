"""The comparison with bare nodes over real topics: short runs, no timed assertions."""

from __future__ import annotations

import csv
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests import ROOT
from tests.ros.conftest import own_words
from tests.ros.test_demo import TIMEOUT

COMMAND = [sys.executable, "-m", "benchmarks.latency"]
CANDIDATES = ["this node", "this node, both", "bare", "bare, single-threaded", "bare, bytes"]


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [*COMMAND, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=False, cwd=ROOT)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_all_candidates_answer_and_page_and_data_agree(tmp_path: Path) -> None:
    arguments = ("--rounds", "1", "--duration", "2", "--rate", "200")  # what also a busy machine manages
    done = run(*arguments, "--output", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert own_words(done.stderr) == ""  # no progress bar in a pipe
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["latency.csv", "latency.md"]
    rows = rows_of(tmp_path / "out" / "latency.csv")
    assert [row["candidate"] for row in rows] == CANDIDATES
    page = (tmp_path / "out" / "latency.md").read_text(encoding="utf-8")
    assert "`python -m benchmarks.latency --rounds 1 --duration 2 --rate 200 --output " in page
    for row in rows:
        assert (row["published"], row["lost"]) == ("400", "0")
        times = [float(row[name]) for name in ("median_ms", "p99_ms", "p999_ms", "max_ms")]
        assert times[0] > 0.0
        assert times == sorted(times)
        assert float(row["cpu_us"]) > 0.0
        name = re.escape(row["candidate"])
        shown = re.search(rf"{name} +\| +([\d.]+) +\| +([\d.]+) +\| ", page)
        assert shown
        # Shown to 0.001 ms, from 100 ms on to 1 ms.
        assert list(map(float, shown.groups())) == [
            pytest.approx(time, abs=6e-4 if time < 99.0 else 0.6) for time in times[:2]
        ]
        assert shown[0] in done.stdout
    median = {row["candidate"]: float(row["median_ms"]) for row in rows}
    ratio = median["this node"] / median["bare"]
    shown = re.search(r"\| this node +\| +([\d.]+) +\| +[\d.]+ +\| +[\d.]+ +\|\n", done.stdout)
    assert shown
    assert float(shown[1]) == pytest.approx(ratio, abs=6e-3)

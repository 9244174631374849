"""The comparison with bare nodes over real topics: short runs, no timed assertions."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

from tests import ROOT
from tests.ros.conftest import own_words
from tests.ros.test_demo import TIMEOUT

COMMAND = [sys.executable, "-m", "benchmarks.latency"]
CANDIDATES = ["this node", "this node, both", "bare", "bare, single-threaded", "bare, bytes"]


def test_all_candidates_answer(tmp_path: Path) -> None:
    command = [*COMMAND, "--rounds", "1", "--duration", "2", "--rate", "200", "--output", tmp_path / "out"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert own_words(done.stderr) == ""  # no progress bar in a pipe
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["latency.csv", "latency.md"]
    with (tmp_path / "out" / "latency.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["candidate"] for row in rows] == CANDIDATES
    for row in rows:
        assert (row["published"], row["lost"]) == ("400", "0")
        times = [float(row[name]) for name in ("median_ms", "p99_ms", "p999_ms", "max_ms")]
        assert times[0] > 0.0
        assert times == sorted(times)
        assert row["candidate"] in done.stdout

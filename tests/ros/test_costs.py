"""What a live sample and a tick of `solve` cost, counted and not timed; `tests/helpers/counted.py` counts."""

import json
import shutil
import subprocess
import sys

import pytest

from tests import ROOT
from tests.helpers.costs import COSTS
from tests.helpers.counted import BEGIN, END


def counted(work, library="", prefix=()):
    """Counts by name."""
    command = [*prefix, sys.executable, "-m", "tests.helpers.counted", work, str(library)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def check(work, found):
    """Compare with the file; versions of Python differ in calls and allocations."""
    for name, number in found.items():
        known = COSTS[work][name]
        if name in ("system_calls", "wake_ups"):
            assert number <= 1.05 * known + 0.01, name
        elif sys.version_info[:2] == (3, 11):
            assert number == pytest.approx(known, rel=0.02, abs=0.01), name
        else:
            assert number <= 1.2 * known + 0.01, name


@pytest.mark.parametrize("work", ["live", "solve"])
def test_calls_and_wake_ups(work):
    found = counted(work)
    check(work, {name: found[name] for name in ("calls", "wake_ups")})


@pytest.mark.parametrize("work", ["live", "solve"])
def test_allocations(work, counted_allocations):
    check(work, {"allocations": counted(work, counted_allocations)["allocations"]})


@pytest.mark.skipif(not shutil.which("strace"), reason="needs strace (Debian: apt install strace)")
@pytest.mark.parametrize("work", ["live", "solve"])
def test_system_calls(work, tmp_path):
    log = tmp_path / "calls"
    found = counted(work, prefix=["strace", "-f", "-o", str(log)])
    lines = log.read_text(encoding="utf-8").splitlines()
    begin, end = (
        next(i for i, line in enumerate(lines) if place in line) for place in (BEGIN, END)
    )
    thread = lines[begin].split()[0]
    own = [
        line.split(maxsplit=1)[1]
        for line in lines[begin + 1 : end]
        if line.startswith(f"{thread} ")
    ]
    calls = [line for line in own if not line.startswith(("futex", "<...", "---"))]
    check(work, {"system_calls": len(calls) / found["work"]})

"""The latency study: samples, searches and pages without a node, and a short run over real topics."""

import csv
import math
import subprocess
import sys
from itertools import islice

import numpy as np
import pytest
from rclpy.qos import QoSProfile

from benchmarks.latency import __main__ as study
from benchmarks.latency import bare, driver
from knee_contact_ros.node.inputs import INPUT_DEPTH
from knee_contact_ros.node.session import OUTPUT_DEPTH
from knee_contact_ros.streams.messages import WRENCH, decode_joint_state
from tests import ROOT

MS = 1_000_000
SHORT = """
from benchmarks.latency.__main__ import CANDIDATES, main
for name in ("this node, both", "bare, bytes", "bare, single-threaded"):  # as others, with another argument
    del CANDIDATES[name]
main()
"""


def test_samples_are_gait_forth_and_back_without_a_leap():
    found = list(islice(driver.samples(1000.0, 7), 9000))
    states = [decode_joint_state(each.angle) for each in found]
    forces = [WRENCH.decode_message(each.force)[0] for each in found]
    stamps = [7 + number * MS for number in range(9000)]
    assert (
        stamps
        == [each.stamp for each in found]
        == [each.stamp for each in states]
        == [each.stamp for each in forces]
    )
    loads = np.array([-0.5 * force.force[1] for force in forces])
    assert loads.max() == pytest.approx(1613.77, abs=0.01)  # the bag's largest
    # The largest steps of the bag at 200 Hz, shared by five; where it turns round there is none.
    assert np.abs(np.diff([state.position[0] for state in states])).max() < 0.015
    assert np.abs(np.diff(loads)).max() < 100.0


def test_bare_nodes_offer_what_the_node_offers():
    assert QoSProfile(depth=INPUT_DEPTH) == bare.INPUT_QOS
    assert QoSProfile(depth=OUTPUT_DEPTH) == bare.OUTPUT_QOS


def attempts(limit):
    """A search where rates up to a limit are sustained; each rate fails at the first attempt."""
    tried = set[float]()

    def attempt(rate):
        good = rate <= limit and rate in tried
        tried.add(rate)
        verdict = study.SUSTAINED if good else study.NODE
        return study.Step(1, driver.OURS, rate, rate, 10, 0, 1.0, 1.0, verdict, 0.0)

    return study.search(attempt)


@pytest.mark.parametrize(
    ("up_to", "rate", "limit"),
    [
        (1000.0, 976.56, study.NODE),
        (1050.0, 1032.6, study.NODE),
        (100.0, 0.0, study.NODE),
        (math.inf, 84703.3, "-"),
    ],
)
def test_the_highest_rate_and_what_limits_it(up_to, rate, limit):
    assert study.highest(attempts(up_to), driver.OURS, 1) == (pytest.approx(rate, abs=0.1), limit)


def test_pages_and_their_data_are_written(tmp_path):
    steps = attempts(1000.0) + [step._replace(candidate=driver.BARE) for step in attempts(2000.0)]
    moments = [
        study.Moment(ticks, memory, "11: 80.0, 12: 120.0", 0, 2000.0, 0.3, 1.0, 2.0, 3.0, 5.0)
        for ticks, memory in ((10_000, 100.0), (50_000, 120.0), (60_000, 123.5), (70_000, 121.0))
    ]
    pages = (
        study.sustained_page(steps),
        study.soak_page(2000.0, "alone", moments, [300_000] * 99 + [20_000_000], (9, 9, 0)),
    )
    for page, words in zip(
        pages,
        (
            ("| this node | 977 |",),
            ("| its largest growth since then [MB] | 3.5 |", "| answers later than 10 ms | 1 |"),
        ),
        strict=True,
    ):
        text, data = (
            path.read_text(encoding="utf-8") for path in study.write(page, tmp_path, "made so")
        )
        assert "Made by `made so`" in text
        for each in words:
            assert each in " ".join(text.split())
        assert len(data.splitlines()) == 1 + len(page.rows)


def test_a_short_run(tmp_path):
    options = ["--rounds", "1", "--duration", "1", "--rate", "200", "--output", str(tmp_path)]
    command = [sys.executable, "-c", SHORT, *options]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=400, check=False, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["latency.csv", "latency.md"]
    with (tmp_path / "latency.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["candidate"] for row in rows] == ["this node", "bare", "bare, beside others"]
    for row in rows:
        assert (row["published"], row["lost"]) == ("200", "0")
        times = [float(row[name]) for name in ("median_ms", "p99_ms", "p999_ms", "max_ms")]
        assert times[0] > 0.0
        assert times == sorted(times)
        assert row["candidate"] in done.stdout

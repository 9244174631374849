"""The latency study without a node: statistics, samples, searches and pages."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from rclpy.qos import QoSProfile

from knee_contact_ros.bags.writer import BagWriter
from knee_contact_ros.node.session import OUTPUT_DEPTH
from knee_contact_ros.node.subscription import DEPTH
from knee_contact_ros.streams.messages import decode_joint_state, decode_wrench_stamped
from knee_contact_ros.streams.topics import KNEE_CONTACT, MESSAGE_TYPES
from knee_contact_ros.tools.latency import bare, comparison, report, soak, sustained
from knee_contact_ros.tools.latency.candidates import BARE, BOTH, BYTES, CANDIDATES, OURS, SINGLE, rotated
from knee_contact_ros.tools.latency.comparison import Part
from knee_contact_ros.tools.latency.driver import Run
from knee_contact_ros.tools.latency.figures import Figures, figures, ratios
from knee_contact_ros.tools.latency.run import LatencyOptions, command
from knee_contact_ros.tools.latency.samples import samples
from knee_contact_ros.tools.latency.soak import Comparison, Moment
from knee_contact_ros.tools.latency.sustained import NODE, SENDER, SUSTAINED, Step
from knee_contact_ros.tools.latency.usage import Snapshot, Taken, Usage, between, snapshot

MS = 1_000_000


def run_of(*milliseconds: int, published: int | None = None, sending: float = 1.0, tail: float = 0.0) -> Run:
    latencies = [each * MS for each in milliseconds]
    return Run(len(latencies) if published is None else published, latencies, [MS], sending, tail)


def test_figures_of_known_times() -> None:
    assert figures([each * MS for each in range(1001)]) == pytest.approx((500.0, 990.0, 999.0, 1000.0))
    assert figures([2 * MS]) == (2.0, 2.0, 2.0, 2.0)
    assert all(map(math.isnan, figures([])))


def test_ratios_of_nothing_are_none() -> None:
    assert ratios(Figures(1.0, 2.0, 3.0, 4.0), Figures(2.0, 2.0, 2.0, 2.0)) == (0.5, 1.0, 1.5, 2.0)
    assert math.isnan(ratios(Figures(1.0, 1.0, 1.0, 1.0), Figures(0.0, 1.0, 1.0, 1.0)).median)
    assert all(map(math.isnan, ratios(Figures(1.0, 1.0, 1.0, 1.0), figures([]))))


def test_samples_are_gait_forth_and_back_without_a_leap() -> None:
    found = list(islice(samples(1000.0, 7), 9000))
    states = [decode_joint_state(sample.angle) for sample in found]
    forces = [decode_wrench_stamped(sample.force) for sample in found]
    assert [sample.stamp for sample in found] == [7 + number * MS for number in range(9000)]
    assert [state.stamp for state in states if state] == [sample.stamp for sample in found]
    assert [force.stamp for force in forces if force] == [sample.stamp for sample in found]
    angles = np.array([state.position[0] for state in states if state])
    loads = np.array([-0.5 * force.force[1] for force in forces if force])
    assert loads.max() == pytest.approx(1613.77, abs=0.01)  # the bag's largest
    # The largest steps of the bag at 200 Hz, shared by five; where it turns round there is none.
    assert np.abs(np.diff(angles)).max() < 0.015
    assert np.abs(np.diff(loads)).max() < 100.0


def test_every_candidate_is_first_in_turn() -> None:
    orders = [rotated(CANDIDATES, number) for number in range(6)]
    assert [order[0] for order in orders] == [OURS, BOTH, BARE, SINGLE, BYTES, OURS]
    assert all(set(order) == set(CANDIDATES) for order in orders)


def test_a_bare_node_offers_what_the_node_offers() -> None:
    assert QoSProfile(depth=DEPTH) == bare.INPUT_QOS
    assert QoSProfile(depth=OUTPUT_DEPTH) == bare.OUTPUT_QOS


IDLE = Taken(3e-4, 0.0, 0.0, 10.0)


def parts() -> list[Part]:
    found = []
    for number in (1, 2):
        found.append(Part(number, OURS, run_of(1, 2, 3, published=4), Taken(4e-4, 2e-4, 0.5, 10.0)))
        found.append(Part(number, BOTH, run_of(1, 2, 3, published=4), Taken(4e-4, 2e-4, 0.5, 10.0)))
        found.append(Part(number, BARE, run_of(2 * number, 4 * number, 6 * number), IDLE))
        found.append(Part(number, SINGLE, run_of(published=3), IDLE))
        found.append(Part(number, BYTES, run_of(1, 1, 1), IDLE))
    return found


def test_a_line_for_every_round_and_for_all() -> None:
    lines = {(line.candidate, line.round): line for line in comparison.lines(parts(), 1000.0)}
    assert len(lines) == 15
    ours, bare_one = lines[OURS.name, "all"], lines[BARE.name, "all"]
    assert (ours.published, ours.lost, ours.median_ms, ours.max_ms) == (8, 2, 2.0, 3.0)
    assert (ours.cpu_us, ours.cpu_children_us) == pytest.approx((100.0, 50.0))
    assert (ours.others_percent, bare_one.others_percent) == (5.0, 0.0)
    assert (bare_one.median_ms, bare_one.max_ms) == (5.0, 12.0)  # of 2, 4, 6, 4, 8, 12
    assert lines[BARE.name, "2"].median_ms == 8.0
    assert len(comparison.lines(parts()[:4], 1000.0)) == 4  # one round says it all


def test_ratios_by_round_and_of_all() -> None:
    rows = {row[0]: row[1] for row in comparison.ratio_sheet(parts()).rows}
    assert rows == {
        f"{OURS.name}, round 1": "0.50", f"{OURS.name}, round 2": "0.25", OURS.name: "0.40",
        BOTH.name: "0.40", SINGLE.name: "-", BYTES.name: "0.20",
    }  # fmt: skip


def test_pages_fit_the_terminal(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    many = [
        part._replace(run=part.run._replace(latencies=[each * 4321 for each in part.run.latencies])) for part in parts()
    ]
    quick = [step._replace(rate=20.0 * step.rate, candidate=each.name) for step in steps() for each in CANDIDATES]
    wide = [step._replace(others_percent=99.0) for step in quick]
    pages = [
        comparison.page(many, 1000.0, 20.0),
        sustained.page(wide),
        soak.page(2000.0, MOMENTS, Comparison(9, 9, 0)),
    ]
    for page in pages:
        report.show(page)
        written = report.write(page, tmp_path, "Made here.")
        assert [path.name for path in written] == [f"{page.title.lower()}.md", f"{page.title.lower()}.csv"]
        assert "{" not in written[0].read_text(encoding="utf-8")
        assert len(written[1].read_text(encoding="utf-8").splitlines()) == 1 + len(page.lines)
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    assert "…" not in shown
    assert all(candidate.name in shown for candidate in CANDIDATES)  # on one line


def attempts(limit: float, verdict: str, failing_once: tuple[float, ...] = ()) -> list[Step]:
    """A search where rates up to a limit are sustained; some fail at the first attempt."""
    left = list(failing_once)

    def attempt(rate: float) -> Step:
        fails = rate > limit or (rate in left and left.remove(rate) is None)
        return Step(1, OURS.name, rate, rate, 10, 0, 1.0, 1.0, verdict if fails else SUSTAINED, 0.0)

    return sustained.search(attempt)


def steps() -> list[Step]:
    theirs = [step._replace(candidate=BARE.name) for step in attempts(2000.0, SENDER)]
    return attempts(1000.0, NODE) + theirs


def test_the_search_rises_and_bisects() -> None:
    found = attempts(1000.0, NODE)
    rates = [step.rate for step in found]
    assert rates[:6] == [500.0, 625.0, 781.25, 976.5625, 1220.703125, 1220.703125]  # a failure is tried again
    assert rates[6:] == pytest.approx([1091.8, 1091.8, 1032.6, 1032.6], abs=0.1)
    assert sustained.highest(found, OURS, 1) == 976.5625
    assert sustained.limit(found, OURS, 1) == NODE
    assert sustained.highest(attempts(1050.0, NODE), OURS, 1) == pytest.approx(1032.6, abs=0.1)


def test_one_failure_is_the_machines() -> None:
    found = attempts(1000.0, NODE, failing_once=(625.0,))
    assert [step.verdict for step in found[:3]] == [SUSTAINED, NODE, SUSTAINED]
    assert sustained.highest(found, OURS, 1) == 976.5625


def test_a_search_that_fails_at_once_ends() -> None:
    found = attempts(100.0, NODE)
    assert [step.rate for step in found] == [500.0, 500.0]
    assert sustained.highest(found, OURS, 1) == 0.0
    assert sustained.limit(found, OURS, 1) == NODE


def test_a_search_without_a_limit_ends() -> None:
    found = attempts(math.inf, NODE)
    assert found[-1].rate < sustained.HIGHEST
    assert sustained.limit(found, OURS, 1) == "-"


def test_rates_over_those_of_the_bare_node() -> None:
    rows = {row[0]: row for row in sustained.page(steps()).sheets[0].rows}
    assert rows[OURS.name][3:5] == [NODE, f"{976.5625 / sustained.highest(steps(), BARE, 1):.2f}"]
    assert rows[BARE.name][3:] == [SENDER, "1.00", "0 %"]
    assert rows[BYTES.name][1] == "0"


@pytest.mark.parametrize(
    ("run", "verdict"),
    [
        (run_of(*[1] * 101), SUSTAINED),
        (run_of(*[1] * 100, published=101), NODE),
        (run_of(*[1] * 101, tail=0.06), NODE),
        (run_of(*[60] * 101), NODE),
        (run_of(*[1] * 101, sending=1.01), SUSTAINED),
        (run_of(*[1] * 101, sending=1.03), SENDER),
        (run_of(published=101), NODE),
    ],
)
def test_what_sustained_means(run: Run, verdict: str) -> None:
    assert sustained.judged(run, 100.0) == verdict


CHILDREN = (Usage(11, 1, 0.0, 0.0, 80_000_000), Usage(12, 1, 0.0, 0.0, 120_000_000))
MOMENTS = [
    Moment(ticks, memory, CHILDREN, 0, 2000.0, 0.3, 1.0, 2.0, 3.0, 5.0)
    for ticks, memory in ((10_000, 100.0), (50_000, 120.0), (60_000, 123.5), (70_000, 121.0))
]


def test_memory_counts_after_the_warm_up() -> None:
    rows = dict(soak.page(2000.0, MOMENTS, Comparison(9, 9, 0)).sheets[0].rows)
    assert rows["node's memory after 50000 ticks [MB]"] == "120.0"
    assert rows["its largest growth since then [MB]"] == "3.5"
    assert rows["its child processes' memory at the end [MB]"] == "11: 80.0, 12: 120.0"
    assert soak.warm(MOMENTS[:1]) == MOMENTS[:1]


def recording(path: Path, *messages: bytes) -> Path:
    with BagWriter(path) as bag:
        bag.add_topic(f"/{KNEE_CONTACT}", MESSAGE_TYPES[KNEE_CONTACT])
        for stamp, data in enumerate(messages):
            bag.write(f"/{KNEE_CONTACT}", stamp, data)
    return path


def test_recordings_are_compared_byte_by_byte(tmp_path: Path) -> None:
    one = recording(tmp_path / "one.mcap", b"abcd", b"efgh", b"ijkl")
    assert soak.compare(one, one) == (3, 3, 0)
    assert soak.compare(one, recording(tmp_path / "two.mcap", b"abcd", b"efgX", b"ijkl")) == (3, 3, 1)
    assert soak.compare(one, recording(tmp_path / "three.mcap", b"abcd")) == (3, 1, 2)


def test_usage_of_a_process_and_its_child() -> None:
    script = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'input()'])"
    with subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        while len(family := snapshot(process.pid).family) < 2:
            assert process.poll() is None
        assert [usage.process for usage in family[:1]] == [process.pid]
        assert [usage.parent for usage in family] == [os.getpid(), process.pid]
        assert process.stdin
        process.stdin.write(b"\n")
    assert snapshot(process.pid).family == []
    assert snapshot(os.getpid()).family[0].resident > 10e6  # Python and NumPy


def test_cpu_time_of_all_has_that_of_what_has_ended() -> None:
    before = snapshot(0)
    work = "import time\nwhile time.process_time() < 0.5: pass"
    subprocess.run([sys.executable, "-c", work], check=True)
    assert between(before, snapshot(0)).others >= 0.4  # the kernel counts in hundredths


def test_cpu_time_is_that_of_processes_that_were_there_all_the_time() -> None:
    def of(*taken: tuple[int, float]) -> list[Usage]:
        return [Usage(process, 0, cpu, 0.0, 0) for process, cpu in taken]

    before = Snapshot(of((1, 1.0), (2, 5.0), (3, 1.0)), 100.0, 10.0, 0.0)
    after = Snapshot(of((1, 1.5), (2, 5.25), (4, 9.0)), 103.0, 11.0, 2.0)
    assert between(before, after)[:3] == (0.5, 0.25, 1.25)
    assert between(before, after).machine == 2.0 * (os.cpu_count() or 0)
    assert between(before, after._replace(family=[]))[:2] == (0.0, 0.0)


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        (LatencyOptions(), "knee-contact latency --rate 1000 --duration 20 --rounds 3"),
        (LatencyOptions(sustained=True), "knee-contact latency --rounds 3 --sustained"),
        (LatencyOptions(rate=2000.0, soak=1000), "knee-contact latency --rate 2000 --soak 1000"),
        (
            LatencyOptions(sustained=True, soak=1000),
            "knee-contact latency --rate 1000 --rounds 3 --sustained --soak 1000",
        ),
    ],
)
def test_the_page_says_the_command(asked: LatencyOptions, text: str) -> None:
    assert command(asked) == text

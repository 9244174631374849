"""The latency study without a node: statistics, samples, searches and pages."""

from __future__ import annotations

import math
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from rclpy.qos import QoSProfile

from benchmarks.latency import __main__ as study
from benchmarks.latency import bare, driver
from knee_contact_ros.node.inputs import DEPTH
from knee_contact_ros.node.session import OUTPUT_DEPTH
from knee_contact_ros.streams.messages import WRENCH, decode_joint_state

MS = 1_000_000


def run_of(*milliseconds: int, published: int | None = None, sending: float = 1.0, tail: float = 0.0) -> driver.Run:
    latencies = [each * MS for each in milliseconds]
    return driver.Run(len(latencies) if published is None else published, latencies, [MS], sending, tail)


def test_samples_are_gait_forth_and_back_without_a_leap() -> None:
    found = list(islice(driver.samples(1000.0, 7), 9000))
    states, forces = zip(
        *((decode_joint_state(each.angle), WRENCH.decode(each.force)[0]) for each in found), strict=True
    )
    stamps = [7 + number * MS for number in range(9000)]
    assert (
        [each.stamp for each in found] == [each.stamp for each in states] == [each.stamp for each in forces] == stamps
    )
    loads = np.array([-0.5 * force.force[1] for force in forces])
    assert loads.max() == pytest.approx(1613.77, abs=0.01)  # the bag's largest
    # The largest steps of the bag at 200 Hz, shared by five; where it turns round there is none.
    assert np.abs(np.diff([state.position[0] for state in states])).max() < 0.015
    assert np.abs(np.diff(loads)).max() < 100.0


def test_every_candidate_is_first_in_turn_and_bare_ones_offer_what_the_node_offers() -> None:
    assert [driver.rotated(driver.CANDIDATES, number)[0] for number in range(6)] == [*driver.CANDIDATES, driver.OURS]
    assert set(driver.rotated(driver.CANDIDATES, 3)) == set(driver.CANDIDATES)
    assert QoSProfile(depth=DEPTH) == bare.INPUT_QOS
    assert QoSProfile(depth=OUTPUT_DEPTH) == bare.OUTPUT_QOS


IDLE = driver.Taken(3e-4, 0.0, 0.0, 10.0)


def parts() -> list[study.Part]:
    found = []
    for number in (1, 2):
        found.append(study.Part(number, driver.OURS, run_of(1, 2, 3, published=4), driver.Taken(4e-4, 2e-4, 0.5, 10.0)))
        found.append(study.Part(number, driver.BOTH, run_of(1, 2, 3, published=4), driver.Taken(4e-4, 2e-4, 0.5, 10.0)))
        found.append(study.Part(number, driver.BARE, run_of(2 * number, 4 * number, 6 * number), IDLE))
        found.append(study.Part(number, driver.SINGLE, run_of(published=3), IDLE))
        found.append(study.Part(number, driver.BYTES, run_of(1, 1, 1), IDLE))
    return found


def test_a_page_and_its_data_are_written(tmp_path: Path) -> None:
    for page in (study.latency_page(parts(), 1000.0, 20.0), study.sustained_page(steps()),
                 study.soak_page(2000.0, MOMENTS, (9, 9, 0))):  # fmt: skip
        written = study.write(page, tmp_path, "made so")
        assert [path.name for path in written] == [f"{page.title.lower()}.md", f"{page.title.lower()}.csv"]
        text = written[0].read_text(encoding="utf-8")
        assert "Made by `made so`" in text
        assert "{" not in text
        assert len(written[1].read_text(encoding="utf-8").splitlines()) == 1 + len(page.lines)


def attempts(limit: float, verdict: str, failing_once: tuple[float, ...] = ()) -> list[study.Step]:
    """A search where rates up to a limit are sustained; some fail at the first attempt."""
    left = list(failing_once)

    def attempt(rate: float) -> study.Step:
        fails = rate > limit or (rate in left and left.remove(rate) is None)
        return study.Step(1, driver.OURS.name, rate, rate, 10, 0, 1.0, 1.0, verdict if fails else study.SUSTAINED, 0.0)

    return study.search(attempt)


def steps() -> list[study.Step]:
    theirs = [step._replace(candidate=driver.BARE.name) for step in attempts(2000.0, study.SENDER)]
    return attempts(1000.0, study.NODE) + theirs


@pytest.mark.parametrize(
    ("up_to", "rate", "limit"),
    [(1000.0, 976.56, study.NODE), (1050.0, 1032.6, study.NODE), (100.0, 0.0, study.NODE), (math.inf, 84703.3, "-")],
)
def test_the_highest_rate_and_what_limits_it(up_to: float, rate: float, limit: str) -> None:
    found = attempts(up_to, study.NODE)
    assert study.highest(found, driver.OURS, 1) == pytest.approx(rate, abs=0.1)
    assert study.limit(found, driver.OURS, 1) == limit


CHILDREN = "11: 80.0, 12: 120.0"
MOMENTS = [
    study.Moment(ticks, memory, CHILDREN, 0, 2000.0, 0.3, 1.0, 2.0, 3.0, 5.0)
    for ticks, memory in ((10_000, 100.0), (50_000, 120.0), (60_000, 123.5), (70_000, 121.0))
]

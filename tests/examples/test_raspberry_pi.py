"""The loop without ROS."""

import pytest

from examples.raspberry_pi import main, read_sensors, samples


def test_the_loop_ticks_in_time_and_answers(capsys):
    main(0.1)
    counts, _, last = capsys.readouterr().out.splitlines()
    assert counts.startswith("20 ticks, ")
    assert counts.endswith(" 0 unusable")
    assert last.startswith("last: 0.")


def test_samples_do_not_drift():
    assert [now for now, _ in samples(0.05)] == pytest.approx([0.005 * k for k in range(10)])
    assert read_sensors(0.0) == pytest.approx((0.1, 900.0))
    assert read_sensors(0.5) == pytest.approx((0.9, 50.0))

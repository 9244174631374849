"""The medial share by a table: what it gives, and what is no table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.joint_reaction.compartments import MeasuredShare, ShareTable
from knee_contact_ros.parameters.files import read_share_table
from knee_contact_ros.system.errors import UsageError

WEIGHT = 654.3
SMALL = "flexion_angle,axial_load,medial_share\n0,0,0.5\n0,2,0.7\n1,0,0.3\n1,2,1\n"


def shipped() -> ShareTable:
    path = Path(__file__).parents[2] / "config" / "share_medial.csv"
    return read_share_table(path.name, path.read_text(encoding="utf-8"))


def test_a_small_table_by_hand() -> None:
    rule = MeasuredShare(read_share_table("small.csv", SMALL), 500.0)
    assert rule.share(500.0, 0.0) == pytest.approx(0.6)
    assert rule.share(500.0, 0.5) == pytest.approx((0.5 + 0.7 + 0.3 + 1.0) / 4.0)
    assert rule.share(1000.0, 1.0) == 1.0  # all, to the last bit
    assert rule.share(5000.0, -0.3) == rule.share(1000.0, 0.0) == pytest.approx(0.7)  # held at the edge
    assert rule.share(-100.0, 3.0) == rule.share(0.0, 1.0) == pytest.approx(0.3)
    assert [rule.beyond(*at) for at in ((500.0, 0.5), (1001.0, 0.5), (-1.0, 0.5), (500.0, 1.1))] == [
        False, True, True, True,
    ]  # fmt: skip


@given(axial=st.floats(-1e4, 1e5), flexion=st.floats(-6.3, 6.3))
def test_numbers_and_arrays_get_the_same_bits_and_no_share_beyond_its_bounds(axial: float, flexion: float) -> None:
    rule = MeasuredShare(shipped(), WEIGHT)
    assert rule.share(np.array([axial]), np.array([flexion])).tolist() == [rule.share(axial, flexion)]
    assert 0.0 <= rule.share(axial, flexion) <= 1.0
    assert rule.beyond(np.array([axial]), np.array([flexion])).tolist() == [rule.beyond(axial, flexion)]


def test_rows_in_any_order_with_and_without_names_are_one_table() -> None:
    lines = SMALL.splitlines()
    for text in ("\n".join(lines[1:]), "# of nobody\n" + "\n".join([lines[0], *reversed(lines[1:])])):
        for ours, first in zip(read_share_table("", text), read_share_table("", SMALL), strict=True):
            np.testing.assert_array_equal(ours, first)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "must hold three columns flexion_angle, axial_load, medial_share of numbers"),
        ("0,0,a\n", "three columns"),
        ("0,0\n1,1\n", "three columns"),
        ("0,0,nan\n", "three columns"),
        ("0,0,0.5\n0,1\n", "three columns"),
        ("0,0,0.5\n0,2,0.7\n60,0,0.3\n60,2,1\n", "reaches 60 rad; flexion angles must be in rad, not deg"),
        ("0,0,0.5\n0,1400,0.7\n1,0,0.3\n1,1400,1\n", "0 to 30 body weights, not N"),
        ("0,0,0.5\n0,2,0.7\n1,0,0.3\n1,2,1.01\n", "has a share of 1.01; allowed: 0 to 1"),
        ("0,0,0.5\n0,2,0.7\n1,0,0.3\n1,2.5,0.4\n", "every one of its 2 angles needs every one of its 3 loads once"),
        ("0,0,0.5\n0,2,0.7\n1,0,0.3\n1,0,0.4\n", "every one of its 2 angles needs"),
        ("0,0,0.5\n0,2,0.7\n", "two or more flexion angles"),
        ("0,0,0.5\n" * 2001, "has 2001 points; at most 2000 are allowed"),
        ("#" * (2**20 + 1), "characters; at most"),
    ],
)
def test_what_is_no_table_is_refused_in_one_line(text: str, reason: str) -> None:
    with pytest.raises(UsageError, match=reason) as raised:
        read_share_table("mine.csv", text)
    assert str(raised.value).startswith("parameter load.share_file: mine.csv ")
    assert "\n" not in str(raised.value)

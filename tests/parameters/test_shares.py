"""The compartment's part of a joint reaction: by rules, by a table, and the report of a split that cannot be used."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from knee_contact_ros.bags.answers import read_answers, read_bag
from knee_contact_ros.commands.main import main
from knee_contact_ros.joint_reaction.compartments import MeasuredShare
from knee_contact_ros.model.types import Status
from knee_contact_ros.parameters.build import load_rule
from knee_contact_ros.parameters.curves import curve_texts, read_share_table
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_pipeline import load_sample
from knee_contact_ros.streams.messages import RefusedSampleError, WrenchStamped
from knee_contact_ros.system.errors import UsageError

WEIGHT = 737.068
WRENCH = "geometry_msgs/msg/WrenchStamped"


def wrench(force_y, moment_x):
    return WrenchStamped(0, "tibia_r", (0.0, force_y, 0.0), (moment_x, 0.0, 0.0))


def part(force_y, moment_x, **load):
    parameters = load_parameters({"load": load})
    rule = load_rule(parameters, curve_texts(parameters, {}))
    sample = load_sample(wrench(force_y, moment_x), rule if rule.by_moment else None)
    return float(rule(sample.axial, sample.moment, 0.0))


def answers_in(path):
    with path.open("rb") as file:
        return [
            message.data
            for _, _, message in make_reader(file).iter_messages(topics=["/knee_contact"])
        ]


def test_every_compartment_by_hand():
    assert part(-1000.0, 12.0, compartment="total") == 1000.0
    assert part(-1000.0, 12.0, compartment="fixed_share", share=0.6) == pytest.approx(600.0)
    # 500 N each, and 21 N m between two compartments 70 mm apart take 300 N from the medial one.
    assert part(-1000.0, 21.0, compartment="moment_balance") == pytest.approx(200.0)
    assert part(
        -1000.0, -12.0, compartment="moment_balance", compartment_spacing=0.06
    ) == pytest.approx(700.0)


def test_a_moment_that_is_no_number_is_refused_where_it_is_needed():
    assert part(-1000.0, float("nan")) == 500.0
    with pytest.raises(RefusedSampleError, match=r"torque\.x is nan"):
        part(-1000.0, float("nan"), compartment="moment_balance")
    with pytest.raises(RefusedSampleError, match="makes a load of"):
        part(-1000.0, 1e6, compartment="moment_balance")


def test_a_recording_has_the_table_of_shares_that_it_was_made_with(right_bag, tmp_path, capsys):
    table, first, again = (tmp_path / name for name in ("mine.csv", "first.mcap", "again.mcap"))
    table.write_text("0,0,0.4\n0,9,0.9\n1.5,0,0.4\n1.5,9,0.6\n", encoding="utf-8")
    rule = ["-p", "load.compartment:=measured_share", "-p", f"load.share_file:={table}"]
    assert main(["solve", str(right_bag), *rule, "--output", str(first)]) == 0
    assert "share of the load" in capsys.readouterr().out
    table.unlink()
    assert main(["solve", str(first), "--output", str(again)]) == 0
    assert answers_in(first) == answers_in(again)
    assert main(["solve", str(right_bag), *rule, "--output", str(tmp_path / "none.mcap")]) == 2
    assert "parameter load.share_file: cannot read" in capsys.readouterr().err


@pytest.mark.parametrize("leg", ["right", "left"])
def test_an_impossible_split_is_reported_and_flagged(leg, right_bag, tmp_path, capsys):
    """Of gait2354's moments between compartments 40 mm apart; between the default 70 mm nothing is wrong."""
    output = tmp_path / "out.mcap"
    balance = [
        "solve",
        str(right_bag.with_name(f"gait2354_{leg}")),
        "-p",
        "load.compartment:=moment_balance",
    ]
    assert main([*balance, "--output", str(output)]) == 0
    printed = capsys.readouterr()
    assert "share of the load" in printed.out
    assert printed.err == ""
    assert not read_answers(output, "/knee_contact")["status"].any()
    narrow = [*balance, "-p", "load.compartment_spacing:=0.04", "--overwrite"]
    assert main([*narrow, "--output", str(output)]) == 0
    flight, *largest, line = capsys.readouterr().err.splitlines()
    assert "above the tibia" in flight
    assert all("more than any knee bears" in each for each in largest)  # 5.4 body weights, left
    assert "load.compartment fixed_share needs no moment" in line
    wrong = sum(
        float(line.split(f"{side} in ")[1].split(" %")[0]) for side in ("above 1", "below 0")
    )
    assert wrong > 10.0
    answers = read_answers(output, "/knee_contact")
    flagged = (answers["status"] & Status.DOUBTFUL_LOAD) != 0
    forces = [
        -m.message.wrench.force.y for m in read_bag(output, {"/joint_reaction_force": WRENCH})
    ]
    stands = np.array(forces) >= 0.5 * WEIGHT
    assert np.array_equal(flagged, stands & ((answers["load"] < 0.0) | (answers["load"] > forces)))
    assert 100.0 * flagged.sum() / stands.sum() == pytest.approx(wrong, abs=0.1)


SMALL = "flexion_angle,axial_load,medial_share\n0,0,0.5\n0,2,0.7\n1,0,0.3\n1,2,1\n"


def shipped():
    path = Path(__file__).parents[2] / "config" / "share_medial.csv"
    return read_share_table(path.name, path.read_text(encoding="utf-8"))


def test_a_small_table_by_hand():
    rule = MeasuredShare(read_share_table("small.csv", SMALL), 500.0)
    assert rule.share_at(500.0, 0.0) == pytest.approx(0.6)
    assert rule.share_at(500.0, 0.5) == pytest.approx((0.5 + 0.7 + 0.3 + 1.0) / 4.0)
    assert rule.share_at(1000.0, 1.0) == 1.0  # all, to the last bit
    assert (
        rule.share_at(5000.0, -0.3) == rule.share_at(1000.0, 0.0) == pytest.approx(0.7)
    )  # held at the edge
    assert rule.share_at(-100.0, 3.0) == rule.share_at(0.0, 1.0) == pytest.approx(0.3)
    assert [
        rule.is_beyond_table(*at)
        for at in ((500.0, 0.5), (1001.0, 0.5), (-1.0, 0.5), (500.0, 1.1))
    ] == [
        False,
        True,
        True,
        True,
    ]


@given(axial=st.floats(-1e4, 1e5), flexion=st.floats(-6.3, 6.3))
def test_numbers_and_arrays_get_the_same_bits_and_no_share_beyond_its_bounds(axial, flexion):
    rule = MeasuredShare(shipped(), WEIGHT)
    assert rule.share_at(np.array([axial]), np.array([flexion])).tolist() == [
        rule.share_at(axial, flexion)
    ]
    assert 0.0 <= rule.share_at(axial, flexion) <= 1.0
    assert rule.is_beyond_table(np.array([axial]), np.array([flexion])).tolist() == [
        rule.is_beyond_table(axial, flexion)
    ]


def test_rows_in_any_order_with_and_without_names_are_one_table():
    lines = SMALL.splitlines()
    for text in (
        "\n".join(lines[1:]),
        "# of nobody\n" + "\n".join([lines[0], *reversed(lines[1:])]),
    ):
        for ours, first in zip(
            read_share_table("", text), read_share_table("", SMALL), strict=True
        ):
            np.testing.assert_array_equal(ours, first)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "must hold three columns flexion_angle, axial_load, medial_share of numbers"),
        ("0,0\n1,1\n", "three columns"),
        ("0,0,0.5\n0,1\n", "three columns"),
        (
            "0,0,0.5\n0,2,0.7\n60,0,0.3\n60,2,1\n",
            "reaches 60 rad; flexion angles must be in rad, not deg",
        ),
        ("0,0,0.5\n0,1400,0.7\n1,0,0.3\n1,1400,1\n", "0 to 30 body weights, not N"),
        ("0,0,0.5\n0,2,0.7\n1,0,0.3\n1,2,1.01\n", "has a share of 1.01; allowed: 0 to 1"),
        (
            "0,0,0.5\n0,2,0.7\n1,0,0.3\n1,2.5,0.4\n",
            "every one of its 2 angles needs every one of its 3 loads once",
        ),
        ("0,0,0.5\n0,2,0.7\n", "two or more flexion angles"),
        ("0,0,0.5\n" * 2001, "has 2001 points; at most 2000 are allowed"),
        ("#" * (2**20 + 1), "characters; at most"),
    ],
)
def test_what_is_no_table_is_refused_in_one_line(text, reason):
    with pytest.raises(UsageError, match=reason) as raised:
        read_share_table("mine.csv", text)
    assert str(raised.value).startswith("parameter load.share_file: mine.csv ")

"""The compartment's part of a joint reaction, and what is said of a split that cannot be used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from knee_contact_ros.bags.reader import read_answers, read_bag
from knee_contact_ros.commands.main import main
from knee_contact_ros.model.types import Status
from knee_contact_ros.parameters.build import load_rule
from knee_contact_ros.parameters.files import curve_texts, load_parameters
from knee_contact_ros.streams.contact_stream import load_sample
from knee_contact_ros.streams.messages import RefusedSampleError, WrenchStamped

WEIGHT = 737.068
WRENCH = "geometry_msgs/msg/WrenchStamped"


def wrench(force_y: float, moment_x: float) -> WrenchStamped:
    return WrenchStamped(0, "tibia_r", (0.0, force_y, 0.0), (moment_x, 0.0, 0.0))


def part(force_y: float, moment_x: float, **load: Any) -> float:
    parameters = load_parameters({"load": load})
    rule = load_rule(parameters, curve_texts(parameters, {}))
    sample = load_sample(wrench(force_y, moment_x), rule if rule.by_moment else None)
    return float(rule(sample.axial, sample.moment, 0.0))


def answers_in(path: Path) -> list[bytes]:
    with path.open("rb") as file:
        return [message.data for _, _, message in make_reader(file).iter_messages(topics=["/knee_contact"])]


def test_every_compartment_by_hand() -> None:
    assert part(-1000.0, 12.0, compartment="total") == 1000.0
    assert part(-1000.0, 12.0, compartment="fixed_share", share=0.6) == pytest.approx(600.0)
    # 500 N each, and 21 N m between two compartments 70 mm apart take 300 N from the medial one.
    assert part(-1000.0, 21.0, compartment="moment_balance") == pytest.approx(200.0)
    assert part(-1000.0, -12.0, compartment="moment_balance", compartment_spacing=0.06) == pytest.approx(700.0)


@given(medial=st.floats(0.0, 3e3), lateral=st.floats(0.0, 3e3), spacing=st.floats(0.01, 0.1))
def test_two_forces_on_the_plateau_are_found_again(medial: float, lateral: float, spacing: float) -> None:
    """The moment about x of forces along -y at z = -d and z = d is -z F_y."""
    force_y = -(medial + lateral)
    moment_x = 0.5 * spacing * (lateral - medial)
    found = part(force_y, moment_x, compartment="moment_balance", compartment_spacing=spacing)
    assert found == pytest.approx(medial, abs=1e-11)  # some roundings of 3e3 N, 5e-13 each


def test_a_moment_that_is_no_number_is_refused_where_it_is_needed() -> None:
    assert part(-1000.0, float("nan")) == 500.0
    with pytest.raises(RefusedSampleError, match=r"torque\.x is nan"):
        part(-1000.0, float("nan"), compartment="moment_balance")
    with pytest.raises(RefusedSampleError, match="makes a load of"):
        part(-1000.0, 1e6, compartment="moment_balance")


def test_a_recording_has_the_table_of_shares_that_it_was_made_with(
    right_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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
def test_a_split_that_no_knee_has_is_told_and_flagged(
    leg: str, right_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of gait2354's moments between compartments 40 mm apart; between the default 70 mm nothing is wrong."""
    output = tmp_path / "out.mcap"
    balance = ["solve", str(right_bag.with_name(f"gait2354_{leg}")), "-p", "load.compartment:=moment_balance"]
    assert main([*balance, "--output", str(output)]) == 0
    said = capsys.readouterr()
    assert "share of the load" in said.out
    assert said.err == ""
    assert not read_answers(output, "/knee_contact")["status"].any()
    narrow = [*balance, "-p", "load.compartment_spacing:=0.04", "--overwrite"]
    assert main([*narrow, "--output", str(output)]) == 0
    flight, line = capsys.readouterr().err.splitlines()
    assert "above the tibia" in flight
    assert "load.compartment fixed_share needs no moment" in line
    wrong = sum(float(line.split(f"{side} in ")[1].split(" %")[0]) for side in ("above 1", "below 0"))
    assert wrong > 10.0
    answers = read_answers(output, "/knee_contact")
    flagged = (answers["status"] & Status.DOUBTFUL_LOAD) != 0
    forces = [-m.message.wrench.force.y for m in read_bag(output, {"/joint_reaction_force": WRENCH})]
    stands = np.array(forces) >= 0.5 * WEIGHT
    assert np.array_equal(flagged, stands & ((answers["load"] < 0.0) | (answers["load"] > forces)))
    assert 100.0 * flagged.sum() / stands.sum() == pytest.approx(wrong, abs=0.1)

"""The compartment's part of a joint reaction, and what is said of a split that cannot be used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.cli.main import main
from knee_contact_ros.messages.cdr import WrenchStamped
from knee_contact_ros.parameters.compartments import COMPARTMENTS, Split
from knee_contact_ros.parameters.reading import load_parameters
from knee_contact_ros.parameters.schema import Load
from knee_contact_ros.pipeline.samples import RefusedSampleError, load_sample

WEIGHT = 737.068


def wrench(force_y: float, moment_x: float) -> WrenchStamped:
    return WrenchStamped(0, "tibia_r", (0.0, force_y, 0.0), (moment_x, 0.0, 0.0))


def part(force_y: float, moment_x: float, **load: Any) -> float:
    return load_sample(wrench(force_y, moment_x), Load(**load)).load


def test_every_compartment_by_hand() -> None:
    assert part(-1000.0, 12.0, compartment="total") == 1000.0
    assert part(-1000.0, 12.0, compartment="fixed_share", share=0.6) == pytest.approx(600.0)
    # 500 N each, and 12 N m between two compartments 40 mm apart take 300 N from the medial one.
    assert part(-1000.0, 12.0, compartment="moment_balance") == pytest.approx(200.0)
    assert part(-1000.0, -12.0, compartment="moment_balance", compartment_spacing=0.06) == pytest.approx(700.0)


@given(medial=st.floats(0.0, 3e3), lateral=st.floats(0.0, 3e3), spacing=st.floats(0.01, 0.1))
def test_two_forces_on_the_plateau_are_found_again(medial: float, lateral: float, spacing: float) -> None:
    """The moment about x of forces along -y at z = -d and z = d is -z F_y."""
    force_y = -(medial + lateral)
    moment_x = 0.5 * spacing * (lateral - medial)
    found = part(force_y, moment_x, compartment="moment_balance", compartment_spacing=spacing)
    assert found == pytest.approx(medial, abs=1e-11)  # some roundings of 3e3 N, 5e-13 each


@given(force_y=st.floats(-1e4, 1e4), moment_x=st.floats(-1e2, 1e2))
def test_numbers_and_arrays_get_the_same_bits(force_y: float, moment_x: float) -> None:
    for name, of in COMPARTMENTS.items():
        load = Load(compartment=name, share=0.7, compartment_spacing=0.045)
        column = of(np.array([force_y]), np.array([moment_x]), load)
        assert column.tolist() == [of(force_y, moment_x, load)]


def test_a_moment_that_is_no_number_is_refused_where_it_is_needed() -> None:
    assert part(-1000.0, float("nan")) == 500.0
    with pytest.raises(RefusedSampleError, match=r"torque\.x is nan"):
        part(-1000.0, float("nan"), compartment="moment_balance")
    with pytest.raises(RefusedSampleError, match="makes a load of"):
        part(-1000.0, 1e6, compartment="moment_balance")


def test_shares_are_counted_while_the_leg_stands() -> None:
    forces, loads = np.array([-100.0, -1000.0, -1000.0, -1000.0]), np.array([900.0, 1100.0, 300.0, -50.0])
    one, many = Split(WEIGHT), Split(WEIGHT)
    many.add_all(forces, loads)
    for force, load in zip(forces.tolist(), loads.tolist(), strict=True):
        one.add(force, load)
    for split in (one, many):
        assert (split.samples, split.above, split.below) == (3, 1, 1)
        assert split.text == "-0.05 to 1.10"
        assert "above 1 in 33.3 % and below 0 in 33.3 %" in split.problem
    good = Split(WEIGHT)
    good.add_all(forces[[2]], loads[[2]])
    assert good.problem == ""
    assert Split(WEIGHT).text == "the leg never stood"


@pytest.mark.parametrize(("leg", "least"), [("right", 10.0), ("left", 10.0)])
def test_the_split_of_gait2354_is_told_to_be_unusable(
    leg: str, least: float, right_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = right_bag.with_name(f"gait2354_{leg}")
    arguments = ["solve", str(bag), "-p", "load.compartment:=moment_balance", "--output", str(tmp_path / "out.mcap")]
    assert main(arguments) == 0
    said = capsys.readouterr()
    assert "share of the load" in said.out
    (line,) = said.err.splitlines()
    assert "load.compartment fixed_share needs no moment" in line
    above = float(line.split("above 1 in ")[1].split(" %")[0])
    assert above > least
    assert load_parameters({}).load.compartment == "fixed_share"

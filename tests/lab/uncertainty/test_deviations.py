"""Standard deviations as they are given."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from knee_contact_ros.lab.uncertainty import Deviation, deviations_of, read_deviations
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.system.errors import UsageError


def test_numbers_and_percents() -> None:
    given = {
        "flexion_angle": 0.02,
        "axial_load": "5 %",
        "contact.stiffness": "10%",
        "femur.radius": 1,
        "femur.mass": np.int64(2),
        "contact.damping": np.float32(0.5),
    }
    assert deviations_of(given, load_parameters("healthy")) == (
        Deviation("flexion_angle", 0.02, relative=False),
        Deviation("axial_load", 0.05, relative=True),
        Deviation("contact.stiffness", 0.1, relative=True),
        Deviation("femur.radius", 1.0, relative=False),
        Deviation("femur.mass", 2.0, relative=False),
        Deviation("contact.damping", 0.5, relative=False),
    )


def test_a_percentage_is_a_factor() -> None:
    ten = Deviation("contact.stiffness", 0.1, relative=True)
    assert ten.moved(200.0, 1.0) == pytest.approx(200.0 * math.exp(0.1), rel=1e-15)
    assert ten.moved(ten.moved(200.0, 1.0), -1.0) == pytest.approx(200.0, rel=1e-15)
    offset = Deviation("axial_load", 20.0, relative=False)
    assert offset.moved(np.array([0.0, 100.0]), -2.0).tolist() == [-40.0, 60.0]
    assert (ten.text, offset.text) == ("10 %", "20 N")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "no standard deviation is given; as contact.stiffness: 10 %"),
        ({"load": 3.0}, "load is not allowed; flexion_angle, axial_load, medial_share, femoral_height, or a parameter"),
        ({"contact.law": 1.0}, "contact.law is not allowed"),
        ({"contact.stifness": "5 %"}, "contact.stifness is not allowed; did you mean contact.stiffness?"),
        ({"axial_loads": 3.0}, "axial_loads is not allowed; did you mean axial_load?"),
        ({"": 3.0}, "'' is not allowed; flexion_angle"),
        ({"fidelity.tolerance": 1e-6}, "fidelity.tolerance is not allowed"),
        ({"knee.flexion_offset": 0.1}, "knee.flexion_offset is not allowed; flexion_angle"),
        ({"contact.stiffness": "ten"}, "contact.stiffness: 'ten' is not allowed; a number > 0 in SI units"),
        ({"contact.stiffness": "120 %"}, "'120 %' is not allowed; a number > 0 in SI units, or up to '100 %'"),
        ({"contact.stiffness": "5 % of it"}, "'5 % of it' is not allowed"),
        ({"contact.stiffness": 0.0}, "contact.stiffness: 0.0 is not allowed"),
        ({"contact.stiffness": -1.0}, "-1.0 is not allowed"),
        ({"contact.stiffness": math.nan}, "nan is not allowed"),
        ({"contact.stiffness": math.inf}, "inf is not allowed"),
        ({"contact.stiffness": 10**400}, "000 is not allowed"),
        ({"contact.stiffness": np.True_}, "contact.stiffness: "),
        ({"contact.stiffness": True}, "True is not allowed"),
        ({"contact.stiffness": None}, "None is not allowed"),
        ({"flexion_angle": "5 %"}, "flexion_angle: '5 %' is not allowed; in rad"),
        ({"medial_share": "5 %"}, "medial_share: '5 %' is not allowed; in parts of 1"),
        ({"lateral.contact.stiffness": "5 %"}, "moves nothing with load.compartment fixed_share"),
        ({"femoral_height": 1e-4}, "femoral_height moves nothing with drive force"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(given: dict[str, Any], said: str) -> None:
    with pytest.raises(UsageError, match=f"^uncertainty: .*{re.escape(said.removeprefix('uncertainty: '))}"):
        deviations_of(given, load_parameters("healthy"))


def test_loads_move_nothing_where_the_height_is_prescribed() -> None:
    parameters = load_parameters({"drive": "displacement"})
    assert deviations_of({"femoral_height": 1e-4}, parameters)[0].text == "0.0001 m"
    with pytest.raises(UsageError, match="axial_load moves nothing with drive displacement"):
        deviations_of({"axial_load": 10.0}, parameters)
    with pytest.raises(UsageError, match="medial_share moves nothing with drive displacement"):
        deviations_of({"medial_share": 0.1}, parameters)


def test_a_file_may_be_nested(tmp_path: Path) -> None:
    path = tmp_path / "sd.yaml"
    path.write_text("flexion_angle: 0.03\ncontact:\n  stiffness: 10 %\n")
    assert read_deviations(path) == {"flexion_angle": 0.03, "contact.stiffness": "10 %"}
    path.write_text("- 3\n")
    with pytest.raises(UsageError, match="names to standard deviations"):
        read_deviations(path)

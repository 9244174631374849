"""Which columns of ground reactions act on which foot."""

from __future__ import annotations

from pathlib import Path

import pytest

from knee_contact_ros.lab.opensim.leg import FootForce, data_file, read_ground
from knee_contact_ros.system.errors import UsageError
from tests.lab.opensim.plates import external, plate, write_loads, write_plates

LEFT = {"stem": "1_ground_force_", "torque": "1_ground_torque_"}


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Two plates by the names of OpenSim's examples."""
    return write_plates(
        tmp_path / "grf.mot",
        plate("ground_force_", "ground_torque_"),
        plate("1_ground_force_", "1_ground_torque_"),
    )


def test_external_loads_say_which_force_is_on_which_foot(data: Path) -> None:
    forces = [external("/bodyset/calcn_l"), external("calcn_r", **LEFT), external("pelvis")]
    loads = write_loads(data.parent / "grf.xml", " grf.mot ", forces)
    assert data_file(loads) == data
    right, left = (read_ground(loads, data_file(loads), side) for side in ("right", "left"))
    assert right.forces == (FootForce("1_ground_force_v", "1_ground_force_p", "1_ground_torque_"),)
    assert left.forces == (FootForce("ground_force_v", "ground_force_p", "ground_torque_"),)
    assert right.notes == left.notes == ("ground: what acts on pelvis is left out",)


def test_several_plates_may_be_below_a_foot_and_forces_be_switched_off(data: Path) -> None:
    off = external("calcn_r", more="<isDisabled> true </isDisabled>")
    also_off = external("calcn_r", more="<appliesForce>false</appliesForce>")
    loads = write_loads(data.parent / "grf.xml", "grf.mot", [off, external("calcn_r", torque=""), also_off])
    (force,) = read_ground(loads, data, "right").forces
    assert force.torque == ""
    loads = write_loads(loads, "grf.mot", [external("calcn_r"), external("toes_r", **LEFT)])
    assert len(read_ground(loads, data, "right").forces) == 2


def test_the_data_lie_beside_their_loads_or_where_a_tool_runs(data: Path) -> None:
    (data.parent / "loads").mkdir()
    loads = write_loads(data.parent / "loads" / "grf.xml", "grf.mot", [external("calcn_r")])
    with pytest.raises(UsageError, match=r"grf\.xml names the datafile grf\.mot, which is not there"):
        data_file(loads)
    assert data_file(loads, data.parent) == data
    assert data_file(data) == data
    with pytest.raises(UsageError, match="names no datafile, which has the numbers"):
        data_file(write_loads(loads, "", []))


@pytest.mark.parametrize(
    ("stems", "torques", "found"),
    [
        (("ground_force_", "1_ground_force_"), ("ground_torque_", "1_ground_torque_"), (0, 1)),
        (("ground_force_l_", "ground_force_r_"), ("ground_moment_l_m", "ground_moment_r_m"), (1, 0)),
        (("left_ground_force_", "right_ground_force_"), ("", ""), (1, 0)),
    ],
)
def test_names_of_columns_tell_the_foot(
    tmp_path: Path, stems: tuple[str, str], torques: tuple[str, str], found: tuple[int, int]
) -> None:
    data = write_plates(tmp_path / "grf.mot", *map(plate, stems, torques))
    for side, number in zip(("right", "left"), found, strict=True):
        (force,) = read_ground(data, data, side).forces
        assert force == FootForce(f"{stems[number]}v", f"{stems[number]}p", torques[number])


def test_what_is_not_clear_is_asked_for(data: Path) -> None:
    three = write_plates(data.parent / "three.mot", *(plate(f"ground_force_{n}_", "") for n in range(3)))
    with pytest.raises(UsageError, match=r"which of ground_force_0_vx, .* of the right foot\? Give the external loads"):
        read_ground(three, three, "right")
    none = write_plates(data.parent / "none.mot", {"x": plate("f_", "")["f_vx"]})
    with pytest.raises(UsageError, match="has no ground force, as ground_force_vx, but x"):
        read_ground(none, none, "left")


@pytest.mark.parametrize(
    ("force", "says"),
    [
        (external("calcn_l"), r"applies no force to the right foot; its forces act on calcn_l"),
        (external("calcn_r", more="<force_expressed_in_body>calcn_r</force_expressed_in_body>"),
         "force 'calcn_r': force_expressed_in_body is calcn_r, and must be ground"),
        (external("calcn_r", more="<point_expressed_in_body>calcn_r</point_expressed_in_body>"),
         "point_expressed_in_body is calcn_r, and must be ground"),
        (external("calcn_r").replace("ground_force_p", ""), "has no point_identifier"),
        (external("calcn_r", stem="2_force_"), "has no column 2_force_vx, 2_force_vy, 2_force_vz, 2_force_px"),
        (external("calcn_r", torque="t"), "has no column tx, ty, tz; it has ground_force_vx"),
    ],
)  # fmt: skip
def test_loads_that_cannot_be_are_refused(data: Path, force: str, says: str) -> None:
    loads = write_loads(data.parent / "grf.xml", "grf.mot", [force])
    with pytest.raises(UsageError, match=says) as refused:
        read_ground(loads, data, "right")
    assert "\n" not in str(refused.value)

"""Results of OpenSim become a knee's gait in our units, signs and frames: recognised where clear, else asked for."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from knee_contact_ros.lab.checks import sign_of, unit_of
from knee_contact_ros.lab.gait_bag import Gait
from knee_contact_ros.lab.opensim import Files, read_knee
from knee_contact_ros.lab.opensim.results import ImportSettings, angle_column, find_reactions
from knee_contact_ros.lab.tables import Table, read_storage
from knee_contact_ros.system.errors import UsageError
from tests.lab.opensim import storages
from tests.lab.opensim.storages import (
    AXES,
    DURATION,
    TIBIA,
    flexion,
    kinematics,
    outcome,
    reaction_columns,
    reactions,
)

DIGITS = 1e-11
"""Files of the tests have twelve decimals"""
ON_TIBIA, STATES = "knee_r_on_tibia_r_in_tibia_r", "/jointset/knee_r/knee_angle_r/"
TIME = np.linspace(0.0, DURATION, 121)


def table(
    names: list[str], values: list[float] | None = None, degrees: bool | None = None
) -> Table:
    column = np.array(values or [0.0])[:, None]
    return Table(
        Path("q.sto"),
        tuple(names),
        np.arange(len(column)),
        np.tile(column, len(names)),
        degrees,
        0,
    )


def on(*prefixes: str) -> Table:
    return table([f"{prefix}_{axis}" for prefix in prefixes for axis in AXES[:6]])


def knee(files: Files, side: str = "right", **settings: object) -> Gait:
    return read_knee(side, files, ImportSettings(**settings), Path())  # type: ignore[arg-type]


def files(folder: Path, **options: object) -> Files:
    return Files(kinematics(folder / "q.sto", **options), reactions(folder / "jr.sto"))  # type: ignore[arg-type]


UNITS = [
    ([-69.0, 1.0], True, "^deg$"),
    ([-1.2, 0.02], False, "^rad$"),
    ([0.0, 60.0], None, "^deg$"),
    (
        [-69.0, 1.0],
        False,
        "inDegrees=no, but a goes from -69 to 1, like degrees; give --angle-unit",
    ),
    (
        [-1.2, 0.02],
        True,
        r"inDegrees=yes, but a goes from -1\.2 to 0\.02, like rad; give --angle-unit",
    ),
    ([0.0, 1.2], None, r"does not say inDegrees, and a goes from 0 to 1\.2; give --angle-unit"),
]
SIGNS = [
    ([-69.0, 1.0], None, None, "^-1$"),
    ([-12.0, 25.0], None, None, "^1$"),
    ([-12.0, 15.0], None, (-2.1, 0.17), "^-1$"),
    ([-12.0, 15.0], None, (0.0, 2.4), "^1$"),
    ([-12.0, 15.0], -1, (0.0, 2.4), "^-1$"),
    (
        [-12.0, 15.0],
        None,
        None,
        r"a goes from -12\.0 to 15\.0 deg: .* --angle-sign 1 or -1, or --model",
    ),
    ([-69.0, 1.0], 1, None, r"with sign \+1 that is -69\.0 to 1\.0 deg of flexion, .* -30 to 170"),
]
OTHER_ANGLES = [
    "hip_flexion_r",
    "knee_angle_r_beta",
    "knee_adduction_r",
    "knee_angle_l",
    STATES + "speed",
]
ANGLES = [
    *[
        ([*OTHER_ANGLES, name], "right", None, f"^{name}$")
        for name in (
            "knee_angle_r",
            "knee_flexion_r",
            "knee_flex_r",
            "knee_r",
            "KNEE_ANGLE_R",
            "r_knee_flexion",
            "right_knee_angle",
            "/jointset/knee_r/knee_angle_r/value",
            "knee_r/knee_angle_r/value",
        )
    ],
    (["/jointset/k/kfr/value", "x"], "right", "kfr", "^/jointset/k/kfr/value$"),
    (
        ["knee_angle_r", "hip"],
        "left",
        None,
        r"no angle of the left knee, but knee_angle_r, hip.*--coordinate",
    ),
    (
        ["knee_angle_r", "knee_flexion_r"],
        "right",
        None,
        "has knee_angle_r, knee_flexion_r; choose one with --coord",
    ),
    (
        ["knee_angle_r", "/jointset/knee_r/knee_angle_r/value"],
        "right",
        None,
        r"has knee_angle_r, /jointset/knee_r/knee_angle_r/value; choose one with --coord",
    ),
    (["x"], "right", "kfl", r"no column kfl \(--coordinate\); it has x"),
]
OTHER_REACTIONS = (
    "hip_r_on_femur_r_in_femur_r",
    "patellofemoral_r_on_patella_r_in_patella_r",
    "knee_l_on_tibia_l_in_tibia_l",
)
LERNER, *HALVES = (
    "knee_r_on_articulation_r_in_articulation_r",
    "lat_cond_r_on_lat_r_in_lat_r",
    "med_cond_r_on_med_r_in_med_r",
)
REACTIONS = [
    ([ON_TIBIA], None, f"^{ON_TIBIA}_$"),
    (
        ["knee_r_on_tibia_proximal_r_in_tibia_proximal_r"],
        None,
        "^knee_r_on_tibia_proximal_r_in_tibia_proximal_r_$",
    ),
    (["knee_r_on_femur_r_in_tibia_r", ON_TIBIA], None, f"^{ON_TIBIA}_$"),
    (["k1_on_tibia_r_in_tibia_r", ON_TIBIA], "k1", "^k1_on_tibia_r_in_tibia_r_$"),
    (["k1_on_tibia_r_in_tibia_r"], "k2", r"no joint k2 \(--joint\); it has .*k1"),
    (
        [ON_TIBIA, f"old_{ON_TIBIA}"],
        None,
        r"knee_r.* none acts on the tibia of the right knee, or several do; .*--joint",
    ),
    (["knee_r_on_tibia_r_in_femur_r"], None, "^knee_r_on_tibia_r_in_femur_r_$"),
    (
        ["knee_r_on_femur_r_in_femur_r", "knee_r_on_tibia_r_in_ground", ON_TIBIA],
        None,
        f"^{ON_TIBIA}_$",
    ),
    (["knee_r_on_femur_r_in_tibia_r_offset"], None, "^knee_r_on_femur_r_in_tibia_r_offset_$"),
    (
        [LERNER, "weld_r_on_tibial_plat_r_in_tibial_plat_r"],
        None,
        "^weld_r_on_tibial_plat_r_in_tibial_plat_r_$",
    ),
    (
        [LERNER, *HALVES, "tibial_plat_weld_r_on_tibia_r_in_tibia_r"],
        None,
        "^tibial_plat_weld_r_on_tibia_r_in_tibia_r_$",
    ),
    ([LERNER, *HALVES], None, f"^{HALVES[1]}_{HALVES[0]}_$"),
    ([LERNER, HALVES[0]], None, "none acts on the tibia of the right knee"),
    ([LERNER], "knee_r", "of knee_r none acts on the tibia of the right knee"),
    (["ankle_r_on_tibia_r_in_tibia_r"], None, "none acts on the tibia of the right knee"),
    (["knee_r_on_patella_r_in_patella_r"], None, "none acts on the tibia of the right knee"),
    ([], None, "of hip_r, patellofemoral_r, knee_l none .*--joint"),
]
"""What is in a file, what is given, and what is found or asked for"""


@pytest.mark.parametrize(("values", "header", "found"), UNITS)
def test_the_unit_is_recognised_or_asked_for(
    values: list[float], header: bool | None, found: str
) -> None:
    angles = table(["a"], values, header)
    assert re.search(found, str(outcome(unit_of, angles, "a", "auto")))
    assert unit_of(angles, "a", "rad") == "rad"


@pytest.mark.parametrize(("degrees", "given", "bounds", "found"), SIGNS)
def test_the_sign_is_that_to_which_it_goes_further(
    degrees: Any, given: Any, bounds: Any, found: str
) -> None:
    assert re.search(found, str(outcome(sign_of, np.radians(degrees), "q.sto: a", given, bounds)))


@pytest.mark.parametrize(("names", "side", "coordinate", "found"), ANGLES)
def test_a_knees_angle_is_found(
    names: list[str], side: str, coordinate: str | None, found: str
) -> None:
    assert re.search(found, str(outcome(angle_column, table(names), side, coordinate)))


@pytest.mark.parametrize(("prefixes", "joint", "found"), REACTIONS)
def test_the_knees_reaction_is_found_or_it_is_said_what_to_set(
    prefixes: list[str], joint: str | None, found: str
) -> None:
    chosen: Any = outcome(find_reactions, on(*OTHER_REACTIONS, *prefixes), "right", joint)
    assert re.search(
        found, chosen if isinstance(chosen, str) else "".join(each.column("") for each in chosen)
    )


def test_a_reaction_with_columns_missing_and_a_file_without_one() -> None:
    some = [f"{ON_TIBIA}_{axis}" for axis in ("fx", "fz", "mx", "my")]
    assert re.search(
        rf"no column {ON_TIBIA}_fy, .*_mz",
        str(outcome(find_reactions, table(some), "right", None)),
    )
    found = outcome(find_reactions, table(["knee_angle_r"]), "right", None)
    assert "no reaction <joint>_on_<body>_in_<frame>_fx" in str(found)
    moco = table([f"/jointset/knee_r|reaction_on_child_{number}" for number in range(1, 7)])
    assert "knee_r', body='tibia', frame='ground', moco='/" in str(
        outcome(find_reactions, moco, "right", None)
    )


@pytest.mark.parametrize(
    ("sign", "unit", "header", "names"),
    [
        (-1.0, "deg", "yes", "knee_angle_{}"),
        (1.0, "deg", "yes", "knee_angle_{}"),
        (1.0, "rad", "no", "/jointset/walker_knee_{0}/knee_angle_{0}/value"),
        (-1.0, "deg", None, "knee_flexion_{}"),
    ],
)
def test_angles_come_out_in_rad_positive_in_flexion(
    tmp_path: Path, sign: float, unit: str, header: str | None, names: str
) -> None:
    angle, rate = (
        knee(files(tmp_path, sign=sign, unit=unit, header=header, names=names))
        .joints["knee"]
        .values.T
    )
    assert angle == pytest.approx(flexion(TIME), abs=DIGITS)
    exact = np.radians(30.0) * 2.0 * np.pi / DURATION * np.sin(2.0 * np.pi * TIME / DURATION)
    # Central differences over 10 ms: h²/6 of the third derivative, 0.0013 rad/s; at the ends h/2 of the second.
    assert rate[1:-1] == pytest.approx(exact[1:-1], abs=1.5e-3)
    assert rate == pytest.approx(exact, abs=0.08)


def test_the_right_reaction_is_taken_as_it_is_and_the_left_one_mirrored(tmp_path: Path) -> None:
    right, left = (knee(files(tmp_path), side) for side in ("right", "left"))
    expected = np.column_stack(reaction_columns(right.wrenches["load"].stamps * 1e-9))
    assert right.wrenches["load"].values == pytest.approx(expected, abs=1e-9)
    assert left.wrenches["load"].values == pytest.approx(
        expected * [1, 1, -1, -1, -1, 1], abs=1e-9
    )
    assert any("mirrored" in note for note in left.notes)


def test_a_reaction_on_the_femur_is_turned_and_moved(tmp_path: Path) -> None:
    time = np.linspace(0.0, DURATION, 201)
    force, torque = (
        np.column_stack(part) for part in np.split(np.array(reaction_columns(time)), 2)
    )
    point = np.column_stack([0.01 * np.sin(time), 0.4 + 0.0 * time, 0.02 * time])
    # At the point of application the torque on the femur is the opposite of that on the tibia, which at the origin has
    # point x force more.
    on_femur = [*(-force).T, *(-(torque - np.cross(point, force))).T, *point.T]
    names = [f"knee_r_on_femur_r_in_tibia_r_{axis}" for axis in AXES]
    jr = storages.write_storage(
        tmp_path / "jr.sto", time, dict(zip(names, on_femur, strict=True)), "no"
    )
    gait = knee(Files(kinematics(tmp_path / "q.sto"), jr))
    assert gait.wrenches["load"].values == pytest.approx(
        np.hstack([force, torque]), abs=1e-8
    )  # 12 decimals of 0.4 m, 1800 N
    assert any("Newton" in note for note in gait.notes)


def test_rates_of_a_file_are_taken_if_they_are_the_angles(tmp_path: Path) -> None:
    rate = np.radians(30.0) * 2.0 * np.pi / DURATION * np.sin(2.0 * np.pi * TIME / DURATION)
    read, u = files(tmp_path), tmp_path / "u.sto"
    for rows, factor, name, says in (
        (121, -1.0, "knee_angle_r", ""),
        (121, -57.3, "knee_angle_r", "the rate of the angle is 57.3"),
        (121, 1.0, "knee_angle_r", "the rate of the angle is -1"),
        (50, -1.0, "knee_angle_r", "less than the angles"),
        (121, -1.0, "hip", "no rate of knee_angle_r"),
    ):
        storages.write_storage(u, TIME[:rows], {name: factor * np.degrees(rate[:rows])}, "yes")
        if says:
            with pytest.raises(UsageError, match=says):
                knee(Files(read.kinematics, read.reactions, u))
        else:
            assert knee(Files(read.kinematics, read.reactions, u)).joints["knee"].values[
                :, 1
            ] == pytest.approx(rate, abs=DIGITS)


def test_reactions_without_an_angle_are_left_out_and_counted(tmp_path: Path) -> None:
    read = Files(
        kinematics(tmp_path / "q.sto"), reactions(tmp_path / "jr.sto", rows=1501, end=1.5)
    )
    gait = knee(read)
    assert gait.wrenches["load"].stamps[-1] == 1_200_000_000
    assert (
        "load: 300 rows left out, before time 0 or where another signal or time is not"
        in gait.notes
    )
    window = knee(read, start=0.2005, end=0.6005)
    assert window.wrenches["load"].stamps[[0, -1]].tolist() == [201_000_000, 600_000_000]
    # The angles' neighbours stay, so that every reaction has an angle on either side.
    assert window.joints["knee"].stamps[[0, -1]].tolist() == [200_000_000, 610_000_000]


@pytest.mark.parametrize(
    ("reaction", "settings", "says"),
    [
        ({}, {"start": 5.0}, "--start 5 --end 1.2: nothing is left of 0 to 1.2 s"),
        (
            {},
            {"start": 0.5001, "end": 0.5004},
            r"fewer than two rows of the load are within 0\.5001 to 0\.5004 s",
        ),
        (
            {},
            {"rate": 1.0, "start": 0.3, "end": 0.5},
            r"fewer than two rows of the angle are within 0\.3 to 0\.5 s at 1 Hz",
        ),
        ({"sign": -1.0}, {}, "fy pulls the knee apart by up to 1800 N, and presses with -900 N"),
        ({"sign": 1.0 / 750.0}, {}, r"fy: the peak is 2\.4 N, plausible is .*, in N, and without"),
        (
            {"rows": 11, "start": 3.0, "end": 4.0},
            {},
            r"no time in common: 0 to 1\.2 s and 3 to 4 s",
        ),
        (
            {"prefix": TIBIA.replace("in_tibia_{0}", "in_ground")},
            {},
            r"is in ground, .*: give --model M\.osim",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(
    tmp_path: Path, reaction: dict[str, float], settings: dict[str, object], says: str
) -> None:
    jr = reactions(tmp_path / "jr.sto", **reaction)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match=says) as refused:
        knee(Files(kinematics(tmp_path / "q.sto"), jr), **settings)
    assert "\n" not in str(refused.value)


def test_a_reaction_in_the_femurs_frame_is_turned_by_the_angle(tmp_path: Path) -> None:
    """On the femur it is the other way round; without a model its torque has another point, and that is told."""
    jr = reactions(tmp_path / "jr.sto")
    tibia = read_storage(jr)
    time = tibia.stamps * 1e-9
    angle = np.interp(time, TIME, flexion(TIME))
    ours = knee(Files(kinematics(tmp_path / "q.sto"), jr), rate=None)
    columns = {name: tibia.column(name) for name in tibia.names if "_on_tibia_r" in name}
    for kind in "fm":
        x, y = (
            next(v for name, v in columns.items() if name.endswith(kind + axis)) for axis in "xy"
        )
        z = next(v for name, v in columns.items() if name.endswith(f"{kind}z"))
        turned = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x, z
        columns |= {
            f"knee_r_on_femur_r_in_femur_r_{kind}{axis}": -v
            for axis, v in zip("xyz", turned, strict=True)
        }
    columns = {name: values for name, values in columns.items() if "femur" in name}
    path = storages.write_storage(tmp_path / "femur.sto", time, columns, "no")
    found = knee(Files(tmp_path / "q.sto", path), rate=None)
    np.testing.assert_allclose(
        found.wrenches["load"].values, ours.wrenches["load"].values, atol=1e-6
    )
    assert (
        "turned from femur_r by the flexion angle alone, as of a hinge, and its torque"
        in found.doubts[0]
    )


def test_a_gap_is_told_and_not_interpolated_across(tmp_path: Path) -> None:
    there = (TIME <= 0.5) | (TIME >= 0.74)
    q = storages.write_storage(
        tmp_path / "q.sto", TIME[there], {"knee_angle_r": -np.degrees(flexion(TIME[there]))}, "yes"
    )
    for rate, rows in ((200.0, 241 - 47), (None, 1201)):
        gait = knee(Files(q, reactions(tmp_path / "jr.sto")), rate=rate)
        assert any(
            "angle: 1 gaps longer than 0.1 s, the longest of 0.24 s at 0.5 s" in note
            for note in gait.notes
        )
        assert len(gait.wrenches["load"].stamps) == rows
        assert gait.joints["knee"].values[:, 0] == pytest.approx(
            flexion(gait.joints["knee"].stamps * 1e-9), abs=3e-4
        )


def test_rows_outside_the_time_that_is_asked_for_do_not_matter(tmp_path: Path) -> None:
    angle = np.where(TIME < 0.2, np.nan, -np.degrees(flexion(TIME)))
    q = storages.write_storage(
        tmp_path / "q.sto", TIME, {"knee_angle_r": angle, "hip": np.nan * TIME}, "yes"
    )
    gait = knee(Files(q, reactions(tmp_path / "jr.sto")), start=0.25, end=1.0, rate=100.0)
    assert gait.joints["knee"].values[:, 0] == pytest.approx(
        flexion(gait.joints["knee"].stamps * 1e-9), abs=DIGITS
    )
    with pytest.raises(
        UsageError, match=r"column knee_angle_r is nan at 0\.1 s; it must be a finite number"
    ):
        knee(Files(q, reactions(tmp_path / "jr.sto")), start=0.1)


def loaded(folder: Path, times: float, model: bool) -> Files:
    """Results with a multiple of a usual load, which is 1800 N at most."""
    time = np.linspace(0.0, DURATION, 241)
    columns = dict(
        zip(
            [f"{ON_TIBIA}_{axis}" for axis in AXES[:6]], reaction_columns(time, times), strict=True
        )
    )
    jr = storages.write_storage(folder / "jr.sto", time, columns, "no")
    return Files(
        kinematics(folder / "q.sto"),
        jr,
        model=storages.write_model(folder / "m.osim") if model else None,
    )


@pytest.mark.parametrize(
    ("times", "says"),
    [
        (5.0, r"the peak of 9000 N is 12\.641 body weights, .*model"),
        (0.2, r"the peak of 360 N is 0\.50564 body weights"),
    ],
)
def test_what_is_likely_a_mistake_is_imported_only_if_the_user_insists(
    tmp_path: Path, times: float, says: str
) -> None:
    read = loaded(tmp_path, times, model=True)
    with pytest.raises(UsageError, match=f"{says}.*--anyway"):
        knee(read)
    assert re.search(says, knee(read, anyway=True).doubts[0])


def test_without_a_model_a_large_load_is_a_warning(tmp_path: Path) -> None:
    assert (
        "the peak is 8640 N, plausible is 400 to 8000"
        in knee(loaded(tmp_path, 4.8, model=False)).doubts[0]
    )
    assert not knee(files(tmp_path)).doubts


def test_a_model_tells_sign_and_weight(tmp_path: Path) -> None:
    standing = storages.write_storage(
        tmp_path / "q.sto", TIME, {"knee_angle_r": -5.0 - 4.0 * np.sin(TIME)}, "yes"
    )
    jr, model = reactions(tmp_path / "jr.sto"), storages.write_model(tmp_path / "m.osim")
    with pytest.raises(UsageError, match="Give --angle-sign 1 or -1, or --model"):
        knee(Files(standing, jr))
    gait = read_knee("right", Files(standing, jr, model=model), ImportSettings(), tmp_path)
    assert gait.joints["knee"].values[:, 0].min() > 0.0
    assert gait.weight == pytest.approx(72.6 * 9.80665)
    good = model.read_text()
    for text, says in (
        (
            good.replace("42.6", "9,3"),
            r"m\.osim \(--model\): mass of Body b is '9,3', and must be numbers",
        ),
        (
            good.replace("42.6", "nan"),
            "mass of all Body elements is nan kg; it must be finite and > 0",
        ),
        (
            good.replace("42.6", "-30"),
            "mass of all Body elements is 0 kg; it must be finite and > 0",
        ),
        (
            good.replace("-2.0943951", "x"),
            "range of Coordinate knee_angle_r is 'x 0.17453293', and must be numbers",
        ),
        ("<a>", r"m\.osim is not an OpenSim document"),
        ("<a><Model/></a>", r"\(--model\) has no coordinate"),
    ):
        model.write_text(text)
        with pytest.raises(UsageError, match=says):
            knee(Files(standing, jr, model=model))


@pytest.fixture(scope="module")
def reference(reference_data: Path) -> Files:
    folder = reference_data / "opensim_gait2354"
    return Files(
        folder / "reference_CMC_Kinematics_q.sto",
        folder / "reference_JointReaction_ReactionLoads.sto",
    )


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_reference_results_are_the_tables_of_the_shipped_bags(
    reference: Files, reference_data: Path, side: str
) -> None:
    gait = knee(reference, side, rate=200.0)
    rows = (reference_data / "gait" / f"gait2354_{side}.csv").read_text().splitlines()
    lines = [line for line in rows if not line.startswith("#")]
    numbers = np.array([[float(value) for value in line.split(",")] for line in lines[1:]])
    assert lines[0].startswith("t,knee_angle,knee_vel,Fx,Fy,Fz,Mx,My,Mz")
    assert numbers[:, 0] == pytest.approx(gait.joints["knee"].stamps * 1e-9, abs=1e-9)
    # The tables have six digits, and rates from the rounded angles' neighbours.
    assert gait.joints["knee"].values[:, 0] == pytest.approx(numbers[:, 1], rel=1e-5, abs=1e-6)
    assert gait.joints["knee"].values[:, 1] == pytest.approx(numbers[:, 2], rel=1e-4, abs=1e-3)
    assert gait.wrenches["load"].values == pytest.approx(numbers[:, 3:9], rel=1e-5, abs=1e-5)

"""Results of OpenSim become a knee's gait in our units, signs and frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.lab.opensim.command import Files, read_knee
from knee_contact_ros.lab.opensim.results import Settings
from knee_contact_ros.system.errors import UsageError
from tests.lab.opensim.storages import (
    AXES,
    DURATION,
    TIBIA,
    flexion,
    kinematics,
    reaction_columns,
    reactions,
    write_storage,
)

DIGITS = 1e-11
"""Files of the tests have twelve decimals"""


def files(folder: Path, **kinematics_arguments: object) -> Files:
    return Files(kinematics(folder / "q.sto", **kinematics_arguments), reactions(folder / "jr.sto"))  # type: ignore[arg-type]


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
    knee = read_knee("right", files(tmp_path, sign=sign, unit=unit, header=header, names=names), Settings())
    time = knee.angles.stamps * 1e-9
    assert len(time) == 121
    assert knee.angles.angle == pytest.approx(flexion(time), abs=DIGITS)
    exact = np.radians(30.0) * 2.0 * np.pi / DURATION * np.sin(2.0 * np.pi * time / DURATION)
    # Central differences over 10 ms: h²/6 of the third derivative, 0.0013 rad/s; at the ends h/2 of the second.
    assert knee.angles.rate is not None
    assert knee.angles.rate[1:-1] == pytest.approx(exact[1:-1], abs=1.5e-3)
    assert knee.angles.rate == pytest.approx(exact, abs=0.08)


def test_the_right_reaction_is_taken_as_it_is_and_the_left_one_mirrored(tmp_path: Path) -> None:
    right, left = (read_knee(side, files(tmp_path), Settings()) for side in ("right", "left"))
    expected = np.column_stack(reaction_columns(right.reactions.stamps * 1e-9))
    assert np.column_stack(right.reactions[1:]) == pytest.approx(expected, abs=1e-9)
    assert np.column_stack(left.reactions[1:]) == pytest.approx(expected * [1, 1, -1, -1, -1, 1], abs=1e-9)
    assert any("mirrored" in note for note in left.notes)


def test_a_reaction_on_the_femur_is_turned_and_moved(tmp_path: Path) -> None:
    time = np.linspace(0.0, DURATION, 201)
    force, torque = (np.column_stack(part) for part in np.split(np.array(reaction_columns(time)), 2))
    point = np.column_stack([0.01 * np.sin(time), 0.4 + 0.0 * time, 0.02 * time])
    # At the point of application the torque on the femur is the opposite of that on the tibia, which at the origin has
    # point x force more.
    on_femur = [*(-force).T, *(-(torque - np.cross(point, force))).T, *point.T]
    names = [f"knee_r_on_femur_r_in_tibia_r_{axis}" for axis in AXES]
    jr = write_storage(tmp_path / "jr.sto", time, dict(zip(names, on_femur, strict=True)), "no")
    knee = read_knee("right", Files(kinematics(tmp_path / "q.sto"), jr), Settings())
    assert knee.reactions.force == pytest.approx(force, abs=1e-9)
    assert knee.reactions.torque == pytest.approx(torque, abs=1e-8)  # 12 decimals of 0.4 m and 1800 N
    assert any("Newton" in note for note in knee.notes)


def test_rates_of_a_file_are_taken(tmp_path: Path) -> None:
    time = np.linspace(0.0, DURATION, 121)
    rate = np.radians(30.0) * 2.0 * np.pi / DURATION * np.sin(2.0 * np.pi * time / DURATION)
    u = write_storage(tmp_path / "u.sto", time, {"knee_angle_r": -np.degrees(rate)}, "yes")
    knee = read_knee(
        "right", files(tmp_path).__class__(kinematics(tmp_path / "q.sto"), tmp_path / "jr.sto", u), Settings()
    )
    assert knee.angles.rate == pytest.approx(rate, abs=DIGITS)
    for factor, says in ((57.3, "is 57.3 times the rate"), (-1.0, "is -1 times the rate")):
        write_storage(u, time, {"knee_angle_r": -factor * np.degrees(rate)}, "yes")
        with pytest.raises(UsageError, match=says):
            read_knee("right", Files(tmp_path / "q.sto", tmp_path / "jr.sto", u), Settings())
    write_storage(u, time[:50], {"knee_angle_r": rate[:50]}, "no")
    with pytest.raises(UsageError, match="less than the angles"):
        read_knee("right", Files(tmp_path / "q.sto", tmp_path / "jr.sto", u), Settings())
    write_storage(u, time, {"hip": rate}, "no")
    with pytest.raises(UsageError, match="no rate of knee_angle_r"):
        read_knee("right", Files(tmp_path / "q.sto", tmp_path / "jr.sto", u), Settings())


def test_reactions_without_an_angle_are_left_out_and_counted(tmp_path: Path) -> None:
    q, jr = kinematics(tmp_path / "q.sto"), reactions(tmp_path / "jr.sto", rows=1501, end=1.5)
    knee = read_knee("right", Files(q, jr), Settings())
    assert knee.reactions.stamps[-1] == 1_200_000_000
    assert "300 reactions left out: no angle at their time, or outside --start and --end" in knee.notes
    window = read_knee("right", Files(q, jr), Settings(start=0.2005, end=0.6005))
    assert (window.reactions.stamps[0], window.reactions.stamps[-1]) == (201_000_000, 600_000_000)
    # The angles' neighbours stay, so that every reaction has an angle on either side.
    assert (window.angles.stamps[0], window.angles.stamps[-1]) == (200_000_000, 610_000_000)


def test_resampled_at_a_rate(tmp_path: Path) -> None:
    knee = read_knee("right", files(tmp_path), Settings(rate=200.0, start=0.1024, end=1.0))
    assert knee.angles.stamps.tolist() == knee.reactions.stamps.tolist()
    assert knee.angles.stamps.tolist() == list(range(105_000_000, 1_000_000_001, 5_000_000))
    time = knee.angles.stamps * 1e-9
    # Linear interpolation over 10 ms: h²/8 of the second derivative of the angle, 1.8e-4 rad.
    assert knee.angles.angle == pytest.approx(flexion(time), abs=2e-4)
    assert knee.reactions.force == pytest.approx(np.column_stack(reaction_columns(time)[:3]), abs=1e-8)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (Settings(start=5.0), "--start 5 --end 1.2: nothing is left of 0 to 1.2 s"),
        (Settings(start=0.5, end=0.4), "--start 0.5 --end 0.4: nothing is left"),
        (Settings(start=0.5001, end=0.5004), r"fewer than two rows of the reactions are within 0\.5001 to 0\.5004 s"),
        (Settings(rate=1.0, start=0.3, end=0.5), "--rate 1: fewer than two samples in 0.2 s"),
        (Settings(joint="elbow"), r"no joint elbow \(--joint\); it has knee_r, knee_l"),
        (Settings(coordinate="elbow"), r"no column elbow \(--coordinate\)"),
        (Settings(angle_sign=1), r"with sign \+1 that is -63\.0 to -3\.0 deg of flexion"),
        (Settings(angle_unit="rad"), "--angle-unit"),
    ],
)
def test_settings_that_cannot_be_are_refused_in_a_line(tmp_path: Path, settings: Settings, says: str) -> None:
    with pytest.raises(UsageError, match=says) as refused:
        read_knee("right", files(tmp_path), settings)
    assert "\n" not in str(refused.value)


def test_forces_of_another_sign_or_unit_are_refused(tmp_path: Path) -> None:
    q = kinematics(tmp_path / "q.sto")
    with pytest.raises(UsageError, match="fy pulls the knee apart, by up to 1800 N, and presses with -900 N"):
        read_knee("right", Files(q, reactions(tmp_path / "jr.sto", sign=-1.0)), Settings())
    with pytest.raises(UsageError, match=r"fy presses with 2\.4 at most; it must be in N"):
        read_knee("right", Files(q, reactions(tmp_path / "jr.sto", sign=1.0 / 750.0)), Settings())
    ground = TIBIA.replace("_in_tibia_{0}", "_in_ground")
    with pytest.raises(UsageError, match=r"expressed in ground, .* express_in_frame child"):
        read_knee("right", Files(q, reactions(tmp_path / "jr.sto", ground)), Settings())


def test_files_of_different_times_are_refused(tmp_path: Path) -> None:
    q, jr = kinematics(tmp_path / "q.sto"), tmp_path / "jr.sto"
    time = np.linspace(3.0, 4.0, 11)
    write_storage(
        jr, time, dict(zip([TIBIA.format("r") + a for a in AXES[:6]], reaction_columns(time), strict=True)), "no"
    )
    with pytest.raises(UsageError, match=r"no time in common: 0 to 1\.2 s and 3 to 4 s"):
        read_knee("right", Files(q, jr), Settings())


MODEL = """<?xml version="1.0"?><OpenSimDocument Version="40000"><Model name="m"><BodySet><objects>
<Body name="a"><mass>30</mass></Body><Body name="b"><mass>42.6</mass></Body></objects></BodySet>
<Coordinate name="knee_angle_r"><range>-2.0943951 0.17453293</range></Coordinate></Model></OpenSimDocument>"""


def test_a_model_tells_sign_and_weight(tmp_path: Path) -> None:
    time = np.linspace(0.0, DURATION, 121)
    standing = write_storage(tmp_path / "q.sto", time, {"knee_angle_r": -5.0 - 4.0 * np.sin(time)}, "yes")
    model = tmp_path / "m.osim"
    model.write_text(MODEL)
    jr = reactions(tmp_path / "jr.sto")
    with pytest.raises(UsageError, match="Give --angle-sign 1 or -1, or --model"):
        read_knee("right", Files(standing, jr), Settings())
    knee = read_knee("right", Files(standing, jr, model=model), Settings())
    assert knee.angles.angle.min() > 0.0
    assert knee.body_weight == pytest.approx(72.6 * 9.80665)
    model.write_text(MODEL.replace("knee_angle_r", "k"))
    with pytest.raises(UsageError, match=r"\(--model\) has no coordinate knee_angle_r"):
        read_knee("right", Files(standing, jr, model=model), Settings())
    model.write_text("<a>")
    with pytest.raises(UsageError, match=r"m\.osim is no OpenSim document"):
        read_knee("right", Files(standing, jr, model=model), Settings())


@pytest.fixture(scope="module")
def reference(reference_data: Path) -> Files:
    folder = reference_data / "opensim_gait2354"
    return Files(folder / "reference_CMC_Kinematics_q.sto", folder / "reference_JointReaction_ReactionLoads.sto")


def test_the_reference_results_have_the_papers_peaks(reference: Files) -> None:
    knee = read_knee("right", reference, Settings(rate=200.0))
    assert len(knee.reactions.stamps) == 387
    half = dict(zip(np.round(knee.reactions.stamps * 1e-9, 3).tolist(), -0.5 * knee.reactions.force[:, 1], strict=True))
    second = {time: load for time, load in half.items() if 1.9 < time < 2.2}
    assert max(second, key=second.__getitem__) == 2.015
    assert max(half, key=half.__getitem__) == 2.43
    assert (round(half[2.015], 1), round(half[2.43], 1)) == (1337.7, 1613.8)


def test_every_row_of_the_reference_results_keeps_its_stamp(reference: Files) -> None:
    knee = read_knee("right", reference, Settings())
    assert (len(knee.angles.stamps), len(knee.reactions.stamps)) == (327, 3257)  # of 3258 one is there twice
    assert any("1 row gave way" in note for note in knee.notes)
    assert np.degrees(knee.angles.angle.max()) == pytest.approx(69.6, abs=0.05)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_reference_results_are_the_tables_of_the_shipped_bags(
    reference: Files, reference_data: Path, side: str
) -> None:
    knee = read_knee(side, reference, Settings(rate=200.0))
    rows = (reference_data / "gait" / f"gait2354_{side}.csv").read_text().splitlines()
    lines = [line for line in rows if not line.startswith("#")]
    table = np.array([[float(value) for value in line.split(",")] for line in lines[1:]])
    assert lines[0].startswith("t,knee_angle,knee_vel,Fx,Fy,Fz,Mx,My,Mz")
    assert table[:, 0] == pytest.approx(knee.angles.stamps * 1e-9, abs=1e-9)
    # The tables have six digits, and rates from the rounded angles' neighbours.
    assert knee.angles.angle == pytest.approx(table[:, 1], rel=1e-5, abs=1e-6)
    assert knee.angles.rate == pytest.approx(table[:, 2], rel=1e-4, abs=1e-3)
    assert knee.reactions.force == pytest.approx(table[:, 3:6], rel=1e-5, abs=1e-5)
    assert knee.reactions.torque == pytest.approx(table[:, 6:9], rel=1e-5, abs=1e-5)

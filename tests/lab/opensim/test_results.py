"""Results of OpenSim become a knee's gait in our units, signs and frames: recognised where clear, else asked for."""

import re
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.lab.checks import angle_unit_of, flexion_sign_of
from knee_contact_ros.lab.opensim import Files, read_knee
from knee_contact_ros.lab.opensim.results import ImportSettings, angle_column, find_reactions
from knee_contact_ros.lab.tables import Table, read_storage
from knee_contact_ros.system.errors import UsageError
from tests.lab.opensim.storages import (
    AXES,
    DURATION,
    TIBIA,
    flexion,
    kinematics,
    outcome,
    reaction_columns,
    reactions,
    write_model,
    write_storage,
)

DIGITS = 1e-11
"""Files of the tests have twelve decimals"""
ON_TIBIA, STATES = "knee_r_on_tibia_r_in_tibia_r", "/jointset/knee_r/knee_angle_r/"
TIME = np.linspace(0.0, DURATION, 121)
RATE = np.radians(30.0) * 2.0 * np.pi / DURATION * np.sin(2.0 * np.pi * TIME / DURATION)
"""[rad/s] of `flexion`"""


def table(names, values=(0.0,), degrees=None):
    columns = np.tile(np.array(values)[:, None], len(names))
    return Table(Path("q.sto"), tuple(names), np.arange(len(values)), columns, degrees, 0)


def knee(files, side="right", **settings):
    return read_knee(side, files, ImportSettings(**settings), Path())


def files(folder, **options):
    return Files(kinematics(folder / "q.sto", **options), reactions(folder / "jr.sto"))


def angles(folder, degrees, time=TIME, **more):
    """Kinematics of a right knee."""
    return write_storage(folder / "q.sto", time, {"knee_angle_r": degrees, **more}, "yes")


def flexion_of(gait):
    return gait.joints["knee"].values[:, 0]


def load_of(gait):
    return gait.wrenches["load"].values


def times_of(gait):
    """Times [s] of the angles."""
    return gait.joints["knee"].stamps * 1e-9


UNITS = [
    ((-69.0, 1.0), True, "^deg$"),
    ((-1.2, 0.02), False, "^rad$"),
    # No knee bends by 3.5 rad; one that hardly moves has so few degrees.
    ((0.5, 3.6), None, "^deg$"),
    ((0.5, 3.4), None, "does not say inDegrees"),
    ((-69.0, 1.0), False, "inDegrees=no, but a goes from -69 to 1, like degrees; give --angle"),
    ((-1.2, 0.02), True, r"inDegrees=yes, but a goes from -1\.2 to 0\.02, like rad; give --angle"),
]
SIGNS = [
    ((-69.0, 1.0), None, None, "^-1$"),
    ((-12.0, 25.0), None, None, "^1$"),
    ((-12.0, 15.0), None, (-2.1, 0.17), "^-1$"),
    ((-12.0, 15.0), None, (0.0, 2.4), "^1$"),
    ((-12.0, 15.0), -1, (0.0, 2.4), "^-1$"),
    ((-12.0, 15.0), None, None, r"from -12\.0 to 15\.0 deg: .* --angle-sign 1 or -1, or --model"),
    ((-69.0, 1.0), 1, None, r"with sign \+1 that is -69\.0 to 1\.0 deg of flexion, .* -30 to 170"),
]
OTHER_ANGLES = "hip_flexion_r knee_angle_r_beta knee_adduction_r knee_angle_l"
KNEE_ANGLES = (
    "knee_angle_r knee_flexion_r knee_flex_r knee_r KNEE_ANGLE_R r_knee_flexion right_knee_angle "
    f"{STATES}value knee_r/knee_angle_r/value"
)
ANGLES = [
    *((f"{OTHER_ANGLES} {STATES}speed {n}", "right", None, f"^{n}$") for n in KNEE_ANGLES.split()),
    ("/jointset/k/kfr/value x", "right", "kfr", "^/jointset/k/kfr/value$"),
    ("knee_angle_r hip", "left", None, "no angle of the left knee, but knee_angle_r, hip.*--coor"),
    (f"knee_angle_r {STATES}value", "right", None, f"has knee_angle_r, {STATES}value; choose one"),
    ("x", "right", "kfl", r"no column kfl \(--coordinate\); it has x"),
]
OTHER_REACTIONS = ("hip_r femur_r", "patellofemoral_r patella_r", "knee_l tibia_l")
LERNER = "knee_r articulation_r"
LATERAL, MEDIAL = "lat_cond_r lat_r", "med_cond_r med_r"
NONE = "none acts on the tibia of the right knee"
REACTIONS = [
    (["knee_r tibia_r"], None, ["knee_r tibia_r"]),
    (["knee_r femur_r tibia_r", "knee_r tibia_r"], None, ["knee_r tibia_r"]),
    (["k1 tibia_r", "knee_r tibia_r"], "k1", ["k1 tibia_r"]),
    (["k1 tibia_r"], "k2", r"no joint k2 \(--joint\); it has .*k1"),
    (["knee_r tibia_r", "old_knee_r tibia_r"], None, rf"knee_r.* {NONE}, or several do; .*--jo"),
    (
        ["knee_r femur_r", "knee_r tibia_r ground", "knee_r tibia_r"],
        None,
        ["knee_r tibia_r"],
    ),
    (["knee_r femur_r tibia_r_offset"], None, ["knee_r femur_r tibia_r_offset"]),
    ([LERNER, "weld_r tibial_plat_r"], None, ["weld_r tibial_plat_r"]),
    ([LERNER, LATERAL, MEDIAL, "plat_weld_r tibia_r"], None, ["plat_weld_r tibia_r"]),
    ([LERNER, LATERAL, MEDIAL], None, [MEDIAL, LATERAL]),
    ([LERNER, LATERAL], None, NONE),
    ([LERNER], "knee_r", f"of knee_r {NONE}"),
    (["knee_r patella_r"], None, NONE),
    ([], None, "of hip_r, patellofemoral_r, knee_l none .*--joint"),
]
"""Joint, body and, if it is another one, frame of the reactions in a file; what is given; what is found or asked for"""


def column(reaction, axis):
    joint, body, *frame = reaction.split()
    return f"{joint}_on_{body}_in_{frame[0] if frame else body}_{axis}"


@pytest.mark.parametrize(("values", "header", "found"), UNITS)
def test_the_unit_is_recognised_or_asked_for(values, header, found):
    given = table(["a"], values, header)
    assert re.search(found, str(outcome(angle_unit_of, given, "a", "auto")))
    assert angle_unit_of(given, "a", "rad") == "rad"


@pytest.mark.parametrize(("degrees", "given", "bounds", "found"), SIGNS)
def test_the_sign_is_that_to_which_it_goes_further(degrees, given, bounds, found):
    assert re.search(
        found, str(outcome(flexion_sign_of, np.radians(degrees), "q.sto: a", given, bounds))
    )


@pytest.mark.parametrize(("names", "side", "coordinate", "found"), ANGLES)
def test_a_knees_angle_is_found(names, side, coordinate, found):
    assert re.search(found, str(outcome(angle_column, table(names.split()), side, coordinate)))


@pytest.mark.parametrize(("there", "joint", "found"), REACTIONS)
def test_the_knees_reaction_is_found_or_the_error_names_an_option(there, joint, found):
    names = [column(each, axis) for each in (*OTHER_REACTIONS, *there) for axis in AXES[:6]]
    chosen = outcome(find_reactions, table(names), "right", joint)
    if isinstance(found, str):
        assert re.search(found, chosen)
    else:
        assert [each.column("fx") for each in chosen] == [column(each, "fx") for each in found]


@pytest.mark.parametrize(
    ("names", "found"),
    [
        ([f"{ON_TIBIA}_{axis}" for axis in ("fx", "fz", "mx", "my")], rf"no column {ON_TIBIA}_fy"),
        (["knee_angle_r"], "no reaction <joint>_on_<body>_in_<frame>_fx"),
        (
            [f"/jointset/knee_r|reaction_on_child_{number}" for number in range(1, 7)],
            "knee_r', body='tibia', frame='ground', moco='/",
        ),
    ],
)
def test_other_columns(names, found):
    assert re.search(found, str(outcome(find_reactions, table(names), "right", None)))


@pytest.mark.parametrize(
    ("sign", "unit", "header", "names"),
    [
        (-1.0, "deg", "yes", "knee_angle_{}"),
        (1.0, "rad", "no", "/jointset/walker_knee_{0}/knee_angle_{0}/value"),
        (-1.0, "deg", None, "knee_flexion_{}"),
    ],
)
def test_angles_come_out_in_rad_positive_in_flexion(tmp_path, sign, unit, header, names):
    gait = knee(files(tmp_path, sign=sign, unit=unit, header=header, names=names))
    angle, rate = gait.joints["knee"].values.T
    assert angle == pytest.approx(flexion(TIME), abs=DIGITS)
    # Central differences over 10 ms: h²/6 of the third derivative, 0.0013 rad/s; at the ends h/2 of the second.
    assert rate[1:-1] == pytest.approx(RATE[1:-1], abs=1.5e-3)
    assert rate == pytest.approx(RATE, abs=0.08)


def test_the_right_reaction_is_taken_as_it_is_and_the_left_one_mirrored(tmp_path):
    right, left = (knee(files(tmp_path), side) for side in ("right", "left"))
    expected = np.column_stack(reaction_columns(right.wrenches["load"].stamps * 1e-9))
    assert load_of(right) == pytest.approx(expected, abs=1e-9)
    assert load_of(left) == pytest.approx(expected * [1, 1, -1, -1, -1, 1], abs=1e-9)
    assert any("mirrored" in note for note in left.notes)


def test_a_reaction_on_the_femur_is_turned_and_moved(tmp_path):
    time = np.linspace(0.0, DURATION, 201)
    wrench = np.column_stack(reaction_columns(time))
    force, torque = np.hsplit(wrench, 2)
    point = np.column_stack([0.01 * np.sin(time), 0.4 + 0.0 * time, 0.02 * time])
    # At the point of application the torque on the femur is the opposite of that on the tibia, which at the origin has
    # point x force more.
    on_femur = np.hstack([-force, np.cross(point, force) - torque, point])
    names = [f"knee_r_on_femur_r_in_tibia_r_{axis}" for axis in AXES]
    columns = dict(zip(names, on_femur.T, strict=True))
    jr = write_storage(tmp_path / "jr.sto", time, columns, "no")
    gait = knee(Files(kinematics(tmp_path / "q.sto"), jr))
    assert load_of(gait) == pytest.approx(wrench, abs=1e-8)  # 12 decimals of 0.4 m, 1800 N
    assert any("Newton" in note for note in gait.notes)


@pytest.mark.parametrize(
    ("rows", "factor", "name", "says"),
    [
        (121, -1.0, "knee_angle_r", ""),
        (121, -57.3, "knee_angle_r", "the rate of the angle is 57.3"),
        (121, 1.0, "knee_angle_r", "the rate of the angle is -1"),
        (50, -1.0, "knee_angle_r", "less than the angles"),
        (121, -1.0, "hip", "no rate of knee_angle_r"),
    ],
)
def test_rates_of_a_file_are_taken_if_they_are_the_angles(tmp_path, rows, factor, name, says):
    rates = {name: factor * np.degrees(RATE[:rows])}
    speeds = write_storage(tmp_path / "u.sto", TIME[:rows], rates, "yes")
    given = files(tmp_path)._replace(speeds=speeds)
    if says:
        with pytest.raises(UsageError, match=says):
            knee(given)
    else:
        assert knee(given).joints["knee"].values[:, 1] == pytest.approx(RATE, abs=DIGITS)


def test_reactions_without_an_angle_are_left_out_and_counted(tmp_path):
    jr = reactions(tmp_path / "jr.sto", rows=1501, end=1.5)
    given = Files(kinematics(tmp_path / "q.sto"), jr)
    gait = knee(given)
    assert gait.wrenches["load"].stamps[-1] == 1_200_000_000
    note = "load: 300 rows left out, before time 0 or where another signal or time is not"
    assert note in gait.notes
    window = knee(given, start=0.2005, end=0.6005)
    assert window.wrenches["load"].stamps[[0, -1]].tolist() == [201_000_000, 600_000_000]
    # The angles' neighbours stay, so that every reaction has an angle on either side.
    assert window.joints["knee"].stamps[[0, -1]].tolist() == [200_000_000, 610_000_000]


@pytest.mark.parametrize(
    ("reaction", "settings", "says"),
    [
        ({}, {"start": 5.0}, "--start 5 --end 1.2: nothing is left of 0 to 1.2 s"),
        ({}, {"start": 0.5001, "end": 0.5004}, r"two rows of the load are within 0\.5001 to 0\.5"),
        (
            {},
            {"rate": 1.0, "start": 0.3, "end": 0.5},
            r"fewer than two rows of the angle are within 0\.3 to 0\.5 s at 1 Hz",
        ),
        ({"sign": -1.0}, {}, "fy pulls the knee apart by up to 1800 N, and presses with -900 N"),
        ({"sign": 1.0 / 750.0}, {}, r"fy: the peak is 2\.4 N, plausible is .*, in N, and without"),
        ({"rows": 11, "start": 3.0, "end": 4.0}, {}, r"in common: 0 to 1\.2 s and 3 to 4 s"),
        (
            {"prefix": TIBIA.replace("in_tibia_{0}", "in_ground")},
            {},
            r"is in ground, .*: give --m",
        ),
    ],
)
def test_impossible_results_are_refused_in_a_line(tmp_path, reaction, settings, says):
    jr = reactions(tmp_path / "jr.sto", **reaction)
    with pytest.raises(UsageError, match=says):
        knee(Files(kinematics(tmp_path / "q.sto"), jr), **settings)


def test_a_reaction_in_the_femurs_frame_is_turned_by_the_angle(tmp_path):
    """On the femur it is the other way round; without a model its torque has another point, and that is told."""
    jr = reactions(tmp_path / "jr.sto")
    tibia = read_storage(jr)
    time = tibia.stamps * 1e-9
    angle = np.interp(time, TIME, flexion(TIME))
    ours = knee(Files(kinematics(tmp_path / "q.sto"), jr))
    columns = {}
    for kind in "fm":
        x, y, z = tibia.columns([f"{TIBIA.format('r')}{kind}{axis}" for axis in "xyz"]).T
        turned = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x, z
        for axis, values in zip("xyz", turned, strict=True):
            columns[f"knee_r_on_femur_r_in_femur_r_{kind}{axis}"] = -values
    path = write_storage(tmp_path / "femur.sto", time, columns, "no")
    found = knee(Files(tmp_path / "q.sto", path))
    np.testing.assert_allclose(load_of(found), load_of(ours), atol=1e-6)
    doubt = "turned from femur_r by the flexion angle alone, as of a hinge, and its torque"
    assert doubt in found.doubts[0]


@pytest.mark.parametrize(("rate", "rows"), [(200.0, 241 - 47), (None, 1201)])
def test_a_gap_is_noted_and_not_interpolated_across(tmp_path, rate, rows):
    there = TIME[(TIME <= 0.5) | (TIME >= 0.74)]
    q = angles(tmp_path, -np.degrees(flexion(there)), there)
    gait = knee(Files(q, reactions(tmp_path / "jr.sto")), rate=rate)
    told = "angle: 1 gap longer than 0.1 s, the longest of 0.24 s at 0.5 s"
    assert any(told in note for note in gait.notes)
    assert len(load_of(gait)) == rows
    assert flexion_of(gait) == pytest.approx(flexion(times_of(gait)), abs=3e-4)


def test_rows_outside_the_time_that_is_asked_for_do_not_matter(tmp_path):
    angle = np.where(TIME < 0.2, np.nan, -np.degrees(flexion(TIME)))
    given = Files(angles(tmp_path, angle, hip=np.nan * TIME), reactions(tmp_path / "jr.sto"))
    gait = knee(given, start=0.25, end=1.0, rate=100.0)
    assert flexion_of(gait) == pytest.approx(flexion(times_of(gait)), abs=DIGITS)
    says = r"column knee_angle_r is nan at 0\.1 s; it must be a finite number"
    with pytest.raises(UsageError, match=says):
        knee(given, start=0.1)


def loaded(folder, times, model=True):
    """Results with a multiple of a usual load, which is 1800 N at most."""
    jr = reactions(folder / "jr.sto", sign=times, rows=241)
    return Files(
        kinematics(folder / "q.sto"), jr, model=write_model(folder / "m.osim") if model else None
    )


@pytest.mark.parametrize(
    ("times", "says"),
    [
        (5.0, r"the peak of 9000 N is 12\.641 body weights, .*model"),
        (0.2, r"the peak of 360 N is 0\.50564 body weights"),
    ],
)
def test_likely_mistakes_are_imported_only_if_the_user_insists(tmp_path, times, says):
    with pytest.raises(UsageError, match=f"{says}.*--anyway"):
        knee(loaded(tmp_path, times))
    assert re.search(says, knee(loaded(tmp_path, times), anyway=True).doubts[0])


def test_without_a_model_a_large_load_is_a_warning(tmp_path):
    large = knee(loaded(tmp_path, 4.8, model=False))
    assert "the peak is 8640 N, plausible is 400 to 8000" in large.doubts[0]
    assert not knee(files(tmp_path)).doubts


MODELS = [
    ("42.6", "9,3", r"m\.osim \(--model\): mass of Body b is '9,3', and must be numbers"),
    ("42.6", "nan", "mass of all Body elements is nan kg; it must be finite and > 0"),
    ("42.6", "-30", "mass of all Body elements is 0 kg; it must be finite and > 0"),
    ("-2.0943951", "x", "range of Coordinate knee_angle_r is 'x 0.17453293', and must be numbers"),
    ("", "<a>", r"m\.osim is not an OpenSim document"),
    ("", "<a><Model/></a>", r"\(--model\) has no coordinate"),
]


def test_a_model_gives_sign_and_weight(tmp_path):
    standing = angles(tmp_path, -5.0 - 4.0 * np.sin(TIME))
    given = Files(standing, reactions(tmp_path / "jr.sto"))
    with pytest.raises(UsageError, match="Give --angle-sign 1 or -1, or --model"):
        knee(given)
    model = write_model(tmp_path / "m.osim")
    gait = knee(given._replace(model=model))
    assert flexion_of(gait).min() > 0.0
    assert gait.weight == pytest.approx(72.6 * 9.80665)
    assert knee(given._replace(model=model), body_weight=700.0).weight == 700.0
    with pytest.raises(UsageError, match="is it kg"):
        knee(given._replace(model=model), body_weight=72.6)
    good = model.read_text()
    for old, new, says in MODELS:
        model.write_text(good.replace(old, new) if old else new)
        with pytest.raises(UsageError, match=says):
            knee(given._replace(model=model))


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_reference_results_are_the_tables_of_the_shipped_bags(reference_data, side):
    folder = reference_data / "opensim_gait2354"
    names = ("reference_CMC_Kinematics_q.sto", "reference_JointReaction_ReactionLoads.sto")
    gait = knee(Files(*(folder / name for name in names)), side, rate=200.0)
    path = reference_data / "gait" / f"gait2354_{side}.csv"
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    assert lines[0].startswith("t,knee_angle,knee_vel,Fx,Fy,Fz,Mx,My,Mz")
    numbers = np.array([line.split(",") for line in lines[1:]], float)
    assert numbers[:, 0] == pytest.approx(times_of(gait), abs=1e-9)
    # The tables have six digits, and rates from the rounded angles' neighbours.
    angle, rate = gait.joints["knee"].values.T
    assert angle == pytest.approx(numbers[:, 1], rel=1e-5, abs=1e-6)
    assert rate == pytest.approx(numbers[:, 2], rel=1e-4, abs=1e-3)
    assert load_of(gait) == pytest.approx(numbers[:, 3:9], rel=1e-5, abs=1e-5)

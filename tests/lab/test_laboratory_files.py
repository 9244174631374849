"""Files as laboratories have them: what was once read wrongly without a word."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from knee_contact_ros.commands.main import main
from knee_contact_ros.lab import c3d
from knee_contact_ros.lab.c3d import read_c3d
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.processes import written_by
from tests.joint_reaction.test_conventions import stance
from tests.lab.opensim.test_command import origin
from tests.lab.test_sensors import angles_of, content, loads_of, stamps_of
from tests.lab.trials import MAP, WEIGHT, cells, flexion, load, write_csv

C3D_MAP = """\
angle: {column: RKneeAngles.X, unit: deg}
load: {column: FZ1, unit: N}
body_weight: 700
"""
TIME = np.arange(150) / 50.0


def write_c3d(labels, event=(), mass=(), first=0, **point):
    """A walk of 3 s at 50 Hz, from a frame on; points are 0 except RKneeAngles.

    FZ1 is the load at 500 Hz with hum of 50 and 25 Hz.
    """
    ezc3d = pytest.importorskip("ezc3d", reason="needs the extra c3d")
    made = ezc3d.c3d()
    fast = np.arange(1500) / 500.0
    points = np.zeros((4, len(labels), len(TIME)))
    (angle,) = (place for place, label in enumerate(labels) if "KneeAngles" in label)
    points[0, angle] = flexion(TIME)
    made["header"]["points"]["first_frame"] = first
    hum = 60.0 * (np.cos(100.0 * np.pi * fast) + np.cos(50.0 * np.pi * fast))
    for kind, rate, names in (("POINT", 50.0, labels), ("ANALOG", 500.0, ["FZ1"])):
        made["parameters"][kind]["RATE"]["value"] = [rate]
        made["parameters"][kind]["LABELS"]["value"] = names
    made["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    made["parameters"]["ANALOG"]["UNITS"]["value"] = ["N"]
    processing = {"Bodymass": [*mass]} if mass else {}
    for group, entries in (("POINT", point), ("EVENT", dict(event)), ("PROCESSING", processing)):
        for name, value in entries.items():
            made.add_parameter(group, name, value)
    made["data"]["points"] = points
    made["data"]["analogs"] = (load(fast) + hum)[None, None]
    made.write("walk.c3d")
    file = Path("walk.c3d")
    file.write_bytes(
        file.read_bytes().replace(b"LABELS9", b"LABELS2")
    )  # which no writer would write


def test_a_c3d_file_that_crashes_its_reader_costs_a_line(tmp_path, monkeypatch):
    """The type of a parameter is none."""
    monkeypatch.chdir(tmp_path)
    write_c3d(["RKneeAngles"])
    data = bytearray(Path("walk.c3d").read_bytes())
    data[data.index(b"USED") + 6] = 255
    Path("walk.c3d").write_bytes(data)
    with pytest.raises(UsageError, match="ezc3d ended by signal"):
        read_c3d(Path("walk.c3d"))


def test_a_c3d_file_may_take_no_more_memory_than_its_samples_need(tmp_path, monkeypatch):
    """The limit is low here, so that the test need not fill a gigabyte."""
    monkeypatch.chdir(tmp_path)
    write_c3d(["RKneeAngles", *map(str, range(300))])
    program = (
        "from knee_contact_ros.lab import c3d_file\n"
        "c3d_file.MEMORY, c3d_file.FACTOR = 2**20, 0\n"
        "c3d_file.main('walk.c3d', 'out', '')"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert "MemoryError" in done.stderr or "bad_alloc" in done.stderr
    assert not Path("out").exists()


def test_a_c3d_file_that_was_cut_off_is_doubted(importing):
    write_c3d(["RKneeAngles"])
    whole = Path("walk.c3d").read_bytes()
    Path("walk.c3d").write_bytes(whole[: len(whole) * 3 // 4])
    said = importing.refused(None, C3D_MAP)
    assert "walk.c3d has 109 rows, and its header says nRows=150: is it cut off?" in said


def test_a_c3d_file_is_read_once_for_an_import(importing, monkeypatch):
    """For the mass, and for the tables."""
    write_c3d(["RKneeAngles"], mass=[75.0])
    read = []
    monkeypatch.setattr(
        c3d, "written_by", lambda *given, **more: read.append(given) or written_by(*given, **more)
    )
    importing(None, C3D_MAP)
    assert len(read) == 1


@pytest.mark.parametrize(("number", "first"), [(3, 100), (300, 0), (600, 0)])
def test_columns_of_a_c3d_file_have_their_own_names(importing, number, first):
    """A file has 255 names in each of LABELS, LABELS2 and so on; hum of the frames' rate is no offset."""
    write_c3d([f"M{place}" for place in range(number)] + ["P01:RKneeAngles"], first=first)
    importing(None, C3D_MAP)
    angles, forces = content()
    np.testing.assert_allclose(angles_of(angles), flexion(TIME), atol=1e-4)
    np.testing.assert_allclose(loads_of(forces)[1:-1], load(TIME)[1:-1], atol=5.0)
    assert stamps_of(forces) == np.rint(1e9 * (TIME + first / 50.0)).astype(int).tolist()


@pytest.mark.parametrize(
    ("point", "words"),
    [
        ({"ANGLES": ["RKneeAngles"], "ANGLE_UNITS": ["rad"]}, "says rad of column RKneeAngles.X"),
        ({"ANGLES": ["LKneeAngles"], "ANGLE_UNITS": ["deg"]}, "says mm of column RKneeAngles.X"),
        ({"LABELS9": ["more"]}, "has 2 points, and names 3 (LABELS)"),
    ],
)
def test_a_c3d_file_that_says_otherwise_is_refused(importing, point, words):
    write_c3d(["RKneeAngles", "LASI"], **point)
    assert words in importing.refused(None, C3D_MAP)
    write_c3d(["RKneeAngles", "LASI"], ANGLES=["RKneeAngles"], ANGLE_UNITS=["deg"])
    importing(None, C3D_MAP)


def test_the_body_mass_of_a_c3d_file_is_that_of_the_bag(importing):
    write_c3d(["RKneeAngles"], mass=[75.0])
    per_mass = C3D_MAP.replace("body_weight: 700\n", "")
    assert "body weight 735.5 N: 75.0 kg of walk.c3d" in importing(None, per_mass)
    assert origin(Path("bag"))["body_weight"] == "735.4987 N"  # 75 kg * 9.80665 m/s^2
    assert "the ratio of its 75.0 kg to the map's body_weight is 0.81722" in importing.refused(
        None, C3D_MAP.replace("700", "900")
    )
    write_c3d(["RKneeAngles"], mass=[1.0])
    importing(None, per_mass)
    assert "body_weight" not in origin(Path("bag"))


def test_a_net_joint_force_is_doubted_and_the_doubt_stays(importing, capsys, tmp_path):
    table = cells()
    peak = load(table["time_s"]).max()
    for name in ("pm_n", "am_n", "al_n", "pl_n"):
        table[name] = (table[name] - 0.25 * load(table["time_s"]).min()) * 1.1 * WEIGHT / peak
    bent = np.radians(table["goniometer_deg"])  # as in walking, the bent leg bears less
    for name in ("pm_n", "am_n", "al_n", "pl_n"):
        table[name] = table[name] * (bent < np.radians(35.0))
    assert "is it the net joint force of inverse dynamics" in importing.refused(table)
    importing(table, MAP, "--anyway")
    for command in (
        ["solve", "bag", "--output=o.mcap"],
        ["report", "bag", "--output=one"],
        ["report", "o.mcap", "--output=two"],
    ):
        capsys.readouterr()
        assert main(command) == 0
        pages = "".join(path.read_text() for path in tmp_path.glob("*/*.html"))
        said = " ".join(capsys.readouterr().err.split()) + pages
        assert "the import doubted: " in said, command
        assert "the net joint force of inverse dynamics" in said, command


def test_a_squeezed_angle_is_doubted(importing):
    """Times of a force at 1000 Hz with angles at 148 Hz turn the knee 6.7 times as fast."""
    table = cells()
    fast = {"time_s": table["time_s"] * 0.148, **{n: v for n, v in table.items() if n != "time_s"}}
    assert "rad/s (at " in importing.refused(fast)


TWO_CLOCKS = {
    "by names": "time: {column: 'X[s]'}\nangle: {column: 'Gonio [deg]', unit: deg}\n"
    "load: {column: 'Force [N]', unit: N}\n",
    "by places": "time: {column: 1}\nangle: {column: 4, unit: deg}\nload: {column: 2, unit: N}\n",
    "of its own": "time: {column: 1}\nload: {column: 'Force [N]', unit: N}\n"
    "angle: {column: 4, unit: deg, time: {column: 3}}\n",
}


@pytest.mark.parametrize("name", TWO_CLOCKS)
def test_each_column_has_the_times_next_to_it(importing, name):
    slow, fast = np.arange(0.0, 3.0, 0.00675), np.arange(0.0, 3.0, 0.001)
    rows = ["X[s],Force [N],X[s],Gonio [deg]"]
    for row, time in enumerate(fast.tolist()):
        beside = f"{slow[row]:.5f},{flexion(slow)[row]:.3f}" if row < len(slow) else ","
        rows.append(f"{time:.4f},{load(time):.2f},{beside}")
    text = TWO_CLOCKS[name] + "body_weight: 700\nmissing: leave_out\n"
    importing("\n".join(rows), text)
    angles, forces = content()
    times = 1e-9 * np.array([angle.stamp for angle in angles])
    np.testing.assert_allclose(angles_of(angles), flexion(times), atol=0.01)
    assert len(forces) > 2900


@pytest.mark.parametrize("frames", [False, True])
def test_each_file_may_have_its_own_time(importing, frames):
    time = np.arange(0.0, 3.0, 0.02)
    own = {"Frame": 1.0 + np.arange(150.0)} if frames else {"Time_ms": 1e3 * time}
    said = "{column: Frame, rate: 50}" if frames else "{column: Time_ms, unit: ms}"
    motion = write_csv(Path("motion.csv"), {**own, "knee_deg": flexion(time)})
    plate = write_csv(Path("plate.csv"), {"abs time (s)": time, "Fz": load(time)})
    text = (
        f"time: {{column: abs time (s)}}\nangle: {{column: knee_deg, unit: deg, time: {said}}}\n"
        "load: {column: Fz, unit: N}\nbody_weight: 700\n"
    )
    importing(None, text, files=[motion, plate])
    angles, forces = content()
    np.testing.assert_allclose(angles_of(angles), flexion(time), atol=1e-4)
    np.testing.assert_allclose(loads_of(forces), load(time), atol=1e-3)


def test_a_point_is_decimal_where_commas_divide_columns(importing):
    time = np.arange(0.0, 3.0, 0.02)
    rows = [
        f"{t:.2f},{q:.3f},{f:.3f}" for t, q, f in zip(time, flexion(time), load(time), strict=True)
    ]
    rows[7] = rows[7].split(",")[0] + ",," + rows[7].split(",")[2]
    text = "angle: {column: knee, unit: deg}\nload: {column: f, unit: N}\nmissing: leave_out\n"
    importing("\n".join(["time,knee,f", *rows]), text)
    assert len(content()[0]) == 149


def test_a_hip_against_the_pelvis_is_doubted_and_the_pelvis_taken_off(importing):
    rows = np.concatenate([stance(seed) for seed in (1, 2)])
    names = ("knee", "hip", "ankle", "fx", "fy", "tz")
    table = {"time": np.arange(len(rows)) / 100.0, **dict(zip(names, rows.T, strict=True))}
    table["hip"] = table["hip"] + np.radians(11.0)
    table["tilt"] = np.full(len(rows), np.radians(11.0))
    text = "body_weight: 700\n" + "".join(
        f"{channel}: {{column: {name}, unit: {unit}}}\n"
        for channel, name, unit in (
            ("angle", "knee", "rad"),
            ("hip", "hip", "rad"),
            ("ankle", "ankle", "rad"),
            ("ground_force", "fy", "N"),
            ("ground_force_x", "fx", "N"),
            ("ground_torque_z", "tz", "N*m"),
        )
    )
    assert "to the pelvis" in importing.refused(table, text)
    said = importing(table, text + "pelvis: {column: tilt, unit: rad}\n")
    assert "hip - tilt of cells.csv" in said


@pytest.mark.parametrize("suffix", ["mat", "xlsx", "b3d", "mvnx", "json", "h5", "npz"])
def test_other_formats_are_refused_with_the_line_that_converts_them(importing, suffix):
    Path(f"trial.{suffix}").write_bytes(bytes(100))
    assert "make it one, as in Python: " in importing.refused(None, MAP, files=[f"trial.{suffix}"])


def test_forces_per_mass_and_brackets_without_a_unit(importing):
    time = np.arange(0.0, 3.0, 0.02)
    mass = WEIGHT / 9.80665
    table = {"time": time, "Knee.Pos[0]": flexion(time), "Fz (R)": load(time) / mass}
    text = (
        "angle: {column: 'Knee.Pos[0]', unit: deg}\nload: {column: 'Fz (R)', unit: N/kg}\n"
        f"body_weight: {WEIGHT}\n"
    )
    importing(table, text)
    np.testing.assert_allclose(loads_of(content()[1]), load(time), atol=1e-3)


def test_newtons_in_a_file_may_be_those_per_mass(importing):
    """As in the C3D files of Plug-in Gait: they state N, and hold N/kg."""
    time = np.arange(0.0, 3.0, 0.02)
    table = {"time": time, "knee": flexion(time), "F [N]": load(time) / (WEIGHT / 9.80665)}
    text = f"angle: {{column: knee, unit: deg}}\nload: {{column: 'F [N]', unit: N}}\nbody_weight: {WEIGHT}\n"
    assert "In N/kg it would be 2.2 body weights" in importing.refused(table, text)
    text = text.replace("unit: N}", "unit: N/kg}")
    assert "cells.csv says N of column F [N], read as N/kg" in importing(table, text)
    np.testing.assert_allclose(loads_of(content()[1]), load(time), atol=1e-3)
    table["F [N]"] = load(time)
    assert importing.refused(table, text)


def of_sensors(stood=1.0, drift=0.0):
    """Quaternions w, x, y, z of thigh and shank, worn anyhow; headings drift apart by so many degrees."""
    time = np.arange(800) / 100.0
    knee = flexion(time) * np.clip(3.0 * (time - stood), 0.0, 1.0)
    thigh = 20.0 * np.sin(5.0 * time) * np.clip(3.0 * (time - stood), 0.0, 1.0)
    mounted = Rotation.from_euler("xyz", [[10, 100, 40], [-30, 60, 170]], degrees=True)
    lateral = np.array([0.6, 0.8, 0.0])  # z is up
    turning = Rotation.from_rotvec(np.radians(thigh)[:, None] * lateral)
    heading = Rotation.from_euler(
        "z", drift * np.clip(time - 1.0, 0.0, 1.0)[:, None], degrees=True
    )
    shank = heading * turning * Rotation.from_rotvec(-np.radians(knee)[:, None] * lateral)
    found = [
        (each * mount).as_quat() for each, mount in zip((turning, shank), mounted, strict=True)
    ]
    return time, knee, np.hstack([each[:, [3, 0, 1, 2]] for each in found])


def of_orientations(columns, time):
    names = [f"{segment}.{part}" for segment in ("thigh", "shank") for part in "wxyz"]
    table = dict(zip(names, columns.T, strict=True))
    return {"time_s": time, **table, "load": load(time)}


SENSOR_MAP = """\
time: {column: time_s}
angle: {orientations: {thigh: thigh, shank: [shank.w, shank.x, shank.y, shank.z]}}
load: {column: load, unit: N}
"""


def test_orientations_of_thigh_and_shank_give_the_angle(importing, capsys):
    time, knee, columns = of_sensors()
    importing(of_orientations(columns, time), SENSOR_MAP)
    np.testing.assert_allclose(angles_of(content()[0]), knee, atol=0.2)
    rows = [
        f"{t}\t{','.join(map(str, row[:4]))}\t{','.join(map(str, row[4:]))}"
        for t, row in zip(time, columns, strict=True)
    ]
    head = "DataType=Quaternion\nversion=3\nendheader\ntime\tfemur_r_imu\ttibia_r_imu"
    Path("imu.sto").write_text("\n".join([head, *rows]))
    names = SENSOR_MAP.replace("thigh: thigh", "thigh: femur_r_imu").replace(
        "[shank.w, shank.x, shank.y, shank.z]", "tibia_r_imu"
    )
    write_csv(Path("load.csv"), {"time_s": time, "load": load(time)})
    importing(None, names, files=["imu.sto", "load.csv"])
    np.testing.assert_allclose(angles_of(content()[0]), knee, atol=0.2)
    capsys.readouterr()
    arguments = ["--kinematics=imu.sto", "--reactions=imu.sto", "--output=x", "--side=right"]
    assert main(["import-opensim", *arguments]) == 2
    assert "angle.orientations of import-csv reads them" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"drift": 40.0}, "have the headings of the two sensors drifted apart"),
        ({"stood": 0.2}, "and a standing one is still (map: angle.orientations.standing)"),
        (None, "row 6: 0, 0, 0, 2 is no quaternion of unit length, w last"),
    ],
)
def test_orientations_that_cannot_be_right_are_refused(importing, change, words):
    time, _, columns = of_sensors(**(change or {}))
    if change is None:
        columns[5] = 2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0
    assert words in importing.refused(of_orientations(columns, time), SENSOR_MAP)

"""`knee-contact import-csv`: what is in the bag, and what is told of files that are damaged or mislabelled."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.sweep import sweep
from knee_contact_ros.offline.notebooks import solve
from knee_contact_ros.streams.messages import JOINT_STATE, WRENCH
from knee_contact_ros.streams.topics import LOAD_INPUTS, types_of
from tests.helpers.bags import raw_messages
from tests.lab.opensim.storages import write_storage
from tests.lab.opensim.test_command import origin
from tests.lab.trials import MAP, SECONDS, cells, flexion, load, motion, write_csv


def content():
    """Angles and forces."""
    messages = raw_messages(Path("bag"))
    angles = [JOINT_STATE.decode_message(m.data) for m in messages if m.topic == "/joint_states"]
    forces = [
        WRENCH.decode_message(m.data) for m in messages if m.topic == "/joint_reaction_force"
    ]
    return [angle for angle, _ in filter(None, angles)], [f for f, _ in filter(None, forces)]


def stamps_of(messages):
    return [message.stamp for message in messages]


def angles_of(messages):
    """Angles of the knee [deg]."""
    return np.degrees([message.position[0] for message in messages])


def loads_of(messages):
    return np.array([-message.force[1] for message in messages])


def test_columns_become_the_messages_that_the_node_reads(importing):
    table = cells()
    assert "goniometer_deg of cells.csv" in importing(table)
    angles, forces = content()
    stamps = np.rint(1e9 * np.round(table["time_s"], 6)).astype(int).tolist()
    assert stamps_of(angles) == stamps_of(forces) == stamps
    assert {angle.name for angle in angles} == {("knee",)}
    np.testing.assert_allclose(angles_of(angles), table["goniometer_deg"], atol=1e-6)
    np.testing.assert_allclose(loads_of(forces), load(table["time_s"]), atol=3e-6)
    assert {force.frame_id for force in forces} == {"tibia_r"}
    assert len(solve(Path("bag"))) == len(stamps)
    record = origin(Path("bag"))
    columns = json.loads(record["map"])["load"]["columns"]
    assert columns == dict.fromkeys(("pm_n", "am_n", "al_n", "pl_n"), 1.0)
    assert re.fullmatch("[0-9a-f]{64}", record["file 1_sha256"])


@pytest.mark.parametrize(
    ("before", "after", "of_load", "of_angle"),
    [
        ("unit: N", "unit: '%BW'", lambda f: f / 7.0, lambda a: a),
        ("unit: N", "unit: N\n  offset: -30", lambda f: f + 120.0 / 4.0, lambda a: a),
        ("deg}", "deg, sign: -1, offset: 180}", lambda f: f, lambda a: 180.0 - a),
    ],
)
def test_units_and_offsets_of_sensors(importing, before, after, of_load, of_angle):
    table = cells()
    total, angle = load(table["time_s"]), table["goniometer_deg"]
    table |= dict.fromkeys(("pm_n", "al_n", "pl_n"), 0.0 * total)
    table |= {"goniometer_deg": of_angle(angle), "am_n": of_load(total)}
    importing(table, MAP.replace(before, after, 1))
    angles, forces = content()
    np.testing.assert_allclose(loads_of(forces), total, atol=2e-3)
    np.testing.assert_allclose(angles_of(angles), angle, atol=6e-6)


def rows(cell="{:.2f},{:.3f},{:.2f}", decimal="."):
    """Three seconds at 50 Hz: time or what counts it, angle [deg] and load [N]."""
    time = np.arange(150) / 50.0
    lines = [cell.format(*row) for row in zip(time, flexion(time), load(time), strict=True)]
    return "\n".join(lines).replace(".", decimal) + "\n"


def clock(begin, text):
    """The same with times of day from `begin` [s] on."""
    lines = rows().splitlines()
    for number, line in enumerate(lines):
        minutes, milliseconds = divmod((1000 * begin + 20 * number) % 86_400_000, 60_000)
        at = text.format(minutes // 60, minutes % 60, milliseconds / 1000.0)
        lines[number] = f"{at},{line.partition(',')[2]}"
    return "\n".join(lines) + "\n"


TAF = "t,a,f\n"
HMS = "{:02d}:{:02d}:{:06.3f}"
FRAMES = rows("{:.0f},0,{:.3f},1,2,3,4,{:.2f}").splitlines()
VICON = "Model Outputs\n50\n,,P01:RKneeAngles,,,P01:RKneeForce,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n,,deg,deg,deg,N,N,N\n"
VICON += "\n".join(f"{101 + n}{line[line.index(',') :]}" for n, line in enumerate(FRAMES)) + "\n"
SIMPLE = "time: {column: t}\nangle: {column: a, unit: deg}\nload: {column: f, unit: N}\n"
CELLS = "{:.2f},{:.3f},{:.2f}"


def vicon_map(load_column):
    return (
        "time: {column: Frame, rate: 50}\nangle: {column: RKneeAngles.X, unit: deg}\n"
        f"load: {{column: '{load_column}', unit: N}}\n"
    )


def columns_of(time, angle, force):
    return (
        SIMPLE.replace("column: t", time).replace("column: a", angle).replace("column: f", force)
    )


WINKEL = SIMPLE.replace("column: a", "column: 'Winkel [°]'")
GERMAN = rows(CELLS.replace(",", ";"), decimal=",")
HALVES = re.sub(r"(?m)^00(.*?),", r"12\1 am,", clock(86_399, HMS))
WAYS = {
    "names of two lines": (VICON, vicon_map("P01:RKneeForce.Z")),
    "one table of several": (
        f"{VICON}\nTrajectories\n50\n,,P01:LASI\nFrame,Sub Frame,X\n,,mm\n101,0,7\n",
        vicon_map("RKneeForce.Z"),
    ),
    "places": (
        VICON,
        "time: {rate: 50}\nangle: {column: 3, unit: deg}\nload: {columns: {8: 1}, unit: N}\n",
    ),
    "places without names": (rows(), columns_of("column: 1", "column: 2", "column: 3")),
    "behind a hash": ("# Name: made up\n# t\ta\tf\n" + rows(CELLS.replace(",", "\t")), SIMPLE),
    "a title, and units": ("made up\n\nt,a,f\ns,deg,N\n" + rows(), SIMPLE),
    "a date and a time": (TAF + clock(36_000, "2020-01-01 " + HMS), SIMPLE),
    "over midnight": (TAF + clock(86_399, HMS), SIMPLE),
    "with a zone": (TAF + clock(36_000, "2020-01-01T" + HMS + "+01:00"), SIMPLE),
    "before midnight and after": (TAF + re.sub(r"(?m)^23(.*?),", r"11\1 PM,", HALVES), SIMPLE),
    "words for no number": ("t,a,f,x\n" + rows(CELLS + ",#N/A"), SIMPLE),
    "Windows": (f"t;Winkel [°];f\n{GERMAN}".encode("cp1252"), WINKEL),
    "semicolons, quotes, a mark and CRLF": (
        ('t;"a";f\n' + rows('{:.2f};"{:.3f}";{:.2f}', decimal=","))
        .replace("\n", "\r\n")
        .encode("utf-8-sig"),
        SIMPLE,
    ),
    "spaces": ("t   a  f\n" + rows("{:.2f}  {:.3f} {:.2f}"), SIMPLE),
    "utf-16": ((TAF + rows()).encode("utf-16"), SIMPLE),
    "an old Macintosh": (
        f"t;Winkel [°];f\n{rows(CELLS.replace(',', ';'))}".encode("mac-roman"),
        WINKEL + "table: {encoding: mac-roman}\n",
    ),
}


@pytest.mark.parametrize("name", WAYS)
def test_files_of_programs_and_loggers_are_read(importing, name):
    importing(*WAYS[name])
    angles, forces = content()
    time = np.arange(150) / 50.0
    assert stamps_of(forces) == stamps_of(angles) == np.rint(1e9 * time).tolist()
    np.testing.assert_allclose(loads_of(forces), load(time), atol=6e-3)
    np.testing.assert_allclose(angles_of(angles), flexion(time), atol=6e-4)


MS = SIMPLE.replace("t}", "t, unit: ms}")
BY_CLOCK = "t,a,x\n" + clock(0, HMS)
STATED = {
    "Rad,N": "Rad of column a",
    "deg/s,N": "deg/s of column a",
    "deg,mm": "mm of column f",
    "deg,V": "V of column f",
}
"""Rows of units below the names, and the one that is refused"""
ONE_FILE = {
    "two of a name": (
        VICON,
        columns_of("column: Frame", "column: X", "column: Z"),
        "2 columns X; say which: P01:RKneeAngles.X, P01:RKneeForce.X",
    ),
    "no frames": (TAF + rows(), MS.replace("unit: ms", "rate: 50"), "0.02, and with time.rate it"),
    "seconds as ms": (
        TAF + rows(),
        MS,
        "plausible is 5 to 10000: is time.unit",
    ),
    "a row of units": ("t,a,f\ns,deg,N\n" + rows(), MS, "s of column t, and time.unit ms"),
    "a unit in a name": (
        "t_ms,a,f\n" + rows(),
        SIMPLE.replace("t}", "t_ms}"),
        "ms of column t_ms, and time",
    ),
    **{
        units: (
            f"t,a,f\ns,{units}\n{rows()}",
            SIMPLE,
            f"says {words}, and map: ",
        )
        for units, words in STATED.items()
    },
    **{
        f"a weight of {weight}": (
            "t,a,f\ns,deg,lbf\n" + rows(),
            SIMPLE.replace("column: f,", f"columns: {{f: {weight}}},"),
            "says lbf of column f",
        )
        for weight in (0.98, -0.98, 44.5)
    },
    "no time of day": (
        TAF + clock(0, HMS).replace("00:00:", "00:61:"),
        SIMPLE,
        "is not a number",
    ),
    **{
        code: (
            TAF + rows(),
            f"{SIMPLE}table: {{encoding: {code}}}\n",
            "' is not known, or not of cells.csv; as utf-8",
        )
        for code in ("idna", "utf-9")
    },
}
"""Content of cells.csv, map and what is told"""
TWO_FILES = {
    "clocks of two kinds": (BY_CLOCK, rows("{0:.2f},{0:.2f},{2:.2f}"), "have times of one clock"),
    "two days": (
        "t,a,x\n" + clock(0, "2026-03-04 " + HMS),
        clock(0, "2026-03-05 " + HMS),
        "no time in common: 0 to 2.98 s and 86400",
    ),
    "days of two forms": (
        "t,a,x\n" + clock(0, "4.3.2026 " + HMS),
        clock(0, "5.3.2026 " + HMS),
        "begins on 4.3.2026, and other.csv on 5.3",
    ),
}
"""Content of cells.csv and of other.csv, and what is told"""


@pytest.mark.parametrize("name", [*ONE_FILE, *TWO_FILES])
def test_tables_that_could_be_misread_are_refused(importing, name):
    made, other, words = (ONE_FILE | TWO_FILES)[name]
    files = ["cells.csv"]
    if name in TWO_FILES:
        files.append("other.csv")
        Path("other.csv").write_text("t,x,f\n" + other)
        other = SIMPLE
    assert words in importing.refused(made, other, files=files)


def test_units_are_spelt_differently_or_converted(importing):
    """And unknown ones are noted."""
    kilo = rows("{0:.2f},{1:.3f},{2:.2f},0.010").replace("\n", ",N/A\n")
    text = SIMPLE.replace(" t}", " T}") + "moment: {columns: {m: 980}, unit: N.M}\n"
    said = importing(f"T,a,f,m,x\nSec,Degrees,widgets,kN*m,N/A\n{kilo}", text)
    assert said.count("'widgets' is not a known unit (map: load.unit N)") == 1
    assert said.count("is not a known unit") == 1
    assert content()[1][0].torque[0] == pytest.approx(9.8)


DATED = "2026-03-0{}T" + HMS.replace("{", "{{").replace("}", "}}")


@pytest.mark.parametrize(
    ("angles", "forces"),
    [
        (
            clock(86_399, DATED.format(4) + "Z").replace("04T00", "05T00"),
            clock(3_599, DATED.format(5) + "+01:00"),
        ),
        (clock(86_399, HMS), "\n".join(clock(86_399, HMS).splitlines()[60:])),
    ],
)
def test_files_of_one_trial_may_begin_on_two_days(importing, angles, forces):
    """By their dates and zones, or without any within a day."""
    Path("other.csv").write_text("t,x,f\n" + forces)
    importing("t,a,x\n" + angles, SIMPLE, files=("cells.csv", "other.csv"))
    _, found = content()
    time = 1e-9 * np.array(stamps_of(found))
    np.testing.assert_allclose(loads_of(found), load(time), atol=6e-3)
    assert len(found) >= 90


def test_an_insole_and_an_encoder_make_the_bag_that_estimate_load_takes(
    importing,
):
    """And what an exoskeleton has beside them; a row that one channel lacks by microseconds is left out."""
    time = np.arange(151) / 50.0
    up = 700.0 * np.clip(np.sin(2.0 * np.pi * time / 1.1), 0.0, None)
    table = {
        "t": time,
        "a": 90.0 - flexion(time),
        "hip": 0.3 * flexion(time),
        "torque": -0.01 * up,
        "up": up - 12.0,
    }
    plate = write_csv(Path("plate.csv"), {"t": time - 1e-6, "x": 0.1 * up, "m": 0.02 * up})
    text = """
time: {column: t}
angle: {column: a, unit: deg, sign: -1, offset: 90}
hip: {column: hip, unit: deg}
assistance: {column: torque, unit: N*m, sign: -1}
ground_force: {column: up, unit: N, offset: 12}
ground_force_x: {column: x, unit: N, sign: -1}
ground_torque_z: {column: m, unit: N*m}
body_weight: 700
side: left
"""
    importing(table, text, files=("cells.csv", plate))
    types = types_of(LOAD_INPUTS)
    messages = raw_messages(Path("bag"), types)
    grounds = [
        WRENCH.decode_message(m.data) for m in messages if m.topic == "/ground_reaction_force"
    ]
    states = [JOINT_STATE.decode_message(m.data) for m in messages if m.topic == "/joint_states"]
    wrenches = np.array([[*ground.force, *ground.torque] for ground, _ in filter(None, grounds)])
    joints = [state for state, _ in filter(None, states)]
    assert (len(wrenches), len(joints)) == (150, 151)
    for place, values in ((0, -0.1 * up), (1, up), (5, 0.02 * up)):
        np.testing.assert_allclose(wrenches[:, place], values[:-1], atol=1e-3)
    assert np.isnan(wrenches[:, 2:5]).all()
    assert joints[0].name == ("knee", "hip")
    np.testing.assert_allclose([joint.effort[0] for joint in joints], 0.01 * up, atol=2e-6)
    hip = np.degrees([joint.position[1] for joint in joints])
    np.testing.assert_allclose(hip, table["hip"], atol=1e-4)
    estimate = ["estimate-load", "bag", "-p", "ground.components:=vertical"]
    assert main([*estimate, "--output=loads.mcap"]) == 0
    assert main(["solve", "loads.mcap", "--output=answers.mcap"]) == 0


def test_a_locohub_table_is_imported_by_the_shipped_map(importing):
    """One of its recordings, in body weights; without saying which, time goes back."""
    pd = pytest.importorskip("pandas", reason="needs the extra tables")
    pytest.importorskip("pyarrow", reason="needs the extra tables")
    time = np.arange(150) / 50.0
    up = np.clip(np.sin(2.0 * np.pi * time / 1.1), 0.0, None)
    one = {
        "time_s": time,
        "step": np.arange(150) // 55,
        "knee_flexion_angle_ipsi_rad": np.radians(flexion(time)),
        "thigh_sagittal_angle_ipsi_rad": 0.3 * np.sin(time),
        "ankle_dorsiflexion_angle_ipsi_rad": 0.2 * np.cos(time),
        "grf_vertical_ipsi_BW": up,
    }
    subjects = [one | {"subject": name, "task": "level_walking"} for name in ("AB01", "AB02")]
    pd.concat(map(pd.DataFrame, subjects)).to_parquet("x_time.parquet")
    own, rows = "body_weight: 800.0\n", "table: {rows: {subject: AB02, task: level_walking}}\n"
    maps = ("--map=locohub", "--map=map.yaml")
    for text, words in (
        (own, "of several recordings choose one (table.rows in the map)"),
        (rows, "unit BW needs body_weight [N] in the map"),
    ):
        assert words in importing.refused(None, text, *maps, files=["x_time.parquet"])
    said = importing(None, own + rows, *maps, files=["x_time.parquet"])
    assert "largest 799.7 N (1.00 BW)" in said


def test_how_parquet_files_are_written(importing):
    """Time as an index, and recordings chosen by the text of whatever their columns hold."""
    pd = pytest.importorskip("pandas", reason="needs the extra tables")
    pytest.importorskip("pyarrow", reason="needs the extra tables")
    time, file = np.arange(150) / 50.0, Path("x.parquet")
    one = {"t": time, "a": flexion(time), "f": load(time)}
    frames = [pd.DataFrame(one | {"text": str(n), "whole": n, "real": float(n)}) for n in (1, 2)]
    pd.concat(frames).set_index("t").to_parquet(file)

    def chosen(choice):
        return None, f"{SIMPLE}table: {{rows: {{{choice}}}}}\n"

    for choice in ("text: 1", "whole: '2'", "real: 2.0"):
        importing(*chosen(choice), files=[file])
        assert len(content()[1]) == 150
    said = importing.refused(*chosen("whole: two"), files=[file])
    assert "has no rows below its names" in said
    data = file.read_bytes()
    file.write_bytes(data[:4] + bytes(300) + data[304:])
    assert "cannot read x.parquet: " in importing.refused(*chosen("whole: 1"), files=[file])


def test_without_a_body_weight_a_strange_load_is_a_warning(importing):
    for times in (0.14, 6.0):
        text = MAP.replace("body_weight: 700.0\n", "")
        said = importing(cells(), text.replace("unit: N", f"unit: N\n  scale: {times}"))
        assert "plausible is 400 to 8000: percent of body weight" in said


def test_files_of_one_trial_make_one_bag(importing):
    """Motion in one, the cells in the other; both have a column time_s."""
    moved = write_csv(Path("motion.csv"), motion())
    text = MAP.replace("goniometer_deg, unit: deg", "knee_flexion_deg, unit: deg, sign: -1")
    importing(cells(), text, files=(moved, "cells.csv"))
    angles, forces = content()
    expected = flexion(1e-9 * np.array(stamps_of(angles)))
    np.testing.assert_allclose(angles_of(angles), expected, atol=1e-5)
    assert angles[0].stamp == 3_000_000  # every row keeps its stamp
    assert forces[0].stamp == 8_333_000  # the first with an angle before it


def test_weights_scale_units_direction_side_and_rate(importing):
    table = cells()
    total = load(table["time_s"])
    table |= {
        "time_s": 1e3 * table["time_s"] + 5000.0,
        "fy": -total / 4.4482216152605,
        "m": 0.01 * total,
    }
    text = """
time: {column: 1, unit: ms, offset: -5.0}
angle: {column: goniometer_deg, unit: deg, joint: left_knee}
load: {column: fy, unit: lbf, direction: tension, scale: 0.5}
moment: {columns: {m: 2}, unit: N*mm}
body_weight: 350
side: left
rate: 100
"""
    importing(table, text)
    angles, forces = content()
    stamps = stamps_of(forces)
    assert stamps == stamps_of(angles) == list(range(0, stamps[-1] + 1, 10_000_000))
    expected = np.interp(1e-9 * np.array(stamps), cells()["time_s"], 0.5 * total)
    np.testing.assert_allclose(loads_of(forces), expected, atol=1e-2)
    np.testing.assert_allclose([force.torque[0] for force in forces], expected * 4e-5, atol=1e-4)
    assert (forces[0].frame_id, angles[0].name) == ("tibia_l", ("left_knee",))


def test_opensim_files_are_tables_too(importing):
    table = cells()
    path = write_storage(Path("q.mot"), table.pop("time_s"), table, "yes")
    text = MAP.replace("{column: time_s}", "{column: time, unit: ms}")  # theirs are s
    importing(None, text, files=[path])
    assert len(content()[0]) == round(120 * SECONDS)
    path.write_text(path.read_text().rstrip().rpartition("\n")[0])
    said = "q.mot has 719 rows, and its header says nRows=720: is it cut off? (--anyway"
    assert said in importing.refused(None, text, files=[path])


SPOILT = {
    "nan": (
        lambda t: t | {"am_n": np.where(t["time_s"] == 1.0, np.nan, t["am_n"])},
        r"column am_n has no number at 1 s, and in 1 of 720 rows .* missing: leave_out",
    ),
    "a fill value": (
        lambda t: t | {"am_n": np.where(np.abs(t["time_s"] - 2.0) < 0.2, -1399.0, t["am_n"])},
        r"the least load is -1\d+.* N, plausible is -700 or more: does it stand for a missing one\?",
    ),
    "negative times": (
        lambda t: t | {"time_s": t["time_s"] - 9.0},
        "no time in common from 0 s on: -9 to -3.0",
    ),
    "time goes back": (
        lambda t: t | {"time_s": np.where(t["time_s"] == 1.0, 0.5, t["time_s"])},
        r"time goes back from 0.991667 to 0.5 s \(rows 120, 121\)",
    ),
    "time stands still": (
        lambda t: t | {"time_s": np.floor(t["time_s"] * 20.0) / 20.0},
        r"in 600 of 720 rows column time_s has the value of the next row",
    ),
    "missing column": (
        lambda t: {("gonio_deg" if n == "goniometer_deg" else n): v for n, v in t.items()},
        r"has no column goniometer_deg \(map: angle\); did you mean gonio_deg\?",
    ),
    "pounds given as newtons": (
        lambda t: t | {n: v / 4.448 for n, v in t.items() if n.endswith("_n")},
        r"the peak of \d+\.\d N is 0\.49\d+ body weights, .*In lbf it would be 2\.2 body",
    ),
}
MAPS = {
    (
        "body_weight",
        "moment: {column: am_n, unit: N*m}\nbody_weight",
    ): r"the largest moment is 3\d+\.\d+ N m, plau.* 0 to 84",
    ("unit: N", "unit: deg"): r"map: load: unit 'deg' is not one of a force; allowed: N, kN",
    ("{column: time_s}", "{column: times}"): r"has no column times; did you mean time_s\?",
    ("700.0", "71.4"): r"^knee-contact: body_weight 71\.4 N: is it kg",
    (
        "unit: deg}",
        "unit: deg, sign: 2}",
    ): r"angle\.sign: 2.* is not allowed; allowed: 1\.0, -1\.0",
    ("{column: goniometer_deg, unit: deg}", "{unit: deg}"): r"angle: .* either column or columns",
    (
        "body_weight",
        "ground_force_x: {column: am_n, unit: N}\nbody_weight",
    ): r"ground_force_x needs ground_force",
    ("load:", "lode:"): r"lode: is not known; did you mean load\?",
    (
        "unit: N",
        "unit: N\n  file: '*.txt'",
    ): r"load\.file: no file is named as \*\.txt; given are cells\.csv",
}
NAMES = b"time_s,pm_n,am_n,al_n,pl_n,goniometer_deg"
FILES = {
    "empty": (b"", "cells.csv is empty"),
    "names only": (NAMES + b"\n", r"has no rows below its names \(line 1\)"),
    "one row": (NAMES + b"\n0,1,2,3,4,5\n", "has 1 row with numbers for angle"),
    "no names": (
        b"0,1,2,3,4,5\n1,1,2,3,4,5\n",
        "line 1 has numbers, and must have the columns' names",
    ),
    "cut off": (NAMES + b"\n0,1,2,3,4,5\n1,1,2", "line 3 has 3 columns, and the names are 6"),
    "infinite": (NAMES + b"\n0,inf,2,3,4,5\n1,1,2,3,4,5\n", "column pm_n has no number"),
    "zeros": (bytes(5000), "is not a text file"),
    "an open quote": (
        NAMES + b'\n"0,1,2,3,4,5\n' + b"1,2,3,4,5,6\n" * 20000,
        "line .* cannot be read: field larger",
    ),
}
REFUSED = {
    **{name: (spoil(cells()), MAP, words) for name, (spoil, words) in SPOILT.items()},
    **{
        f"{old} > {new}": (cells(), MAP.replace(old, new, 1), words)
        for (old, new), words in MAPS.items()
    },
    **{name: (data, MAP, words) for name, (data, words) in FILES.items()},
}
"""What is in cells.csv, what in the map, and what is told"""


@pytest.mark.parametrize("name", REFUSED)
def test_damaged_or_mislabelled_files_are_refused(importing, name):
    made, text, words = REFUSED[name]
    assert (text != MAP) == (" > " in name)
    assert re.search(words, importing.refused(made, text))
    assert {path.name for path in Path().iterdir()} == {"cells.csv", "map.yaml"}


def test_likely_mistakes_are_imported_only_if_the_user_insists(importing):
    said = importing(SPOILT["pounds given as newtons"][0](cells()), MAP, "--anyway")
    assert re.search(r"warning: .* the peak of 3\d\d", said)
    assert "In lbf" in origin(Path("bag"))["doubts"]
    impossible = MAP.replace("{column: goniometer_deg", "{column: pm_n")
    assert importing.refused(cells(), impossible, "--anyway")


def test_rows_without_a_number_are_left_out_if_so_asked_and_gaps_stay(importing):
    table = cells()
    hole = (table["time_s"] > 2.0) & (table["time_s"] < 2.5)
    table["goniometer_deg"] = np.where(hole, np.nan, table["goniometer_deg"])
    for rate, number in (("", 720), ("rate: 120\n", 720 - 59)):
        said = importing(table, f"missing: leave_out\n{rate}{MAP}")
        assert "angle: 59 of 720 rows left out, as a number is missing" in said
        assert "angle: 1 gap longer than 0.1 s, the longest of 0.5 s at 2 s" in said
        assert tuple(map(len, content())) == (720 - 59, number)


def test_in_gaps_of_other_channels_nothing_is_made_up(importing):
    """Load and angle have no gap, the moment one of a second, and the hip another."""
    time = np.arange(150) / 50.0
    hip, moment = ((time <= gap) | (time >= gap + 1.0) for gap in (1.0, 1.5))
    files = [
        write_csv(Path("cells.csv"), {"t": time, "a": flexion(time), "f": load(time)}),
        write_csv(Path("hip.csv"), {"t": time[hip], "h": 0.3 * flexion(time[hip])}),
        write_csv(Path("moment.csv"), {"t": time[moment], "m": 0.01 * load(time[moment])}),
    ]
    text = SIMPLE + "hip: {column: h, unit: deg}\nmoment: {column: m, unit: N*m}\n"
    said = importing(None, text, files=files)
    for name, at in (("hip", "1 s"), ("moment", "1.5 s")):
        assert f"{name}: 1 gap longer than 0.1 s, the longest of 1 s at {at};" in said
    angles, forces = map(stamps_of, content())
    assert angles == np.rint(1e9 * time[hip]).tolist()
    assert forces == np.rint(1e9 * time[moment]).tolist()
    write_csv(files[2], {"t": time[::30] + 0.001, "m": 0.01 * load(time[::30])})
    assert "cells.csv: f: all but 0 rows lie in gaps of another channel" in importing.refused(
        None, text, files=files
    )


def test_rows_with_the_time_of_the_next_are_dropped_and_counted(importing):
    for again, told in (([10], "1 row"), ([10, 20], "2 rows")):
        rows = np.sort(np.append(np.arange(len(cells()["goniometer_deg"])), again))
        said = importing({name: values[rows] for name, values in cells().items()})
        assert f"{told} dropped: the next has the same time" in said


def test_behind_a_gap_a_knee_may_be_anywhere(importing):
    gap = slice(545, 574)  # a quarter of a second
    without = {name: np.delete(values, gap) for name, values in cells().items()}
    assert np.abs(np.diff(without["goniometer_deg"])).max() > 30.0
    assert "angle: 1 gap longer than 0.1 s" in importing(without)


def test_the_body_weight_goes_with_the_bag(importing, capsys):
    """And wins over the default, not over one that the user gives."""
    importing(cells(), MAP.replace("700.0", "560.0"))
    peak = 0.5 * load(cells()["time_s"]).max()
    for weight in (560.0, 600.0, 737.068):
        given = [] if weight == 560.0 else ["-p", f"body_weight:={weight}"]
        assert main(["solve", "bag", "--output=o.mcap", "--overwrite", *given]) == 0
        said = capsys.readouterr()
        assert f"{peak / weight:.2f}" in said.out
        warning = f"body_weight {weight:g} N is used as you gave it, but bag bag was imported with"
        assert (f"{warning} 560 N" in " ".join(said.err.split())) == bool(given)
        assert ("560 N, as bag was imported with" in said.out) != bool(given)


def test_the_body_weight_goes_through_an_estimate_and_a_sweep(importing, capsys):
    """The load node's mass, then the contact node's weight: 560 N is 57.10 kg."""
    time = np.arange(150) / 50.0
    up = 560.0 * np.clip(np.sin(2.0 * np.pi * time / 1.1), 0.0, None)
    text = SIMPLE.replace("load: {column: f", "ground_force: {column: f") + "body_weight: 560\n"
    importing({"t": time, "a": flexion(time), "f": up}, text)
    assert main(["estimate-load", "bag", "--output=loads.mcap"]) == 0
    assert "560 N" in capsys.readouterr().out
    assert main(["estimate-load", "bag", "-p", "person.mass:=80.0", "--output=heavier.mcap"]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "person.mass 80 kg is used as you gave it, but bag bag was imported with 560 N" in said
    assert main(["solve", "loads.mcap", "--output=o.mcap"]) == 0
    assert "560 N, as loads.mcap was imported with" in capsys.readouterr().out
    damping = {"contact.damping": [5e3]}
    swept, given = (
        sweep("loads.mcap", damping, {"load.compartment": "measured_share", **more})
        for more in ({}, {"body_weight": 560.0})
    )
    assert swept.outcomes.peak_force.tolist() == given.outcomes.peak_force.tolist()


def test_columns_in_two_files_are_asked_for(importing):
    both = [write_csv(Path(f"{name}.csv"), cells()) for name in ("a", "b")]
    said = "a.csv and b.csv both have goniometer_deg; say which with angle.file"
    assert said in importing.refused(files=both)
    named = MAP.replace("unit: deg}", "unit: deg, file: 'a*'}", 1)
    importing(None, named.replace("  unit: N", "  unit: N\n  file: b.csv"), files=both)

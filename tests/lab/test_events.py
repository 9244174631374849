"""Gait events that a laboratory has: read from C3D, table or command line, kept with the bag, and used for strides."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pandas", reason="needs the extra notebook")

import pandas as pd

from knee_contact_ros import solve
from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.commands.main import main
from knee_contact_ros.streams.gait_events import HEEL_STRIKE, TOE_OFF
from tests.lab.test_laboratory_files import C3D_MAP, write_c3d
from tests.lab.test_plates import MAP as PLATES
from tests.lab.test_plates import write
from tests.streams.test_gait_events import BODY_WEIGHT, STRIDE, walking

MAP = f"""\
angle: {{column: knee, unit: rad}}
load: {{column: force, unit: N}}
body_weight: {BODY_WEIGHT}
missing: leave_out
"""
LANDS, LEAVES = 0.08, 0.872
"""[s] of heel strike and toe-off in a stride of `walking`"""
LATE = 0.03
"""[s] by which given events are late: more than `LARGEST_ERROR` of found ones"""
EVENT = {
    "LABELS": ["Foot Off", "Foot Strike", "General", "Foot Strike", "Foot Strike", "RTO"],
    "CONTEXTS": ["Right", "Right", "General", "Left", "Right", ""],
    "SUBJECTS": ["Ann", "", "Ann", "Ann", "Ann", "Ann"],
    "TIMES": [[0.0] * 6, [1.0, 1.4, 1.1, 0.9, 0.3, 2.1]],
}
RIGHT = [(0.3, HEEL_STRIKE), (1.0, TOE_OFF), (1.4, HEEL_STRIKE), (2.1, TOE_OFF)]
"""Those of the right leg in `EVENT`"""


def walk(strides=4.0):
    stamps, angle, load = walking(100.0, strides * STRIDE)
    return {"time": (stamps - stamps[0]) / 1e9, "knee": angle, "force": 2.0 * load}


def events_of(bag):
    with Bag(Path(bag)) as opened:
        return [(each.stamp / 1e9, each.kind) for each in opened.gait_events]


def flat(times):
    return [number for minute, second in zip(*times, strict=True) for number in (minute, second)]


@pytest.mark.parametrize("as_pairs", [True, False])
def test_events_of_a_c3d_file_are_those_of_the_leg(importing, as_pairs):
    event = EVENT if as_pairs else {**EVENT, "TIMES": flat(EVENT["TIMES"])}
    write_c3d(["RKneeAngles"], event=event)
    said = importing(None, C3D_MAP + "time: {offset: 5}\n")
    assert "heel strikes 2, toe-offs 2" in said
    assert events_of("bag") == [(pytest.approx(5.0 + at), kind) for at, kind in RIGHT]
    importing(None, C3D_MAP + "side: left\n")
    assert events_of("bag") == [(pytest.approx(0.9), HEEL_STRIKE)]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"SUBJECTS": ["Ann", "Ben", "Ann", "Ann", "Ann", "Ann"]}, "events of Ann, Ben"),
        ({"LABELS": EVENT["LABELS"][:-1]}, "5 events with 6 times are not used"),
        ({"TIMES": [[1.0] * 6, EVENT["TIMES"][1]]}, "toe-offs 0 (4 more outside the data)"),
    ],
)
def test_events_that_are_not_clear_are_left_out_and_told(importing, change, words):
    write_c3d(["RKneeAngles"], event={**EVENT, **change})
    assert words in importing(None, C3D_MAP)
    assert not events_of("bag")


VICON = """\
Events
100
Subject,Context,Name,Time (s),Description
Ann,Left,Foot Strike,0.9,
Ann,Right,Foot Strike,0.3,
Ann,Right,Foot Off,1,
Ann,General,Event,1.2,
Ann,Right,Foot Strike,1.4,
Ann,Right,Foot Off,2.1,

Devices
1000
"""


@pytest.mark.parametrize(
    "table",
    [
        VICON,
        "time;event;side\n0,3;heel strike;R\n1;toe-off;R\n0,9;heel strike;L\n1,4;IC;right\n2,1;TO;r",
        "time,event\n0.3,RHS\n0.9,LHS\n1.0,RTO\n1.4,HS\n2.1,TO",
        "0.3,1,1.4,2.1",
    ],
)
def test_events_of_a_table_or_times_take_the_place_of_the_file_s(importing, table):
    write_c3d(["RKneeAngles"], event=EVENT)
    given = table
    if "\n" in table:
        given = "events.csv"
        Path(given).write_text(table)
    importing(None, C3D_MAP, "--events", given)
    assert events_of("bag") == [(pytest.approx(at), kind) for at, kind in RIGHT]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("1.4,1.0", "no increasing times [s] of heel strike, toe-off, heel strike"),
        ("events.txt", "no such file"),
        ("30,31", "none is within the data, 0 to 4.93 s"),
        ("cells.csv", "need the columns time [s] and event"),
        ("wrong.csv", "soon is no time [s] of an event"),
    ],
)
def test_events_that_cannot_be_used_are_refused(importing, given, words):
    Path("wrong.csv").write_text("time,event\nsoon,HS\n")
    assert words in importing.refused(walk(), MAP, "--events", given)


def lines(*events):
    return "\n".join(["time,event", *(f"{at:.6f},{kind}" for at, kind in events)])


def test_imported_events_make_the_strides_everywhere(importing):
    given = [
        (LATE + number * STRIDE + at, kind)
        for number in range(3)
        for at, kind in ((LANDS, "HS"), (LEAVES, "TO"))
    ]
    Path("events.csv").write_text(lines(*given))
    importing(walk(), MAP, "--events=events.csv")
    assert main(["solve", "bag", "--output=o.mcap"]) == 0
    strikes = [LATE + LANDS + number * STRIDE for number in range(2)]
    for source in ("bag", "o.mcap"):
        table = solve(source).strides()
        # Times in the table have microseconds
        assert table["heel_strike"].tolist() == pytest.approx(strikes, abs=2e-6)
        assert table["toe_off"].tolist() == pytest.approx(
            [at + LEAVES - LANDS for at in strikes], abs=2e-6
        )
        assert main(["report", source, f"--output=of_{source}"]) == 0
        report = pd.read_csv(Path(f"of_{source}", "strides.csv"))
        assert report["heel_strike_s"].tolist() == pytest.approx(strikes, abs=2e-6)


def test_a_single_stride_is_a_cycle_where_the_load_ends_with_it(importing):
    """One plate was hit: the load is known from just before a heel strike to just before the next."""
    table = walk()
    first, last = STRIDE + LANDS, 2.0 * STRIDE + LANDS
    known = (table["time"] > first - 0.15) & (table["time"] < last - 0.02)
    table["force"] = np.where(known, table["force"], np.nan)
    importing(table, MAP)
    assert solve("bag").strides().empty
    times = f"{first},{STRIDE + LEAVES},{last}"
    importing(table, MAP, f"--events={times}")
    cycles = solve("bag").cycles()
    assert len(cycles) == 101
    assert main(["report", "bag", "--output=page"]) == 0
    assert len(pd.read_csv("page/cycles.csv")) == 101


def test_one_plate_of_a_c3d_file_is_enough_for_a_cycle(importing):
    """The events go from the file to the bag, to the estimated load, and to the answers."""
    write()
    importing(None, PLATES, "--events=1.0,1.6,2.2")
    assert main(["estimate-load", "bag", "--params=load/insole", "--output=load.mcap"]) == 0
    (stride,) = solve("load.mcap").strides().itertuples()
    assert stride.heel_strike == pytest.approx(1.0)
    assert stride.stance == pytest.approx(50.0)
    assert stride.usable


def test_an_event_that_nobody_marked_is_no_contradiction(importing):
    times = [(LANDS, "HS"), (LEAVES, "TO"), (LANDS + STRIDE, "HS"), (LANDS + 2 * STRIDE, "HS")]
    Path("events.csv").write_text(lines(*times))
    importing(walk(), MAP, "--events=events.csv")
    assert len(solve("bag").strides()) == 1


@pytest.mark.parametrize("shift", [0.5 * STRIDE, 0.25])
def test_events_that_the_load_contradicts_are_doubted(importing, shift):
    times = ",".join(
        f"{number * STRIDE + at + shift:.3f}" for number in range(3) for at in (LANDS, LEAVES)
    )
    assert "angle and load show a " in importing.refused(walk(), MAP, f"--events={times}")
    importing(walk(), MAP, f"--events={times}", "--anyway")
    with Bag(Path("bag")) as bag:
        assert len(bag.doubts) == 1

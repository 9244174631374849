"""What the commands print fits a terminal of 80 columns, no word of it broken; and `knee-contact table`."""

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros import solve
from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.bags.bag import INPUT_TYPES
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.bags.recover import Recovery, TopicCount
from knee_contact_ros.commands import tables
from knee_contact_ros.commands.tables import show_recovery
from knee_contact_ros.lab import trade
from knee_contact_ros.model.types import FLAT, MESSAGE_FIELDS
from knee_contact_ros.system import terminal
from knee_contact_ros.system.files import share_folder
from tests.helpers.bags import raw_messages
from tests.helpers.commands import run
from tests.helpers.terminals import Terminal
from tests.helpers.walking import walk, walking_bag
from tests.lab.opensim.storages import kinematics, reactions

COLUMNS = 80
MODULES = (tables, terminal)
NO_TABLE = re.compile(r"^(Recording|Bag|Recovered): |^- |^Take ")
"""Files, and what is printed in whole lines"""
RULE = re.compile("─+")

Print = Callable[[], object]
Check = Callable[[Print], None]


@pytest.fixture
def check(monkeypatch, capsys):
    """Lets something print twice, the second time as wide as it wants to be."""

    def both(prints):
        capsys.readouterr()
        prints()
        narrow = capsys.readouterr().out
        with monkeypatch.context() as patch:
            for module in MODULES:
                patch.setattr(module, "WIDTH", 1000)
            prints()
        wide = capsys.readouterr().out
        assert narrow
        lines = [line.rstrip() for line in narrow.splitlines() if not NO_TABLE.match(line)]
        assert [line for line in lines if len(line) > COLUMNS] == []
        assert sorted(RULE.sub("", narrow).split()) == sorted(RULE.sub("", wide).split())

    return both


@pytest.mark.parametrize(
    "more",
    [
        "",
        "--params healthy.yaml --params osteoarthritis.yaml --params mri_femur.yaml",
        "-p load.compartment:=moment_balance -p body_weight:=300",
    ],
)
def test_solve(check, right_bag, tmp_path, more):
    """The last one prints much: the share of the load, and what makes no sense."""
    check(lambda: run(f"solve {right_bag} {more} --overwrite --output {tmp_path}/out.mcap"))


MUCH = (
    "--params load/inverse_dynamics -p calibrated:=true -p pairing.max_gap:=0.001 -p level:=auto"
)


@pytest.mark.parametrize("more", ["", MUCH])
def test_estimate_load(check, tmp_path, more):
    """The last one says much: every estimate but the first is flagged."""
    bag = walking_bag(tmp_path / "walk.mcap", walk(40))
    check(lambda: run(f"estimate-load {bag} {more} --overwrite --output {tmp_path}/out.mcap"))


def test_recover(check, right_bag, tmp_path):
    assert run(f"solve {right_bag} --output {tmp_path}/in.mcap") == 0
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((tmp_path / "in.mcap").read_bytes()[:60_000])
    check(lambda: run(f"recover {cut} {tmp_path}/out.mcap --overwrite"))
    topic = TopicCount(
        "/left_leg/exoskeleton_controller/knee_contact",
        "knee_contact_ros/msg/KneeContact",
        10**6,
        None,
    )
    check(lambda: show_recovery(Recovery([topic], (0, 10**9), 10, 0, []), "out.mcap"))


def test_import_opensim(check, tmp_path):
    angles = kinematics(tmp_path / "q.sto")
    forces = reactions(tmp_path / "jr.sto")
    files = f"--kinematics {angles} --reactions {forces}"
    check(lambda: run(f"import-opensim {files} --side both --overwrite --output {tmp_path}/bag"))


def test_trade(check, right_bag, tmp_path):
    """Of a knee whose contact points differ too."""
    found = trade.measure(solve(right_bag, "mri_knee")[:20], worth=1e-6)
    check(lambda: trade.show_trade(found, Path("trade.png")))


def test_a_line_that_hangs_breaks_between_words_on_a_terminal():
    text = "tolerance  0.05 mm RMS beyond the roughness of 0.041 mm: at most 0.065 mm; 0.064 mm in the slab of a_name"
    code = f"from knee_contact_ros.system.terminal import say; say({text!r}, hang=11)"
    with Terminal("/usr/bin/env", "COLUMNS=80", sys.executable, "-c", code) as terminal:
        printed = terminal.wait_for(r"(?s)^(.*?)\[ended with 0")[1].replace("\r", "").strip("\n")
    first, second = printed.splitlines()
    assert len(first) <= COLUMNS
    assert second.startswith(" " * 11)
    assert printed.split() == text.split()


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("values", [{}, {"load.compartment": "both"}])
def test_a_table_has_every_number_of_every_answer(suffix, values, tmp_path):
    pandas = pytest.importorskip("pandas")
    if suffix == ".parquet":
        parquet = pytest.importorskip("pyarrow.parquet")
    recording, output = tmp_path / "out.mcap", tmp_path / f"table{suffix}"
    solve(share_folder() / "bags" / "gait2354_right", values, output=recording)
    assert run(f"table {recording} --output {output}") == 0
    table = (
        pandas.read_parquet(output)
        if suffix == ".parquet"
        else pandas.read_csv(output, engine="python")
    )
    for topic in table["topic"].unique() if values else ["/knee_contact"]:
        answers = read_answers(recording, topic).view(FLAT)
        own = table[table["topic"] == topic] if values else table
        for name in ("stamp", *MESSAGE_FIELDS):
            assert np.array_equal(own[name], answers[name]), name
        assert np.allclose(own["time"], answers["stamp"] / 1e9, rtol=1e-15, atol=0.0)  # a rounding
    assert len(table) == 387 * (2 if values else 1)
    if suffix == ".parquet":
        about = parquet.read_schema(output).metadata
        assert json.loads(about[b"units"])["load"] == "N"
        assert json.loads(about[b"parameters"])["load.compartment"] == values.get(
            "load.compartment", "fixed_share"
        )
    else:
        assert run(f"table {recording} --output {output} --overwrite --units") == 0
        names = output.read_text().partition("\n")[0].split(",")
        assert {"time [s]", "run", "stamp [ns]", "load [N]", "contact_point_x [m]"} <= {*names}


def test_a_table_that_exists_is_kept(tmp_path, capsys):
    recording, output = tmp_path / "out.mcap", tmp_path / "table.csv"
    solve(share_folder() / "bags" / "gait2354_right", {}, output=recording)
    output.write_text("mine")
    assert run(f"table {recording} --output {output}") == 2
    assert "exists already; choose another name, or --overwrite" in capsys.readouterr().err
    assert output.read_text() == "mine"
    assert run(f"table {recording} --output {output} --overwrite") == 0
    assert output.read_text().startswith("time,")


def test_one_namespace_is_found_and_an_empty_recording_is_told(tmp_path, capsys):
    source, bag, empty = (
        share_folder() / "bags" / "gait2354_right",
        tmp_path / "right.mcap",
        tmp_path / "empty.mcap",
    )
    with BagWriter(bag) as writer, BagWriter(empty) as nothing:
        for topic, kind in INPUT_TYPES.items():
            writer.add_topic(f"/right{topic}", kind)
            nothing.add_topic(topic, kind)
        for message in raw_messages(source, INPUT_TYPES):
            writer.write_message(f"/right{message.topic}", message.log_time, message.data)
    assert run(f"solve {bag} --output {tmp_path}/one.mcap") == 0
    assert run(f"solve {source} --output {tmp_path}/two.mcap") == 0
    one, two = (
        read_answers(tmp_path / name, "/knee_contact") for name in ("one.mcap", "two.mcap")
    )
    assert all(one[name].tobytes() == two[name].tobytes() for name in one.dtype.names)
    capsys.readouterr()
    for command in (f"table {empty} --output t.csv", f"solve {empty} --output {tmp_path}/no.mcap"):
        assert run(command) == 2
        assert "is empty: nothing came while it was written" in capsys.readouterr().err

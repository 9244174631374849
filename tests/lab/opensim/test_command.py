"""`knee-contact import-opensim` as a person runs it: bags, what is printed, and what it says of bad input."""

import json

import numpy as np
import pytest
from mcap.reader import make_reader

from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.bags.bag import INPUT_TYPES
from knee_contact_ros.commands.main import main
from knee_contact_ros.system.files import not_installed
from tests.helpers.offline import solve
from tests.lab.opensim.storages import (
    external,
    kinematics,
    plate,
    reactions,
    write_loads,
    write_model,
    write_storage,
)


@pytest.fixture
def results(tmp_path):
    q, jr = kinematics(tmp_path / "q.sto"), reactions(tmp_path / "jr.sto")
    return ["import-opensim", "--kinematics", str(q), "--reactions", str(jr)]


def origin(bag):
    (path,) = bag.glob("*.mcap")
    with path.open("rb") as file:
        records = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    return records["origin"]


def test_a_bag_comes_out_that_solve_takes(results, tmp_path, capsys):
    bag = tmp_path / "walk"
    assert main([*results, "--side", "right", "--output", str(bag)]) == 0
    said = capsys.readouterr().out
    for part in (
        "knee_angle_r of q.sto",
        "241 rows, 0.000 to 1.200 s, 3.0 to 63.0 deg",
        "degrees to rad, sign turned",
        "largest 1800.0 N at 0.300 s",
        f"Bag: {bag}",
    ):
        assert part in said
    assert sorted(path.name for path in bag.iterdir()) == ["metadata.yaml", "walk_0.mcap"]
    messages = read_bag(bag, INPUT_TYPES)
    assert [message.log_time for message in messages] == sorted(
        message.log_time for message in messages
    )
    assert (messages[0].topic, messages[1].topic) == ("/joint_states", "/joint_reaction_force")
    assert list(messages[0].message.name) == ["knee"]
    assert messages[1].message.header.frame_id == "tibia_r"
    summary = solve(bag, "healthy", tmp_path / "out.mcap")
    assert (summary.ticks, summary.refused.total(), summary.flagged.total()) == (241, 0, 0)
    assert summary.peaks["load"].load == pytest.approx(900.0, rel=1e-9)


def test_the_bag_says_where_it_comes_from_and_nothing_of_this_machine(results, tmp_path):
    bags = [tmp_path / name / "walk" for name in ("a", "b")]
    for bag in bags:
        bag.parent.mkdir()
        assert main([*results, "--side", "left", "--output", str(bag), "--rate", "100"]) == 0
    record = origin(bags[0])
    assert (record["kinematics"], record["columns of angle"], len(record["reactions_sha256"])) == (
        "q.sto",
        "knee_angle_l of q.sto",
        64,
    )
    assert "mirrored" in record["conversions"]
    assert json.loads(record["settings"])["rate"] == 100.0
    assert str(tmp_path) not in "".join(record.values())
    assert (bags[0] / "walk_0.mcap").read_bytes() == (bags[1] / "walk_0.mcap").read_bytes()


def test_both_sides_are_two_bags(results, tmp_path):
    assert main([*results, "--side", "both", "--output", str(tmp_path / "walk")]) == 0
    assert sorted(path.name for path in tmp_path.glob("walk*")) == ["walk_left", "walk_right"]
    assert origin(tmp_path / "walk_left")["side"] == "left"


def test_a_bag_is_replaced_only_when_asked_and_nothing_else_ever(results, tmp_path, capsys):
    bag = tmp_path / "walk"
    arguments = [*results, "--side", "right", "--output", str(bag)]
    assert main(arguments) == 0
    before = (bag / "walk_0.mcap").read_bytes()
    assert main([*arguments, "--rate", "50"]) == 2
    assert "exists already; give another --output, or --overwrite" in capsys.readouterr().err
    assert (bag / "walk_0.mcap").read_bytes() == before
    assert main([*arguments, "--rate", "50", "--overwrite"]) == 0
    assert (bag / "walk_0.mcap").read_bytes() != before
    (bag / "thesis.docx").touch()
    assert main([*arguments, "--overwrite"]) == 2
    assert (
        "is not replaced: it has thesis.docx, and no metadata.yaml says that it belongs"
        in capsys.readouterr().err
    )
    assert (bag / "thesis.docx").exists()
    (bag / "thesis.docx").rename(bag / "monday.mcap")
    assert main([*arguments, "--overwrite"]) == 2
    (bag / "metadata.yaml").unlink()
    (bag / "walk_0.mcap").unlink()
    assert main([*arguments, "--overwrite"]) == 2
    assert capsys.readouterr().err.count("it has monday.mcap, and no") == 2
    bag.rename(tmp_path / "kept")
    bag.symlink_to("kept")
    (tmp_path / "kept" / "monday.mcap").unlink()
    assert main([*arguments, "--overwrite"]) == 0
    assert [*(tmp_path / "kept").iterdir()] == []
    assert not bag.is_symlink()


def test_the_body_weight_judges_the_load_and_is_kept(results, tmp_path, capsys):
    """1800 N are 2.5 body weights of 72.6 kg, and 9 of a child; a mass in kg is found."""
    bag = tmp_path / "walk"
    command = [*results, "--side=right", f"--output={bag}"]
    assert main([*command, "--body-weight=712.0"]) == 0
    assert origin(bag)["body_weight"] == "712 N"
    assert main(["solve", str(bag), f"--output={tmp_path / 'out.mcap'}"]) == 0
    assert "712 N, as walk was imported with" in " ".join(capsys.readouterr().out.split())
    for weight, said in (("72.6", "is it kg"), ("150", "is 12 body weights")):
        assert main([*command, "--overwrite", f"--body-weight={weight}"]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1


MISSING = not_installed("opensim", "opensim").partition("; ")[0]
ONE_SIDE = "--kinematics=q.sto --reactions=jr.sto --side=right --output=walk"
LATE = "late.mot spans 10 to 11 s, and the kinematics 0 to 1.2 s"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (f"{ONE_SIDE} --joint hip_r", "no joint hip_r (--joint); it has knee_r, knee_l"),
        (
            f"{ONE_SIDE} --kinematics cut.sto",
            "120 rows, and its header says nRows=121: is it cut off? (--anyway",
        ),
        (f"{ONE_SIDE} --rate -1", "-1.0 is not in the range 0.0<=x<=10000.0"),
        (f"{ONE_SIDE} --start nan", "'--start': nan is not a finite number"),
        (f"{ONE_SIDE} --speeds none.sto", "cannot read none.sto: No such file"),
        (f"{ONE_SIDE} --setup .", "--kinematics and --setup cannot be given together"),
        (f"{ONE_SIDE} --steps ik", "--steps and --work need --setup"),
        (
            "--kinematics=q.sto --side=right --output=walk",
            "--reactions FILE is missing; or give --setup FOLDER",
        ),
        (f"{ONE_SIDE} --side both --joint knee_r", "give --side right or left with them"),
        (f"{ONE_SIDE} --output walk.mcap", "as a folder; give its name without .mcap"),
        (f"{ONE_SIDE} --output jr.sto --overwrite", "is a file and not a bag's folder"),
        (f"{ONE_SIDE} --ground late.xml", "--ground needs --model M.osim, to find the ankle"),
        (
            f"{ONE_SIDE} --ground --model m.osim",
            "--ground FILE is missing; it is found only with --setup",
        ),
        (f"{ONE_SIDE} --ground late.xml --model m.osim", MISSING),
        (f"{ONE_SIDE} --ground none.xml --model m.osim", "cannot read none.xml"),
        (f"{ONE_SIDE} --ground late.mot --model m.osim", LATE),
        (f"{ONE_SIDE} --ground late.xml --model m.osim", LATE),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    results,
    tmp_path,
    monkeypatch,
    capsys,
    arguments,
    says,
):
    """As if OpenSim were installed, or, without, with a line that says what to install."""
    monkeypatch.chdir(tmp_path)
    write_model(tmp_path / "m.osim")
    whole = (tmp_path / "q.sto").read_text().rstrip()
    (tmp_path / "cut.sto").write_text(whole.rpartition("\n")[0])
    time = np.linspace(10.0, 11.0, 241)
    write_storage(tmp_path / "late.mot", time, plate("ground_force_r_"), "yes")
    force = external("calcn_r", "ground_force_r_", torque="")
    write_loads(tmp_path / "late.xml", "late.mot", [force])
    files = sorted(path.name for path in tmp_path.iterdir())
    monkeypatch.setattr(
        "knee_contact_ros.system.files.find_spec", lambda name: None if says == MISSING else name
    )
    assert main(["import-opensim", *arguments.split()]) == 2
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == files

"""Options on the command line as a user types them; `load` and `estimate-load`."""

import math
import re
import sys
from pathlib import Path

import pytest

from knee_contact_ros import estimate_load as estimate_load_in_python
from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.bags.provenance import change_record, provenance_record
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.commands.live import replay
from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS
from knee_contact_ros.joint_reaction.leg import GRAVITY
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.streams.output import LOAD_PROVENANCE
from knee_contact_ros.streams.topics import INPUTS, LOAD_INPUTS, MESSAGE_TYPES, RECORDED, types_of
from tests.helpers.bags import raw_messages, write_rosbag2
from tests.helpers.commands import run
from tests.helpers.offline import estimate_load
from tests.helpers.walking import WHOLE_LEG, walk, walking_bag

TOPICS = types_of(RECORDED)


def recorded(path):
    return [(m.topic, m.log_time, str(m.message)) for m in read_bag(path, TOPICS)]


def test_solve_takes_inputs_and_parameters_from_elsewhere(right_bag, tmp_path, capsys):
    """The recording has the node's names, and what it would have without all this."""
    gait = raw_messages(right_bag)[:100]
    plain = write_rosbag2(tmp_path / "plain", gait)
    left = write_rosbag2(tmp_path / "left", gait, name=lambda topic: f"/left{topic}")
    damping = "-p contact.damping:=900"
    remaps = " ".join(f"--remap {topic}:=/left/{topic}" for topic in INPUTS)
    assert run(f"solve {plain} {damping} --output {tmp_path}/a.mcap") == 0
    assert run(f"solve {left} --namespace left {damping} --output {tmp_path}/b.mcap") == 0
    assert run(f"solve {left} {remaps} --output {tmp_path}/c.mcap") == 0
    assert recorded(tmp_path / "a.mcap") == recorded(tmp_path / "b.mcap")
    assert recorded(tmp_path / "a.mcap") != recorded(tmp_path / "c.mcap")  # the damping
    each = [
        write_rosbag2(tmp_path / topic[1:], [m for m in gait if m.topic == topic])
        for topic in {m.topic for m in gait}
    ]
    each += [
        write_rosbag2(tmp_path / "late", gait[50:]),
        write_rosbag2(tmp_path / "early", gait[:50]),
    ]
    for number in (0, 2):  # a recorder a topic, and bags that follow each other, in either order
        one, other = each[number : number + 2]
        assert run(f"solve {one} {other} {damping} --output {tmp_path}/{number}.mcap") == 0
        assert recorded(tmp_path / f"{number}.mcap") == recorded(tmp_path / "a.mcap")
    assert capsys.readouterr().err == ""  # no progress bar in a pipe
    assert run(f"solve {plain} {plain} --output {tmp_path}/d.mcap") == 2
    assert capsys.readouterr().err == f"knee-contact: {plain} is given twice\n"
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(next(plain.glob("*.mcap")).read_bytes()[:-100])
    assert run(f"solve {plain} {cut} --output {tmp_path}/e.mcap") == 1
    assert f"knee-contact: bag {plain} and {cut} is damaged, " in (
        reported := capsys.readouterr().err
    )
    assert f"{cut}: the end is missing" in reported  # by the names that were given


@pytest.mark.parametrize(
    ("words", "clock"),
    [
        ("bag", None),
        ("bag --clock", 0.0),
        ("--clock bag", 0.0),
        ("--clock 40 bag", 40.0),
    ],
)
def test_the_clocks_rate_may_be_left_out(words, clock):
    values = replay.make_context("replay", words.split()).params
    assert (values["clock"], values["bag"]) == (clock, Path("bag"))


Output = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def walking(tmp_path_factory):
    """A bag of a walking leg."""
    return walking_bag(tmp_path_factory.mktemp("walk") / "walk.mcap", walk())


@pytest.fixture(scope="module")
def estimated(walking):
    """What is made of it with all that it tells."""
    output = walking.with_name("load.mcap")
    estimate_load(walking, load_parameters(WHOLE_LEG, LoadParameters), output)
    return output


@pytest.mark.parametrize("words", ["load -h", "estimate-load --help"])
def test_help_needs_no_ros_and_names_the_topics(words, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert run(words) == 0
    out, error = capsys.readouterr()
    assert error == ""
    assert out.startswith(f"Usage: knee-contact {words.split(maxsplit=1)[0]} ")
    assert re.search(r"joint_states\s+and\s+/?ground_reaction_force", out)


def test_estimate_load_prints_level_parts_and_deviation(walking, tmp_path, capsys):
    output = tmp_path / "out.mcap"
    values = "--params load/inverse_dynamics -p person.mass:=80"
    assert run(f"estimate-load {walking} {values} --output {output}") == 0
    printed = capsys.readouterr()
    rows = dict(re.findall(r"^ ?((?:  )?[a-z][a-z ]*?)  +(\S.*?) *$", printed.out, re.MULTILINE))
    forces = {
        name: float(value.split()[0])
        for name, value in rows.items()
        if re.match(r"-?\d+\.\d +-?\d+\.\d\d$", value)
    }
    parts = [
        forces[f"  {name}"]
        for name in ("without muscles", "quadriceps", "hamstrings", "gastrocnemius")
    ]
    # Five numbers of one decimal.
    assert sum(parts) == pytest.approx(forces["by the sensors"], abs=0.25)
    half = 0.5 * (forces["by the sensors"] + forces["expected in walking"])
    assert half == pytest.approx(forces["largest joint reaction"], abs=0.1)
    floor, part = LOAD_LEVELS["ankle_moment"].uncalibrated
    deviation = math.hypot(floor * 80.0 * GRAVITY, part * forces["largest joint reaction"])
    assert forces["standard deviation"] == pytest.approx(deviation, abs=0.1)  # one decimal
    assert rows["level"] == "ankle_moment"
    assert rows["constants"].startswith("not calibrated to this person")
    assert rows["parameters"] == "load/inverse_dynamics, person.mass:=80"
    assert rows["estimates"] == "240 in 1.20 s"
    assert (rows["samples refused"], rows["estimates flagged"]) == ("0", "0")
    assert f"Bag: {output}" in printed.out


def test_a_recording_is_computed_again_with_its_own_parameters(
    estimated, tmp_path, monkeypatch, capsys
):
    own = estimate_load_in_python(estimated)
    assert own.tobytes() == estimate_load_in_python(estimated, WHOLE_LEG).tobytes()
    other = estimate_load_in_python(estimated, values={"person.tone": 0.5})
    given = estimate_load_in_python(estimated, [WHOLE_LEG, {"person.tone": 0.5}])
    assert other.tobytes() == given.tobytes()
    assert (own["sensed_force"] < other["sensed_force"]).all()
    assert run(f"estimate-load {estimated} --output {tmp_path}/again.mcap") == 0
    assert re.search(r"parameters +those in load\.mcap", capsys.readouterr().out)
    assert estimate_load_in_python(tmp_path / "again.mcap").tobytes() == own.tobytes()


def test_changed_parameters_in_a_recording_are_reported(tmp_path, capsys):
    bag = tmp_path / "changed.mcap"
    with BagWriter(bag) as writer:
        for topic in LOAD_INPUTS:
            writer.add_topic(f"/{topic}", MESSAGE_TYPES[topic])
        writer.add_metadata(
            LOAD_PROVENANCE, provenance_record(load_parameters(WHOLE_LEG, LoadParameters))
        )
        writer.add_metadata("parameters_changed", change_record(10, {"person.tone": 0.5}))
        writer.add_metadata("parameters_changed", change_record(20, {"diagnostics.timeout": 2.0}))
        for message in walk():
            writer.write_message(message.topic, message.log_time, message.data)
    assert run(f"estimate-load {bag} --output {tmp_path}/again.mcap") == 0
    assert "parameters changed 1 times in it; those of its beginning are used" in " ".join(
        capsys.readouterr().err.split()
    )
